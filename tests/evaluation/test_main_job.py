"""The main job, called from Python."""

import json
from dataclasses import replace

import numpy as np
import pytest

from optkit.basics.errors import InputError, SolverError, TrainingError
from optkit.bounds import full_information
from optkit.evaluation import proven
from optkit.evaluation.main_job import run_main_job
from optkit.evaluation.results_folder import check_target, write_results
from optkit.evaluation.verification import verify_pricing
from optkit.instances.catalogue import scenario
from optkit.instances.scenario import Split
from optkit.learning.rounds import learn_once, learn_preferences
from optkit.learning.training import train
from optkit.models.value import KernelValue
from optkit.policies import PostDecisionPricing
from optkit.simulation.simulator import simulate


@pytest.fixture(scope="module")
def split():
    """A small split of Scenario I.1."""
    return scenario("I.1", seed=0, split=(6, 4, 1), horizon=10).split()


@pytest.fixture(scope="module")
def run(split):
    """A run on it, and the last progress that each stage told."""
    told = {}
    result = run_main_job(
        split, {"folder": "by hand"}, verify=3, progress=lambda stage, *done: told.update({stage: done})
    )
    return result, told


@pytest.fixture(scope="module")
def groups():
    """A small split of Scenario II, with three groups of workers, and a run on it."""
    small = scenario("II", seed=0, split=(12, 4, 2), horizon=8).split()
    return small, run_main_job(small, {}, verify=0, seed=3)


@pytest.mark.slow
def test_every_stage_is_told_to_its_end(run):
    """Progress names the stages, and each reaches its total."""
    _, told = run
    assert list(told) == ["tuning PP", "tuning FP", "bounding", "learning", "training", "verifying"]
    assert all(done == total for done, total in told.values())


@pytest.fixture(scope="module")
def without_second(split):
    """A run where the bound of the second test instance cannot be computed, and a training diverges.

    With it, the last progress that each stage told.
    """
    calls = iter(range(100))

    def sometimes(instance):
        if next(calls) == 1:
            raise SolverError("hit its time limit")
        return full_information(instance)

    def diverge(*_, **__):
        raise TrainingError("training diverged")

    told = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proven, "full_information", sometimes)
        patch.setattr(KernelValue, "fit", diverge)
        result = run_main_job(split, {}, verify=0, progress=lambda stage, *done: told.update({stage: done}))
    return result, told


@pytest.mark.slow
def test_an_instance_without_a_bound_is_left_out_and_named(without_second):
    """Where a solver gives up, no bound is invented: the instance is named with the reason, the others go on."""
    result, _ = without_second
    assert result.bound_failures == {1: "hit its time limit"}
    assert result.comparison.table["instances"].tolist() == [3] * 7


def test_rows_keep_the_numbers_of_their_instances(split, without_second):
    """Without instance 1, the rows are those of instances 0, 2 and 3."""
    rows = without_second[0].comparison.per_instance
    myopic = rows[rows["policy"] == "Myopic, true MNL"]
    assert myopic["instance"].tolist() == [0, 2, 3]
    assert myopic["requests"].tolist() == [split.test[i].n_requests for i in (0, 2, 3)]


def test_a_bound_that_is_not_proven_is_no_bound(split, monkeypatch):
    """A solver that claims less than its certificate proves is caught, instance by instance."""
    monkeypatch.setattr(proven, "full_information", lambda one: replace(full_information(one), value=-1e6))
    with pytest.raises(SolverError, match="claimed"):
        run_main_job(split, {}, verify=0)


@pytest.mark.slow
def test_what_cannot_be_learned_is_left_out(split):
    """Where nothing is attractive to any worker, learning fails with a reason, and the other policies go on."""
    hopeless = Split(*([replace(day, utility=day.utility - 500.0) for day in part] for part in split))
    result = run_main_job(hopeless, {}, verify=0)
    assert set(result.record["not learned"]) == {"Learned MNL, paper's data", "Learned MNL, re-estimated"}
    assert set(result.record["not trained"]) == {"Linear, learned MNL"}
    left = ["Myopic, true MNL", "Linear, true MNL", "Kernel, true MNL", "FP", "PP"]
    assert result.comparison.table["policy"].tolist() == left


def test_a_training_that_fails_is_left_out(without_second):
    """A value function that diverges is named with the reason, progress reaches its end, and the others go on."""
    result, told = without_second
    assert result.record["not trained"] == {"Kernel, true MNL": "training diverged"}
    assert "Kernel, true MNL" not in result.comparison.table["policy"].tolist()
    assert "Linear, learned MNL" in result.comparison.table["policy"].tolist()
    assert told["training"] == (6, 6)


@pytest.mark.slow
def test_a_policy_that_does_not_know_the_tests_is_left_out(split):
    """A test instance that lasts longer than all training instances is beyond what value functions were fitted on."""
    day = split.test[0]
    steps = 80 - day.n_workers + np.arange(day.n_workers)
    late = replace(day, horizon=80, expiry=np.full(day.n_requests, 79), worker_step=steps)
    result = run_main_job(Split(split.train, [late], split.validation), {}, verify=0)
    assert set(result.record["not trained"]) == {"Linear, true MNL", "Kernel, true MNL", "Linear, learned MNL"}
    assert all("beyond the 10 steps" in why for why in result.record["not trained"].values())


@pytest.mark.slow
def test_trained_policies_are_what_they_are_called(groups):
    """Each trained row of the run is what train() gives for its name, with the run's seed."""
    small, result = groups
    ways = {
        "Linear, true MNL": train(small, choice="true", seed=3),
        "Kernel, true MNL": train(small, "kernel", choice="true", seed=3),
        "Linear, learned MNL": train(small, choice="learned", seed=3),
    }
    rewards = result.comparison.per_instance.set_index("policy")["reward"]
    for name, trained in ways.items():
        assert rewards[name].tolist() == simulate(small.test, trained.policy).reward.tolist()
        rounds = result.record["trained"][name]["rounds"]
        assert [row["score"] for row in rounds] == [row["score"] for row in trained.record]
    assert len({tuple(rewards[name]) for name in ways}) == 3


@pytest.mark.slow
def test_every_optimal_price_is_verified(split, run):
    """Decisions of the myopic, the learned and the trained policies are all certified; FP and PP claim nothing."""
    result, _ = run
    names = result.record["verify"]["policies"]
    assert names == [name for name in result.comparison.table["policy"] if name not in ("FP", "PP")]
    assert len(names) == 6
    myopic = verify_pricing(split.test, sample=0)
    assert result.verification.solved == 3
    assert result.verification.certified == result.verification.decisions > 5 * myopic.decisions


@pytest.mark.slow
def test_learned_policies_are_what_they_are_called(groups):
    """Each learned row of the run is the policy that its name says, learned on the training instances alone."""
    small, result = groups
    ways = {
        "Learned MNL, paper's data": learn_once(small.train, seed=3),
        "Learned MNL, re-estimated": learn_preferences(small.train, seed=3),
        "Single MNL, re-estimated": learn_preferences(small.train, seed=3, pooled=True),
    }
    ratios = result.comparison.per_instance.set_index("policy")["reward"]
    for name, learned in ways.items():
        rows = result.record["learned"][name]["rounds"]
        told = learned.rounds.rename(columns={"converged": "fit_converged"}).to_dict(orient="records")
        assert rows == [{str(k): v for k, v in row.items()} for row in told]
        expected = simulate(small.test, PostDecisionPricing(choice=learned.preferences)).reward
        assert ratios[name].tolist() == expected.tolist()
    assert ratios["Single MNL, re-estimated"].tolist() != ratios["Learned MNL, re-estimated"].tolist()


def test_no_bound_at_all_is_an_error(split, monkeypatch):
    """If no instance can be bounded, there is nothing to report."""

    def never(_):
        raise SolverError("gave up")

    monkeypatch.setattr(proven, "full_information", never)
    with pytest.raises(SolverError, match="gave up"):
        run_main_job(split, {}, verify=0)


def test_both_parts_are_needed(split):
    """Without training or test instances there is nothing to tune on or to report."""
    for part in (Split([], split.test, []), Split(split.train, [], [])):
        with pytest.raises(InputError, match="both are needed"):
            run_main_job(part, {}, verify=0)


@pytest.mark.slow
def test_written_results_are_the_result(run, tmp_path):
    """The folder holds what the result says, and counts as a run's that may be replaced."""
    result, _ = run
    assert not check_target(tmp_path / "run")
    write_results(tmp_path / "run", result, "by hand")
    assert check_target(tmp_path / "run")
    written = json.loads((tmp_path / "run" / "summary.json").read_text())
    expected = json.loads(json.dumps(result.to_dict()))
    assert {key: written[key] for key in expected} == expected
