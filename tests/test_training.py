"""Training the value of waiting."""

from dataclasses import replace

import numpy as np
import pytest

from optkit.errors import InputError
from optkit.learning import learn_preferences
from optkit.metrics import mean_interval
from optkit.policies import PostDecisionPricing
from optkit.scenarios import scenario
from optkit.simulator import simulate
from optkit.training import train_ranked_value


@pytest.mark.parametrize("name", ["I.1", "II"])
def test_waiting_pays_where_workers_are_scarce(name):
    """On fresh instances the trained policy earns more than the myopic one: the paired 95 % interval excludes zero."""
    source = scenario(name, seed=0)
    trained = train_ranked_value(source.sample(240, seed=5))
    fresh = source.sample(200, seed=6)
    gain = mean_interval(simulate(fresh, trained.policy).reward, simulate(fresh, PostDecisionPricing()).reward)
    assert gain.low > 0


def test_waiting_is_worth_nothing_where_nothing_can_wait():
    """If every request lives for one step, there is nothing to lose, and the policy is the myopic one."""
    days = [replace(day, expiry=day.arrival) for day in scenario("I.1", seed=0).sample(20, seed=1)]
    trained = train_ranked_value(days)
    assert not trained.value.coefficients.any()
    assert np.array_equal(simulate(days, trained.policy).reward, simulate(days, PostDecisionPricing()).reward)


def test_waiting_pays_where_workers_abound():
    """With a worker at every step waiting has a value too: pay little, and wait for one who is in the mood."""
    source = scenario("I.1", seed=0, request_rate=0.08, worker_rate=3.0)
    trained = train_ranked_value(source.sample(200, seed=1))
    fresh = source.sample(200, seed=2)
    gain = mean_interval(simulate(fresh, trained.policy).reward, simulate(fresh, PostDecisionPricing()).reward)
    assert gain.low > 0


def test_learned_preferences_lose_little():
    """With learned preferences in place of the truth, the trained policy still beats the true-model myopic one."""
    source = scenario("I.1", seed=0)
    days, fresh = source.sample(240, seed=5), source.sample(200, seed=6)
    trained = train_ranked_value(days, preferences=learn_preferences(days).preferences)
    gain = mean_interval(simulate(fresh, trained.policy).reward, simulate(fresh, PostDecisionPricing()).reward)
    assert gain.low > 0


def test_same_seed_same_coefficients():
    """Training is reproducible, and its record names rounds, exploration and residuals."""
    days = scenario("I.2", seed=0).sample(40, seed=1)
    one, two = (train_ranked_value(days, seed=3) for _ in range(2))
    assert np.array_equal(one.value.coefficients, two.value.coefficients)
    assert [row["deviation"] for row in one.record] == [8.0, 4.0]
    assert not one.value.coefficients[-1].any()


@pytest.mark.parametrize(
    "options", [{"ridge": -1.0}, {"discount": 1.5}, {"deviations": ()}, {"deviations": (-1.0,)}, {"seed": -1}]
)
def test_bad_arguments_are_refused(options):
    """Arguments out of range are errors of ours."""
    with pytest.raises(InputError):
        train_ranked_value(scenario("I.2", seed=0).sample(3, seed=1), **options)


def test_nothing_to_train_on_is_refused():
    """Neither no instances nor instances without requests can be trained on."""
    empty = scenario("I.1", seed=0, request_rate=0.0).sample(2, seed=0)
    for instances in ([], empty):
        with pytest.raises(InputError):
            train_ranked_value(instances)
