"""The tree of exceptions."""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import optkit
from optkit.basics import errors

ROOT = Path(optkit.__file__).parent
DERIVED = re.compile(r"\bclass\s+\w+\s*\([^:]*(Error|Exception|Interrupt|Exit)")


def exceptions(root=ROOT):
    """Module and name of every public exception that a file below root defines, by what its bases are called."""
    for path in sorted(root.rglob("*.py")):
        module = ".".join((root.name, *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        text = path.read_text()
        if not DERIVED.search(text):  # most files, which need not be parsed
            continue
        for thing in ast.walk(ast.parse(text)):
            if isinstance(thing, ast.ClassDef) and not thing.name.startswith("_"):
                bases = {ast.unparse(base).rpartition(".")[2] for base in thing.bases}
                if any(base.endswith(("Error", "Exception", "Interrupt", "Exit")) for base in bases):
                    yield module, thing.name


EXCEPTIONS = list(exceptions())


@pytest.mark.parametrize(("module", "name"), EXCEPTIONS, ids=[name for _, name in EXCEPTIONS])
def test_every_error_of_the_kit_is_an_optkit_error_and_says_when_it_is_raised(module, name):
    """Whichever file defines it: one except clause catches all."""
    error = getattr(import_module(module), name)
    assert issubclass(error, errors.OptkitError)
    assert inspect.cleandoc(error.__doc__).endswith(".")


def test_the_errors_are_found():
    """Those of the one module are among them, and none is missed because its base is called otherwise."""
    found = {name for module, name in EXCEPTIONS if module == errors.__name__}
    assert {"OptkitError", "InputError", "InstanceError", "DataError", "PolicyError", "SolverError"} <= found
    assert found == {name for name, thing in vars(errors).items() if isinstance(thing, type)}


@pytest.mark.parametrize(
    ("error", "builtin"),
    [(errors.InputError, ValueError), (errors.SolverError, RuntimeError), (errors.MissingExtraError, ImportError)],
)
def test_errors_can_be_caught_by_the_builtin_that_a_reader_expects(error, builtin):
    assert issubclass(error, builtin)


def test_the_module_offers_errors():
    """Its public classes are errors made there, and no module that it imports shows."""
    public = {name: thing for name, thing in vars(errors).items() if not name.startswith("_")}
    made = {name for name, thing in public.items() if not inspect.isfunction(thing)}
    assert not {name for name in made if getattr(public[name], "__module__", "") != errors.__name__}
    assert all(issubclass(public[name], errors.OptkitError) for name in made)
