"""Seeds, checked and never used up by those who draw from them, and the one list of the streams drawn from them.

A stream is the child of a caller's seed under a key of at least two numbers: its name in :class:`Stream`, then whatever
counts within it. Samples of instances spawn keys of one number, ``(0,), (1,), ...``, from a seed of the caller's; so no
stream is a sample's, and no two streams are alike. Claims of independence (pools, charges, training, validation and
tests) rest on this. A generator made from a seed alone is its caller's own.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from optkit.basics.arrays import whole_number


class Stream(IntEnum):
    """Everything random that optkit draws from a seed: what each stream is for, and whose seed it comes from."""

    WORLD = 0
    """Types, places and weights of a scenario; the world's seed."""
    SPLIT = 1
    """Instances of a scenario's split; the world's seed."""
    ROUND_NOISE = 2
    """Workers' noise in later rounds of learning; the learner's seed."""
    FURTHER_TRAIN = 3
    """Training instances beyond the split's; the world's seed."""
    FURTHER_TEST = 4
    """Test instances beyond the split's; the world's seed."""
    FURTHER_VALIDATION = 5
    """Validation instances beyond the split's; the world's seed."""
    REPORT_NOISE = 6
    """Workers' noise that a gap report redraws; the report's seed."""
    REPORT_OWN_NOISE = 7
    """Workers' noise of instances that come to a gap report without any; the report's seed."""
    FOLDER_NOISE = 8
    """Workers' noise of instance sets on disk that have none; seed 0."""
    CHARGES = 9
    """Arrivals that charges for foresight take their expectations over; the report's seed."""
    POOL = 10
    """Instances that these arrivals are drawn from; the world's seed."""
    BELIEFS = 11
    """Errors of perturbed preferences; the number of the draw."""
    PROCESS_TESTS = 12
    """Days that a report's process is tested by; the report's seed."""


def stream(seed: int, name: Stream, *numbers: int) -> np.random.SeedSequence:
    """Return a stream's seed sequence; spawn from it where no number is given.

    Parameters
    ----------
    seed : int
        At least 0.
    name : Stream
        What it is for.
    *numbers : int
        Which of its kind.

    Examples
    --------
    >>> stream(3, Stream.CHARGES, 5).spawn_key
    (9, 5)
    """
    return np.random.SeedSequence(seed, spawn_key=(int(name), *numbers))


def step_generator(seed: int, step: int) -> np.random.Generator:
    """Return the generator with which a policy of this seed explores at a step.

    Its entropy is the pair of both, not a key below the seed: no stream has it, and at step 0 it is the seed's own.
    """
    return np.random.default_rng([seed, step])


def check_count(count: int) -> None:
    """Raise an InputError unless ``count`` is a whole number of at least 0."""
    whole_number("count", count, least=0)


def seed_sequence(seed: int | np.random.SeedSequence) -> np.random.SeedSequence:
    """Return a fresh seed sequence; InputError if the seed is not a whole number >= 0."""
    if isinstance(seed, np.random.SeedSequence):
        # A copy, so that sampling twice from one sequence gives the same instances twice.
        return np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)
    return np.random.SeedSequence(whole_number("seed", seed, least=0))


def check_seed(seed: object) -> None:
    """Raise an InputError unless the seed is a whole number of at least 0."""
    whole_number("seed", seed, least=0)
