"""Bid prices from the fluid bound."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit import scenario
from optkit.basics.errors import InputError
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.fluid.bound import FluidModel, fluid_bound
from optkit.bounds.fluid.prices import FluidPrices

seeds = st.integers(0, 2**32 - 1)


def random_model(rng, *, horizon=6, classes=8, groups=2):
    arrival = rng.integers(0, horizon, classes)
    presence = rng.random((horizon, groups)) * (rng.random((horizon, 1)) < 0.8)
    return FluidModel(
        horizon, arrival, np.minimum(arrival + rng.integers(0, 4, classes), horizon - 1), 30 + 10 * rng.random(classes),
        -5 * rng.random(classes), -20 * rng.random((groups, classes)), 0.1 + rng.random(classes), presence / groups,
        1.0 + rng.random(groups), rng.random(groups),
    )  # fmt: skip


def with_one_more(model, count, step, steps_left, reward, penalty, utility):
    """The model with a class that comes after ``step``."""
    return replace(
        model,
        arrival=np.append(model.arrival, step + 1),
        expiry=np.append(model.expiry, step + steps_left),
        reward=np.append(model.reward, reward),
        penalty=np.append(model.penalty, penalty),
        utility=np.column_stack([model.utility, utility]),
        count=np.append(model.count, count),
    )


@pytest.mark.slow
@given(seeds)
@settings(max_examples=25, deadline=None)
def test_the_price_is_the_derivative_of_the_bound(seed):
    """What one more request that waits would add, by finite differences of the fluid bound."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    bound = fluid_bound(model, tolerance=1e-12)
    prices = FluidPrices.of(model, bound)
    step, left = int(rng.integers(0, 4)), int(rng.integers(1, 3))
    request = {"reward": rng.uniform(0, 60), "penalty": -5.0, "utility": -20 * rng.random(2)}
    h = 1e-5
    low, high = (
        fluid_bound(with_one_more(model, count, step, left, **request), tolerance=1e-12).value for count in (h, 2 * h)
    )
    # Extrapolated to no step at all, because the bound bends where noise is small: what is left is the third derivative
    # times the square of h, and 1e-12 of a gain near 200 over h.
    slope = [(value - bound.value) / more for value, more in ((low, h), (high, 2 * h))]
    price = prices.opportunity_cost(step, steps_left=left, **request)
    assert 2 * slope[0] - slope[1] == pytest.approx(price, abs=5e-3)


def test_prices_by_hand_where_groups_and_noise_agree():
    """One scale: M(l) = M(0) exp(-l/mu), so that l = mu max(0, ln M(0)), and the choice is worth mu min(1, M(0))."""
    model = replace(random_model(np.random.default_rng(4)), mu=[1.5, 1.5])
    prices = FluidPrices.of(model, fluid_bound(model))
    reward, penalty, utility = np.array([0.0, 15.0, 30.0, 60.0]), -5.0, np.array([[-10.0], [-14.0]])
    advantage = reward - penalty + utility - model.outside_utility[:, None]
    rate = np.exp(prices.log_rate[2:5]).sum(axis=0)
    often = (np.exp(advantage / 1.5) * rate[:, None]).sum(axis=0)
    assert often.min() < 1 < often.max()
    expected = penalty + 1.5 * (np.maximum(np.log(often), 0) + np.minimum(often, 1))
    cost = prices.opportunity_cost(1, reward, penalty, np.broadcast_to(utility, (2, 4)), 3)
    assert cost == pytest.approx(expected, rel=1e-10)  # rounding, and 1e-12 in the logarithm


def test_prices_fall_as_time_passes_and_end_at_nothing():
    model = random_model(np.random.default_rng(5))
    prices = FluidPrices.of(model, fluid_bound(model))
    cost = np.array([prices.opportunity_cost(step, 40.0, -5.0, [-10.0, -12.0], 5 - step) for step in range(6)])
    assert (np.diff(cost[:5]) <= 1e-12).all()
    assert cost[0] > cost[4] >= -5.0
    assert cost[5] == 0.0
    # A deadline beyond the horizon is one at the horizon.
    assert prices.opportunity_cost(3, 40.0, -5.0, [-10.0, -12.0], 99) == cost[3]


def test_prices_take_any_shape():
    model = random_model(np.random.default_rng(6))
    prices = FluidPrices.of(model, fluid_bound(model))
    left = np.array([[0, 1, 2], [3, 1, 0]])
    utility = np.full((2, 2, 3), -10.0)
    cost = prices.opportunity_cost(1, np.full((2, 3), 35.0), np.full((2, 3), -2.0), utility, left)
    assert cost.shape == (2, 3)
    assert (cost[left == 0] == 0).all()
    assert cost[0, 1] == cost[1, 1] == prices.opportunity_cost(1, 35.0, -2.0, [-10.0, -10.0], 1)


def test_prices_need_a_fluid_bound():
    model = random_model(np.random.default_rng(7))
    with pytest.raises(InputError, match="prices need a fluid bound"):
        FluidPrices.of(model, arrival_dual(scenario("I.1", seed=0).sample(1, seed=1)[0]))
    with pytest.raises(InputError, match=r"multipliers has shape \(3,\); it needs \(8,\)"):
        FluidPrices.of(model, fluid_bound(random_model(np.random.default_rng(8), classes=3)))


def test_where_nobody_comes_waiting_costs_the_penalty():
    model = replace(random_model(np.random.default_rng(3)), presence=np.zeros((6, 2)))
    assert FluidPrices.of(model, fluid_bound(model)).opportunity_cost(0, 30.0, -5.0, [-10.0, -10.0], 3) == -5.0
