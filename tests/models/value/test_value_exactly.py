"""Light value functions against small models that are solved exactly."""

from itertools import product

import numpy as np
import pytest

from optkit import simulate
from optkit.bounds.exact.exact_value import solve_exactly
from optkit.bounds.exact.small_model import SmallModel
from optkit.learning.training import train
from optkit.models.pricing import optimal_prices
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.mean import MeanValue
from optkit.models.value.request_sets import KnownRequests, RequestSets, removal_differences
from optkit.policies import PostDecisionPricing
from optkit.simulation.metrics import mean_interval

TINY = SmallModel(
    horizon=6, reward=[30.0, 45.0], penalty=[-4.0, -10.0], lifetime=[3, 2], utility=[[-10.0, -28.0], [-25.0, -9.0]],
    mu=[2.0, 4.0], outside_utility=[0.0, 1.0], share=[0.4, 0.6], arrivals=[0.4, 0.3], workers=[0.45, 0.55],
)  # fmt: skip
"""Two types and two groups that differ in what they like: small enough to list every set that may wait."""

SCARCE = SmallModel(
    horizon=12, reward=[30.0, 60.0], penalty=[-2.0, -2.0], lifetime=[5, 5], utility=[[-10.0, -12.0]], mu=[3.0],
    arrivals=[0.5, 0.25], workers=[0.6, 0.4],
)  # fmt: skip
"""More requests than workers, of two worths: who serves the cheap ones may lack a worker for the dear ones."""

CHOOSY = SmallModel(
    horizon=10, reward=[50.0, 45.0], penalty=[-4.0, -10.0], lifetime=[4, 4], utility=[[-5.0, -35.0], [-35.0, -10.0]],
    mu=[2.0, 4.0], outside_utility=[0.0, 1.0], share=[0.4, 0.6], arrivals=[0.3, 0.3], workers=[0.3, 0.7],
)  # fmt: skip
"""Each group dislikes one type: it pays to wait for a worker of the other group."""


class AllSets:
    """Every set of requests that may wait in a small model, with targets in expectation over everything.

    There is one request for each type and step of arrival, so a set is a row of 0s and 1s over all of them.
    """

    def __init__(self, model):
        self.model, self.horizon = model, model.horizon
        kind, arrival = (x.ravel() for x in np.indices((model.reward.size, model.horizon)))
        expiry = np.minimum(arrival + model.lifetime[kind], model.horizon - 1)
        utility = model.utility[:, kind] - model.outside_by_group[:, None]
        none = np.zeros((kind.size, 0))
        # The type stands where the pick-up place does.
        self.requests = KnownRequests(
            model.reward[kind], model.penalty[kind], arrival, expiry, utility, none, kind, np.zeros_like(kind)
        )

    def sets(self, step):
        """All subsets of those that may wait."""
        r = self.requests
        may = np.flatnonzero((r.arrival <= step) & (r.expiry > step))
        if not may.size:
            return None
        member = np.zeros((2**may.size, r.reward.size), dtype=bool)
        member[:, may] = np.array(list(product([False, True], repeat=may.size)))
        return self._rows(step, member)

    def _rows(self, step, member):
        return RequestSets(self.requests, step, np.broadcast_to(np.arange(member.shape[1]), member.shape), member)

    def _target(self, value, step, member):
        """Lemma 1 before the new requests, the worker and the group are seen, (b,)."""
        m, r, total = self.model, self.requests, np.zeros(len(member))
        for new in product([0, 1], repeat=m.reward.size):
            chance = np.prod([stream.probability[c] for stream, c in zip(m.streams, new, strict=True)])
            open_ = member | ((r.arrival == step + 1) & (np.array(new)[r.pickup] == 1))
            over = open_ & (r.expiry == step + 1)
            waits = self._rows(step + 1, open_ & ~over)
            total += chance * (value.value(waits) + (over * r.penalty).sum(axis=1))
            worth = r.reward - over * r.penalty - value.opportunity_cost(waits)
            for group, share in enumerate(m.share):
                profit = optimal_prices(worth, r.utility[group], m.mu[group], offered=open_).profit
                total += chance * (1.0 - m.workers[0]) * share * profit
        return total

    def target_differences(self, value, step):
        """Target of each set less that without each member."""
        sets = self.sets(step)
        return removal_differences(lambda s: self._target(value, step, s.member), sets)


class Indicators:
    """A term with one coefficient for each multiset of (type, steps left) but the empty one."""

    def __init__(self, experience):
        self._number = {}
        for step in range(experience.horizon - 1):
            for key in self._keys(experience.sets(step)):
                if key:
                    self._number.setdefault(key, len(self._number))
        self.size = len(self._number)

    def _keys(self, sets):
        pairs = zip(sets.requests.pickup[sets.index], sets.steps_left, sets.member, strict=True)
        return [tuple(sorted(zip(k[on].tolist(), left[on].tolist(), strict=True))) for k, left, on in pairs]

    def _basis(self, sets):
        basis = np.zeros((len(sets), self.size))
        for b, key in enumerate(self._keys(sets)):
            if key:
                basis[b, self._number[key]] = 1.0
        return basis

    def value(self, sets, theta):
        """The coefficient of each set's multiset."""
        return self._basis(sets) @ theta

    def opportunity_cost(self, sets, theta):
        """Differences of coefficients."""
        return removal_differences(lambda s: self.value(s, theta), sets)

    def differences(self, sets):
        """Differences of indicators."""
        b, i = np.nonzero(sets.member)
        found = np.zeros((*sets.member.shape, self.size))
        found[b, i] = self._basis(sets)[b] - self._basis(sets.without(b, i))
        return found


def test_indicators_reproduce_the_exact_value_function():
    """With a coefficient for each state and exact expectations, the fit is the exact value function (1e-6 asked for).

    Opportunity costs and values beyond the empty set's, at every step and set; least squares leave some 1e-9.
    """
    experience = AllSets(TINY)
    fitted = LinearValue(terms=[Indicators(experience)], ridge=0.0).fit(experience)
    exact, seen = solve_exactly(TINY), 0
    for step in range(TINY.horizon - 1):
        sets = experience.sets(step)
        kind = experience.requests.pickup[sets.index]
        left = sets.steps_left.astype(int)
        cost = exact.opportunity_cost(step, kind, left, sets.member)
        np.testing.assert_allclose(fitted.opportunity_cost(sets), cost, atol=1e-6)
        level = exact.post_decision_value(step, kind, left, sets.member)
        np.testing.assert_allclose(fitted.value(sets), level - level[0], atol=1e-6)
        seen += sets.member.sum()
    assert seen > 200
    assert fitted.residual_ < 1e-6


@pytest.fixture(scope="module", params=[SCARCE, CHOOSY], ids=["scarce", "choosy"])
def solved(request):
    """A model, its exact value, fresh instances, and what the exact and the myopic policy earn on them."""
    model = request.param
    exact = solve_exactly(model)

    class Exact:
        def opportunity_cost(self, state):
            return exact.opportunity_cost(state.step, state.pickup, np.maximum(state.steps_left, 0), state.offered)

    fresh = model.sample(2500 if model is SCARCE else 4000, seed=2)
    policies = (PostDecisionPricing(value_function=Exact()), PostDecisionPricing())
    return model, exact.value, fresh, *(simulate(fresh, policy).reward for policy in policies)


@pytest.mark.slow
@pytest.mark.parametrize("form", [LinearValue(), KernelValue(), MeanValue()], ids=["linear", "kernel", "mean"])
def test_trained_policies_are_nearly_optimal(solved, form):
    """Trained on 300 instances, on 2500 or 4000 others: above myopic, not above the optimum, and within 0.5 % of it.

    Paired with the exact policy on the same instances, its share is known to some 0.2 %. All forms reach 99.7 % of it
    and more, myopic prices 99.0 and 95.4 %.
    """
    model, optimum, fresh, best, myopic = solved
    earned = simulate(fresh, train(model.sample(300, seed=1), form, choice="true").policy).reward
    assert mean_interval(earned, myopic).low > 0
    error = earned.std() / np.sqrt(earned.size)
    assert earned.mean() <= optimum + 4 * error
    assert abs(best.mean() - optimum) <= 4 * error
    assert mean_interval(earned, 0.995 * best).low > 0
