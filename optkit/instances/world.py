"""The synthetic world behind a scenario: its settings and the weights drawn once from the world's seed.

``docs/explanation/scenarios.md``; paper section 4.1 and Table 1. The draws are frozen: every published
figure depends on their order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats, Ints, Known
from optkit.basics.memory import check_memory
from optkit.basics.seeds import check_count
from optkit.instances.instance import DENSE_NOISE_LIMIT, Instance, fifo_queue
from optkit.instances.settings import ScenarioSettings


@dataclass(frozen=True, eq=False)
class World(Known):
    """What all instances of a scenario share: request types, places and weights.

    Attributes
    ----------
    kinds : (k, m) float
        Characteristics of the request types.
    pickup_point, dropoff_point : (l, 2) float
        Coordinates in the unit square.
    reward_weight, penalty_weight : (m + 1,) float
        Weights of x = (characteristics, travel time), in money.
    utility_weight : (D, m + 1) float
        Weights of x in the workers' utility; positive numbers are a burden.
    pickup_weight, dropoff_weight : (D, l) float
        Burden of each location, in money.
    """

    kinds: Floats
    pickup_point: Floats
    dropoff_point: Floats
    reward_weight: Floats
    penalty_weight: Floats
    utility_weight: Floats
    pickup_weight: Floats
    dropoff_weight: Floats

    @classmethod
    def draw(cls, settings: ScenarioSettings, rng: np.random.Generator) -> World:
        """Draw a world from its seed's generator.

        Raises
        ------
        InputError
            If it would not fit in memory.
        """
        s, m = settings, settings.characteristics
        places = s.pickups + s.dropoffs
        numbers = m * (s.types + s.groups) + places * (2 + s.groups)
        check_memory(
            "a scenario of these settings", 8.0 * numbers, "take fewer groups, types, places or characteristics"
        )
        world = cls(
            kinds=rng.uniform(0, 1, (s.types, m)),
            pickup_point=rng.uniform(0, 1, (s.pickups, 2)),
            dropoff_point=rng.uniform(0, 1, (s.dropoffs, 2)),
            reward_weight=rng.uniform(20, 50, m + 1),
            penalty_weight=rng.uniform(3, 15, m + 1),
            utility_weight=rng.uniform(4, 20, (s.groups, m + 1)),
            pickup_weight=rng.uniform(0, 10, (s.groups, s.pickups)),
            dropoff_weight=rng.uniform(0, 10, (s.groups, s.dropoffs)),
        )
        world.pickup_weight[:, 0] -= s.loved_pickup
        world.dropoff_weight[:, 0] += s.shunned_dropoff
        return world

    def travel_time(self, pickup: Ints, dropoff: Ints) -> Floats:
        """Euclidean distance between two places, (n,)."""
        return np.asarray(np.linalg.norm(self.pickup_point[pickup] - self.dropoff_point[dropoff], axis=-1))

    def utility(self, features: Floats, pickup: Ints, dropoff: Ints) -> Floats:
        """Mean utility of requests to every group, (D, n), in money: minus the burdens."""
        burden = self.utility_weight @ features.T + self.pickup_weight[:, pickup] + self.dropoff_weight[:, dropoff]
        return np.asarray(-burden)


@dataclass(frozen=True)
class DrawnRequests:
    """Where and when requests appear, before a world gives them characteristics and money; all (n,)."""

    arrival: Ints
    pickup: Ints
    dropoff: Ints
    travel_time: Floats


def poisson_requests(settings: ScenarioSettings, world: World, rng: np.random.Generator) -> DrawnRequests:
    """Requests of a Poisson process with uniform pick-up and drop-off points."""
    arrival = np.repeat(np.arange(settings.horizon), rng.poisson(settings.request_rate, settings.horizon))
    pickup = rng.integers(0, settings.pickups, arrival.size)
    dropoff = rng.integers(0, settings.dropoffs, arrival.size)
    return DrawnRequests(arrival, pickup, dropoff, world.travel_time(pickup, dropoff))


def furnish(settings: ScenarioSettings, world: World, requests: DrawnRequests, rng: np.random.Generator) -> Instance:
    """Complete requests to an instance without noise: type, lifetime, reward, penalty, utility and workers.

    Reward ``20 + x.w + 5 [lifetime < 3]``, penalty ``-(x.w + 0.1 lifetime)``, lifetime ``expiry - arrival`` with
    ``expiry = min(arrival + ceil(Exp(mean_lifetime)), T - 1)`` (``docs/explanation/scenarios.md``).
    """
    T, n = settings.horizon, requests.arrival.size
    kind = rng.integers(0, settings.types, n)
    features = np.column_stack([world.kinds[kind], requests.travel_time])
    waits = np.ceil(rng.exponential(settings.mean_lifetime, n)).astype(np.int64)
    expiry = np.minimum(requests.arrival + waits, T - 1)
    lifetime = expiry - requests.arrival
    utility = world.utility(features, requests.pickup, requests.dropoff)
    joined = np.repeat(np.arange(T), rng.poisson(settings.worker_rate, T))
    group = rng.integers(0, settings.groups, joined.size)
    step, served = fifo_queue(joined, T)
    if settings.utility_noise > 0:
        utility = utility + rng.normal(0.0, settings.utility_noise, utility.shape)
    return Instance(
        horizon=T,
        arrival=requests.arrival,
        expiry=expiry,
        reward=20.0 + features @ world.reward_weight + 5.0 * (lifetime < 3),
        penalty=-(features @ world.penalty_weight + 0.1 * lifetime),
        features=features,
        pickup=requests.pickup,
        dropoff=requests.dropoff,
        worker_step=step,
        worker_group=group[served],
        utility=utility,
        mu=np.full(settings.groups, settings.mu),
    )


def poisson_instance(settings: ScenarioSettings, world: World, rng: np.random.Generator) -> Instance:
    """Draw what arrives in one instance of a synthetic scenario; noise is drawn last, so that it may be left out."""
    return furnish(settings, world, poisson_requests(settings, world, rng), rng)


OVERHEAD = 3_000
"""Bytes of an instance in which nothing happens."""

COPIES = 3.0
"""Times that what is drawn is there at once, while it is drawn, simulated or saved."""


def check_sample(settings: ScenarioSettings, count: int) -> None:
    """Refuse, before the first is drawn, instances that would not fit in memory.

    Raises
    ------
    InputError
        If ``count`` is no whole number of at least 0, or so many would not fit.
    """
    check_count(count)
    s, T = settings, float(settings.horizon)
    joined, n = s.worker_rate * T, s.request_rate * T
    workers = min(joined, T)
    pairs = workers * n
    if pairs > DENSE_NOISE_LIMIT:  # only pairs that can meet
        pairs *= min(1.0, (s.mean_lifetime + 1.0) / T)
    numbers = n * (10.0 + s.characteristics + 2.0 * s.groups) + 4.0 * workers + 2.0 * pairs
    one, draft = 8.0 * numbers + OVERHEAD, 8.0 * (T + joined)
    what = f"{count:,} instance{'s' if count != 1 else ''} of these settings"
    needed = COPIES * (count * one + draft) if count else 0.0
    check_memory(what, needed, "take fewer instances or groups, a shorter horizon or lower rates")
