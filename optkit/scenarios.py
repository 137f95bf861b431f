"""Scenarios: named sources of random instances, the same for the same seed on any machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from optkit.errors import InputError
from optkit.instance import Instance
from optkit.seeds import check_count, seed_sequence
from optkit.world import TABLE_1, Settings, World, furnish, poisson_requests

Part = Literal["train", "test", "validation"]

FURTHER_STREAMS: dict[Part, int] = {"train": 3, "test": 4, "validation": 5}
"""Spawn keys of the world's seed for further instances of each part. Samples have (0,), (1,), ... below their seed,
splits (1, 0), (1, 1), ..., these (3, 0), (3, 1), ...; :mod:`optkit.charging` has (2, 0), (2, 1), ..."""


class Split(NamedTuple):
    """Instances to learn from, to report on, and to choose between models with.

    Attributes
    ----------
    train, test, validation : list of Instance
        In this order; no instance is in two of them.
    """

    train: list[Instance]
    test: list[Instance]
    validation: list[Instance]


@dataclass(frozen=True, eq=False)
class Scenario:
    """A source of random instances. :func:`scenario` makes one by name.

    Attributes
    ----------
    name : str
        Name in the paper's Table 1.
    seed : int
        The world's seed: it fixes types, places and weights.
    settings : Settings
        Rates, sizes and scales.
    world : World
        The weights that the seed gave.
    """

    name: str
    seed: int
    settings: Settings
    world: World

    def instance(self, seed: int | np.random.SeedSequence) -> Instance:
        """Draw one instance, noise included."""
        rng = np.random.default_rng(seed)
        return furnish(self.settings, self.world, poisson_requests(self.settings, self.world, rng), rng)

    def sample(self, count: int, seed: int | np.random.SeedSequence) -> list[Instance]:
        """Draw ``count`` independent instances.

        Each has a seed of its own, spawned from ``seed``: a larger sample begins with the instances of a smaller one,
        and it does not matter which process draws which.

        Parameters
        ----------
        count : int
            Number of instances, at least 0.
        seed : int or SeedSequence
            Source of the randomness, apart from the world's.

        Returns
        -------
        list of Instance
            With their noise.

        Raises
        ------
        InputError
            If ``count`` or ``seed`` is negative.
        """
        check_count(count)
        return [self.instance(child) for child in seed_sequence(seed).spawn(count)]

    def split(self) -> Split:
        """Training, test and validation instances, fixed by the world's seed (480/120/30 in the paper)."""
        drawn = self.sample(sum(self.settings.split), np.random.SeedSequence(self.seed, spawn_key=(1,)))
        return cut(drawn, self.settings.split)

    def further(self, part: Part, count: int) -> list[Instance]:
        """Draw ``count`` further instances for a part of the split, fixed by the world's seed: as many as one likes.

        None is in the split, in a sample, or in those of another part. A scenario with trips realises the half-hours of
        that part of the split anew, one after the other.

        Parameters
        ----------
        part : {"train", "test", "validation"}
            Of :class:`Split`.
        count : int
            Number of instances, at least 0.

        Raises
        ------
        InputError
            If there is no such part, or ``count`` is negative.

        Examples
        --------
        >>> len(scenario("I.2", seed=0).further("train", 3))
        3
        """
        return self.sample(count, self._further_seed(part))

    def _further_seed(self, part: Part) -> np.random.SeedSequence:
        if part not in FURTHER_STREAMS:
            raise InputError(f"part = {part!r}: a split has train, test and validation")
        return np.random.SeedSequence(self.seed, spawn_key=(FURTHER_STREAMS[part],))

    def describe(self) -> dict[str, Any]:
        """Name, seed and settings as plain data, enough to make the scenario again."""
        return {"name": self.name, "seed": self.seed, "settings": asdict(self.settings)}


def scenario(
    name: str, seed: int = 0, *, trips: str | Path | Sequence[str | Path] | None = None, **settings: Any
) -> Scenario:
    """Make a scenario of the paper's Table 1.

    Parameters
    ----------
    name : {"I.1", "I.2", "I.3", "II", "nyc-weak", "nyc-strong"}
        Case does not matter.
    seed : int
        The world's seed. I.1, I.2 and I.3 share their world at the same seed.
    trips : path or sequence of paths, optional
        Trip records for the two NYC scenarios, see :func:`optkit.nyc.trip_scenario`.
    **settings
        Fields of :class:`optkit.world.Settings` to change, for example ``horizon=1000``; for the NYC scenarios also
        those of :func:`optkit.nyc.trip_scenario`.

    Returns
    -------
    Scenario
        The same for the same name, seed and settings on any machine.

    Raises
    ------
    InputError
        If the name or a setting is unknown or out of range, or trips are missing where they are needed.

    Examples
    --------
    >>> one, again = (scenario("I.1", seed=0).sample(2, seed=7) for _ in range(2))
    >>> one == again
    True
    >>> [len(part) for part in scenario("II", seed=0, split=(4, 2, 1)).split()]
    [4, 2, 1]
    """
    known = {key.lower(): key for key in TABLE_1}
    key = known.get(str(name).lower().replace("_", "-"))
    if key is None:
        raise InputError(f"no scenario {name!r}; there are {', '.join(TABLE_1)}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"the world's seed {seed!r} is not a whole number >= 0")
    if key.startswith("nyc"):
        from optkit.nyc import trip_scenario

        if trips is None:
            raise InputError(f"scenario {key} needs trip records: pass trips= a TLC file (parquet or CSV)")
        return trip_scenario(key, int(seed), trips, **settings)
    if trips is not None:
        raise InputError(f"scenario {key} takes no trips; the scenarios with trips are nyc-weak and nyc-strong")
    chosen = adjust(TABLE_1[key], settings)
    return Scenario(key, int(seed), chosen, World.draw(chosen, world_generator(int(seed))))


def adjust(base: Settings, changes: dict[str, Any]) -> Settings:
    """Change some settings after checking their names and ranges.

    Raises
    ------
    InputError
        If a name is unknown or a number out of range.
    """
    names = [f.name for f in fields(Settings)]
    for name in changes:
        if name not in names:
            raise InputError(f"no setting {name!r}; there are {', '.join(names)}")
    checked = {name: _setting(name, value) for name, value in changes.items()}
    return replace(base, **checked)


LARGEST = 1e8
"""Upper limit of every setting: beyond it nothing fits in memory."""

_WHOLE = {"groups": 1, "horizon": 1, "types": 1, "pickups": 1, "dropoffs": 1, "characteristics": 0}
_POSITIVE = ("mean_lifetime", "mu")
_NOT_NEGATIVE = ("request_rate", "worker_rate", "utility_noise")


def _setting(name: str, value: Any) -> Any:
    """Return a setting's value in its own type, or raise an InputError."""
    if name == "split":
        if not isinstance(value, Sequence) or len(value) != 3:
            raise InputError(f"setting split = {value!r} must be three whole numbers: training, test, validation")
        return tuple(_whole("split", size, 0) for size in value)
    if name in _WHOLE:
        return _whole(name, value, _WHOLE[name])
    number = float(value) if isinstance(value, int | float | np.number) else float("nan")
    if not np.abs(number) <= LARGEST:
        raise InputError(f"setting {name} = {value!r} must be a finite number of at most {LARGEST:g}")
    if (name in _POSITIVE and number <= 0) or (name in _NOT_NEGATIVE and number < 0):
        raise InputError(f"setting {name} = {value!r} must {'be positive' if name in _POSITIVE else 'not be negative'}")
    return number


def _whole(name: str, value: Any, least: int) -> int:
    if (
        not isinstance(value, int | float | np.number)
        or not np.isfinite(value)
        or not least <= value <= LARGEST
        or value != int(value)
    ):
        raise InputError(f"setting {name} = {value!r} must be a whole number from {least} to {LARGEST:g}")
    return int(value)


def world_generator(seed: int) -> np.random.Generator:
    """Return the generator that draws a world: no instance of any sample comes from the same numbers.

    Samples spawn keys (0,), (1,), ... from their seed, splits (1, 0), (1, 1), ... from the world's.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 0)))


def cut(drawn: list[Instance], sizes: tuple[int, int, int]) -> Split:
    """Cut a list into training, test and validation instances, in that order."""
    train, test, _ = sizes
    return Split(drawn[:train], drawn[train : train + test], drawn[train + test : sum(sizes)])
