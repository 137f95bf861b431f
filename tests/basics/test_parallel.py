"""One function over many things, in several processes."""

import os
import time

import numpy as np
import pytest

from optkit.basics import parallel
from optkit.basics.errors import InputError, SolverError
from optkit.basics.parallel import check_jobs, in_parallel


@pytest.mark.parametrize("jobs", [1, 2, None])
def test_answers_belong_to_their_tasks(jobs):
    """Whatever the order, each number comes once with the answer to its task; closures travel."""
    factor = 3
    found = dict(in_parallel(lambda x: factor * x, range(7), jobs))
    assert found == {i: 3 * i for i in range(7)}


@pytest.mark.slow
def test_processes_are_taken_where_it_lasts(monkeypatch):
    """What is quick is done in this process; what would last begins here and goes on in others."""
    here = os.getpid()
    assert {pid for _, pid in in_parallel(lambda x: os.getpid(), range(50), None)} == {here}
    monkeypatch.setattr(parallel, "PATIENCE", 0.2)

    def slow(x):
        time.sleep(0.05)
        return x, os.getpid()

    found = dict(in_parallel(slow, range(12), None))
    assert [found[i][0] for i in range(12)] == [*range(12)]
    assert found[0][1] == here
    assert len({pid for _, pid in found.values()}) > 1


def test_the_last_digit_does_not_depend_on_processes():
    """Products of matrices come out the same, because BLAS has one thread everywhere."""
    matrices = [np.random.default_rng(k).normal(size=(300, 300)) for k in range(3)]
    one, two = (dict(in_parallel(lambda x: (x @ x).sum(), matrices, jobs)) for jobs in (1, 2))
    assert one == two


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_come_through(jobs):
    """An error of the function is raised as it is."""

    def fails(x):
        raise InputError(f"not {x}")

    with pytest.raises(InputError, match="not a"):
        list(in_parallel(fails, ["a"] * 3, jobs))


@pytest.mark.slow
def test_a_process_that_is_killed_is_said():
    """The end of a worker process is an error of ours with a remedy."""
    with pytest.raises(SolverError, match="killed"):
        list(in_parallel(lambda x: os._exit(9), [1, 2, 3], 2))


def test_jobs_are_checked():
    """0 is one per core; a negative number or half a process is refused."""
    assert check_jobs(0) >= 1
    assert check_jobs(3) == 3
    for wrong in (-1, 1.5, True):
        with pytest.raises(InputError, match="n_jobs"):
            check_jobs(wrong)
