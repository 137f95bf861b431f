"""Laws of every policy of the kit: feasible, repeatable, blind to what it may not see, and the same in any company."""

import dataclasses

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.gap.fluid_scenario import bid_prices
from optkit.learning.beliefs import BelievedValue
from optkit.learning.perturbation import perturb, true_preferences
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.policies import Formula, PostDecisionPricing, RewardPercentage
from optkit.policies.explore import Explore, RandomOffers
from optkit.simulation.batch import Batch
from optkit.simulation.state import State

SOURCE = scenario("II", seed=0, horizon=15)
DAYS = SOURCE.sample(8, seed=1)
BELIEVED = perturb(true_preferences(SOURCE), 3.0, seed=0)
DRAWN = {"random": RandomOffers(seed=3), "exploring": Explore(RewardPercentage(0.5), 2.0)}
"""These draw one number for each entry of what they are shown, which company changes."""


@pytest.fixture(scope="module")
def policies():
    """All of them by name; of those that price optimally, with true preferences and with others."""
    value = train(DAYS, LinearValue(busy_knots=(0.0, 3.0)), choice="true").value
    return {
        **DRAWN,
        "share": RewardPercentage(0.6),
        "formula": Formula(0.5, 7.0, -0.1, 0.3),
        "myopic": PostDecisionPricing(),
        "clipped": PostDecisionPricing(nonnegative="clip"),
        "believing": PostDecisionPricing(choice=BELIEVED),
        "bid prices": PostDecisionPricing(value_function=bid_prices(SOURCE, 1e-2)[1]),
        "patient": PostDecisionPricing(value_function=BelievedValue(value)),
        "patient believing": PostDecisionPricing(choice=BELIEVED, value_function=BelievedValue(value, BELIEVED)),
    }


SEE_THE_TRUTH = ("myopic", "clipped", "bid prices", "patient")
NAMES = (
    *("random", "exploring", "share", "formula", "myopic", "clipped", "believing", "bid prices"),
    *("patient", "patient believing"),
)
every_policy = pytest.mark.parametrize("name", NAMES)


@pytest.fixture(scope="module")
def visited():
    """Some states of a run, with many and with few open requests."""
    seen = []
    simulate(DAYS, RewardPercentage(0.5), observe=lambda state, *_: seen.append(state))
    return seen[::4]


def prices(policy, state):
    """Return what it pays where something is offered."""
    return np.where(state.offered, policy(state), 0.0)


def shown(state, batch, rows=slice(None), columns=slice(None)):
    """Return the same decisions, or some, in another batch."""
    places = (state.row[rows], state.instance[rows], state.worker[rows])
    return State(batch, state.step, *places, state.request[rows, columns], state.offered[rows, columns])


@pytest.mark.slow
@every_policy
def test_offers_are_feasible_and_repeatable(policies, visited, name):
    """Finite numbers of at least 0, the same when asked again."""
    assert set(policies) == set(NAMES)
    for state in visited:
        paid = prices(policies[name], state)
        assert paid.shape == state.offered.shape
        assert ((paid >= 0) & np.isfinite(paid)).all()
        np.testing.assert_array_equal(prices(policies[name], state), paid)


@pytest.mark.slow
@every_policy
def test_what_may_not_be_seen_does_not_matter(policies, visited, name):
    """Not the workers' noise, nor requests and workers of later steps; nor, unless it knows them, true preferences."""
    rng = np.random.default_rng(0)
    for state in visited:

        def otherwise(day, step=state.step):
            later, drawn = day.arrival > step, {}
            for field, money in (("reward", 50.0), ("penalty", -9.0)):
                drawn[field] = np.where(later, money * rng.random(later.size), getattr(day, field))
            unseen = later if name in SEE_THE_TRUTH else np.ones_like(later)
            drawn["utility"] = np.where(unseen, -30 * rng.random(day.utility.shape), day.utility)
            drawn["features"] = np.where(later[:, None], rng.random(day.features.shape), day.features)
            to_come = day.worker_step > step
            drawn["worker_group"] = np.where(to_come, (day.worker_group + 1) % day.n_groups, day.worker_group)
            if name not in SEE_THE_TRUTH:
                drawn |= {"mu": 2 * day.mu, "outside_utility": day.outside_by_group - 3.0}
            return dataclasses.replace(day, **drawn).with_noise(rng)

        other = Batch.of([otherwise(day) for day in DAYS])
        np.testing.assert_array_equal(prices(policies[name], shown(state, other)), prices(policies[name], state))


@pytest.mark.parametrize("name", [name for name in NAMES if name not in DRAWN])
def test_company_does_not_matter(policies, visited, name):
    """A decision alone, without padding, is priced as among others (rounding: 1e-9)."""
    for state in visited[::2]:
        together = prices(policies[name], state)
        for k in range(len(state.row)):
            width = int(state.offered[k].sum())
            alone = prices(policies[name], shown(state, state.batch, slice(k, k + 1), slice(width)))
            np.testing.assert_allclose(alone[0], together[k, :width], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", SEE_THE_TRUTH)
def test_the_law_can_fail(policies, visited, name):
    """Who knows the true preferences prices by them: the laws above see it when they change."""
    state = visited[0]
    other = Batch.of([dataclasses.replace(day, utility=day.utility - 5.0) for day in DAYS])
    assert np.abs(prices(policies[name], shown(state, other)) - prices(policies[name], state)).max() > 0.1
