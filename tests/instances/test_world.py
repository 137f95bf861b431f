"""Worlds and their instances: every formula of docs/explanation/scenarios.md, recomputed from the weights."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import stats

from optkit import scenario
from optkit.instances.scenario import world_generator
from optkit.instances.settings import TABLE_1, ScenarioSettings
from optkit.instances.world import World, poisson_requests

NAMES = ["I.1", "I.2", "I.3", "II"]
LONG = {"horizon": 4000}


@pytest.mark.parametrize("name", NAMES)
def test_money_by_hand(name):
    """Reward, penalty and utility of every request follow from the world's weights by the printed formulas."""
    source = scenario(name, seed=4)
    world, urgent = source.world, 0
    for day in source.sample(3, seed=2):
        for i in range(day.n_requests):
            x, pickup, dropoff = day.features[i], day.pickup[i], day.dropoff[i]
            (xp, yp), (xd, yd) = world.pickup_point[pickup], world.dropoff_point[dropoff]
            assert x[:-1].tolist() in world.kinds.tolist()
            assert x[-1] == pytest.approx(math.hypot(xp - xd, yp - yd))
            lifetime = day.expiry[i] - day.arrival[i]
            urgent += lifetime < 3
            reward = 20 + sum(a * w for a, w in zip(x, world.reward_weight, strict=True)) + (5 if lifetime < 3 else 0)
            penalty = -(sum(a * w for a, w in zip(x, world.penalty_weight, strict=True)) + 0.1 * lifetime)
            assert day.reward[i] == pytest.approx(reward)
            assert day.penalty[i] == pytest.approx(penalty)
            for d in range(day.n_groups):
                burden = sum(a * w for a, w in zip(x, world.utility_weight[d], strict=True))
                places = world.pickup_weight[d, pickup] + world.dropoff_weight[d, dropoff]
                assert day.utility[d, i] == pytest.approx(-(burden + places))
        assert day.mu.tolist() == [1.0] * day.n_groups
        assert day.outside_utility == 0.0
    assert urgent > 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(5))
def test_ranges_of_the_weights(name, seed):
    """Weights lie in their ranges and have the shapes that the settings ask for."""
    s, w = TABLE_1[name], scenario(name, seed).world
    k, m, groups = s.types, s.characteristics, s.groups
    expected = {
        "kinds": (0, 1, (k, m)),
        "pickup_point": (0, 1, (s.pickups, 2)),
        "dropoff_point": (0, 1, (s.dropoffs, 2)),
        "reward_weight": (20, 50, (m + 1,)),
        "penalty_weight": (3, 15, (m + 1,)),
        "utility_weight": (4, 20, (groups, m + 1)),
        "pickup_weight": (0, 10, (groups, s.pickups)),
        "dropoff_weight": (0, 10, (groups, s.dropoffs)),
    }
    assert set(expected) == {f.name for f in dataclasses.fields(World)}
    for name_, (low, high, shape) in expected.items():
        weights = getattr(w, name_)
        assert weights.shape == shape
        assert (weights >= low).all()
        assert (weights <= high).all()


def test_weights_are_uniform():
    """Over many worlds each kind of weight is uniform on its range (Kolmogorov-Smirnov at 1e-6)."""
    ranges = {"reward_weight": (20, 50), "penalty_weight": (3, 15), "utility_weight": (4, 20), "pickup_weight": (0, 10)}
    worlds = [World.draw(ScenarioSettings(), world_generator(seed)) for seed in range(300)]
    for name, (low, high) in ranges.items():
        drawn = np.concatenate([getattr(w, name).ravel() for w in worlds])
        assert stats.kstest(drawn, stats.uniform(low, high - low).cdf).pvalue > 1e-6


def test_strong_preferences_shift_one_place():
    """The strong preference eases pick-up region 1 and burdens drop-off region 1 by 30 each, all else equal."""
    weak, strong = (World.draw(TABLE_1[f"nyc-{kind}"], world_generator(3)) for kind in ("weak", "strong"))
    assert np.allclose(weak.pickup_weight - strong.pickup_weight, [[30, 0, 0, 0]])
    assert np.allclose(strong.dropoff_weight - weak.dropoff_weight, [[30, 0, 0, 0]])
    for name in ("kinds", "pickup_point", "dropoff_point", "reward_weight", "penalty_weight", "utility_weight"):
        assert np.array_equal(getattr(weak, name), getattr(strong, name))


def test_travel_time_is_euclidean():
    """Travel time is the straight line between two points, 0 from a place to itself."""
    world = dataclasses.replace(
        scenario("I.1").world, pickup_point=np.array([[0.0, 0.0]]), dropoff_point=np.array([[3.0, 4.0], [0.0, 0.0]])
    )
    assert world.travel_time(np.array([0, 0]), np.array([0, 1])).tolist() == [5.0, 0.0]


@pytest.mark.parametrize(("name", "rate"), [("I.1", 0.5), ("I.2", 0.3), ("I.3", 1.0), ("II", 0.5)])
def test_arrivals_are_poisson(name, rate):
    """Requests per step have the scenario's mean and the variance of a Poisson law.

    Tolerances are 5 standard errors over N = 4000 steps: sqrt(rate / N) for the mean, and for the variance
    sqrt((rate + 2 rate^2) / N).
    """
    source = scenario(name, seed=1, **LONG)
    requests = poisson_requests(source.settings, source.world, np.random.default_rng(5))
    per_step = np.bincount(requests.arrival, minlength=4000)
    assert abs(per_step.mean() - rate) < 5 * math.sqrt(rate / 4000)
    assert abs(per_step.var() - rate) < 5 * math.sqrt((rate + 2 * rate**2) / 4000)
    assert (np.diff(requests.arrival) >= 0).all()


def test_types_and_places_are_uniform():
    """Types, pick-up and drop-off places are equally likely and independent (chi-square at 1e-6)."""
    source = scenario("I.3", seed=0, horizon=20_000)
    (day,) = source.sample(1, seed=3)
    kind = np.array([source.world.kinds.tolist().index(x[:-1].tolist()) for x in day.features])
    for values in (kind, day.pickup, day.dropoff):
        assert stats.chisquare(np.bincount(values, minlength=5)).pvalue > 1e-6
    joint = np.bincount(kind * 25 + day.pickup * 5 + day.dropoff, minlength=125)
    assert stats.chisquare(joint).pvalue > 1e-6


def test_lifetimes_are_rounded_up_exponentials():
    """Requests wait ceil(Exp(mean 10)) steps, at least 1, cut at the last step.

    ceil(Exp) is geometric with success 1 - exp(-1/10); its mean may be off by 5 standard errors.
    """
    (day,) = scenario("I.3", seed=0, **LONG).sample(1, seed=3)
    lifetime = (day.expiry - day.arrival)[day.arrival < 4000 - 300]
    success = 1 - math.exp(-0.1)
    assert lifetime.min() == 1
    assert abs(lifetime.mean() - 1 / success) < 5 * math.sqrt(1 - success) / success / math.sqrt(lifetime.size)
    counts = np.bincount(np.minimum(lifetime, 30), minlength=31)[1:]
    chances = np.append((1 - success) ** np.arange(29) * success, (1 - success) ** 29)
    assert stats.chisquare(counts, chances * lifetime.size).pvalue > 1e-6
    last = day.arrival == 3999
    assert (day.expiry[last] == 3999).all()


def test_workers_queue():
    """Workers come at the scenario's rate, one a step, and groups of scenario II are equally likely.

    Half a worker a step leaves a short queue, so that the number seen in T = 4000 steps is Poisson but for the few
    still waiting: 5 standard errors, and 20 workers.
    """
    (day,) = scenario("II", seed=0, **LONG).sample(1, seed=8)
    assert abs(day.n_workers - 2000) < 5 * math.sqrt(2000) + 20
    assert stats.chisquare(np.bincount(day.worker_group, minlength=3)).pvalue > 1e-6
    # Were arrivals thinned instead of queued, only 1 - exp(-1/2) = 39 % of the steps would see a worker.
    assert day.n_workers > 0.45 * 4000
    # A queue makes the next step busy more often than one step in two.
    busy = np.isin(np.arange(4000), day.worker_step)
    assert busy[1:][busy[:-1]].mean() > 0.5


def test_crowds_of_workers_are_seen_every_step():
    """With more workers than steps every step after the first arrival sees one."""
    (day,) = scenario("I.1", seed=0, worker_rate=5.0).sample(1, seed=0)
    assert np.array_equal(day.worker_step, np.arange(day.worker_step[0], 50))


def test_optional_utility_noise():
    """The paper's random term of the utility is off by default; as a setting it adds N(0, sd) and changes nothing else.

    Its standard deviation may be off by 5 standard errors, sd / sqrt(2 N).
    """
    plain = scenario("I.3", seed=2, **LONG).sample(1, seed=1)[0]
    noisy = scenario("I.3", seed=2, utility_noise=2.0, **LONG).sample(1, seed=1)[0]
    extra = (noisy.utility - plain.utility).ravel()
    assert abs(extra.std() - 2) < 5 * 2 / math.sqrt(2 * extra.size)
    assert abs(extra.mean()) < 5 * 2 / math.sqrt(extra.size)
    for name in ("arrival", "expiry", "reward", "penalty", "worker_step", "pickup", "dropoff"):
        assert np.array_equal(getattr(plain, name), getattr(noisy, name))


@pytest.mark.parametrize(
    "rates", [{"request_rate": 0.0}, {"worker_rate": 0.0}, {"request_rate": 0.0, "worker_rate": 0}]
)
def test_a_rate_of_zero(rates):
    """A scenario without requests or without workers still makes instances."""
    (day,) = scenario("II", seed=0, **rates).sample(1, seed=0)
    assert (day.n_requests == 0) == ("request_rate" in rates)
    assert (day.n_workers == 0) == ("worker_rate" in rates)
