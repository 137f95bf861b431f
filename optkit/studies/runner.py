"""Working a study's cells out, here or on a cluster, and keeping each as soon as it is there."""

from __future__ import annotations

import json
import logging
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_all_start_methods
from typing import TYPE_CHECKING, Any, NamedTuple

from optkit.basics.errors import InputError, OptkitError
from optkit.basics.parallel import check_jobs, one_thread
from optkit.basics.plain_json import to_json
from optkit.studies.cells import Cell
from optkit.studies.policies import POLICIES, Spec
from optkit.studies.store import CellStore, Stored

if TYPE_CHECKING:
    from optkit.studies.run_cell import Result

SECONDS: dict[str, float] = {"bounds": 1.2, "utilities": 0.5, "estimate": 0.8, "perturbed": 1.0, "gap": 95.0}
"""What a cell takes on one core by kind, measured on I.1: for the plan, and so that the longest begin first."""

POLICY_SECONDS: dict[str | None, float] = {
    None: 0.5,
    "linear": 1.5,
    "kernel": 1.5,
    "attention": 7.5,
    "attention-printed": 15.0,
}

BUSY = {"I.2": 0.6, "I.3": 2.5, "II": 2.0, "nyc-weak": 0.6, "nyc-strong": 0.6}
GAP_BUSY = {"I.2": 0.65, "I.3": 4.2, "II": 3.0, "nyc-weak": 0.2, "nyc-strong": 0.2}
"""How much longer a cell of another scenario takes than one of I.1, and the cell of its gap."""

SECONDS_TO_CONNECT = 10.0
"""How long a Dask scheduler is waited for, since it may start later than what asks for it."""


class Outcome(NamedTuple):
    """What became of one cell."""

    result: Result | None
    seconds: float
    error: str | None


@dataclass
class StudyRun:
    """A study's cells and what is known of them.

    Attributes
    ----------
    cells : list of Cell
    found : dict from key to Stored
        Finished cells.
    failed : dict from key to str
        Why a cell could not be worked out.
    fresh : int
        Number of cells that were worked out by this call.
    """

    cells: Sequence[Cell]
    found: dict[str, Stored]
    failed: dict[str, str] = field(default_factory=dict)
    fresh: int = 0

    @property
    def missing(self) -> list[Cell]:
        """Cells without a result."""
        return [cell for cell in self.cells if cell.key not in self.found]

    def results(self, kind: str, scenario: str | None = None) -> Iterator[tuple[Cell, Result]]:
        """Yield the finished cells of a kind with their results, in the order of the grid."""
        for cell in self.cells:
            fits = cell.kind == kind and scenario in (None, cell.place["scenario"])
            if fits and cell.key in self.found:
                yield cell, self.found[cell.key].result

    @property
    def expected_seconds(self) -> float:
        """What the missing cells should take on one core."""
        return sum(expected_seconds(cell) for cell in self.missing)


Progress = Callable[[int, int, float], object]
"""Called with cells done, their number, and the seconds of work that are left, as far as that is known."""


def expected_seconds(cell: Cell) -> float:
    """What a cell should take on one core.

    Parameters
    ----------
    cell : Cell
        What is to be worked out.

    Returns
    -------
    float
        Seconds, on the machine of the kept benchmarks.

    Examples
    --------
    >>> expected_seconds(Cell("gap", {"scenario": "I.3", "world": 0}, {}))
    399.0
    """
    if cell.kind == "policy":
        spec = POLICIES.get(cell.settings["policy"], Spec())
        base = 6.0 if spec.rule == "FP" else POLICY_SECONDS[spec.value]
    else:
        base = SECONDS[cell.kind]
    return base * (GAP_BUSY if cell.kind == "gap" else BUSY).get(cell.place["scenario"], 1.0)


def load(cells: Sequence[Cell], store: CellStore) -> StudyRun:
    """Look up what is finished of some cells.

    Parameters
    ----------
    cells : sequence of Cell
        The study's, in the order of its tables.
    store : CellStore
        Where results are kept.

    Returns
    -------
    StudyRun
        The finished cells.

    Examples
    --------
    >>> import tempfile
    >>> cell = Cell("policy", {"scenario": "I.1", "world": 0}, {"policy": "PP", "seed": 0})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     load([cell], CellStore(folder)).missing == [cell]
    True
    """
    found = {cell.key: kept for cell in cells if (kept := store.get(cell)) is not None}
    return StudyRun(cells, found)


def run_cells(
    cells: Sequence[Cell],
    store: CellStore,
    *,
    trips: tuple[str, ...] = (),
    jobs: int = 1,
    dask: str | None = None,
    progress: Progress | None = None,
) -> StudyRun:
    """Work out the cells that are missing, and keep each as soon as it is there.

    A cell that fails does not stop the others. Results do not depend on the number of processes, on the order in which
    they come, or on how often the work was interrupted.

    Parameters
    ----------
    cells : sequence of Cell
        The study's, in the order of its tables.
    store : CellStore
        Where results are kept.
    trips : tuple of str
        Files of trip records; with ``dask`` on several machines, every one of these must find them there.
    jobs : int
        Processes on this machine, 0 for one per core.
    dask : str, optional
        Address of a Dask scheduler, like ``tcp://host:8786``, or "local" for a cluster of ``jobs`` workers here; needs
        ``optkit[dask]``.
    progress : callable, optional
        See :data:`Progress`.

    Returns
    -------
    StudyRun
        Results, and why a cell has none.

    Raises
    ------
    InputError
        If the number of processes is negative, or there is no such scheduler.
    OptkitError
        If the disk refuses.

    Examples
    --------
    >>> import tempfile
    >>> place = {"scenario": "I.2", "world": 0, "set": {"horizon": 15, "split": [20, 4, 4]}}
    >>> cells = [Cell("policy", place, {"policy": name, "seed": 0}) for name in ("PP", "Myopic, true MNL")]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     first = run_cells(cells, CellStore(folder))
    ...     again = run_cells(cells, CellStore(folder))
    >>> first.fresh, again.fresh, first.missing
    (2, 0, [])
    """
    jobs = check_jobs(jobs)
    run = load(cells, store)
    total = len(cells)
    left = run.expected_seconds
    # Seconds spent on seconds expected: the machine's own measure, from the cells done so far.
    spent, expected = 0.0, 0.0
    if progress is not None:
        progress(total - len(run.missing), total, left / jobs)

    def keep(cell: Cell, outcome: Outcome) -> None:
        nonlocal left, spent, expected
        left -= expected_seconds(cell)
        if outcome.result is None:
            run.failed[cell.key] = str(outcome.error)
        else:
            store.put(cell, outcome.result, outcome.seconds)
            run.found[cell.key] = Stored(outcome.result, outcome.seconds)
            run.fresh += 1
            spent, expected = spent + outcome.seconds, expected + expected_seconds(cell)
        if progress is not None:
            pace = spent / expected if expected else 1.0
            progress(len(run.found) + len(run.failed), total, max(left, 0.0) * pace / jobs)

    def waiting() -> list[Cell]:
        found = (cell for cell in run.missing if cell.key not in run.failed)
        return sorted(found, key=expected_seconds, reverse=True)

    with _engine(jobs, dask) as engine:
        while True:
            try:
                for cell, outcome in engine(waiting(), trips):
                    keep(cell, outcome)
                return run
            except _KilledError:
                # Which cell it was is not known, only that joblib hands out twice as many as there are processes. Each
                # of these is tried alone, so that one that always kills its process does not take the others with it.
                for suspect in waiting()[: 2 * jobs]:
                    try:
                        for cell, outcome in engine([suspect], trips):
                            keep(cell, outcome)
                    except _KilledError as error:
                        keep(suspect, Outcome(None, 0.0, str(error)))


class _KilledError(Exception):
    """A process that worked a cell out was killed."""


_Engine = Callable[[Sequence[Cell], tuple[str, ...]], Iterator[tuple[Cell, Outcome]]]


@contextmanager
def _engine(jobs: int, dask: str | None) -> Iterator[_Engine]:
    """Yield what works cells out and gives them as they come."""
    if dask is not None:
        with _dask(jobs, dask) as engine:
            yield engine
    elif jobs == 1:
        yield _in_this_process
    else:
        yield lambda cells, trips: _joblib(cells, trips, jobs)


def _in_this_process(cells: Sequence[Cell], trips: tuple[str, ...]) -> Iterator[tuple[Cell, Outcome]]:
    for cell in cells:
        yield cell, _attempt(cell, trips)[1]


def _joblib(cells: Sequence[Cell], trips: tuple[str, ...], jobs: int) -> Iterator[tuple[Cell, Outcome]]:
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    by_key = {cell.key: cell for cell in cells}
    # One cell at a time, so that each is kept when it is done and the longest do not end up behind each other.
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    try:
        with warnings.catch_warnings():
            # A process that has grown is replaced, which is as it should be.
            warnings.filterwarnings("ignore", message="A worker stopped", category=UserWarning)
            for key, outcome in parallel(delayed(_attempt)(cell, trips) for cell in cells):
                yield by_key[key], outcome
    except TerminatedWorkerError:
        raise _KilledError("its process was killed, perhaps for want of memory (take fewer processes)") from None


@contextmanager
def _dask(jobs: int, address: str) -> Iterator[_Engine]:
    """Yield an engine on a Dask cluster, which replaces workers that are lost by itself."""
    try:
        import dask
        from distributed import LocalCluster
    except ImportError:
        raise InputError("--dask needs Dask: pip install 'optkit[dask]'") from None
    from joblib import parallel_config

    cluster: Any = address
    with ExitStack() as started:
        if address == "local":
            if "forkserver" in get_all_start_methods():  # Dask is loaded once for all workers
                started.enter_context(dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}))
            # What its workers log of themselves, also while they end, is nothing to a person: failed cells are named.
            cluster = LocalCluster(  # type: ignore[no-untyped-call]
                n_workers=jobs, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
            )
            started.callback(cluster.close)
        client = started.enter_context(_client(cluster, address))

        def engine(cells: Sequence[Cell], trips: tuple[str, ...]) -> Iterator[tuple[Cell, Outcome]]:
            blamed = []
            with parallel_config(_backend(client)):
                for cell, outcome in _joblib(cells, trips, -1):
                    if len(cells) > 1 and str(outcome.error).startswith("KilledWorker"):
                        blamed.append(cell)
                    else:
                        yield cell, outcome
            # Dask blames all that waited where a worker died; each is tried with no other beside it.
            for cell in blamed:
                yield from engine([cell], trips)

        yield engine


@contextmanager
def _client(cluster: Any, address: str) -> Iterator[Any]:
    """Yield a client of a Dask cluster that has workers."""
    from distributed import Client

    try:
        client = Client(cluster, timeout=SECONDS_TO_CONNECT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise InputError(f"there is no Dask scheduler at {address}: {str(error).splitlines()[0]}") from None
    try:
        if not client.scheduler_info()["workers"]:
            raise InputError(f"the Dask scheduler at {address} has no workers: start some with dask worker {address}")
        yield client
    finally:
        client.close()  # type: ignore[no-untyped-call]


def _backend(client: Any) -> Any:
    """Return joblib's backend for Dask, mended: it never tells of tasks that Dask itself gives up, and so waits on."""
    from joblib._dask import DaskDistributedBackend

    class Backend(DaskDistributedBackend):  # type: ignore[misc]
        def submit(self, func: Any, callback: Any = None) -> Any:
            cell = func.items[0][1][0]

            def tell(done: Any) -> None:
                if not done.cancelled() and (error := done.exception()) is not None:
                    callback([(cell.key, Outcome(None, 0.0, f"{type(error).__name__}: {error}"))])

            future = super().submit(func, callback)
            future.add_done_callback(tell)
            return future

    return Backend(client=client, pure=False)


def _attempt(cell: Cell, trips: tuple[str, ...]) -> tuple[str, Outcome]:
    """Work a cell out, and say why if that fails. One BLAS thread, so that the last digit is the same everywhere."""
    from optkit.studies.run_cell import run_cell  # here, since it loads nearly all of the kit: to plan needs none of it

    started = time.perf_counter()
    try:
        if str(POLICIES.get(cell.settings.get("policy", ""), Spec()).value).startswith("attention"):
            import optkit.models.value.attention.network  # noqa: F401  # what is loaded later would keep its threads
        with one_thread():
            result = json.loads(to_json(run_cell(cell, trips)))  # as it will be read again
        return cell.key, Outcome(result, time.perf_counter() - started, None)
    except Exception as error:  # a failed cell, of whatever cause, must not stop the others
        told = str(error) if isinstance(error, OptkitError) else f"{type(error).__name__}: {error}"
        return cell.key, Outcome(None, time.perf_counter() - started, told)
