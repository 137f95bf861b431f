"""Whether two files hold the same trips: a month as CSV and as parquet, a second download, a year and its January."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import DataError

KEPT = 4096
"""Trips of a file that are remembered."""

SHARE = 0.1
"""Share of the trips of the smaller file that must not be in the other: chance alone makes a millionth."""

Hashes = npt.NDArray[np.uint64]


@dataclass
class Sketch:
    """The trips of a file with the smallest hashes: of two files with the same trips, the same ones.

    Attributes
    ----------
    path : Path
        The file.
    kept : (k,) uint64
        The smallest hashes, sorted; all of them if there are fewer than :data:`KEPT`.
    """

    path: Path
    kept: Hashes = field(default_factory=lambda: np.zeros(0, np.uint64))

    def add(self, *columns: npt.NDArray[np.int64]) -> None:
        """Take trips in, given by columns of whole numbers."""
        found = np.zeros(columns[0].size, np.uint64)
        for column in columns:
            found = _mixed(found ^ column.astype(np.uint64))
        if self.kept.size == KEPT:
            found = found[found < self.kept[-1]]
        self.kept = np.unique(np.concatenate([self.kept, found]))[:KEPT]

    def shared(self, other: Sketch) -> float:
        """Return which share of the trips of the smaller file is in the other too, about; 0 where nobody can tell.

        Examples
        --------
        >>> import numpy as np
        >>> one, two, three = (Sketch(Path(name)) for name in "abc")
        >>> one.add(np.arange(9_000)), two.add(np.arange(9_000)[::-1]), three.add(np.arange(8_000, 20_000))
        (None, None, None)
        >>> one.shared(two), 0.08 < one.shared(three) < 0.15
        (1.0, True)
        """
        whole = np.iinfo(np.uint64).max
        limit = min(one.kept[-1] if one.kept.size == KEPT else whole for one in (self, other))
        mine, theirs = (one.kept[one.kept <= limit] for one in (self, other))
        least = min(mine.size, theirs.size)
        return float(np.intersect1d(mine, theirs, assume_unique=True).size / least) if least else 0.0


def check_apart(new: Sketch, others: list[Sketch]) -> None:
    """Raise a DataError if a file repeats trips of another: each would be counted twice."""
    for other in others:
        share = new.shared(other)
        if share >= SHARE:
            much = "the same trips" if share == 1.0 else f"the same trips in part (about {share:.0%})"
            raise DataError(f"{other.path} and {new.path} hold {much}, which would count twice: leave one out")


def _mixed(number: Hashes) -> Hashes:
    """Return hashes of whole numbers, by the finaliser of SplitMix64."""
    with np.errstate(over="ignore"):
        number = number + np.uint64(0x9E3779B97F4A7C15)
        number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return number ^ (number >> np.uint64(31))
