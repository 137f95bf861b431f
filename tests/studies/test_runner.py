"""Studies that are killed, interrupted, spread over processes and over a cluster end with the same tables."""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from optkit.basics.errors import InputError
from optkit.studies import run_cell as work
from optkit.studies import runner
from optkit.studies.cells import Cell
from optkit.studies.grids import Study
from optkit.studies.runner import Outcome, load, run_cells
from optkit.studies.store import CellStore
from optkit.studies.tables import study_tables

SETTINGS = {"horizon": 6, "split": (8, 3, 3)}
STUDY = Study("sensitivity", settings=SETTINGS)
CELLS = STUDY.cells()[:12]


def texts(run):
    """All tables as text, to the last digit."""
    return {name: frame.to_csv(index=False) for name, frame in study_tables(run).items()}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A study that nothing disturbed, the store of its cells, and seconds that a cell took."""
    store, ends = CellStore(tmp_path_factory.mktemp("whole")), []
    run = run_cells(CELLS, store, progress=lambda *_: ends.append(time.monotonic()))
    assert run.fresh == len(CELLS)
    return run, store, (ends[-1] - ends[1]) / (len(CELLS) - 1)  # the first cell loads what all need


@pytest.fixture(scope="module")
def whole(undisturbed):
    """Its tables."""
    return texts(undisturbed[0])


@pytest.fixture
def half_done(undisturbed, tmp_path):
    """A store of one's own with the first eight cells."""
    store = CellStore(tmp_path)
    for cell in CELLS[:8]:
        shutil.copy(undisturbed[1].path(cell), store.path(cell))
    return store


@pytest.mark.slow
def test_what_is_finished_is_not_worked_out_again_and_what_was_damaged_is(half_done, whole, monkeypatch):
    half_done.path(CELLS[3]).write_text("{")
    assert run_cells(CELLS, half_done).fresh == 5
    monkeypatch.setattr(work, "run_cell", lambda *_: pytest.fail("worked out again"))
    again = run_cells(CELLS, half_done)
    assert (again.fresh, again.failed, texts(again)) == (0, {}, whole)


@pytest.mark.slow
def test_a_cell_that_fails_does_not_stop_the_others(tmp_path, whole):
    """An unknown policy, and one whose training leads nowhere; the rest is in two processes as it was in one."""
    place = CELLS[0].place
    bad = [
        Cell("policy", place, {"policy": "Guess", "seed": 0}),
        Cell("perturbed", place, {"epsilon": -1.0, "draw": 0, "value": "linear", "seed": 0}),
    ]
    run = run_cells([*bad, *CELLS], CellStore(tmp_path), jobs=2)
    assert run.failed[bad[0].key].startswith("no policy 'Guess'")
    assert run.failed[bad[1].key].startswith("epsilon = -1.0 must be")
    assert run.missing == bad
    assert texts(run) == whole


def test_progress_ends_at_the_number_of_cells(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(work, "run_cell", lambda cell, trips: {"cell": cell.key})
    run_cells(CELLS[:5], CellStore(tmp_path), progress=lambda *told: seen.append(told))
    assert [done for done, _, _ in seen] == [0, 1, 2, 3, 4, 5]
    assert {total for _, total, _ in seen} == {5}
    left = [seconds for _, _, seconds in seen]
    assert left[0] > 0
    assert left[-1] == pytest.approx(0.0, abs=1e-9)


def _started(folder, jobs):
    """Work the cells out in a process that leads a group of its own; return its number once it begins."""
    ready, begun = os.pipe()
    child = os.fork()  # spares what a new process would import
    if child == 0:
        try:
            os.setsid()
            os.write(begun, b".")
            run_cells(CELLS, CellStore(folder), jobs=jobs)
        finally:
            os._exit(0)
    os.close(begun)
    os.read(ready, 1)
    os.close(ready)
    return child


@pytest.mark.slow
def test_killed_at_twenty_random_moments(tmp_path, undisturbed, whole):
    """SIGKILL to the whole process group, at moments spread over the work; nothing half written is ever read."""
    longest = 3 * undisturbed[2]
    rng, finished = random.Random(0), []
    for attempt in range(20):
        child = _started(tmp_path, 2 if attempt % 5 == 4 else 1)
        time.sleep(rng.uniform(0.0, longest))
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        store = CellStore(tmp_path)
        finished.append(len(load(CELLS, store).found))
        assert store.damaged == 0
    assert finished == sorted(finished)
    assert finished[-1] > 0
    run = run_cells(CELLS, CellStore(tmp_path))
    assert run.fresh == len(CELLS) - finished[-1]
    assert texts(run) == whole
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_finished(half_done, whole):
    def stop(done, total, left):
        if done == 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cells(CELLS, half_done, progress=stop)
    run = run_cells(CELLS, half_done)
    assert (run.fresh, texts(run)) == (len(CELLS) - 10, whole)


@pytest.mark.slow
def test_processes_that_are_killed_are_replaced(tmp_path, monkeypatch):
    """A cell that kills its process once is worked out by another."""
    mark = tmp_path / "killed"

    def kills_once(cell, trips):
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return cell.key, Outcome({"cell": cell.key}, 0.0, None)  # as good as any, and nothing to load

    monkeypatch.setattr(runner, "_attempt", kills_once)
    run = run_cells(CELLS[:8], CellStore(tmp_path / "cells"), jobs=2)
    assert mark.exists()
    assert {key: kept.result for key, kept in run.found.items()} == {c.key: {"cell": c.key} for c in CELLS[:8]}


@pytest.mark.slow
@pytest.mark.parametrize("dask", [None, "local"])
def test_a_cell_that_always_kills_its_process_does_not_stop_the_others(tmp_path, monkeypatch, dask):
    """It is named as failed, and all else is there; on a cluster too, where joblib's own backend waits for ever."""
    bad = Cell("perturbed", CELLS[0].place, {"epsilon": 1.0, "draw": 99, "value": "linear", "seed": 0})
    deadly = bad.key

    def kills(cell, trips):
        if cell.key == deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return cell.key, Outcome({"cell": cell.key}, 0.0, None)

    monkeypatch.setattr(runner, "_attempt", kills)
    if dask:
        pytest.importorskip("distributed", reason="Dask is missing: pip install 'optkit[dask]'")
    run = run_cells([bad, *CELLS], CellStore(tmp_path), jobs=2, dask=dask)
    assert run.missing == [bad]
    assert re.search("killed|KilledWorker", run.failed[bad.key])
    assert {key: kept.result for key, kept in run.found.items()} == {cell.key: {"cell": cell.key} for cell in CELLS}


@pytest.mark.slow
def test_libraries_that_are_loaded_late_have_one_thread_too():
    """The first cell with the network in a process, before which nothing has loaded torch."""
    pytest.importorskip("torch", reason="torch is missing: pip install 'optkit[attention]'")
    program = (
        "import sys\n"
        "from types import SimpleNamespace\n"
        "from optkit.studies import runner\n"
        "from optkit.studies.cells import Cell\n"
        "def see(*_):\n"
        "    import torch\n"
        "    print(torch.get_num_threads())\n"
        "    return {}\n"
        "assert 'torch' not in sys.modules\n"
        "sys.modules['optkit.studies.run_cell'] = SimpleNamespace(run_cell=see)\n"
        "place = {'scenario': 'I.1', 'world': 0, 'set': {}}\n"
        "runner._attempt(Cell('policy', place, {'policy': 'Attention, true MNL', 'seed': 0}), ())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env={**os.environ, "OMP_NUM_THREADS": "2"},
    )  # fmt: skip
    assert done.stdout.strip() == "1"


@pytest.fixture
def scheduler(tmp_path):
    """A Dask scheduler and two workers, each a process of its own; without nannies: who is killed stays dead.

    They are one program that loads Dask and then becomes three.
    """
    pytest.importorskip("distributed", reason="Dask is missing: pip install 'optkit[dask]'")
    file = str(tmp_path / "scheduler.json")
    program = """if True:
        import json, os, sys
        from distributed.cli import dask_scheduler, dask_worker

        numbers = []
        for main, arguments in zip([dask_scheduler.main, dask_worker.main, dask_worker.main], json.loads(sys.argv[1])):
            numbers.append(os.fork())
            if numbers[-1] == 0:
                sys.stdout.close()
                main(arguments)
                os._exit(0)
        print(json.dumps(numbers), flush=True)
        for number in numbers:
            os.waitpid(number, 0)
        """
    where = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", file]
    worker = ["--nthreads", "1", "--no-nanny", *where]
    command = [sys.executable, "-c", program, json.dumps([["--port", "0", *where], worker, worker])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        numbers = json.loads(process.stdout.readline())
        address = _awaited(lambda: json.loads(Path(file).read_text())["address"])
        from distributed import Client

        with Client(address, timeout=30) as client:
            client.wait_for_workers(2, timeout=60)
        yield address, numbers[1]
        for number in numbers:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)


def _awaited(look, seconds=30.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            return look()
        except (OSError, ValueError, KeyError):
            time.sleep(0.1)
    return look()


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_gives_the_same_results(tmp_path, monkeypatch, scheduler):
    """A real scheduler; one of two workers is killed when a third of the cells is there.

    Cells are light, so that workers need not load the kit; those of the page on clusters are real.
    """
    address, worker = scheduler
    killed = []

    def light(cell, trips):
        time.sleep(0.05)
        return cell.key, Outcome({"cell": cell.key}, 0.05, None)

    def kill(done, total, left):
        if done >= 4 and not killed:
            os.kill(worker, signal.SIGKILL)
            killed.append(done)

    monkeypatch.setattr(runner, "_attempt", light)
    run = run_cells(CELLS, CellStore(tmp_path / "cells"), dask=address, progress=kill)
    assert killed[0] < len(CELLS)
    assert (run.failed, run.missing) == ({}, [])
    assert {key: kept.result for key, kept in run.found.items()} == {cell.key: {"cell": cell.key} for cell in CELLS}


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "SECONDS_TO_CONNECT", 0.1)
    pytest.importorskip("distributed", reason="Dask is missing: pip install 'optkit[dask]'")
    with pytest.raises(InputError, match=r"there is no Dask scheduler at tcp://127\.0\.0\.1:9"):
        run_cells(CELLS, CellStore(tmp_path), dask="tcp://127.0.0.1:9")


def test_without_dask_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'optkit\[dask\]'"):
        run_cells(CELLS, CellStore(tmp_path), dask="local")
