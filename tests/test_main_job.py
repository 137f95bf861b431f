"""The main job, called from Python."""

import json
from dataclasses import replace

import pytest

from optkit import main_job
from optkit.bounds import full_information
from optkit.errors import InputError, SolverError
from optkit.learning import learn_once, learn_preferences
from optkit.main_job import run_main_job
from optkit.policies import PostDecisionPricing
from optkit.results import check_target, write_results
from optkit.scenarios import Split, scenario
from optkit.simulator import simulate


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


@pytest.fixture
def second_fails(monkeypatch):
    """The bound of the second test instance cannot be computed."""
    calls = iter(range(100))

    def sometimes(instance):
        if next(calls) == 1:
            raise SolverError("hit its time limit")
        return full_information(instance)

    monkeypatch.setattr(main_job, "full_information", sometimes)


@pytest.mark.usefixtures("second_fails")
def test_an_instance_without_a_bound_is_left_out_and_named(split):
    """Where a solver gives up, no bound is invented: the instance is named with the reason, the others go on."""
    result = run_main_job(split, {}, verify=0)
    assert result.bound_failures == {1: "hit its time limit"}
    assert result.comparison.table["instances"].tolist() == [3] * 5


@pytest.mark.usefixtures("second_fails")
def test_rows_keep_the_numbers_of_their_instances(split):
    """Without instance 1, the rows are those of instances 0, 2 and 3."""
    rows = run_main_job(split, {}, verify=0).comparison.per_instance
    myopic = rows[rows["policy"] == "Myopic, true MNL"]
    assert myopic["instance"].tolist() == [0, 2, 3]
    assert myopic["requests"].tolist() == [split.test[i].n_requests for i in (0, 2, 3)]


def test_a_bound_that_is_not_proven_is_no_bound(split, monkeypatch):
    """A solver that claims less than its certificate proves is caught, instance by instance."""
    monkeypatch.setattr(main_job, "full_information", lambda one: replace(full_information(one), value=-1e6))
    with pytest.raises(SolverError, match="claimed"):
        run_main_job(split, {}, verify=0)


def test_what_cannot_be_learned_is_left_out(split):
    """Where nothing is attractive to any worker, learning fails with a reason, and the other policies go on."""
    hopeless = Split(*([replace(day, utility=day.utility - 500.0) for day in part] for part in split))
    result = run_main_job(hopeless, {}, verify=0)
    assert set(result.record["not learned"]) == {"Learned MNL, paper's data", "Learned MNL, re-estimated"}
    assert result.comparison.table["policy"].tolist() == ["Myopic, true MNL", "FP", "PP"]


def test_learned_policies_are_what_they_are_called():
    """Each learned row of the run is the policy that its name says, learned on the training instances alone."""
    small = scenario("II", seed=0, split=(40, 6, 0)).split()
    result = run_main_job(small, {}, verify=0)
    ways = {
        "Learned MNL, paper's data": learn_once(small.train),
        "Learned MNL, re-estimated": learn_preferences(small.train),
        "Single MNL, re-estimated": learn_preferences(small.train, pooled=True),
    }
    ratios = result.comparison.per_instance.set_index("policy")["reward"]
    for name, learned in ways.items():
        rows = result.record["learned"][name]["rounds"]
        assert rows == [{str(k): v for k, v in row.items()} for row in learned.rounds.to_dict(orient="records")]
        expected = simulate(small.test, PostDecisionPricing(choice=learned.preferences)).reward
        assert ratios[name].tolist() == expected.tolist()
    assert ratios["Single MNL, re-estimated"].tolist() != ratios["Learned MNL, re-estimated"].tolist()


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
