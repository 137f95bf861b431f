"""Docstrings of all that the reference lists are complete, and every public name of the kit has one."""

import dataclasses
import importlib
import inspect
import pkgutil
import re
from pathlib import Path
from types import FunctionType

import pytest

import optkit

validate = pytest.importorskip("numpydoc.validate", reason="numpydoc is missing: pip install 'optkit[docs]'").validate

REFERENCE = sorted((Path(__file__).parents[2] / "docs" / "reference").glob("*.rst"))
PUBLIC = [
    "optkit.instances.instance.Instance",
    "optkit.instances.catalogue.scenario",
    "optkit.simulation.simulator.simulate",
    "optkit.simulation.metrics.performance_ratio",
    "optkit.models.pricing.optimal_prices",
    "optkit.models.pricing.certificate.certify",
    "optkit.models.pricing_program.PricingProgram",
    "optkit.models.choice.acceptance_probabilities",
    "optkit.models.estimation.ConditionalLogit",
    "optkit.policies.reward_percentage.RewardPercentage",
    "optkit.policies.formula.Formula",
    "optkit.policies.post_decision.PostDecisionPricing",
    "optkit.bounds.full.full_information.full_information",
    "optkit.bounds.arrival.arrival_information.arrival_information",
    "optkit.bounds.penalised.penalized.penalized",
    "optkit.bounds.exact.exact_value.exact_value",
]
"""What the kit promises, by its home; the reference must list it."""

EVERYWHERE = {
    "GL03": "no two blank lines in a row",
    "GL05": "no tabs",
    "GL06": "known sections only",
    "GL07": "sections in the usual order",
    "GL08": "there is a docstring",
    "GL09": "deprecation before the summary's end",
    "GL10": "directives have two colons",
    "SS01": "there is a summary",
    "SS03": "the summary ends with a full stop",
    "SS04": "the summary does not begin with spaces",
    "PR02": "no parameter that does not exist",
    "PR03": "parameters in their order",
    "PR04": "parameters have a type",
    "PR07": "parameters have a description",
    "PR09": "which ends with a full stop",
    "PR10": "a space before the type's colon",
    "RT03": "what is returned has a description",
    "RT04": "which begins with a capital letter",
    "RT05": "and ends with a full stop",
}
"""Checks of everything in the reference, methods and properties too."""

OF_FUNCTIONS = {
    "PR01": "all parameters are documented",
    "RT01": "what is returned is documented",
    "YD01": "what is yielded is documented",
    "EX01": "there is an example, which the doctests run",
}
"""Checks of functions and classes. A method says in a sentence what it takes and gives."""


def modules():
    """Return the kit's modules that can be imported here."""
    for found in pkgutil.walk_packages(optkit.__path__, "optkit."):
        if ".teach" in found.name or any(part.startswith("_") for part in found.name.split(".")):
            continue  # notebooks
        try:
            yield importlib.import_module(found.name)
        except ImportError as error:
            # An extra that is not installed is left out; anything else is an error.
            if (error.name or "optkit").startswith("optkit"):
                raise


def own(module):
    """Return the public functions and classes that a module defines."""
    return [
        name
        for name, thing in vars(module).items()
        if not name.startswith("_")
        and (inspect.isclass(thing) or inspect.isfunction(thing))
        and thing.__module__ == module.__name__
    ]


def listed():
    """Return what the reference lists: functions and classes by their home."""
    found = []
    for page in REFERENCE:
        for name, members in re.findall(r"automodule:: (\S+)\n(?:   :members:(.*)\n)?", page.read_text()):
            if re.search(rf"automodule:: {re.escape(name)}\n   :members:", page.read_text()):
                module = importlib.import_module(name)
                names = [one.strip() for one in members.split(",") if one.strip()] or own(module)
                found += [f"{name}.{one}" for one in names if isinstance(getattr(module, one), type | FunctionType)]
    return found


def of_name(name):
    """Return the object of a dotted name."""
    module, _, short = name.rpartition(".")
    return getattr(importlib.import_module(module), short)


LISTED = listed()


def members(cls):
    """Return the public methods and properties that a class defines itself."""
    kinds = (classmethod, staticmethod, property)
    return [
        name
        for name, thing in vars(cls).items()
        if not name.startswith("_") and (isinstance(thing, kinds) or inspect.isfunction(thing))
    ]


def complaints(name, checks):
    """Return what numpydoc says against a docstring, of the checks that count here."""
    return [f"{name}: {code} {said}" for code, said in validate(name)["errors"] if code in checks]


def checks_of(thing):
    """Return the checks for a function or a class."""
    checks = {**EVERYWHERE, **OF_FUNCTIONS}
    if inspect.isclass(thing):
        sections = re.findall(r"^(\w+)\n-+$", inspect.getdoc(thing) or "", re.M)
        if "Attributes" in sections and "Parameters" not in sections:
            # What functions return is not made by hand: attributes take the place of parameters.
            del checks["PR01"], checks["EX01"]
        elif issubclass(thing, Exception) or getattr(thing, "_is_protocol", False):
            del checks["PR01"], checks["EX01"]
    return checks


@pytest.mark.slow
@pytest.mark.parametrize("name", LISTED)
def test_docstrings_of_the_reference_are_complete(name):
    """Parameters, returns and an example of every function and class; methods and properties are described."""
    thing = of_name(name)
    found = complaints(name, checks_of(thing))
    if inspect.isclass(thing):
        for member in members(thing):
            found += complaints(f"{name}.{member}", EVERYWHERE)
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", [name for name in LISTED if dataclasses.is_dataclass(of_name(name))])
def test_attributes_are_documented(name):
    """A dataclass that lists attributes lists all of its fields."""
    doc = inspect.getdoc(of_name(name)) or ""
    fields = [one.name for one in dataclasses.fields(of_name(name)) if one.init and not one.name.startswith("_")]
    section = doc.partition("Attributes\n----------\n")[2] or doc.partition("Parameters\n----------\n")[2]
    described = {
        word.strip() for line in re.findall(r"^([\w, ]+?)(?: :.*)?$", section, re.M) for word in line.split(",")
    }
    assert set(fields) <= described, f"{name}: {sorted(set(fields) - described)}"


def test_the_reference_lists_what_the_kit_promises():
    """Every name of the public surface is in the reference, once."""
    assert set(PUBLIC) <= set(LISTED)
    assert len(LISTED) == len(set(LISTED))


@pytest.mark.slow
def test_everything_public_has_a_docstring():
    """All public modules, functions, classes and methods of the kit say what they are."""
    silent = []
    for module in modules():
        if not module.__doc__:
            silent.append(module.__name__)
        for name in own(module):
            thing = getattr(module, name)
            silent += [] if inspect.getdoc(thing) else [f"{module.__name__}.{name}"]
            if inspect.isclass(thing):
                silent += [f"{module.__name__}.{name}.{m}" for m in members(thing) if not getattr(thing, m).__doc__]
    assert not silent, silent


def test_a_poor_docstring_is_found():
    """The checks fail where a parameter or an example is missing."""
    assert any("PR01" in one for one in complaints("inspect.getdoc", OF_FUNCTIONS))


def test_files_that_pages_and_docstrings_name_are_there():
    """Documents and docstrings send readers to files that exist, and to no document that readers lack."""
    root = Path(__file__).parents[2]
    texts = [*root.glob("*.md"), *(root / "benchmarks").glob("*.md")]
    texts += [one for end in ("md", "rst") for one in (root / "docs").rglob(f"*.{end}") if "_build" not in one.parts]
    texts += [one for end in ("py", "md") for one in (root / "optkit").rglob(f"*.{end}")]
    cited = 0
    for path in texts:
        text = path.read_text()
        assert not re.search(r"\bdesign,? sections? \d", text), path
        named = re.findall(r"\b(?:docs|optkit|tests)/[\w/-]+\.(?:md|rst|py|csv|j2)\b", text)
        cited += len(named)
        assert all((root / name).exists() for name in named), (path, [n for n in named if not (root / n).exists()])
    assert cited > 30


def test_what_the_code_cites_is_there():
    """A page of the explanation, and its heading; never a document that readers do not have."""
    root = Path(__file__).parents[2]
    cited = 0
    for path in sorted((root / "optkit").rglob("*.py")):
        text = re.sub(r"\s+", " ", path.read_text())
        assert not re.search("design section", text, re.IGNORECASE), path
        for page, heading in re.findall(r'``(docs/explanation/\w+\.md)``(?:, "([^"]+)")?', text):
            lines = (root / page).read_text().splitlines()
            assert not heading or any(line.lstrip("# ") == heading and line[0] == "#" for line in lines if line), path
            cited += 1
    assert cited > 20
