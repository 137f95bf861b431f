"""Days whose workers come by processes that are known: what tests of a process are tried on."""

import numpy as np

from optkit import Instance
from optkit.instances.queue import fifo_queue

STEPS = 50


def constant(rng):
    """Half a worker a step, by Poisson draws: what is assumed."""
    return rng.poisson(np.full(STEPS, 0.5))


def rush(rng):
    """As many a day, but few in the morning and many in the evening."""
    return rng.poisson(np.where(np.arange(STEPS) < STEPS // 2, 0.1, 0.9))


def slow(rng):
    """Fewer all day."""
    return rng.poisson(np.full(STEPS, 0.4))


def uneven(rng):
    """As many in the mean, but good days and bad days."""
    return rng.poisson(np.full(STEPS, 0.5 * rng.gamma(4.0, 1 / 4.0)))


def bursts(rng):
    """As many in the mean, but six at a time."""
    return 6 * (rng.random(STEPS) < 0.5 / 6)


def timetable(rng):
    """One worker every other step, on the minute."""
    return (np.arange(STEPS) + rng.integers(2)) % 2


FALSE = (rush, slow, uneven, bursts, timetable)
"""Processes that are not that of ``constant``."""


def days(process, count, seed, groups=None):
    """Draw days; ``groups`` draws the workers' groups, (J,), from their steps and a generator."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        step, _ = fifo_queue(np.repeat(np.arange(STEPS), process(rng)), STEPS)
        n = int(rng.poisson(8))
        arrival = np.sort(rng.integers(0, STEPS, n))
        group = np.zeros(step.size, int) if groups is None else groups(step, rng)
        sides = 1 if groups is None else 2
        found.append(
            Instance(
                horizon=STEPS, arrival=arrival, expiry=np.minimum(arrival + rng.integers(2, 12, n), STEPS - 1),
                reward=rng.uniform(20, 60, n), penalty=np.full(n, -5.0), features=np.zeros((n, 0)),
                pickup=np.zeros(n, int), dropoff=np.zeros(n, int), worker_step=step, worker_group=group,
                utility=np.tile(rng.uniform(-30, -10, n), (sides, 1)), mu=np.ones(sides),
            ).with_noise(int(rng.integers(2**31)))
        )  # fmt: skip
    return found
