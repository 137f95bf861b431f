"""The main job, called from Python."""

import json

import pytest

from optkit import main_job
from optkit.bounds import full_information
from optkit.errors import InputError, SolverError
from optkit.main_job import check_target, run_main_job, write_results
from optkit.scenarios import Split, scenario


@pytest.fixture(scope="module")
def split():
    """A small split of Scenario I.1."""
    return scenario("I.1", seed=0, split=(6, 4, 1)).split()


def test_every_stage_is_told_to_its_end(split):
    """Progress names the stages, and each reaches its total."""
    told = {}
    run_main_job(split, {}, verify=3, progress=lambda stage, done, total: told.update({stage: (done, total)}))
    assert list(told) == ["tuning PP", "tuning FP", "bounding", "learning", "verifying"]
    assert all(done == total for done, total in told.values())


def test_an_instance_without_a_bound_is_left_out_and_named(split, monkeypatch):
    """Where a solver gives up, no bound is invented: the instance is named with the reason, the others go on."""
    calls = iter(range(100))

    def sometimes(instance):
        if next(calls) == 1:
            raise SolverError("hit its time limit")
        return full_information(instance)

    monkeypatch.setattr(main_job, "full_information", sometimes)
    result = run_main_job(split, {}, verify=0)
    assert result.bound_failures == {1: "hit its time limit"}
    assert result.comparison.table["instances"].tolist() == [3] * 5


def test_no_bound_at_all_is_an_error(split, monkeypatch):
    """If no instance can be bounded, there is nothing to report."""

    def never(_):
        raise SolverError("gave up")

    monkeypatch.setattr(main_job, "full_information", never)
    with pytest.raises(SolverError, match="gave up"):
        run_main_job(split, {}, verify=0)


def test_both_parts_are_needed(split):
    """Without training or test instances there is nothing to tune on or to report."""
    for part in (Split([], split.test, []), Split(split.train, [], [])):
        with pytest.raises(InputError, match="both are needed"):
            run_main_job(part, {}, verify=0)


def test_written_results_are_the_result(split, tmp_path):
    """The folder holds what the result says, and counts as a run's that may be replaced."""
    result = run_main_job(split, {"folder": "by hand"}, verify=2)
    assert not check_target(tmp_path / "run")
    write_results(tmp_path / "run", result, "by hand")
    assert check_target(tmp_path / "run")
    written = json.loads((tmp_path / "run" / "summary.json").read_text())
    expected = json.loads(json.dumps(result.to_dict()))
    assert {key: written[key] for key in expected} == expected
