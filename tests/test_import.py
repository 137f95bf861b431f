"""Importing optkit is quiet and light, and its top level is what it says."""

import importlib
import json
import os
import pkgutil
import subprocess
import sys

import pytest

import optkit
from tests.layers import GROUND, ORDER, ROOT, arrows, circles, depth, imported, module_circles

HEAVY = [
    "cvxpy",
    "statsmodels",
    "sklearn",
    "torch",
    "matplotlib",
    "pandas",
    "highspy",
    "ortools",
    "clarabel",
    "pyarrow",
    "typer",
]


USE = """
import json, sys

def loaded():
    return sorted({name.partition(".")[0] for name in sys.modules})

import optkit

face = loaded()
import logging, warnings
import numpy as np, scipy.sparse, scipy.special  # which bring filters of their own

def take():
    state = np.random.get_state()[1].tolist()
    return logging.root.handlers[:], logging.root.level, warnings.filters[:], np.geterr(), np.get_printoptions(), state

np.random.seed(1)
before = take()
from optkit import Instance, OptkitError, performance_ratio, scenario, simulate
from optkit.models.pricing import optimal_prices
from optkit.policies import Formula, PostDecisionPricing

days = scenario("I.1", horizon=5).sample(4, seed=0)
simulate(days[:1], PostDecisionPricing())
optimal_prices([1.0], [0.0])
assert take() == before
from optkit.gap.report import gap_report
from optkit.learning.training import train
import optkit.models.value.attention.value
from optkit.studies.run_cell import run_cell

train(days, choice="true")
assert take() == before
print(json.dumps([face, loaded()]))
"""


@pytest.fixture(scope="module")
def used():
    """What a process prints that imports optkit, draws, simulates, prices and trains: the modules it has loaded."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", USE],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert (done.returncode, done.stderr) == (0, "")  # and nothing has changed, see there
    (printed,) = done.stdout.splitlines()
    return [set(names) for names in json.loads(printed)]


@pytest.mark.slow
def test_import_is_quiet_and_light(used):
    """Importing optkit prints nothing and loads no library, not even NumPy."""
    assert used[0].isdisjoint([*HEAVY, "numpy", "scipy"])


def test_use_is_quiet_and_loads_only_what_is_used(used):
    """Drawing, simulating, pricing and training print nothing and load none of the heavy libraries.

    They leave logging, warnings and NumPy's error handling and random state as they were.
    """
    assert used[1].isdisjoint(HEAVY)


FACE = {
    "ConditionalLogit": "optkit.models.estimation",
    "Formula": "optkit.policies",
    "Instance": "optkit.instances.instance",
    "OptkitError": "optkit.basics.errors",
    "PostDecisionPricing": "optkit.policies",
    "RewardPercentage": "optkit.policies",
    "acceptance_probabilities": "optkit.models.choice",
    "arrival_information": "optkit.bounds",
    "certify": "optkit.models.pricing",
    "full_information": "optkit.bounds",
    "gap_report": "optkit.gap.report",
    "optimal_prices": "optkit.models.pricing",
    "performance_ratio": "optkit.simulation.metrics",
    "scenario": "optkit.instances.catalogue",
    "simulate": "optkit.simulation.simulator",
    "train": "optkit.learning.training",
}
"""What a person reaches for first, and where it is documented."""


@pytest.mark.parametrize("name", sorted({*FACE, *optkit.__all__} - {"__version__"}))
def test_every_public_name_is_there(name):
    """Each name that is promised, and no other, is the very thing of the module where it is documented."""
    assert name in FACE, "a public name belongs into the table of this test"
    assert name in optkit.__all__
    thing = getattr(optkit, name)
    assert thing is getattr(importlib.import_module(FACE[name]), name)
    assert thing.__name__ == name
    assert callable(thing)
    assert thing.__doc__


def test_dir_lists_the_public_names():
    """dir() shows the public names, for completion in a notebook."""
    assert dir(optkit) == sorted([*FACE, "__version__"])
    assert sorted(optkit.__all__) == sorted([*FACE, "__version__"])


def test_unknown_name():
    """An unknown name is an AttributeError as in any module, and an ImportError when imported."""
    with pytest.raises(AttributeError, match="module 'optkit' has no attribute 'nonsense'"):
        _ = optkit.nonsense
    with pytest.raises(ImportError):
        exec("from optkit import nonsense")
    assert not hasattr(optkit, "nonsense")


def test_errors_form_one_tree():
    """Every exception of optkit.basics.errors derives from OptkitError, so that one except clause catches all."""
    from optkit.basics import errors

    own = [thing for thing in vars(errors).values() if isinstance(thing, type) and issubclass(thing, Exception)]
    assert len(own) >= 6
    assert all(issubclass(thing, optkit.OptkitError) for thing in own)


def test_version_is_one():
    """The version is a plain string of numbers."""
    assert [part.isdigit() for part in optkit.__version__.split(".")] == [True] * 3


PACKAGES = sorted(
    ".".join(("optkit", *path.parent.relative_to(ROOT).parts))
    for path in ROOT.rglob("__init__.py")
    if "teach" not in path.parts
)


def test_dir_of_every_package_is_its_face():
    """A package's dir() lists its public names, or, where it offers none of its own, its modules; nothing else."""
    for name in PACKAGES:
        package = importlib.import_module(name)
        names = set(getattr(package, "__all__", ()))
        assert all(hasattr(package, one) for one in names), name
        inside = set() if names else {one.name for one in pkgutil.iter_modules(package.__path__)}
        shown = {one for one in dir(package) if not one.startswith("__")}
        assert shown <= names | inside, (name, shown)


@pytest.mark.slow
def test_imports_point_down():
    """Every file imports from packages below its own in the declared order, nested files and late imports too."""
    rank = {name: height for height, names in enumerate(ORDER) for name in names}
    assert set(rank) == set(arrows())
    for here, there in arrows().items():
        assert all(rank[name] < rank[here] for name in there), (here, {n for n in there if rank[n] >= rank[here]})


@pytest.mark.slow
def test_there_are_few_units_and_no_circle():
    """At most 16 units in at most 9 layers; only the face and the door of ``python -m optkit`` lie loose."""
    graph = arrows()
    assert {path.name for path in ROOT.glob("*.py")} == {"__init__.py", "__main__.py"}
    assert len(graph) <= 16
    assert depth(graph) <= len(ORDER) <= 9
    assert circles(graph) == []
    assert module_circles() == []


@pytest.mark.slow
@pytest.mark.parametrize(("part", "others"), [("models", ()), ("bounds", ("optkit.models",))])
def test_mathematics_knows_errors_arrays_seeds_and_the_instance_only(part, others):
    """``models`` knows nothing else of the kit, ``bounds`` the models besides."""
    own = (f"optkit.{part}", *others)
    for path in (ROOT / part).rglob("*.py"):
        strange = {
            n for n in imported(path) if n not in GROUND and not any(n == o or n.startswith(f"{o}.") for o in own)
        }
        assert not strange, (path, strange)


def test_the_checks_of_imports_see_nested_files(tmp_path):
    """A wrong import in a nested file, inside a function, is found; so is a circle of two files."""
    for name, text in {
        "__init__.py": "",
        "models/__init__.py": "",
        "models/value/__init__.py": "",
        "models/value/deep.py": "def f():\n    from optkit.gap import report\n",
        "gap/__init__.py": "",
        "gap/report.py": "from optkit.models.value import deep\n",
    }.items():
        path = tmp_path / "optkit" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    root = tmp_path / "optkit"
    assert arrows(root) == {"__init__": set(), "gap": {"models"}, "models": {"gap"}}
    assert circles(arrows(root)) == [("gap", "models")]
    assert module_circles(root) == [("optkit.gap.report", "optkit.models.value.deep")]


@pytest.mark.slow
def test_the_command_line_is_also_a_module():
    """``python -m optkit`` is the command line."""
    done = subprocess.run([sys.executable, "-m", "optkit", "--version"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert optkit.__version__ in done.stdout
