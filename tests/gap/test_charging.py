"""What a penalised bound charges with."""

import numpy as np
import pandas as pd
import pytest

from optkit import scenario
from optkit.basics.errors import InputError
from optkit.gap.charging import Charging, charging_value, scenario_charging, worker_charging
from optkit.instances.catalogue import scenario_of, worker_settings
from optkit.instances.new_york.trip_scenario import TripScenario, trip_scenario
from optkit.instances.new_york.trips import Trips
from optkit.instances.splits import held_out
from optkit.models.value import LinearValue

SMALL = scenario("I.2", seed=3, split=(30, 5, 5), horizon=15)


@pytest.fixture(scope="module")
def weeks():
    """A scenario with trips, four weeks of one a minute."""
    times = np.datetime64("2018-01-01T07", "s") + 60 * np.arange(40_000)
    frame = pd.DataFrame({"pickup_time": times, "pickup": 0, "dropoff": 1, "travel_time": 12.0})
    trips = Trips(frame, report={}, rows=40_000, files=(), period=(times[0], times[-1]))
    return trip_scenario("nyc-weak", 0, trips, horizon=20, split=(4, 2, 1))


@pytest.mark.slow
def test_everything_is_drawn_apart():
    """No instance of the pool is one of the split, of a sample, or of those held out beyond the split."""
    made = scenario_charging(SMALL, training=40, pool=20, estimator=LinearValue())
    other = [*[day for part in SMALL.split() for day in part], *SMALL.sample(40, seed=3), *held_out(SMALL, 12)]
    mine = {day.reward.tobytes() for day in made.foresight.arrivals if day.n_requests}
    assert mine.isdisjoint(day.reward.tobytes() for day in other)
    assert all(day.noise is None for day in made.foresight.arrivals)


@pytest.mark.slow
def test_the_process_is_the_scenario_s():
    """Shares are equal, an empty step has its Poisson probability, and workers come as the settings say."""
    made = scenario_charging(scenario("II", seed=1, horizon=12, worker_rate=0.4), training=30, pool=20)
    assert made.foresight.share.tolist() == [1 / 3] * 3
    assert made.foresight.nothing == pytest.approx(np.exp(-0.5))
    assert made.foresight.presence[0] == pytest.approx(1 - np.exp(-0.4))
    assert isinstance(made, Charging)
    assert any("0.4 a step" in told for told in made.assumptions)


def test_with_trips_only_workers_are_charged_for(weeks, monkeypatch):
    """Weeks differ, so that nothing is assumed of requests; the value function saw the training episodes alone."""
    drawn, realise = [], TripScenario.instance

    def noted(self, seed, episode):
        drawn.append(episode)
        return realise(self, seed, episode)

    monkeypatch.setattr(TripScenario, "instance", noted)
    made = scenario_charging(weeks, training=10, estimator=LinearValue())
    assert made.foresight.arrivals == ()
    assert any("10 realisations of the split's 4 training half-hours" in told for told in made.assumptions)
    order = weeks.order(7, np.random.SeedSequence(0, spawn_key=(1,)))
    assert drawn[-10:] == [order[i % 4] for i in range(10)]


def test_groups_need_their_shares():
    """With one group there is nothing to say; with several the shares must be given, and be as many."""
    days = SMALL.sample(30, seed=1)
    assert worker_charging(days, 0.5, estimator=LinearValue()).foresight.share.tolist() == [1.0]
    several = scenario("II", seed=1, horizon=12).sample(20, seed=1)
    with pytest.raises(InputError, match="3 groups of workers"):
        worker_charging(several, 0.5)
    with pytest.raises(InputError, match="2 shares for 3 groups"):
        worker_charging(several, 0.5, [0.5, 0.5])
    with pytest.raises(InputError, match="rate"):
        worker_charging(days, -1.0)


def test_a_set_leads_back_to_its_scenario(weeks):
    """What a description says is made again, but for trips, and for what is no scenario or was tampered with."""
    told = {**SMALL.describe(), "sample_seed": 4}
    again = scenario_of(told)
    assert again.settings == SMALL.settings
    assert again.sample(2, seed=1) == SMALL.sample(2, seed=1)
    assert scenario_of(weeks.describe()) is None
    assert worker_settings(weeks.describe()).worker_rate == weeks.settings.worker_rate
    for wrong in ({}, {"name": "I.1"}, {**told, "settings": {"horizon": -3}}, {**told, "settings": None}):
        assert scenario_of(wrong) is None
    assert worker_settings({"name": "mine"}) is None


def test_held_out_instances(weeks):
    """Test instances first, then others; trips have no others."""
    assert held_out(SMALL) == SMALL.split().test
    assert held_out(SMALL, 2) == SMALL.split().test[:2]
    more = held_out(SMALL, 7)
    assert more[:5] == SMALL.split().test
    assert more[5:] == held_out(SMALL, 9)[5:7]
    assert held_out(weeks, 1) == weeks.split().test[:1]
    with pytest.raises(InputError, match="2 test instances"):
        held_out(weeks, 3)
    with pytest.raises(InputError, match="count"):
        held_out(SMALL, -1)


def test_the_estimator_has_a_term_for_each_group():
    """One term for one group, one more than groups for several."""
    assert not charging_value().by_group
    assert charging_value(3).by_group
