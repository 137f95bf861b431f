"""The market of an instance, its dual in closed form, and the certificate that needs nothing but multipliers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.market import MultiplierCertificate, OpenPairs
from optkit.bounds.bound import Bound, SolverRecord, prove
from optkit.models.pricing import optimal_prices

seeds = st.integers(0, 2**32 - 1)
kinds = st.fixed_dictionaries(
    {
        "groups": st.integers(1, 3),
        "ties": st.booleans(),
        "reward": st.sampled_from([-50.0, 0.0, 30.0, 300.0]),
        "lifetime": st.sampled_from([1.0, 5.0]),
        "requests": st.integers(1, 12),
    }
)


def claim(value, multipliers):
    return Bound(value, "arrival information", MultiplierCertificate(multipliers), SolverRecord("test", "", 0.0))


def by_definition(day, multipliers):
    """D(l) worker by worker, from the definition of Lambert's W, in extended precision where there is one."""
    long = np.longdouble
    total = day.penalty.astype(long).sum() + multipliers.astype(long).sum()
    for step, d in zip(day.worker_step, day.worker_group, strict=True):
        at = (day.arrival <= step) & (step <= day.expiry)
        mu, outside = long(day.mu[d]), long(day.outside_by_group[d])
        earned = day.reward.astype(long) - day.penalty - multipliers
        score = ((earned + day.utility[d] - outside) / mu - 1)[at]
        if not score.size:
            continue
        z = score.max() + np.log(np.exp(score - score.max()).sum())
        # Newton's method from above, on y + ln y = z, or on y e^y = e^z where the logarithm would be negative.
        y = z if z > 1 else np.exp(z)
        for _ in range(60):
            y = y * (1 + z - np.log(y)) / (1 + y) if z > 1 else y - (y - np.exp(z - y)) / (1 + y)
        total += mu * y
    return total


def a_solution(day, multipliers):
    """The workers' response by optimal_prices, scaled down where a request is served more than once, (J, n + 1)."""
    J, n = day.n_workers, day.n_requests
    P = np.zeros((J, n))
    for j, (step, d) in enumerate(zip(day.worker_step, day.worker_group, strict=True)):
        at = (day.arrival <= step) & (step <= day.expiry)
        value = day.reward - day.penalty - multipliers
        P[j] = optimal_prices(
            value, day.utility[d], day.mu[d], outside_utility=day.outside_by_group[d], nonnegative=False, offered=at
        ).acceptance
    return P / np.maximum(P.sum(axis=0), 1.0)


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, kinds, st.floats(0, 100))
def test_the_dual_is_its_definition_and_never_below_it(random_instance, seed, kind, level):
    rng = np.random.default_rng(seed)
    day = random_instance(rng, **kind)
    multipliers = level * rng.random(day.n_requests)
    market = OpenPairs.of(day)
    bound, exact = market.verdict(multipliers).bound, by_definition(day, multipliers)
    assert bound >= exact or not market.size  # a plain sum is not rounded up
    # 1e-11 of the money in play, at most 1e4: the promised rounding itself.
    assert bound == pytest.approx(float(exact), abs=1e-11 * 1e4)


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, kinds, st.floats(0, 100))
def test_the_gradient_is_that_of_finite_differences(random_instance, seed, kind, level):
    rng = np.random.default_rng(seed)
    day = random_instance(rng, **kind)
    multipliers = 1.0 + level * rng.random(day.n_requests)
    market = OpenPairs.of(day)
    if not market.size:
        return
    slope = market.count - market.served(market.respond(multipliers)[1])
    direction = rng.standard_normal(day.n_requests)
    h = 1e-5
    up, down = (by_definition(day, multipliers + sign * h * direction) for sign in (1, -1))
    # Central differences: h^2 times third derivatives of order 1/mu^2 (mu >= 0.5), and rounding 1e-12 / h.
    assert float(up - down) / (2 * h) == pytest.approx(slope @ direction, abs=1e-6 * day.n_requests)


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, kinds, st.floats(0, 100))
def test_weak_duality_with_any_feasible_solution(random_instance, seed, kind, level):
    """What a feasible solution earns, computed from the definition, is what the verdict says, and below every D(l)."""
    rng = np.random.default_rng(seed)
    day = random_instance(rng, **kind)
    multipliers, others = (level * rng.random(day.n_requests) for _ in range(2))
    P = a_solution(day, multipliers)
    P0 = 1.0 - P.sum(axis=1, keepdims=True)
    d = day.worker_group
    with np.errstate(divide="ignore", invalid="ignore"):
        choice = np.where(P > 0, day.mu[d, None] * (np.log(P0) - np.log(P)), 0.0)
    advantage = day.reward - day.penalty + day.utility[d] - day.outside_by_group[d, None]
    earned = float(day.penalty.sum() + (P * (advantage + choice)).sum())
    verdict = OpenPairs.of(day).verdict(multipliers)
    # 1e-8: P0 = 1 - sum P has lost up to eight digits here where a worker hardly ever rejects.
    assert verdict.attained == pytest.approx(earned, rel=1e-8, abs=1e-8)
    for proven in (verdict.bound, OpenPairs.of(day).verdict(others).bound):
        assert verdict.attained <= proven
    assert verdict.residual == 0


def test_the_response_is_every_workers_unconstrained_optimum(random_instance):
    day = random_instance(np.random.default_rng(0), groups=3, requests=20)
    multipliers = np.linspace(0, 20, 20)
    market = OpenPairs.of(day)
    _, acceptance = market.respond(multipliers)
    response = np.zeros((market.mu.size, 20))
    response[market.worker, market.request] = acceptance
    expected = np.array(
        [
            optimal_prices(
                day.reward - day.penalty - multipliers, day.utility[d], day.mu[d], nonnegative=False,
                outside_utility=day.outside_by_group[d], offered=(day.arrival <= step) & (step <= day.expiry),
            ).acceptance
            for step, d in zip(day.worker_step, day.worker_group, strict=True)
        ]
    )  # fmt: skip
    met = expected.any(axis=1)
    assert np.allclose(response, expected[met], rtol=1e-12, atol=0)  # the same formula, sums in another order


def test_requests_of_a_kind_can_be_counted_instead_of_listed(random_instance):
    """Three copies of every request, at equal multipliers, are one request with a count of three."""
    rng = np.random.default_rng(1)
    day = random_instance(rng, groups=2)
    listed = replace(
        day, **{name: np.repeat(getattr(day, name), 3, axis=-1) for name in ("arrival", "expiry", "reward", "penalty",
        "pickup", "dropoff", "utility")}, features=np.repeat(day.features, 3, axis=0), noise=None, outside_noise=None,
    )  # fmt: skip
    multipliers = 10 * rng.random(day.n_requests)
    counted = OpenPairs.of(day, np.ones(day.n_workers), np.full(day.n_requests, 3.0)).verdict(multipliers)
    expected = OpenPairs.of(listed).verdict(np.repeat(multipliers, 3))
    assert counted.bound == pytest.approx(expected.bound, rel=1e-12)  # rounding
    assert counted.attained == pytest.approx(expected.attained, rel=1e-12)


def test_an_absent_worker_adds_nothing_and_a_likely_one_his_share(random_instance):
    day = random_instance(np.random.default_rng(2))
    multipliers = np.full(day.n_requests, 5.0)
    ones = np.ones(day.n_requests)
    constant = day.penalty.sum() + multipliers.sum()
    full, half = (OpenPairs.of(day, np.full(day.n_workers, q), ones).verdict(multipliers).bound for q in (1.0, 0.5))
    assert half - constant == pytest.approx((full - constant) / 2, rel=1e-12)  # rounding


def test_a_negative_multiplier_breaks_weak_duality_and_is_refused(random_instance):
    """Nobody competes for a request that no worker is there for, so that its multiplier would lower D without end."""
    day = random_instance(np.random.default_rng(4), workers=0)
    multipliers = np.zeros(day.n_requests)
    multipliers[2] = -40.0
    verdict = MultiplierCertificate(multipliers).check(day)
    assert verdict.residual == 40.0
    # What the positive part of the multipliers proves.
    assert verdict.bound == pytest.approx(
        day.penalty.sum(), rel=1e-15
    )  # what the positive part of the multipliers proves
    with pytest.raises(SolverError, match="breaks a constraint"):
        prove(claim(day.penalty.sum() - 40.0, multipliers), day)


@pytest.mark.parametrize("wrong", [np.zeros(7), np.zeros((8, 1)), np.full(8, np.nan), np.full(8, np.inf)])
def test_multipliers_that_do_not_fit_are_refused(random_instance, wrong):
    day = random_instance(np.random.default_rng(5))
    with pytest.raises(InputError, match=r"multipliers has shape|multipliers\[0\] is"):
        MultiplierCertificate(wrong).check(day)


def test_the_noise_is_not_looked_at(random_instance):
    day = random_instance(np.random.default_rng(6))
    multipliers = np.ones(day.n_requests)
    bare = replace(day, noise=None, outside_noise=None)
    assert MultiplierCertificate(multipliers).check(day) == MultiplierCertificate(multipliers).check(bare)
