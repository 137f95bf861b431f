"""The exact arrival-information bound and its certificate, against noise that is drawn."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit import simulate
from optkit.basics.errors import InputError, SolverError
from optkit.bounds import full_information
from optkit.bounds.arrival.exact import arrival_exact
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import Bound, prove
from optkit.bounds.rounding import sum_up
from optkit.instances.instance import Instance
from optkit.models.pricing import optimal_prices
from optkit.policies import PostDecisionPricing, RewardPercentage

seeds = st.integers(0, 2**32 - 1)
bounded = settings(derandomize=True, deadline=None, max_examples=25)


def one_request(workers, **changes):
    """One request that is open all day, and some workers."""
    given = {
        "arrival": [0],
        "expiry": [workers],
        "reward": [30.0],
        "penalty": [-5.0],
        "features": [[]],
        "pickup": [0],
        "dropoff": [0],
        "utility": [[-10.0]],
        "mu": [2.0],
    }
    come = {"worker_step": 1 + np.arange(workers), "worker_group": np.zeros(workers, int)}
    return Instance(horizon=workers + 1, **come, **(given | changes))


def standard_error(x):
    return x.std(ddof=1) / np.sqrt(x.size)


def test_one_request_and_one_worker_are_one_decision():
    profit = optimal_prices([35.0], [-10.0], 2.0).profit
    assert arrival_exact(one_request(1)).value == pytest.approx(profit - 5.0, abs=1e-12)


def test_one_request_and_two_workers_are_two_decisions_in_a_row():
    last = optimal_prices([35.0], [-10.0], 2.0).profit
    first = optimal_prices([35.0 - last], [-10.0], 2.0).profit
    assert arrival_exact(one_request(2)).value == pytest.approx(first + last - 5.0, abs=1e-12)


def test_as_the_noise_vanishes_the_bound_becomes_the_full_information_bound(random_instance):
    """A limit case: without noise there is nothing left that only full information knows."""
    day = replace(random_instance(np.random.default_rng(0), groups=2), mu=[1e-5, 1e-5])
    still = replace(day, noise=np.zeros((day.n_workers, day.n_requests)), outside_noise=np.zeros(day.n_workers))
    # The markup mu (1 + W0(exp(50 / mu))) exceeds the best price by mu ln(50 / mu), about 2e-4, per worker.
    assert arrival_exact(day).value == pytest.approx(full_information(still).value, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_full_information_is_worth_more_in_the_mean(random_instance, seed):
    day = random_instance(np.random.default_rng(seed), groups=2)
    bound = arrival_exact(day).value
    full = np.array([full_information(day.with_noise(draw)).value for draw in range(300)])
    assert bound < full.mean() - 4 * standard_error(full)


@pytest.mark.slow
@pytest.mark.parametrize("policy", [RewardPercentage(0.6), PostDecisionPricing()], ids=["percentage", "myopic"])
def test_no_policy_earns_more_in_the_mean(random_instance, policy):
    day = random_instance(np.random.default_rng(1), requests=10, groups=2)
    reward = simulate([day.with_noise(draw) for draw in range(1500)], policy).reward
    assert reward.mean() <= arrival_exact(day).value + 4 * standard_error(reward)


@pytest.mark.parametrize("liking", [0.0, 55.0], ids=["prices free", "prices held at 0"])
def test_the_prices_of_its_tables_earn_it(random_instance, liking):
    """The bound is reached: its own policy, which knows the arrivals, simulated with drawn noise."""
    day = random_instance(np.random.default_rng(2), requests=9, workers=6, lifetime=5.0, groups=2)
    day = replace(day, utility=day.utility + liking)
    bound = arrival_exact(day)
    runs, rng = 20_000, np.random.default_rng(3)
    cut = stages(day)
    induction = SubsetProgram(day, cut, np.zeros(day.n_requests), np.ones(day.n_requests, bool))
    tables = bound.certificate.tables
    entry, earned, row = np.zeros(runs, int), np.full(runs, day.penalty.sum()), np.arange(runs)
    for stage, table, later in zip(cut, tables, [*tables[1:], np.zeros(1)], strict=True):
        offers = induction.offers(stage, later, entry)
        group = day.worker_group[stage.worker]
        mu = day.mu[group]
        paid = offers.prices((table[entry] - later[offers.stay])[:, None] / mu)[0]
        noise = rng.gumbel(-np.euler_gamma * mu, mu, (runs, stage.requests.size + 1))
        happy = day.utility[group, stage.requests] + paid + noise[:, 1:]
        happy = np.where(offers.offered, happy, -np.inf)
        best = happy.argmax(axis=1)
        takes = happy[row, best] > day.outside_by_group[group] + noise[:, 0]
        served = stage.requests[best]
        earned += np.where(takes, (day.reward - day.penalty)[served] - paid[row, best], 0.0)
        entry = np.where(takes, offers.leave[row, best], offers.stay)
    assert earned.mean() == pytest.approx(bound.value, abs=4 * standard_error(earned))


@bounded
@given(seeds, st.integers(0, 9), st.integers(0, 6), st.floats(0.0, 60.0), st.booleans())
def test_every_bound_is_proven_and_reached(random_instance, seed, requests, workers, liking, nonnegative):
    day = random_instance(np.random.default_rng(seed), requests=requests, workers=workers, groups=2)
    day = replace(day, utility=day.utility + liking)
    bound = arrival_exact(day, nonnegative=nonnegative)
    verdict = prove(bound, day)
    assert abs(verdict.gap) <= 1e-8  # a few roundings of about 1000 units of money per worker
    assert bound.value <= arrival_exact(day, nonnegative=False).value + 1e-9


@pytest.mark.parametrize("from_stage", [0, 2])
def test_lowered_tables_do_not_pass(random_instance, from_stage):
    """Who lowers the first table, and the bound with it, or all later ones, is found out."""
    day = random_instance(np.random.default_rng(4), lifetime=5.0)
    bound = arrival_exact(day)
    tables = [table - 0.1 * (j >= from_stage) for j, table in enumerate(bound.certificate.tables)]
    value = bound.value - 0.1 if from_stage == 0 else bound.value
    forged = replace(bound, value=value, certificate=replace(bound.certificate, tables=tuple(tables)))
    with pytest.raises(SolverError, match="claimed"):
        prove(forged, day)


def test_a_certificate_of_another_instance_proves_no_less_than_is_true(random_instance):
    """Same requests and workers, other rewards: what it proves there is still a bound."""
    day = random_instance(np.random.default_rng(5))
    proof = arrival_exact(day).certificate
    richer = replace(day, reward=day.reward + 10.0)
    assert proof.check(richer).bound >= arrival_exact(richer).value - 1e-9


@pytest.mark.parametrize(
    "change",
    [
        {"tracked": np.ones(3, bool)},
        {"multipliers": np.ones(3)},
        {"multipliers": np.full(8, -1.0)},
        {"multipliers": np.full(8, np.nan)},
        {"tables": ()},
        {"tables": (np.zeros(3),)},
    ],
)
def test_a_certificate_that_does_not_fit_is_refused(random_instance, change):
    day = random_instance(np.random.default_rng(6))
    with pytest.raises(InputError):
        replace(arrival_exact(day).certificate, **change).check(day)


@pytest.mark.parametrize("sizes", [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}])
def test_with_nobody_to_serve_or_to_be_served_the_penalties_are_paid(random_instance, sizes):
    day = random_instance(np.random.default_rng(7), **sizes)
    bound = arrival_exact(day)
    assert bound.value == sum_up(day.penalty)
    assert prove(bound, day).gap <= 1e-15 * abs(bound.value)
    assert bound.solver.details["states"] == 0


def test_the_noise_is_not_looked_at(random_instance):
    day = random_instance(np.random.default_rng(8))
    assert arrival_exact(replace(day, noise=None, outside_noise=None)).value == arrival_exact(day).value


def crowd(count):
    """Requests that are all open at the same three workers."""
    same = {"arrival": np.zeros(count, int), "expiry": np.full(count, 3), "reward": np.full(count, 30.0)}
    places = {"pickup": np.zeros(count, int), "dropoff": np.zeros(count, int), "features": np.zeros((count, 0))}
    return one_request(3, utility=np.full((1, count), -10.0), penalty=np.full(count, -1.0), **same, **places)


def test_too_many_open_requests_are_refused_with_the_size_the_step_and_a_way_out():
    with pytest.raises(
        SolverError, match=r"^9 requests .* at step 2 .* 2\^9 states .* limit = 8; take method=\"hybrid\""
    ):
        arrival_exact(crowd(9), limit=8)
    assert isinstance(arrival_exact(crowd(9), limit=9), Bound)


@pytest.mark.parametrize("limit", [-1, 2.5, True, "8"])
def test_a_limit_is_a_whole_number(limit):
    with pytest.raises(InputError, match="limit"):
        arrival_exact(crowd(2), limit=limit)


def test_the_record_tells_the_sizes():
    bound = arrival_exact(crowd(5))
    assert (bound.kind, bound.solver.method) == ("arrival information", "exact")
    sizes = {name: bound.solver.details[name] for name in ("largest_open_set", "largest_lattice", "states")}
    assert sizes == {"largest_open_set": 5, "largest_lattice": 5, "states": 1 + 32 + 32}
