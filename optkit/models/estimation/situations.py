"""Which situation each row belongs to, and what is known of a whole situation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from optkit.basics.arrays import Bools, Ints, unmasked
from optkit.basics.errors import InputError
from optkit.models.rows import Rows, labelled, written


@dataclass(frozen=True)
class Situations:
    """n rows of some situations.

    Attributes
    ----------
    rows : Rows
        What the rows are called.
    codes : (n,) int
        Number of the situation of each row.
    labels : pandas.Index
        What the situations are called, in order of first appearance.
    used : (p,) int
        Rows that are available; the others are ignored, whatever they hold.
    kept : bool array
        Which of the situations have such a row.
    """

    rows: Rows
    codes: Ints
    labels: pd.Index
    used: Ints
    kept: Bools

    def each(self, name: str, given: Any) -> npt.NDArray[Any]:
        """Bring what is given by row, by situation or by a situation's label to one entry per situation that is kept.

        Raises
        ------
        InputError
            If it fits neither the rows nor the situations, fits both but not alike, or differs within a situation.
        """
        n, size = len(self.codes), len(self.labels)
        unmasked(name, given)
        if not labelled(given):
            array = np.asarray(given) if hasattr(given, "__array__") else entries(name, given)
            if array.shape not in ((n,), (size,)):
                raise InputError(
                    f"{name} has shape {array.shape}; give one per row ({n}) or one per situation in order of "
                    f"appearance ({size})"
                )
            return self._alike(name, array) if len(array) == n else array[self.kept]
        if given.ndim != 1:
            raise InputError(f"{name} has shape {given.shape}; give one column")
        by_label, by_row, labels = None, None, self.labels[self.kept]
        if self.rows.has(given):
            by_row = self._alike(name, np.asarray(self.rows.take(name, given)))
        if by_row is None or n == size:  # labels of n rows are none of fewer situations, even if these are among them
            place = given.index.get_indexer(labels) if given.index.is_unique else np.array([-1])
            by_label = given.to_numpy()[place] if place.min() >= 0 else None
        if by_label is not None and by_row is not None and not pd.Series(by_row).equals(pd.Series(by_label)):
            raise InputError(
                f"{name} has labels that are those of rows and of situations; give an array of one per row"
            )
        found = by_label if by_row is None else by_row
        if found is None:
            twice = given.index[given.index.duplicated()]
            unknown = labels[~labels.isin(given.index)]
            why = f"has the label {written(twice[0])} twice" if len(twice) else f"has no label {written(unknown[0])}"
            raise InputError(f"{name} {why}; give one entry per situation, by its label, or one per row")
        return np.asarray(found)

    def _alike(self, name: str, by_row: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return one entry per situation of what must be the same in all its rows."""
        try:
            entry, _ = pd.factorize(by_row)
        except (TypeError, NotImplementedError) as error:
            raise InputError(f"{name} does not hold one plain entry per row: {error}") from None
        own = self.codes[self.used]
        first = np.zeros(len(self.labels), dtype=np.int64)
        first[own[::-1]] = self.used[::-1]
        uneven = entry[self.used] != entry[first][own]
        if uneven.any():
            raise InputError(f"{name} differ within situation {label(self.labels, own[uneven.argmax()])}")
        return by_row[first[self.kept]]


def situation_of(groups: Any, rows: Rows) -> tuple[Ints, pd.Index]:
    """Return the situation of each row, (n,), and the labels in order of first appearance."""
    unmasked("groups", groups)
    shape = getattr(groups, "shape", (rows.n,))
    if len(shape) != 1:
        raise InputError(f"groups has shape {shape}; give one label per row")
    if getattr(groups, "dtype", None) == np.float16:
        groups = np.asarray(groups, dtype=float)  # pandas knows no labels so short
    try:
        # A list goes through a Series: an array of it would make text of the numbers beside text.
        plain = np.asarray(groups) if hasattr(groups, "__array__") else pd.Series(list(groups))
        codes, labels = pd.factorize(groups if isinstance(groups, pd.Series | pd.Index) else plain)
    except TypeError as error:
        raise InputError(f"groups cannot serve as labels: {error}") from None
    if len(codes) != rows.n:
        raise InputError(f"groups has {len(codes)} labels for {rows.n} rows; give one per row")
    if (codes < 0).any():
        row = rows.called(int((codes < 0).argmax()))
        raise InputError(f"groups is missing in {row}; every row belongs to a situation")
    return codes, pd.Index(labels)


def label(labels: pd.Index, place: Any) -> str:
    """Write the label of a situation as its owner would."""
    return written(labels[int(place)])


def entries(name: str, given: Any) -> npt.NDArray[Any]:
    """Return what a list or anything like it holds, (any number,)."""
    try:
        listed = list(given)
    except TypeError:
        raise InputError(f"{name} has shape (); give a list or an array") from None
    array = np.empty(len(listed), dtype=object)
    for i, entry in enumerate(listed):
        array[i] = entry
    return array
