"""Importing optkit is quiet and light, and its top level is what it says."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import optkit

HEAVY = [
    "cvxpy",
    "statsmodels",
    "sklearn",
    "matplotlib",
    "pandas",
    "highspy",
    "ortools",
    "clarabel",
    "pyarrow",
    "typer",
]


def fresh(code):
    """Run code in a fresh interpreter; return what it printed and which modules it loaded."""
    report = "; import sys, json; print('\\x00' + json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code + report],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert done.returncode == 0, done.stderr
    printed, modules = done.stdout.split("\x00")
    return printed + done.stderr, {name.partition(".")[0] for name in json.loads(modules)}


def test_import_is_quiet_and_light():
    """Importing optkit prints nothing and loads no library, not even NumPy."""
    printed, modules = fresh("import optkit")
    assert printed == ""
    assert modules.isdisjoint([*HEAVY, "numpy", "scipy"])


@pytest.mark.parametrize(
    "code",
    [
        "from optkit import Instance, OptkitError, performance_ratio, scenario, simulate",
        "from optkit import scenario; scenario('I.1').sample(1, seed=0)",
        "from optkit import scenario, simulate; from optkit.policies import Formula, PostDecisionPricing;"
        "simulate(scenario('I.1').sample(1, seed=0), PostDecisionPricing())",
        "from optkit.models.pricing import optimal_prices; optimal_prices([1.0], [0.0])",
    ],
    ids=["names", "sample", "simulate", "price"],
)
def test_use_loads_only_what_is_used(code):
    """Drawing, simulating and pricing print nothing and load none of the heavy libraries."""
    printed, modules = fresh(code)
    assert printed == ""
    assert modules.isdisjoint(HEAVY)


def test_import_changes_nothing():
    """Importing optkit leaves logging, warnings and NumPy's error handling and random state as they were.

    SciPy is loaded beforehand: it brings filters of its own.
    """
    code = (
        "import logging, warnings, numpy as np, scipy.sparse, scipy.special; np.random.seed(1);"
        "take = lambda: (logging.root.handlers[:], logging.root.level, warnings.filters[:], np.geterr(),"
        "  np.get_printoptions(), np.random.get_state()[1].tolist());"
        "before = take(); from optkit import scenario, simulate; from optkit.policies import PostDecisionPricing;"
        "simulate(scenario('I.1').sample(1, seed=0), PostDecisionPricing()); assert take() == before"
    )
    assert fresh(code)[0] == ""


def test_every_public_name_is_there():
    """All names of the top level can be loaded, and come from the modules where they are documented."""
    for name in optkit.__all__:
        assert getattr(optkit, name) is not None
    from optkit.instance import Instance
    from optkit.simulator import simulate

    assert optkit.Instance is Instance
    assert optkit.simulate is simulate


def test_dir_lists_the_public_names():
    """dir() shows the public names, for completion in a notebook."""
    assert dir(optkit) == sorted(optkit.__all__)
    assert {"Instance", "scenario", "simulate", "performance_ratio", "OptkitError"} <= set(dir(optkit))


def test_unknown_name():
    """An unknown name is an AttributeError as in any module, and an ImportError when imported."""
    with pytest.raises(AttributeError, match="module 'optkit' has no attribute 'nonsense'"):
        _ = optkit.nonsense
    with pytest.raises(ImportError):
        exec("from optkit import nonsense")
    assert not hasattr(optkit, "nonsense")


def test_errors_form_one_tree():
    """Every exception of optkit.errors derives from OptkitError, so that one except clause catches all."""
    from optkit import errors

    own = [thing for thing in vars(errors).values() if isinstance(thing, type) and issubclass(thing, Exception)]
    assert len(own) >= 6
    assert all(issubclass(thing, optkit.OptkitError) for thing in own)


def test_version_is_one():
    """The version is a plain string of numbers."""
    assert [part.isdigit() for part in optkit.__version__.split(".")] == [True] * 3


def test_imports_point_one_way():
    """optkit.models knows instances, errors, arrays and seeds, optkit.bounds also the models; neither knows more."""
    root = Path(__file__).parents[1] / "optkit"
    allowed = {"optkit.instance", "optkit.errors", "optkit.arrays", "optkit.seeds"}
    for part, known in (("models", ["models"]), ("bounds", ["bounds", "models"])):
        own = tuple(f"optkit.{one}." for one in known)
        for path in (root / part).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                names = [node.module] if isinstance(node, ast.ImportFrom) else []
                names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                kit = {name for name in names if name and name.split(".")[0] == "optkit"}
                assert all(name in allowed or f"{name}.".startswith(own) for name in kit), (
                    path.name,
                    kit,
                )
