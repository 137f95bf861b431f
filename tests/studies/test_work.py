"""Each kind of cell against the function that it stands for, called by hand."""

import json
from functools import partial

import numpy as np
import pytest

from optkit import simulate
from optkit.basics.errors import DataError, InputError, TrainingError
from optkit.basics.plain_json import to_json
from optkit.basics.seeds import Stream, stream
from optkit.bounds import arrival_information, full_information
from optkit.gap.charging import scenario_charging
from optkit.gap.report import gap_report
from optkit.instances.catalogue import scenario
from optkit.learning.perturbation import perturb, true_preferences
from optkit.learning.rounds import learn_once, learn_preferences
from optkit.learning.training import train
from optkit.policies import PostDecisionPricing
from optkit.policies.tuning import tune_formula
from optkit.studies import run_cell as work
from optkit.studies.cells import SCHEMA, Cell
from optkit.studies.grids import digest_of
from optkit.studies.policies import POLICIES, Spec
from optkit.studies.run_cell import run_cell

SETTINGS = {"horizon": 10, "split": (30, 4, 4)}
PLACE = {"scenario": "II", "world": 1, "set": {"horizon": 10, "split": [30, 4, 4]}}
SOURCE = scenario("II", seed=1, **SETTINGS)
SPLIT = SOURCE.split()


def cell(kind, **settings):
    return run_cell(Cell(kind, PLACE, settings))


def test_bounds_are_those_of_the_test_instances():
    found = cell("bounds")
    for name, bound in (
        ("full", full_information),
        ("arrival", arrival_information),
        ("lagrangian", lambda day: arrival_information(day, "lagrangian")),
    ):
        np.testing.assert_allclose(found[name], [bound(day).value for day in SPLIT.test], rtol=1e-9)
        assert 0 <= found["certificate_gap"][name] < 1e-4
    assert found["workers"] == [day.n_workers for day in SPLIT.test]
    assert found["penalty"] == [day.penalty.sum() for day in SPLIT.test]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "policy"),
    [
        ("Myopic, true MNL", lambda: PostDecisionPricing()),
        ("FP", lambda: tune_formula(SPLIT.train).policy),
        ("Linear, true MNL", lambda: train(SPLIT, "linear", choice="true", seed=3).policy),
        ("Linear, re-estimated", lambda: train(SPLIT, "linear", choice="learned", seed=3).policy),
        (
            "Linear, single MNL, paper's data",
            lambda: (
                train(SPLIT, "linear", choice=learn_once(SPLIT.train, pooled=True, seed=3).preferences, seed=3).policy
            ),
        ),
        (
            "Myopic, single MNL",
            lambda: PostDecisionPricing(choice=learn_preferences(SPLIT.train, pooled=True, seed=3).preferences),
        ),
    ],
)
def test_policies_earn_what_they_earn(name, policy):
    """Rewards, payments and the validation score are those of the same policy made by hand."""
    try:
        made = policy()
    except TrainingError as error:
        with pytest.raises(TrainingError, match=str(error)[:30]):
            cell("policy", policy=name, seed=3)
        return
    found, outcome = cell("policy", policy=name, seed=3), simulate(SPLIT.test, made)
    np.testing.assert_allclose(found["reward"], outcome.reward, rtol=1e-12)
    np.testing.assert_allclose(found["paid"], np.nansum(outcome.compensation, axis=1), rtol=1e-12)
    assert found["served"] == outcome.served.tolist()
    assert found["score"] == pytest.approx(simulate(SPLIT.validation, made).reward.mean(), rel=1e-12)


def test_details_add_up():
    """Requests asked for and served, by places, and what each worker got beyond the burden."""
    found = cell("policy", policy="Myopic, true MNL", seed=0, detail=True)
    assert np.sum(found["asked"]) == sum(day.n_requests for day in SPLIT.test)
    assert np.sum(found["taken"]) == sum(found["served"])
    outcome, over = simulate(SPLIT.test, PostDecisionPricing()), []
    for run, worker in np.argwhere(outcome.accepted >= 0):
        day, request = SPLIT.test[run], outcome.accepted[run, worker]
        over.append(outcome.compensation[run, worker] + day.utility[day.worker_group[worker], request])
    np.testing.assert_allclose(found["over"], over, atol=1e-6)


@pytest.mark.slow
def test_errors_of_utilities_are_true_less_estimated():
    """Against every request of the test instances, one by one."""
    told, found = cell("utilities"), cell("estimate", choice="learned", seed=2)
    believed = learn_preferences(SPLIT.train, seed=2).preferences
    groups = np.arange(3)[:, None]
    error = np.concatenate(
        [d.utility - believed.utility_of(d.features, d.pickup, d.dropoff, groups) for d in SPLIT.test], axis=1
    )
    np.testing.assert_allclose(found["mbe"], error.mean(axis=1), rtol=1e-9)
    np.testing.assert_allclose(found["rmse"], np.sqrt((error**2).mean(axis=1)), rtol=1e-9)
    assert sum(told["count"]) == error.shape[1]
    weighted = np.average(found["error"], axis=1, weights=told["count"])
    np.testing.assert_allclose(weighted, error.mean(axis=1), atol=1e-5)
    kinds = [SOURCE.world.kinds[k] for k in told["type"]]
    features = {tuple(np.round(x[:3], 9)) for day in SPLIT.test for x in day.features}
    assert {tuple(np.round(x, 9)) for x in kinds} == features


@pytest.mark.slow
@pytest.mark.parametrize("groups", [None, [1]])
def test_perturbed_policies_believe_what_they_are_told(groups):
    more = {} if groups is None else {"groups": groups}
    found = cell("perturbed", epsilon=4.0, draw=5, value="linear", seed=0, **more)
    rng = np.random.default_rng(stream(5, Stream.BELIEFS, 0 if groups is None else 3))
    believed = perturb(true_preferences(SOURCE), 4.0, rng, groups=groups)
    policy = train(SPLIT.train, "linear", choice=believed, seed=0).policy
    np.testing.assert_allclose(found["reward"], simulate(SPLIT.test, policy).reward, rtol=1e-12)
    moved = [group for group in range(3) if abs(found["mbe"][group]) > 1e-9]
    assert moved == ([0, 1, 2] if groups is None else groups)


@pytest.mark.slow
def test_the_gap_is_the_report_s(monkeypatch):
    """With little training, to be quick."""
    few = partial(scenario_charging, training=40, pool=120)
    monkeypatch.setattr(work, "scenario_charging", few)
    found = json.loads(to_json(cell("gap")))
    charging = few(SOURCE)
    policies = {"Myopic, true MNL": PostDecisionPricing(), "Charging, true MNL": charging.policy}
    report = gap_report(SPLIT.test, policies, value=charging.value, foresight=charging.foresight)
    assert found["best"]["claim"] == report.claim()
    assert found["gaps"] == json.loads(to_json(report.to_dict()["gaps"]))
    assert not any("seconds" in row for row in found["bounds"])


@pytest.mark.slow
def test_trips_that_are_not_those_of_the_plan_are_refused(trip_a_minute):
    """Also when the scenario was made before: a place's digest, not the path, says which trips are meant."""
    place = {"scenario": "nyc-weak", "world": 0, "set": {"split": [1, 1, 1]}}
    rewards = []
    for minutes in (12, 20):
        file = trip_a_minute(30_000, minutes)
        one = Cell("policy", {**place, "trips": digest_of([str(file)])}, {"policy": "Myopic, true MNL", "seed": 0})
        rewards.append(run_cell(one, (str(file),))["reward"])
    assert rewards[0] != rewards[1]
    with pytest.raises(DataError, match="not those that the study was planned with"):
        run_cell(Cell("policy", {**place, "trips": "0" * 16}, {"policy": "Myopic, true MNL", "seed": 0}), (str(file),))


@pytest.mark.slow
def test_trips_are_selected_as_the_place_says(trip_a_minute):
    """Mondays from 11 to 12 as the paper does, and a share of them; a week pooled otherwise."""
    file = trip_a_minute(30_000)
    place = {"scenario": "nyc-weak", "world": 0, "set": {"split": [1, 2, 1]}, "trips": digest_of([str(file)])}
    for more in ({}, {"mode": "mondays"}, {"mode": "mondays", "fraction": 0.6}):
        found = run_cell(Cell("bounds", {**place, **more}, {}), (str(file),))["requests"]
        days = scenario("nyc-weak", 0, trips=[file], split=(1, 2, 1), **more).split().test
        assert found == [day.n_requests for day in days]
    # A trip a minute for three weeks: a Monday's half-hour has 30, of which three fifths are requests.
    assert all(5 < count < 30 for count in found)


def test_what_is_not_known_of_a_place_is_refused():
    """A worker with an older optkit must not leave a setting out."""
    with pytest.raises(DataError, match="does not know weather of a study"):
        run_cell(Cell("bounds", {**PLACE, "weather": "rain"}, {}))


@pytest.mark.slow
def test_the_same_cell_gives_the_same_result():
    one = Cell("policy", PLACE, {"policy": "Kernel, true MNL", "seed": 1})
    assert run_cell(one) == run_cell(one)


def test_names_say_what_policies_are():
    assert POLICIES["Attention, paper's data"] == Spec(None, "attention", "paper")
    assert not POLICIES["PP"].random
    assert not POLICIES["Myopic, true MNL"].random
    assert POLICIES["Myopic, re-estimated"].random
    with pytest.raises(InputError, match="no policy 'Guess'"):
        cell("policy", policy="Guess", seed=0)
    with pytest.raises(InputError, match="choice = 'true'"):
        cell("estimate", choice="true", seed=0)


FROZEN = {
    ("bounds", "arrival"): ({}, 623.3045680688613),
    ("policy", "reward", "myopic"): ({"policy": "Myopic, re-estimated", "seed": 0}, 627.2156462549474),
    ("policy", "reward", "linear"): ({"policy": "Linear, true MNL", "seed": 0}, 618.204029001787),
    ("policy", "reward", "kernel"): ({"policy": "Kernel, true MNL", "seed": 0}, 619.2046835470047),
    ("policy", "reward", "rule"): ({"policy": "FP", "seed": 0}, 433.6977725799239),
    ("estimate", "rmse"): ({"choice": "paper", "seed": 0}, 40.10008156441114),
    ("perturbed", "reward"): (
        {"epsilon": 4.0, "draw": 0, "groups": [1], "value": "linear", "seed": 0},
        617.7214578513458,
    ),
}
"""Sums of the results of tiny cells with SCHEMA 2; of perturbed ones since their streams moved."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FROZEN, ids=" ".join)
def test_what_cells_mean_has_not_changed(name):
    """A default that changes gives other results under the same key. If it was meant, raise SCHEMA and freeze anew.

    To 1e-4, because machines round differently, and k-means may break a tie the other way.
    """
    settings, total = FROZEN[name]
    place = {"scenario": "II", "world": 0, "set": {"horizon": 12, "split": [20, 4, 4]}}
    assert SCHEMA == 2
    assert np.sum(run_cell(Cell(name[0], place, settings))[name[1]]) == pytest.approx(total, rel=1e-4)
