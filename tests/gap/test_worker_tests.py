"""Whether workers come as was assumed."""

import numpy as np
import pytest

from optkit import scenario
from optkit.basics.errors import InputError
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.gap.simulated_test import LEVEL, ProcessTest, stands_out
from optkit.gap.worker_tests import worker_test
from optkit.learning.worker_rates import learn_worker_rates
from tests.gap import processes

ASSUMED = Foresight(fifo_presence(0.5), np.ones(1))


@pytest.mark.slow
@pytest.mark.parametrize("process", processes.FALSE)
def test_what_is_not_the_process_is_contradicted(process):
    """The number a day may agree: by time of day, by stretch or by its spread it does not."""
    found = worker_test(processes.days(process, 40, seed=0), ASSUMED)
    assert found.contradicted
    assert "foretold" in found.told


def test_a_rush_is_told_by_its_hour():
    """The line says which part of the day is amiss, and by how much."""
    told = worker_test(processes.days(processes.rush, 10, seed=1), ASSUMED).told
    assert told.startswith("by time of day")
    assert "steps 13 to 24 saw" in told or "steps 0 to 12 saw" in told


@pytest.mark.slow
def test_the_true_process_is_seldom_contradicted(monkeypatch):
    """P-values of true processes are uniform: of 20 one at most is at the level, and they spread over 0 to 1."""
    monkeypatch.setattr(processes, "STEPS", 24)
    p = [worker_test(processes.days(processes.constant, 4, seed=s), ASSUMED, seed=s).p for s in range(20)]
    assert sum(one <= LEVEL for one in p) <= 1  # two or more in 0.2 % of cases
    assert 0.3 < np.mean(p) < 0.7
    assert np.quantile(p, 0.2) < 0.4


@pytest.mark.slow
def test_rates_by_step_are_tested_as_they_are():
    """A rush that is foretold is no contradiction, and a steady stream is one then."""
    rates = np.where(np.arange(50) < 25, 0.1, 0.9)
    foretold = Foresight(fifo_presence(rates), np.ones(1))
    assert not worker_test(processes.days(processes.rush, 30, seed=2), foretold).contradicted
    assert worker_test(processes.days(processes.constant, 30, seed=2), foretold).contradicted


@pytest.mark.slow
def test_groups_are_tested_by_time_of_day():
    """Shares that are right in all may be wrong morning and evening; right ones are not contradicted."""
    even = Foresight(fifo_presence(0.5), [0.5, 0.5])

    def mixed(step, rng):
        return rng.integers(0, 2, step.size)

    def parted(step, rng):
        return (rng.random(step.size) < np.where(step < 25, 0.2, 0.8)).astype(int)

    assert not worker_test(processes.days(processes.constant, 30, 3, mixed), even).contradicted
    found = worker_test(processes.days(processes.constant, 30, 3, parted), even)
    assert found.contradicted
    assert found.told.startswith("by group")
    never = Foresight(fifo_presence(0.5), [1.0, 0.0])
    assert worker_test(processes.days(processes.constant, 3, 3, mixed), never).p == 0.0


def test_what_cannot_be_is_contradicted_outright():
    """Workers where none can come, or none where one is certain."""
    some = processes.days(processes.constant, 3, seed=4)
    assert worker_test(some, Foresight([0.0], [1.0])).p == 0.0
    assert worker_test(some, Foresight([1.0], [1.0])).p == 0.0


def test_days_of_several_lengths_go_together():
    """What lies beyond a day's end is no step without a worker."""
    from dataclasses import replace

    long = processes.days(processes.constant, 12, seed=5)
    short = [
        replace(
            day, horizon=20, expiry=day.expiry[:0], worker_step=day.worker_step[day.worker_step < 20],
            worker_group=day.worker_group[day.worker_step < 20], utility=day.utility[:, :0], features=day.features[:0],
            noise=None, outside_noise=None,
            **{name: getattr(day, name)[:0] for name in ("arrival", "reward", "penalty", "pickup", "dropoff")},
        )
        for day in long
    ]  # fmt: skip
    assert not worker_test([*long[:6], *short[6:]], ASSUMED).contradicted


def test_a_foresight_of_other_groups_is_refused():
    with pytest.raises(InputError, match="share has 2 groups"):
        worker_test(processes.days(processes.constant, 2, seed=0), Foresight(fifo_presence(0.5), [0.5, 0.5]))


def test_one_p_value_of_several_statistics():
    """By hand: the largest standardised statistic of the data is ranked among those of the draws."""
    simulated = np.array([[0.0, 1.0], [1.0, 0.0], [0.0, 0.0], [1.0, 1.0]])
    assert stands_out(np.array([9.0, 0.0]), simulated, [False, False]) == (0.2, 0)
    assert stands_out(np.array([0.0, 0.0]), simulated, [False, False])[0] == 1.0
    assert stands_out(np.array([0.0, np.inf]), simulated, [False, False]) == (0.0, 1)
    low = np.array([5.0]), np.array([[9.0], [10.0], [11.0], [10.0]])
    assert stands_out(*low, [False])[0] > 0.9
    assert stands_out(*low, [True])[0] == 0.2
    assert ProcessTest(LEVEL, "").contradicted
    assert not ProcessTest(LEVEL + 0.001, "").contradicted


@pytest.mark.slow
def test_shares_that_are_given_are_not_excused_by_rates_that_were_learned():
    """What few days could teach of the rates says nothing for shares that somebody states."""
    days = scenario("II", seed=0).sample(12, seed=0)
    learned = learn_worker_rates(scenario("II", seed=0).sample(12, seed=1))
    for share, contradicted in ((learned.share, False), (np.array([0.9, 0.05, 0.05]), True)):
        assert worker_test(days, Foresight(learned.presence, share), learned=learned).contradicted == contradicted
