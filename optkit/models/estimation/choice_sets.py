"""Ragged choice sets as one flat array: sums and multinomial logit shares over situations of any size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from optkit.basics.arrays import Floats, Ints


@dataclass(frozen=True)
class ChoiceSets:
    """S situations, each with a run of consecutive rows; no situation is empty.

    Attributes
    ----------
    start : (S + 1,) int
        Situation s holds the rows ``start[s]`` to ``start[s + 1] - 1``.

    Examples
    --------
    Two situations with one and two alternatives.

    >>> sets = ChoiceSets.of_sizes([1, 2])
    >>> sets.sum(np.array([1.0, 2.0, 3.0]))
    array([1., 5.])
    >>> share, inclusive = sets.shares(np.log([1.0, 2.0, 1.0]), outside=True)
    >>> share, np.exp(inclusive)
    (array([0.5 , 0.5 , 0.25]), array([2., 4.]))
    """

    start: Ints

    @classmethod
    def of_sizes(cls, sizes: npt.ArrayLike) -> ChoiceSets:
        """Return the sets with so many rows each; every size is at least 1."""
        return cls(np.concatenate([[0], np.cumsum(np.asarray(sizes, dtype=np.int64))]))

    def __len__(self) -> int:
        return len(self.start) - 1

    @cached_property
    def sizes(self) -> Ints:
        """Number of rows of each situation, (S,)."""
        return np.diff(self.start)

    @cached_property
    def situation(self) -> Ints:
        """Situation that each row belongs to, (p,)."""
        return np.repeat(np.arange(len(self)), self.sizes)

    @cached_property
    def _indicator(self) -> csr_array[Any]:
        # A product with the 0/1 matrix (situation, row) sums runs several times faster than np.add.reduceat.
        rows = int(self.start[-1])
        small = np.int32 if rows < np.iinfo(np.int32).max else np.int64
        index = np.arange(rows, dtype=small)
        return csr_array((np.ones(rows), index, self.start.astype(small)), shape=(len(self), rows))

    def sum(self, x: Floats) -> Floats:
        """Sum the rows of each situation: (p,) to (S,), or (p, k) to (S, k)."""
        total: Floats = self._indicator @ x
        return total

    def max(self, x: Floats) -> Floats:
        """Return the largest entry of each situation: (p,) to (S,)."""
        return np.maximum.reduceat(x, self.start[:-1]) if len(self) else np.empty(0)

    def shares(self, index: Floats, outside: bool) -> tuple[Floats, Floats]:
        """Multinomial logit shares, and the log of the sum of exponentials.

        Parameters
        ----------
        index : (p,) float
            Utility of each row divided by the noise scale; finite, of any size.
        outside : bool
            Whether every situation has one more alternative, of utility 0.

        Returns
        -------
        share : (p,) float
            Choice probability of each row.
        inclusive : (S,) float
            ``log(sum exp(index))`` over the situation, the outside option included.
        """
        top = self.max(index)
        if outside:
            top = np.maximum(top, 0.0)
        weight = np.exp(index - top[self.situation])
        total = self.sum(weight)
        # Written so that a small sum beside an outside option of 0 keeps all its digits.
        excess = total + np.expm1(-top) if outside else total - 1.0
        return weight / (1.0 + excess)[self.situation], top + np.log1p(excess)
