"""Newton's method on the dual: it converges, however steep, and by whichever linear algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from optkit import scenario
from optkit.basics.errors import InputError
from optkit.bounds.arrival import newton as dual_newton
from optkit.bounds.arrival.market import OpenPairs
from optkit.bounds.arrival.newton import check_options, minimise

seeds = st.integers(0, 2**32 - 1)
kinds = st.fixed_dictionaries(
    {
        "groups": st.integers(1, 3),
        "ties": st.booleans(),
        "reward": st.sampled_from([-100.0, 0.0, 30.0, 300.0]),
        "lifetime": st.sampled_from([1.0, 5.0, 50.0]),
        "requests": st.integers(1, 30),
        "workers": st.integers(1, 12),
    }
)


def stretched(market, factor):
    """The same market with every mu multiplied."""
    return OpenPairs(
        market.worker, market.request, market.advantage, market.money, factor * market.mu, market.presence,
        market.count, market.constant,
    )  # fmt: skip


@pytest.mark.slow
@given(seeds, kinds, st.sampled_from([0.1, 1.0, 10.0, 1e3]))
@settings(deadline=None)  # the first example imports SciPy's linear algebra
def test_the_optimum_is_certified_at_any_noise(random_instance, seed, kind, factor):
    market = stretched(OpenPairs.of(random_instance(np.random.default_rng(seed), **kind)), factor)
    solved = minimise(market)
    verdict = market.verdict(solved.multipliers)
    assert solved.status == "optimal"
    assert verdict.residual == 0
    # The tolerance of 1e-9 of the gain, and the rounding that the bound adds to it.
    assert verdict.gap <= 1e-9 * (verdict.bound - market.constant) + 2e-10


@pytest.mark.slow
@given(seeds, kinds)
@settings(deadline=None, max_examples=25)
def test_sparse_and_dense_linear_algebra_agree(random_instance, seed, kind):
    market = OpenPairs.of(random_instance(np.random.default_rng(seed), **kind))
    values = []
    for dense, workers in ((dual_newton.DENSE, 0), (0, 10**6), (0, 0)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(dual_newton, "DENSE", dense)
            patch.setattr(dual_newton, "DENSE_WORKERS", workers)
            solved = minimise(market)
        assert solved.status == "optimal"
        values.append(market.verdict(solved.multipliers).bound)
    assert np.ptp(values) <= 2e-9 * (values[0] - market.constant) + 1e-9  # the tolerance twice, and rounding


@pytest.mark.slow
def test_a_long_horizon_is_solved_as_well_as_by_a_first_order_method():
    day = scenario("I.3", seed=0, horizon=2000).sample(1, seed=1)[0]
    market = OpenPairs.of(day)
    assert market.mu.size * market.count.size > dual_newton.DENSE

    def dual(prices):
        ratio, acceptance = market.respond(prices)
        return market.gain(prices, ratio), market.count - market.served(acceptance)

    first_order = minimize(
        dual, np.zeros(day.n_requests), jac=True, method="L-BFGS-B", bounds=[(0, None)] * day.n_requests,
        options={"maxiter": 2000, "maxfun": 2000, "ftol": 1e-13},
    )  # fmt: skip
    solved = minimise(market)
    assert solved.status == "optimal"
    ours = dual(solved.multipliers)[0]
    assert ours <= first_order.fun * (1 + 1e-9)  # the tolerance
    assert ours == pytest.approx(first_order.fun, rel=1e-6)  # L-BFGS-B stops where the last digits stop to change


def test_the_optimality_conditions_hold():
    """Served once at most; exactly once where the multiplier is positive."""
    market = OpenPairs.of(scenario("II", seed=0).sample(1, seed=2)[0])
    solved = minimise(market, tolerance=1e-12)
    served = market.served(market.respond(solved.multipliers)[1])
    # The gap of 1e-12 of a gain near 2000 at a curvature of about 1 leaves 1e-5 in the gradient at worst.
    assert served.max() <= 1 + 1e-4
    assert served[solved.multipliers > 1e-3] == pytest.approx(1.0, abs=1e-4)


def test_a_good_start_saves_steps():
    market = OpenPairs.of(scenario("I.1", seed=0).sample(1, seed=3)[0])
    cold = minimise(market)
    assert minimise(market, start=cold.multipliers).iterations == 0
    near = minimise(market, start=1.001 * cold.multipliers)
    assert near.status == "optimal"
    assert near.iterations < cold.iterations


@pytest.mark.parametrize("start", [0.0, 10.0, 1e4])
def test_a_bad_start_does_no_harm(start):
    day = scenario("I.1", seed=0).sample(1, seed=4)[0]
    market = OpenPairs.of(day)
    best = market.verdict(minimise(market).multipliers).bound
    solved = minimise(market, start=np.full(day.n_requests, start))
    assert solved.status == "optimal"
    assert market.verdict(solved.multipliers).bound == pytest.approx(best, rel=1e-8)  # the tolerance, of the gain


def test_an_accuracy_that_rounding_forbids_ends_and_says_so():
    market = OpenPairs.of(scenario("I.1", seed=0).sample(1, seed=5)[0])
    solved = minimise(market, tolerance=1e-30)
    assert solved.status == "optimal" or solved.status.startswith("stopped without further progress: valid")
    assert solved.gap <= 1e-12
    assert solved.iterations < 100


def test_no_step_is_an_end_that_says_so(monkeypatch):
    monkeypatch.setattr(dual_newton, "ROUNDS", 0)
    market = OpenPairs.of(scenario("I.1", seed=0).sample(1, seed=5)[0])
    solved = minimise(market)
    assert solved.status.startswith("stopped without further progress: valid")
    assert (solved.multipliers == 0).all()
    assert solved.gap > 0.01


def test_steps_run_out():
    market = OpenPairs.of(scenario("I.1", seed=0).sample(1, seed=6)[0])
    best = market.verdict(minimise(market).multipliers).bound
    for steps in (1, 4, 8):
        solved = minimise(market, max_iterations=steps)
        assert solved.iterations == steps
        assert solved.status.startswith(f"stopped by the limit of {steps} steps: valid")
        gain = market.verdict(solved.multipliers).bound - market.constant
        assert gain > best - market.constant
        assert gain * (1 - solved.gap) <= best - market.constant  # the gap that it reports is no promise too much


@pytest.mark.parametrize(("tolerance", "steps"), [(0.0, 1), (-1.0, 1), (float("nan"), 1), (1e-9, 0)])
def test_options_out_of_range_are_refused(tolerance, steps):
    with pytest.raises(InputError, match=r"tolerance|max_iterations"):
        check_options(tolerance, steps)
