"""Scenarios: named sources of random instances, the same for the same seed on any machine."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from optkit.basics.errors import InputError
from optkit.basics.seeds import Stream, seed_sequence, stream
from optkit.instances.instance import Instance
from optkit.instances.settings import ScenarioSettings
from optkit.instances.world import World, check_sample, poisson_instance

Part = Literal["train", "test", "validation"]

FURTHER: dict[Part, Stream] = {
    "train": Stream.FURTHER_TRAIN,
    "test": Stream.FURTHER_TEST,
    "validation": Stream.FURTHER_VALIDATION,
}
"""Streams of further instances of each part of a split."""


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
    """A source of random instances. :func:`~optkit.instances.catalogue.scenario` makes one by name.

    Attributes
    ----------
    name : str
        Name in the paper's Table 1.
    seed : int
        The world's seed: it fixes types, places and weights.
    settings : ScenarioSettings
        Rates, sizes and scales.
    world : World
        The weights that the seed gave.
    """

    name: str
    seed: int
    settings: ScenarioSettings
    world: World

    def __repr__(self) -> str:
        told = self.settings
        sizes = f"groups={told.groups}, horizon={told.horizon}, split={told.split}"
        return f"Scenario({self.name!r}, seed={self.seed}, {sizes})"

    def _repr_html_(self) -> str:
        from html import escape

        settings = asdict(self.settings).items()
        rows = "".join(f"<tr><th>{name}</th><td>{escape(str(x))}</td></tr>" for name, x in settings)
        return f"<p>{escape(repr(self))}</p><table>{rows}</table>"

    def instance(self, seed: int | np.random.SeedSequence) -> Instance:
        """Draw one instance, noise included."""
        rng = np.random.default_rng(seed)
        return poisson_instance(self.settings, self.world, rng).with_noise(rng)

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
            If ``count`` or ``seed`` is negative, or so many would not fit in memory.
        """
        check_sample(self.settings, count)
        return [self.instance(child) for child in seed_sequence(seed).spawn(count)]

    def split(self) -> Split:
        """Training, test and validation instances, fixed by the world's seed (480/120/30 in the paper)."""
        drawn = self.sample(sum(self.settings.split), stream(self.seed, Stream.SPLIT))
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
        >>> from optkit import scenario
        >>> len(scenario("I.2", seed=0).further("train", 3))
        3
        """
        return self.sample(count, self._further_seed(part))

    def _further_seed(self, part: Part) -> np.random.SeedSequence:
        if part not in FURTHER:
            raise InputError(f"part = {part!r}: a split has train, test and validation")
        return stream(self.seed, FURTHER[part])

    def describe(self) -> dict[str, Any]:
        """Name, seed and settings as plain data, enough to make the scenario again."""
        return {"name": self.name, "seed": self.seed, "settings": asdict(self.settings)}


def world_generator(seed: int) -> np.random.Generator:
    """Return the generator that draws a world: no instance of any sample comes from the same numbers."""
    return np.random.default_rng(stream(seed, Stream.WORLD, 0))


def cut(drawn: list[Instance], sizes: tuple[int, int, int]) -> Split:
    """Cut a list into training, test and validation instances, in that order."""
    train, test, _ = sizes
    return Split(drawn[:train], drawn[train : train + test], drawn[train + test : sum(sizes)])
