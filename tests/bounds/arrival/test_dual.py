"""The arrival-information bound by multipliers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import lambertw

from optkit import scenario
from optkit.basics.errors import InputError
from optkit.bounds import full_information
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.bound import Bound, prove
from optkit.instances.instance import Instance

SCENARIOS = ("I.1", "I.2", "I.3", "II")
seeds = st.integers(0, 2**32 - 1)


def day_of(reward, penalty, utility, worker_step, mu=(1.0,), outside=0.0, group=None):
    """All requests are open from step 0 to the last worker's."""
    n, J = len(reward), len(worker_step)
    return Instance(
        horizon=max(worker_step, default=0) + 1, arrival=[0] * n, expiry=[max(worker_step, default=0)] * n,
        reward=reward, penalty=penalty, features=np.zeros((n, 0)), pickup=[0] * n, dropoff=[0] * n,
        worker_step=worker_step, worker_group=group or [0] * J, utility=np.reshape(utility, (len(mu), n)), mu=mu,
        outside_utility=outside,
    )  # fmt: skip


def by_slsqp(day):
    """The primal program over all pairs (every request is open to every worker), by a general solver."""
    J, n = day.n_workers, day.n_requests
    d = day.worker_group
    advantage = day.reward - day.penalty + day.utility[d] - day.outside_by_group[d, None]

    def loss(x):
        P = x.reshape(J, n)
        P0 = 1 - P.sum(axis=1, keepdims=True)
        return -(P * (advantage - day.mu[d, None] * (np.log(P) - np.log(P0)))).sum()

    def slack(x):
        P = x.reshape(J, n)
        return np.concatenate([1 - P.sum(axis=0), 1 - 1e-9 - P.sum(axis=1)])

    start = np.full(J * n, 0.5 / max(J, n))
    found = minimize(
        loss, start, bounds=[(1e-12, 1)] * (J * n), constraints={"type": "ineq", "fun": slack}, method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 1000},
    )  # fmt: skip
    return day.penalty.sum() - found.fun


@pytest.mark.parametrize("mu", [0.2, 1.0, 30.0])
@pytest.mark.parametrize("surplus", [-4.0, 0.0, 40.0])
def test_one_request_and_one_worker_by_hand(mu, surplus):
    """Nobody competes: beta + mu W0(exp(a/mu - 1))."""
    bound = arrival_dual(day_of([30.0 + surplus], [-5.0], [-33.0], [0], mu=[mu], outside=2.0))
    expected = -5.0 + mu * lambertw(np.exp(surplus / mu - 1)).real
    assert bound.value == pytest.approx(expected, rel=1e-12)  # rounding, which the bound has added
    assert bound.certificate.multipliers == pytest.approx([0.0])


def test_two_workers_and_one_request_by_hand():
    """Alike, each takes it with probability 1/2, so that mu y = mu, and l is what makes a worker want no more."""
    mu, surplus = 2.0, 20.0
    bound = arrival_dual(day_of([30.0], [0.0], [surplus - 30.0], [0, 1], mu=[mu]))
    # y = 1 where W0(x) = 1, so x = e: (a - l)/mu - 1 = 1. Then D = l + 2 mu.
    assert bound.certificate.multipliers == pytest.approx([surplus - 2 * mu], rel=1e-6)  # flat: the gap's square root
    assert bound.value == pytest.approx(surplus, rel=1e-9)  # the tolerance


@pytest.mark.parametrize("seed", range(6))
def test_two_by_two_by_a_general_solver(seed):
    rng = np.random.default_rng(seed)
    day = day_of(
        30 + rng.uniform(0, 10, 2), -rng.uniform(0, 5, 2), -rng.uniform(10, 40, 4), [0, 1],
        mu=rng.uniform(1, 5, 2), outside=rng.uniform(-2, 2, 2), group=[0, 1],
    )  # fmt: skip
    assert arrival_dual(day).value == pytest.approx(by_slsqp(day), rel=1e-6)  # SLSQP's differences by 1e-8


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_are_solved_and_proven(name):
    for day in scenario(name, seed=0).sample(5, seed=11):
        bound = arrival_dual(day)
        verdict = prove(bound, day)
        assert (bound.kind, bound.solver.method, bound.solver.status) == (
            "arrival information",
            "lagrangian",
            "optimal",
        )
        assert verdict.bound == bound.value
        assert verdict.gap == bound.solver.details["gap"]
        assert 0 <= verdict.gap <= 2e-9 * (bound.value - day.penalty.sum())  # the tolerance, and rounding


@pytest.mark.slow
def test_below_the_mean_of_full_information():
    """Who also knows the noise earns more in the mean; over 400 draws by far more than their standard error."""
    for day in scenario("II", seed=0).sample(2, seed=3):
        full = [full_information(day.with_noise(seed)).value for seed in range(400)]
        assert arrival_dual(day).value < np.mean(full) - 4 * np.std(full) / 20


def test_without_noise_it_becomes_the_matching():
    """As mu falls, the bound falls to the full-information bound without noise: mu y_t is the best of a - l."""
    day = scenario("I.1", seed=0).sample(1, seed=9)[0]
    quiet = replace(day, mu=1e-3 * day.mu, noise=0 * day.noise, outside_noise=0 * day.outside_noise)
    matching = full_information(quiet).value
    # Entropy: each worker's choice is worth mu ln(1 + number of options), and rejection takes mu ln(a/mu) off.
    few = 1e-3 * day.n_workers * np.log(1e6)
    assert abs(arrival_dual(quiet).value - matching) <= few
    assert abs(arrival_dual(day).value - matching) > few


@pytest.mark.slow
@given(seeds, st.integers(1, 3), st.integers(1, 40))
@settings(deadline=None)  # the first example imports SciPy's linear algebra
def test_stopping_early_is_valid_looser_and_says_so(random_instance, seed, groups, steps):
    day = random_instance(np.random.default_rng(seed), groups=groups, requests=25, workers=12)
    best, early = arrival_dual(day), arrival_dual(day, max_iterations=steps)
    assert early.value >= prove(best, day).attained
    assert prove(early, day).gap == early.solver.details["gap"]
    if early.solver.status != "optimal":
        assert "limit" in early.solver.status
        assert early.solver.details["gap"] > 1e-9 * (early.value - day.penalty.sum())


def test_a_looser_tolerance_is_kept_too():
    day = scenario("I.3", seed=0, horizon=500).sample(1, seed=2)[0]
    best, rough = arrival_dual(day), arrival_dual(day, tolerance=1e-3)
    assert rough.solver.status == "optimal"
    assert rough.solver.details["iterations"] < best.solver.details["iterations"]
    assert best.value <= rough.value <= best.value + 1e-3 * (best.value - day.penalty.sum())


@pytest.mark.parametrize("kind", [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}])
def test_where_nobody_meets_anybody_all_penalties_are_paid(random_instance, kind):
    day = random_instance(np.random.default_rng(7), **kind)
    bound = arrival_dual(day)
    assert isinstance(bound, Bound)
    total = math.fsum(day.penalty)
    assert 0 <= bound.value - total <= 1e-14 * abs(total)  # a proof rounds up
    assert bound.solver.status == "optimal"
    assert 0 <= prove(bound, day).gap <= 1e-14 * abs(total)


def test_requests_that_meet_nobody_add_their_penalty():
    day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    met = np.zeros(day.n_requests, bool)
    met[day.pairs()[1]] = True
    assert not met.all()
    kept = {name: getattr(day, name)[..., met] for name in ("arrival", "expiry", "reward", "penalty", "pickup",
            "dropoff", "utility")}  # fmt: skip
    part = replace(day, **kept, features=day.features[met], noise=None, outside_noise=None)
    assert arrival_dual(day).value == pytest.approx(arrival_dual(part).value + day.penalty[~met].sum(), rel=1e-9)


def test_pairs_that_nobody_wants_are_worth_nothing(random_instance):
    day = random_instance(np.random.default_rng(8), reward=-1e6)
    bound = arrival_dual(day)
    assert bound.solver.status == "optimal"
    assert bound.value == pytest.approx(day.penalty.sum(), abs=1e-8)  # rounding of 1e6


def test_requests_come_in_any_order():
    day = scenario("II", seed=0).sample(1, seed=5)[0]
    mixed = np.random.default_rng(0).permutation(day.n_requests)
    moved = {name: getattr(day, name)[..., mixed] for name in ("arrival", "expiry", "reward", "penalty", "pickup",
             "dropoff", "utility")}  # fmt: skip
    shuffled = replace(day, **moved, features=day.features[mixed], noise=None, outside_noise=None)
    assert arrival_dual(shuffled).value == pytest.approx(arrival_dual(day).value, rel=1e-9)  # the tolerance


def test_a_start_is_used():
    day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    best = arrival_dual(day)
    again = arrival_dual(day, multipliers=best.certificate.multipliers)
    assert again.solver.details["iterations"] == 0
    assert again.value == best.value


@pytest.mark.parametrize("wrong", [[1.0], np.zeros((25, 1)), "nan", "negative"])
def test_a_start_that_does_not_fit_is_refused(wrong):
    day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    if isinstance(wrong, str):
        wrong = np.full(day.n_requests, np.nan if wrong == "nan" else -1.0)
    with pytest.raises(InputError, match=r"multipliers(\[0\])? (has shape|is|=)"):
        arrival_dual(day, multipliers=wrong)


@pytest.mark.parametrize("option", [{"tolerance": 0.0}, {"max_iterations": 0}])
def test_options_out_of_range_are_refused(option):
    with pytest.raises(InputError, match=r"tolerance|max_iterations"):
        arrival_dual(scenario("I.1", seed=0).sample(1, seed=1)[0], **option)
