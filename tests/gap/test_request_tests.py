"""Whether requests arrive as was assumed."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import scenario
from optkit.bounds.penalised.foresight import Foresight
from optkit.gap.request_tests import request_test
from optkit.gap.simulated_test import LEVEL

HERE = {"seed": 0, "horizon": 20}


@pytest.fixture(scope="module")
def pool():
    """What might have arrived, by the assumption."""
    return Foresight([0.5], [1.0], scenario("I.2", **HERE).sample(150, seed=1))


@pytest.mark.slow
def test_the_true_process_is_seldom_contradicted(pool):
    """P-values of other days of the same scenario are spread over 0 to 1."""
    p = [request_test(scenario("I.2", **HERE).sample(8, seed=s), pool, seed=s).p for s in range(2, 22)]
    assert sum(one <= LEVEL for one in p) <= 1
    assert 0.3 < np.mean(p) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda day: replace(day, reward=day.reward * 1.3), "rewards"),
        (lambda day: replace(day, penalty=day.penalty * 1.5), "penalties"),
        (lambda day: replace(day, utility=day.utility - 5.0), "utilities"),
        (lambda day: replace(day, arrival=np.minimum(day.arrival, 9)), ""),
        (lambda day: replace(day, pickup=np.zeros_like(day.pickup)), "places"),
        (lambda day: replace(day, features=day.features + 0.5), "features"),
        (lambda day: replace(day, features=day.features[:, :2]), "features"),
    ],
)
def test_days_that_were_changed_are_contradicted(pool, change, told):
    """Amounts, kinds, places or times of other days than the pool's; the line says what stands out."""
    days = [replace(day, noise=None, outside_noise=None) for day in scenario("I.2", **HERE).sample(40, seed=2)]
    assert not request_test(days, pool).contradicted
    found = request_test([change(day) for day in days], pool)
    assert found.contradicted
    assert told in found.told


@pytest.mark.slow
def test_numbers_and_their_spread_are_compared(pool):
    """More requests a day; or as many, but good days and bad days."""
    more = request_test(scenario("I.2", request_rate=0.6, **HERE).sample(20, seed=2), pool)
    assert more.contradicted
    quiet, busy = (scenario("I.2", request_rate=rate, **HERE).sample(20, seed=2) for rate in (0.05, 0.55))
    found = request_test([*quiet, *busy], pool)
    assert found.contradicted


@pytest.mark.slow
def test_a_pool_that_is_all_that_can_be(pool):
    """Days of it are not contradicted, whatever their weights; a day that it does not hold is, outright."""
    few = pool.arrivals[:3]
    assumed = Foresight([0.5], [1.0], few, weight=[0.5, 0.25, 0.25])
    rng = np.random.default_rng(0)
    picked = [few[i] for i in rng.choice(3, 40, p=[0.5, 0.25, 0.25])]
    assert not request_test(picked, assumed).contradicted
    assert request_test([few[1]] * 40, assumed).contradicted
    assert request_test(list(pool.arrivals[3:20]), assumed).contradicted


def test_nothing_is_assumed_of_requests_without_a_pool():
    assert request_test(scenario("I.2", **HERE).sample(2, seed=1), Foresight([0.5], [1.0])) is None
