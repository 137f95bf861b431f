"""Code of the user's own: each way to fail is one line."""

import json
import sys

import pytest

from optkit.basics.errors import InputError, PolicyError
from optkit.basics.parallel import in_parallel
from optkit.basics.users_code import name_of, printing_aside, users_code


def test_names():
    """Functions have their own; what else can be called has that of its class."""

    class Priced:
        def __call__(self):
            """Be callable."""

    assert [name_of(one) for one in (test_names, Priced, Priced(), max)] == ["test_names", "Priced", "Priced", "max"]


def test_where_it_failed():
    """The place is the user's, though a library raises; the class of the error is the caller's choice."""
    said = r"^mine failed \(JSONDecodeError: .*\) in test_users_code.py, line \d+$"
    with pytest.raises(InputError, match=said) as caught, users_code("mine", InputError):
        json.loads("{")
    assert type(caught.value.__cause__).__name__ == "JSONDecodeError"


def test_what_succeeds_is_left_alone():
    """Nothing is raised, and an error of the kit is the same one."""
    with users_code("mine"):
        pass
    mine = PolicyError("x")
    with pytest.raises(PolicyError) as caught, users_code("mine"):
        raise mine
    assert caught.value is mine


def where_it_prints(_):
    with users_code("mine"):
        return sys.stdout is sys.stderr


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_it_prints_is_no_command_s_answer(jobs, capsys):
    """It goes to standard error while a command runs, in other processes too, and where it wants to otherwise."""
    assert not any(aside for _, aside in in_parallel(where_it_prints, range(3), jobs))
    with printing_aside():
        assert all(aside for _, aside in in_parallel(where_it_prints, range(3), jobs))
        with users_code("mine"):
            print("mine")
        print("the command's")
    assert tuple(capsys.readouterr()) == ("the command's\n", "mine\n")
