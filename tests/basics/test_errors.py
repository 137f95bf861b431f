"""The tree of exceptions."""

import inspect

import pytest

from optkit.basics import errors

classes = [c for _, c in inspect.getmembers(errors, inspect.isclass) if issubclass(c, BaseException)]


@pytest.mark.parametrize("error", classes, ids=lambda c: c.__name__)
def test_every_exported_error_is_an_optkit_error_and_says_when_it_is_raised(error):
    assert issubclass(error, errors.OptkitError)
    assert error.__doc__


@pytest.mark.parametrize(
    ("error", "builtin"),
    [(errors.InputError, ValueError), (errors.SolverError, RuntimeError), (errors.MissingExtraError, ImportError)],
)
def test_errors_can_be_caught_by_the_builtin_that_a_reader_expects(error, builtin):
    assert issubclass(error, builtin)


def test_the_module_exports_nothing_but_errors():
    public = {name for name, _ in inspect.getmembers(errors, inspect.isclass) if not name.startswith("_")}
    assert public == {c.__name__ for c in classes}
