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
def whole(tmp_path_factory):
    """Tables of a study that nothing disturbed."""
    run = run_cells(CELLS, CellStore(tmp_path_factory.mktemp("whole")))
    assert run.fresh == len(CELLS)
    return texts(run)


@pytest.mark.slow
def test_the_number_of_processes_does_not_matter(tmp_path, whole):
    assert texts(run_cells(CELLS, CellStore(tmp_path), jobs=2)) == whole


@pytest.mark.slow
def test_what_is_finished_is_not_worked_out_again(tmp_path, whole, monkeypatch):
    store = CellStore(tmp_path)
    assert run_cells(CELLS[:8], store).fresh == 8
    assert run_cells(CELLS, store).fresh == 4
    monkeypatch.setattr(work, "run_cell", lambda *_: pytest.fail("worked out again"))
    again = run_cells(CELLS, store)
    assert (again.fresh, again.failed, texts(again)) == (0, {}, whole)


@pytest.mark.slow
def test_what_was_damaged_is_worked_out_again(tmp_path, whole):
    store = CellStore(tmp_path)
    run_cells(CELLS, store)
    store.path(CELLS[3]).write_text("{")
    run = run_cells(CELLS, store)
    assert (run.fresh, texts(run)) == (1, whole)


@pytest.mark.slow
def test_a_cell_that_fails_does_not_stop_the_others(tmp_path, whole):
    """An unknown policy, and one whose training leads nowhere; the rest is as it was."""
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


@pytest.mark.slow
def test_progress_ends_at_the_number_of_cells(tmp_path):
    seen = []
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
def test_killed_at_twenty_random_moments(tmp_path, whole):
    """SIGKILL to the whole process group, at moments spread over the work; nothing half written is ever read."""
    rng, finished = random.Random(0), []
    for attempt in range(20):
        child = _started(tmp_path, 2 if attempt % 5 == 4 else 1)
        time.sleep(rng.uniform(0.0, 0.2))
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
def test_an_interrupt_keeps_what_is_finished(tmp_path, whole):
    def stop(done, total, left):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_cells(CELLS, CellStore(tmp_path), progress=stop)
    run = run_cells(CELLS, CellStore(tmp_path))
    assert (run.fresh, texts(run)) == (len(CELLS) - 4, whole)


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
    """A Dask scheduler and two workers, each a process of its own; without nannies: who is killed stays dead."""
    pytest.importorskip("distributed", reason="Dask is missing: pip install 'optkit[dask]'")
    dask = shutil.which("dask", path=str(Path(sys.executable).parent)) or shutil.which("dask")
    assert dask is not None
    file, processes = tmp_path / "scheduler.json", []

    def start(*arguments):
        processes.append(subprocess.Popen([dask, *arguments], stderr=subprocess.DEVNULL))
        return processes[-1]

    where = ["--port", "0", "--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
    start("scheduler", *where)
    address = _awaited(lambda: json.loads(file.read_text())["address"])
    worker = ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
    workers = [start(*worker) for _ in range(2)]
    from distributed import Client

    with Client(address, timeout=30) as client:
        client.wait_for_workers(2, timeout=60)
    yield address, workers
    for process in processes:
        process.kill()
        process.wait()


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
    address, workers = scheduler

    def light(cell, trips):
        time.sleep(0.05)
        return cell.key, Outcome({"cell": cell.key}, 0.05, None)

    def kill(done, total, left):
        if done >= 4 and workers[0].poll() is None:
            workers[0].kill()
            workers[0].wait()

    monkeypatch.setattr(runner, "_attempt", light)
    run = run_cells(CELLS, CellStore(tmp_path / "cells"), dask=address, progress=kill)
    assert workers[0].returncode == -signal.SIGKILL
    assert (run.failed, run.missing) == ({}, [])
    assert {key: kept.result for key, kept in run.found.items()} == {cell.key: {"cell": cell.key} for cell in CELLS}


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_said(tmp_path):
    pytest.importorskip("distributed", reason="Dask is missing: pip install 'optkit[dask]'")
    with pytest.raises(InputError, match=r"there is no Dask scheduler at tcp://127\.0\.0\.1:9"):
        run_cells(CELLS, CellStore(tmp_path), dask="tcp://127.0.0.1:9")


def test_without_dask_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'optkit\[dask\]'"):
        run_cells(CELLS, CellStore(tmp_path), dask="local")
