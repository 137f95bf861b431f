"""Seeds: checked, and never used up by those who draw from them."""

from __future__ import annotations

import numpy as np

from optkit.basics.errors import InputError


def check_count(count: int) -> None:
    """Raise an InputError unless ``count`` is a whole number of at least 0."""
    if not isinstance(count, int | np.integer) or count < 0:
        raise InputError(f"count = {count} is negative or no whole number; ask for 0 or more instances")


def seed_sequence(seed: int | np.random.SeedSequence) -> np.random.SeedSequence:
    """Return a fresh seed sequence; InputError if the seed is not a whole number >= 0."""
    if isinstance(seed, np.random.SeedSequence):
        # A copy, so that sampling twice from one sequence gives the same instances twice.
        return np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed {seed!r} is not a whole number >= 0")
    return np.random.SeedSequence(int(seed))


def check_seed(seed: object) -> None:
    """Raise an InputError unless the seed is a whole number of at least 0."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed {seed!r} is not a whole number >= 0")
