"""optkit study, called as a user calls it."""

import json
import shutil
from functools import partial

import pandas as pd
import pytest

from optkit.studies import grids, runner
from optkit.studies import run_cell as work
from optkit.studies.report.figures import study_figures
from optkit.studies.report.maps import bubble_grid
from optkit.studies.store import CellStore
from tests import command_line
from tests.command_line import strict

SETTINGS = {"split": (10, 3, 3), "horizon": 6}
SMALL = ["--draws", 2, "--set", "split=10,3,3", "--set", "horizon=6"]
FEW = ["--set", "split=6,4,2", "--set", "horizon=10"]


@pytest.fixture
def few_cells(monkeypatch):
    """The bounds and the first cells of each kind, of one scenario."""
    whole = grids.Study.cells

    def few(study):
        cells = [cell for cell in whole(study) if cell.place == whole(study)[0].place]
        return [cell for i, cell in enumerate(cells) if [one.kind for one in cells[:i]].count(cell.kind) < 2]

    monkeypatch.setattr(grids.Study, "cells", few)


@pytest.fixture
def no_figures(monkeypatch):
    """Reports without figures, where these are not what is tested."""
    monkeypatch.setattr("optkit.studies.report.report.study_figures", lambda tables, trips: {})


@pytest.fixture(scope="module")
def one_figure():
    """Reports with one figure of the study of sensitivity: the tests of figures draw the others."""

    def few(tables, trips):
        return {"sens_syn": bubble_grid(tables, "I.1")}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("optkit.studies.report.report.study_figures", few)
        yield


@pytest.fixture
def study(monkeypatch, optkit):
    """Run the verb in this process, without the network; return exit status, output and errors."""
    monkeypatch.setattr(grids, "find_spec", lambda _: None)
    return partial(optkit, "study")


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "timings.csv"}


@pytest.fixture(scope="module")
def finished(one_figure, tmp_path_factory):
    """A folder with a small study, what was planned before it ran, and what it told."""
    out = tmp_path_factory.mktemp("finished")
    common = ["study", "sensitivity", *SMALL, "--out", out, "--jobs", 1]
    planned = command_line.optkit(*common, "--dry-run", check=0).stdout
    assert not (out / "cells").exists()
    return out, planned, command_line.optkit(*common, "--json", check=0).stdout


@pytest.mark.slow
def test_a_study_is_planned_run_and_not_run_again(study, one_figure, finished):
    """Plan, results, and a second call that works nothing out and writes the same files."""
    folder, planned, run = finished
    common = ["sensitivity", *SMALL, "--out", folder, "--jobs", 1]
    assert "sensitivity: 34 cells (2 bounds, 32 perturbed), 34 to be worked out" in planned
    (told,) = strict(run)
    assert (told["cells"], told["fresh"], told["failed"]) == (34, 34, {})
    assert {claim["result"] for claim in told["claims"]} == {2, 4}
    first = files(folder / "sensitivity")
    assert "report.html" in first
    assert len(pd.read_csv(folder / "sensitivity" / "sensitivity.csv")) == 32
    status, out, _ = study(*common)
    assert status == 0
    assert "34 of 34 cells, 0 worked out now" in out
    assert files(folder / "sensitivity") == first
    status, out, _ = study(*common, "--dry-run", "--json")
    assert strict(out)[0]["missing"] == 0


@pytest.mark.slow
def test_force_works_out_anew(study, few_cells, no_figures, tmp_path):
    """All cells again, here in one process after two: the same tables."""
    common = ["heterogeneous", *SMALL, "--out", tmp_path, "--no-gap", "--seeds", 1, "--json"]
    before = strict(study(*common, "--jobs", 2)[1])[0]
    again = strict(study(*common, "--jobs", 1, "--force")[1])[0]
    assert again["fresh"] == before["fresh"] == before["cells"]
    assert again["tables"] == before["tables"]


def test_worlds_are_numbers_or_seeds(study, tmp_path):
    for text, worlds in (("2", {"world 0", "world 1"}), ("4,7", {"world 4", "world 7"})):
        _, out, _ = study("heterogeneous", "--worlds", text, "--out", tmp_path, "--dry-run", "--json")
        assert {cell.split(": ")[0].split(", ")[1] for cell in strict(out)[0]["list"]} == worlds


def test_all_without_trips_says_what_is_left_out(study, tmp_path, monkeypatch):
    _, out, _ = study("all", "--out", tmp_path, "--dry-run", "--json")
    assert [plan["study"] for plan in strict(out)] == ["homogeneous", "heterogeneous", "sensitivity"]


@pytest.mark.slow
def test_a_failed_cell_is_reported_and_the_status_says_so(study, finished, no_figures, tmp_path, monkeypatch):
    """The cells of one draw fail, and are named; all others are there, and make the report."""
    shutil.copytree(finished[0] / "cells", tmp_path / "cells")
    store = CellStore(tmp_path / "cells")
    lost = [c for c in grids.Study("sensitivity", settings=SETTINGS, draws=2).cells() if c.settings.get("draw") == 1]
    for cell in lost:
        store.path(cell).unlink()

    def fail(cell, trips):
        raise ValueError("no luck")

    monkeypatch.setattr(work, "run_cell", fail)
    status, out, err = study("sensitivity", *SMALL, "--out", tmp_path, "--jobs", 1)
    assert status == 1
    assert "failed: I.1, world 0: perturbed, epsilon 2.0, draw 1, value linear, seed 0: ValueError: no luck" in err
    assert len(lost) == 15
    assert "19 of 34 cells, 0 worked out now" in out
    assert (tmp_path / "sensitivity" / "report.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["guess"], "no study 'guess'"),
        (["nyc"], "needs trip records"),
        (["homogeneous", "--trips", "x.parquet"], "--trips goes with"),
        (["nyc", "--trips", "none.parquet"], "there is no file none.parquet"),
        (["homogeneous", "--mode", "mondays"], "--mode goes with --trips"),
        (["all", "--fraction", "0.3"], "--fraction goes with --trips"),
        (["nyc", "--trips", "x.parquet", "--mode", "sundays"], "no mode 'sundays'"),
        (["homogeneous", "--worlds", "0"], "--worlds 0"),
        (["homogeneous", "--worlds", "1,1"], "--worlds 1,1"),
        (["homogeneous", "--worlds", "many"], "--worlds many"),
        (["homogeneous", "--set", "horizont=3"], "no setting 'horizont'"),
        (["homogeneous", "--set", "horizon=-3"], "horizon = -3"),
        (["sensitivity", "--set", "split=20,4"], "split"),
        (["heterogeneous", "--dask", "tcp://127.0.0.1:9"], "no Dask scheduler"),
    ],
)
def test_bad_input_is_one_line(study, arguments, message, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "SECONDS_TO_CONNECT", 0.1)
    status, _, err = study(*arguments, "--out", tmp_path)
    assert status == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_the_paper_s_own_selection_of_trips(study, few_cells, no_figures, tmp_path, trip_a_minute):
    """Options reach the cells and the report's settings."""
    trips = trip_a_minute(60_000, pickups=(261, 236, 43))
    common = ["nyc", "--trips", trips, "--mode", "mondays", "--fraction", 0.9, *FEW]
    status, _, _ = study(*common, "--no-gap", "--seeds", 1, "--out", tmp_path / "out", "--jobs", 1)
    told = json.loads((tmp_path / "out" / "nyc" / "report.json").read_text())
    assert status == 0
    assert told["settings"]["changed settings"] == {
        "split": [6, 4, 2],
        "horizon": 10,
        "mode": "mondays",
        "fraction": 0.9,
    }
    status, out, _ = study("all", *common[1:], "--dry-run", "--json", "--out", tmp_path / "out")
    assert status == 0
    assert [one["study"] for one in strict(out)] == ["homogeneous", "heterogeneous", "sensitivity", "nyc"]


@pytest.mark.slow
def test_policies_that_serve_nobody_have_a_report_too(study, tmp_path, trip_a_minute, monkeypatch):
    """Nobody asks: what is paid for a request has no mean then.

    Figures are made, and that of pairs of regions is drawn.
    """

    def few(tables, trips):
        figures = study_figures(tables, trips=trips)
        assert "fair_nyt_combined" in figures
        for label in figures.keys() - {"fair_nyt_combined"}:
            figures[label].clf()
            figures[label].set_layout_engine(None)  # nothing is left to lay out
        return figures

    monkeypatch.setattr("optkit.studies.report.report.study_figures", few)
    trips = trip_a_minute(60_000)
    common = ["nyc", "--trips", trips, "--fraction", 1e-9, *FEW, "--no-gap", "--seeds", 1]
    status, out, err = study(*common, "--out", tmp_path / "out", "--jobs", 1)
    assert (tmp_path / "out" / "nyc" / "report.html").exists()
    assert status == 1  # of policies that want data to learn from
    assert "training needs instances with requests" in err
    assert "report:" in out


def test_a_folder_of_others_is_not_replaced(study, tmp_path):
    """What stands in the report's place is not ours."""
    (tmp_path / "sensitivity").mkdir()
    (tmp_path / "sensitivity" / "thesis.tex").write_text("years of work")
    status, _, err = study("sensitivity", *SMALL, "--out", tmp_path)
    assert status == 2
    assert "thesis.tex" in err
    assert (tmp_path / "sensitivity" / "thesis.tex").read_text() == "years of work"
