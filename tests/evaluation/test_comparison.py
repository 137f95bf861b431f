"""The comparison of policies."""

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.bounds import full_information
from optkit.evaluation.comparison import compare
from optkit.instances.catalogue import scenario
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.metrics import mean_interval, performance_ratio
from optkit.simulation.simulator import simulate


@pytest.fixture(scope="module")
def days():
    """A few instances of Scenario II."""
    return scenario("II", seed=1).sample(8, seed=2)


@pytest.fixture(scope="module")
def bounds(days):
    """Their full-information bounds."""
    return [full_information(day) for day in days]


def test_table_is_the_mean_of_the_rows(days, bounds):
    """Means, spreads, intervals and paired differences are those of the per-instance ratios, recomputed here."""
    policies = {"myopic": PostDecisionPricing(), "half": RewardPercentage(0.5)}
    found = compare(days, policies, bounds)
    least = [day.penalty.sum() for day in days]
    ratios = {
        n: performance_ratio(simulate(days, p).reward, [b.value for b in bounds], least) for n, p in policies.items()
    }
    for name, row in found.table.set_index("policy").iterrows():
        interval = mean_interval(ratios[name])
        paired = mean_interval(ratios[name], ratios["myopic"])
        assert (row["ratio"], row["low"], row["high"]) == (interval.mean, interval.low, interval.high)
        assert (row["difference"], row["difference_low"]) == (paired.mean, paired.low)
        assert np.array_equal(found.ratios()[name], ratios[name])


def test_shares_are_counted_from_the_simulation(days, bounds):
    """Served requests and the share of the reward kept follow from what was accepted and paid."""
    found = compare(days, {"half": RewardPercentage(0.5)}, bounds).table.iloc[0]
    outcome = simulate(days, RewardPercentage(0.5))
    assert found["served"] == outcome.served.sum() / sum(day.n_requests for day in days)
    assert found["margin_share"] == pytest.approx(0.5, rel=1e-12)  # half is paid, half is kept


@pytest.mark.parametrize(("take", "policies"), [(7, {"a": RewardPercentage(0.5)}), (8, {})])
def test_what_does_not_fit_is_refused(days, bounds, take, policies):
    """A bound too few, or no policy, is an error that says so."""
    with pytest.raises(InputError):
        compare(days, policies, bounds[:take])
