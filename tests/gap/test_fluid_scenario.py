"""The fluid model of a scenario, against what is sampled from it, and its prices against simulation."""

from functools import cache

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError
from optkit.bounds import arrival_information
from optkit.bounds.fluid.bound import FluidModel, fluid_bound
from optkit.gap.fluid_scenario import BidPriceValue, bid_prices, fluid_model
from optkit.policies import PostDecisionPricing

SOURCE = scenario("II", seed=3, horizon=12, mean_lifetime=4.0)


@cache
def days_of_source():
    """Instances of the source; drawn when a test wants them, not whenever tests are looked for."""
    return SOURCE.sample(2000, seed=1)


@pytest.mark.slow
def test_expected_requests_are_those_that_come():
    """Means of numbers, money, windows and utilities, each within five standard errors of 2,000 instances."""
    model = fluid_model(SOURCE)

    def same(expected, observed):
        seen = np.array(observed)
        error = seen.std(axis=0, ddof=1) / np.sqrt(len(seen))
        assert (np.abs(seen.mean(axis=0) - expected) <= 5 * error + 1e-12).all()

    same(model.count.sum(), [day.n_requests for day in days_of_source()])
    same(model.count @ model.reward, [day.reward.sum() for day in days_of_source()])
    same(model.count @ model.penalty, [day.penalty.sum() for day in days_of_source()])
    same(model.utility @ model.count, [day.utility.sum(axis=1) for day in days_of_source()])
    for step in range(12):
        same(model.count[model.expiry == step].sum(), [(day.expiry == step).sum() for day in days_of_source()])
        same(model.count[model.arrival == step].sum(), [(day.arrival == step).sum() for day in days_of_source()])
    brief = model.expiry - model.arrival < 3
    same(
        (model.count * model.reward)[brief].sum(), [d.reward[d.expiry - d.arrival < 3].sum() for d in days_of_source()]
    )
    there = np.zeros((len(days_of_source()), 12, 3))
    for seen, day in zip(there, days_of_source(), strict=True):
        seen[day.worker_step, day.worker_group] = 1
    same(model.presence, there)


@pytest.mark.slow
def test_the_bound_is_proven_and_above_what_can_be_earned():
    """The certificate holds against the model made anew, and the bound lies above arrival information in the mean."""
    bound, value = bid_prices(SOURCE)
    verdict = bound.certificate.check(fluid_model(SOURCE))
    assert verdict.bound == pytest.approx(bound.value, rel=1e-12)
    exact = np.array([arrival_information(day).value for day in days_of_source()[:150]])
    assert bound.value > exact.mean() + 3 * exact.std() / np.sqrt(150)
    earned = simulate(days_of_source(), PostDecisionPricing(value_function=value)).reward
    assert earned.mean() < bound.value


@pytest.mark.slow
def test_sampled_means_come_near():
    """FluidModel.from_instances of 1,000 instances is within two per cent."""
    exact = fluid_bound(fluid_model(SOURCE), tolerance=1e-4).value
    assert fluid_bound(FluidModel.from_instances(days_of_source()[:1000]), tolerance=1e-4).value == pytest.approx(
        exact, rel=0.02
    )


@pytest.mark.slow
def test_bid_prices_pay_where_requests_are_many():
    """On I.3 they earn more than the myopic policy does, with an interval that excludes zero."""
    source = scenario("I.3", seed=0, horizon=20)
    _, value = bid_prices(source, tolerance=1e-4)
    days = source.sample(200, seed=1)
    gain = (
        simulate(days, PostDecisionPricing(value_function=value)).reward - simulate(days, PostDecisionPricing()).reward
    )
    assert gain.mean() > 2 * gain.std(ddof=1) / np.sqrt(gain.size)


@pytest.mark.slow
def test_bid_prices_are_zero_where_nothing_waits():
    """What expires now has no future."""
    seen = []

    class Noted(BidPriceValue):
        def opportunity_cost(self, state):
            seen.append((state.offered & (state.steps_left > 0), super().opportunity_cost(state)))
            return seen[-1][1]

    simulate(
        days_of_source()[:5], PostDecisionPricing(value_function=Noted(bid_prices(SOURCE, tolerance=1e-3)[1].prices))
    )
    assert any(waits.any() for waits, _ in seen)
    assert all((cost[~waits] == 0).all() and np.isfinite(cost).all() for waits, cost in seen)


def test_random_utilities_are_refused():
    """Each would be a class of its own."""
    with pytest.raises(InputError, match="utility_noise = 1"):
        fluid_model(scenario("I.1", seed=0, utility_noise=1.0))
