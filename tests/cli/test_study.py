"""optkit study, called as a user calls it."""

import json
from functools import partial

import pandas as pd
import pytest

from optkit.studies import grids, runner

SMALL = ["--set", "split=20,4,4", "--set", "horizon=12"]


@pytest.fixture
def study(monkeypatch, optkit):
    """Run the verb in this process, without the network; return exit status, output and errors."""
    monkeypatch.setattr(grids, "find_spec", lambda _: None)
    return partial(optkit, "study")


def strict(text):
    """Parse JSON that every reader takes."""
    return json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "timings.csv"}


def test_a_study_is_planned_run_and_not_run_again(study, tmp_path):
    """Plan, results, and a second call that works nothing out and writes the same files."""
    common = ["sensitivity", *SMALL, "--out", tmp_path, "--jobs", 1]
    status, out, _ = study(*common, "--dry-run")
    assert status == 0
    assert "sensitivity: 154 cells (2 bounds, 152 perturbed), 154 to be worked out" in out
    assert not (tmp_path / "cells").exists()
    status, out, _ = study(*common, "--json")
    (told,) = strict(out)
    assert (status, told["cells"], told["fresh"], told["failed"]) == (0, 154, 154, {})
    assert {claim["result"] for claim in told["claims"]} == {2, 4}
    first = files(tmp_path / "sensitivity")
    assert "report.html" in first
    assert len(pd.read_csv(tmp_path / "sensitivity" / "sensitivity.csv")) == 152
    status, out, _ = study(*common)
    assert status == 0
    assert "154 of 154 cells, 0 worked out now" in out
    assert files(tmp_path / "sensitivity") == first
    status, out, _ = study(*common, "--dry-run", "--json")
    assert strict(out)[0]["missing"] == 0


def test_force_works_out_anew(study, tmp_path):
    common = ["heterogeneous", *SMALL, "--out", tmp_path, "--no-gap", "--seeds", 1, "--jobs", 2]
    _, out, _ = study(*common, "--json")
    before = strict(out)[0]
    _, out, _ = study(*common, "--json", "--force")
    again = strict(out)[0]
    assert again["fresh"] == before["fresh"] == before["cells"]
    assert again["tables"] == before["tables"]


def test_worlds_are_numbers_or_seeds(study, tmp_path):
    for text, worlds in (("2", {"world 0", "world 1"}), ("4,7", {"world 4", "world 7"})):
        _, out, _ = study("heterogeneous", "--worlds", text, "--out", tmp_path, "--dry-run", "--json")
        assert {cell.split(": ")[0].split(", ")[1] for cell in strict(out)[0]["list"]} == worlds


def test_all_without_trips_says_what_is_left_out(study, tmp_path, monkeypatch):
    _, out, _ = study("all", "--out", tmp_path, "--dry-run", "--json")
    assert [plan["study"] for plan in strict(out)] == ["homogeneous", "heterogeneous", "sensitivity"]


def test_a_failed_cell_is_reported_and_the_status_says_so(study, tmp_path, monkeypatch):
    work = runner.run_cell

    def fail(cell, trips):
        if cell.settings.get("draw") == 3:
            raise ValueError("no luck")
        return work(cell, trips)

    monkeypatch.setattr(runner, "run_cell", fail)
    status, out, err = study("sensitivity", *SMALL, "--out", tmp_path, "--jobs", 1)
    assert status == 1
    assert "failed: I.1, world 0: perturbed, epsilon 2.0, draw 3, value linear, seed 0: ValueError: no luck" in err
    assert "139 of 154 cells" in out
    assert (tmp_path / "sensitivity" / "report.html").exists()
    monkeypatch.undo()


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
def test_bad_input_is_one_line(study, arguments, message, tmp_path):
    status, _, err = study(*arguments, "--out", tmp_path)
    assert status == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_the_paper_s_own_selection_of_trips(study, tmp_path, trip_a_minute):
    """Options reach the cells and the report's settings."""
    trips = trip_a_minute(60_000, pickups=(261, 236, 43))
    common = ["nyc", "--trips", trips, "--mode", "mondays", "--fraction", 0.9, "--set", "split=6,4,2"]
    status, _, _ = study(*common, "--no-gap", "--seeds", 1, "--out", tmp_path / "out", "--jobs", 1)
    told = json.loads((tmp_path / "out" / "nyc" / "report.json").read_text())
    assert status == 0
    assert told["settings"]["changed settings"] == {"split": [6, 4, 2], "mode": "mondays", "fraction": 0.9}
    status, out, _ = study("all", *common[1:], "--dry-run", "--json", "--out", tmp_path / "out")
    assert status == 0
    assert [one["study"] for one in strict(out)] == ["homogeneous", "heterogeneous", "sensitivity", "nyc"]


def test_policies_that_serve_nobody_have_a_report_too(study, tmp_path, trip_a_minute):
    """Nobody asks: what is paid for a request has no mean then."""
    trips = trip_a_minute(60_000)
    common = ["nyc", "--trips", trips, "--fraction", 1e-9, "--set", "split=6,4,2", "--no-gap", "--seeds", 1]
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
