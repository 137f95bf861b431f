"""The comparison of policies."""

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.bounds import full_information
from optkit.evaluation.comparison import compare
from optkit.instances.catalogue import scenario
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.simulator import simulate


@pytest.fixture(scope="module")
def days():
    """A few instances of Scenario II."""
    return scenario("II", seed=1).sample(8, seed=2)


@pytest.fixture(scope="module")
def bounds(days):
    """Their full-information bounds."""
    return [full_information(day) for day in days]


@pytest.mark.slow
def test_table_is_what_the_formulas_give_by_hand(days, bounds):
    """Ratios, means, spreads, Student intervals and paired differences, written out here as the paper defines them."""
    policies = {"myopic": PostDecisionPricing(), "half": RewardPercentage(0.5)}
    found = compare(days, policies, bounds)
    assert found.table["policy"].tolist() == list(policies)
    quantile = 2.3646242515927849  # of Student's distribution with 7 degrees of freedom, at 97.5 %
    ratios = {}
    for name, policy in policies.items():
        ratios[name] = np.empty(len(days))
        for i, (day, bound) in enumerate(zip(days, bounds, strict=True)):
            nothing = sum(day.penalty)
            ratios[name][i] = 100 * (simulate(day, policy).reward[0] - nothing) / (bound.value - nothing)
        np.testing.assert_allclose(found.ratios()[name], ratios[name], rtol=1e-12)
    for name, row in found.table.set_index("policy").iterrows():
        for numbers, mean, low, high in (
            (ratios[name], "ratio", "low", "high"),
            (ratios[name] - ratios["myopic"], "difference", "difference_low", "difference_high"),
        ):
            centre = sum(numbers) / 8
            std = (sum((numbers - centre) ** 2) / 7) ** 0.5
            half = quantile * std / 8**0.5
            assert row[[mean, low, high]].tolist() == pytest.approx([centre, centre - half, centre + half], abs=1e-9)
            if mean == "ratio":
                assert row["std"] == pytest.approx(std, rel=1e-9)
    assert found.table["instances"].tolist() == [8, 8]
    assert found.table["difference"].iloc[1] < -5  # half the reward is far from optimal


def test_shares_are_counted_worker_by_worker(days, bounds):
    """A request is served where a worker took it; what the worker was not paid of its reward was kept."""

    def policy(state):
        return state.reward / (2 + 0.1 * state.offered.sum(axis=1, keepdims=True))

    found = compare(days, {"less in a crowd": policy}, bounds).table.iloc[0]
    served = rewards = paid = 0.0
    for day in days:
        one = simulate(day, policy)
        for request, pay in zip(one.accepted[0], one.compensation[0], strict=True):
            if request >= 0:
                served, rewards, paid = served + 1, rewards + day.reward[request], paid + pay
    assert served > 20
    assert found["served"] == pytest.approx(served / sum(day.n_requests for day in days), rel=1e-12)
    assert found["margin_share"] == pytest.approx((rewards - paid) / rewards, rel=1e-12)


@pytest.mark.parametrize(("take", "policies"), [(7, {"a": RewardPercentage(0.5)}), (8, {})])
def test_what_does_not_fit_is_refused(days, bounds, take, policies):
    """A bound too few, or no policy, is an error that says so."""
    with pytest.raises(InputError):
        compare(days, policies, bounds[:take])
