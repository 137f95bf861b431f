"""Rows of a table that come in several pieces: what is labelled goes by label, what is not by place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from optkit.basics.errors import InputError


def labelled(value: Any) -> bool:
    """Whether something has an index of its own, as pandas' Series and DataFrames do."""
    return hasattr(value, "iloc") and hasattr(value, "index")


@dataclass(frozen=True)
class Rows:
    """n rows, and what whoever gave them calls them.

    Attributes
    ----------
    n : int
        Number of rows.
    labels : pandas.Index or None
        What the rows are called; None where nothing is labelled.
    owner : str
        The argument that the labels came with.

    Examples
    --------
    A column that was sorted finds its rows again.

    >>> import pandas as pd
    >>> pay = pd.Series([5.0, 3.0], index=["a", "b"])
    >>> Rows.of(2, pay=pay).take("kilometres", pd.Series([1.0, 2.0], index=["b", "a"])).tolist()
    [2.0, 1.0]
    """

    n: int
    labels: Any = None
    owner: str = ""

    @classmethod
    def of(cls, n: int, **given: Any) -> Rows:
        """Return rows that are called as the first labelled one of the arguments calls them.

        Raises
        ------
        InputError
            If one alone is labelled, and by places in another order: by label and by place are both likely.
        """
        named = [(name, value.index) for name, value in given.items() if labelled(value) and len(value) == n]
        if not named:
            return cls(n)
        owner, labels = named[0]
        if len(named) == 1 and owner != next(iter(given)) and _permuted(labels, n):
            raise InputError(
                f"{owner} has the row labels 0 to {n - 1} in another order, and {next(iter(given))} has none: give "
                f"{owner}.sort_index() if they are places, {owner}.to_numpy() if not"
            )
        return cls(n, labels, owner)

    def take(self, name: str, value: Any) -> Any:
        """Return a column in the order of these rows: a labelled one by its labels, any other as it is.

        Raises
        ------
        InputError
            If it has other labels, or the order differs and a label stands there twice.
        """
        if self.labels is None or not labelled(value) or len(value) != self.n or value.index.equals(self.labels):
            return value
        if self.has(value):
            return value.iloc[value.index.get_indexer(self.labels)]
        row = next((i for i in range(self.n) if not _same(value.index[i], self.labels[i])), 0)
        raise InputError(
            f"row {row} is called {written(self.labels[row])} in {self.owner} and {written(value.index[row])} in "
            f"{name}: give them the same index, or give {name}.to_numpy() if the rows are the same"
        )

    def has(self, value: Any) -> bool:
        """Whether something that is labelled can be brought into the order of these rows."""
        if len(value) != self.n:
            return False
        if self.labels is None or value.index.equals(self.labels):
            return True
        if not (value.index.is_unique and self.labels.is_unique):
            return False
        return bool((value.index.get_indexer(self.labels) >= 0).all())

    def called(self, row: int) -> str:
        """Write a row as its owner would: by its place, and by its label where that says more."""
        if self.labels is None or _same(self.labels[row], row):
            return f"row {row}"
        return f"row {row} (label {written(self.labels[row])})"


def written(name: Any) -> str:
    """Write a label as its owner would, on one line and not too long."""
    return " ".join(repr(name.item() if isinstance(name, np.generic) else name).split())[:80]


def _same(one: Any, other: Any) -> bool:
    return type(one) is type(other) and one == other if isinstance(one, str | tuple) else bool(one == other)


def _permuted(labels: Any, n: int) -> bool:
    """Whether labels are 0 to n - 1, but not in this order."""
    if labels.dtype.kind not in "iu" or not labels.is_unique or labels.is_monotonic_increasing:
        return False
    return bool(labels.min() == 0 and labels.max() == n - 1)
