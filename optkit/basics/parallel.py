"""One function over many things, in one process or several, with the answers as they come."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

from optkit.basics.arrays import whole_number
from optkit.basics.errors import SolverError
from optkit.basics.users_code import printing_aside, prints_aside

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

Task = TypeVar("Task")
Answer = TypeVar("Answer")


MOST_JOBS = 1_000
"""Processes that one machine is asked for at most: each takes a tenth of a gigabyte."""


PATIENCE = 4.0
"""Seconds of work that are left to one process: several take a second or two to begin."""


def check_jobs(jobs: int, name: str = "n_jobs") -> int:
    """Return a number of processes, with 0 for one per core; InputError if it is none or beyond any machine."""
    return whole_number(name, jobs, least=0, most=MOST_JOBS) or os.cpu_count() or 1


def in_parallel(
    function: Callable[[Task], Answer], tasks: Sequence[Task], jobs: int | None = 1
) -> Iterator[tuple[int, Answer]]:
    """Yield the number of each task with its answer, in the order in which they are done.

    Every call runs with one BLAS thread, so that the last digit does not depend on the number of processes.

    Parameters
    ----------
    function : callable
        Of one task; closures and lambdas may go to other processes too.
    tasks : sequence
    jobs : int or None
        Processes; with 1 all is done in this one. None begins in this one, and takes one per core for the rest once the
        first tasks have shown that it would last longer than :data:`PATIENCE`.

    Raises
    ------
    SolverError
        If a process was killed.

    Examples
    --------
    >>> sorted(in_parallel(abs, [-3, 4]))
    [(0, 3), (1, 4)]
    """
    numbered = list(enumerate(tasks))
    begun = time.perf_counter()
    for done, item in enumerate(numbered if jobs is None else []):
        spent = time.perf_counter() - begun
        if done and spent / done * (len(numbered) - done) > PATIENCE:
            numbered, jobs = numbered[done:], os.cpu_count() or 1
            break
        yield _call(function, item, prints_aside())
    if jobs is None:
        return
    jobs = min(jobs, len(numbered))
    if jobs <= 1:
        for item in numbered:
            yield _call(function, item, prints_aside())
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    try:
        yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(
            delayed(_call)(function, item, prints_aside()) for item in numbered
        )
    except TerminatedWorkerError as error:
        raise SolverError("a worker process was killed, perhaps for want of memory: take fewer processes") from error


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which the libraries of linear algebra take one thread each.

    To look for them takes milliseconds, as long as many a task: that is done anew once a module was imported.
    """
    limited: AbstractContextManager[Any] = _libraries(len(sys.modules)).limit(limits=1)
    return limited


@lru_cache(maxsize=1)
def _libraries(_: int) -> ThreadpoolController:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _call(function: Callable[[Any], Any], item: tuple[int, Any], aside: bool) -> tuple[int, Any]:
    number, task = item
    with one_thread(), printing_aside(aside):
        return number, function(task)
