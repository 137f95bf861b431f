"""Observed choices, checked and sorted by situation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from optkit.basics.errors import InputError
from optkit.models.decision import Bools, Floats
from optkit.models.estimation.choice_sets import ChoiceSets, Integers


@dataclass(frozen=True)
class ChoiceData:
    """Who chose what from which set; rows that are not available are gone.

    Attributes
    ----------
    rows : (p,) int
        Input row of each available alternative, situation by situation.
    sets : ChoiceSets
        The S situations over those rows, in order of first appearance.
    labels : pandas.Index
        Their labels, (S,).
    chosen : (S,) int
        Place of the chosen alternative among the p rows; -1 for the outside option.
    weights : (S,) float or None
        How often each situation was seen; None for once.
    offset : (p,) float or None
        Known part of the index.
    outside : bool
        Whether an outside option of utility 0 is on offer in every situation.
    """

    rows: Integers
    sets: ChoiceSets
    labels: pd.Index
    chosen: Integers
    weights: Floats | None
    offset: Floats | None
    outside: bool

    @classmethod
    def of(
        cls,
        endog: Floats,
        groups: Any,
        *,
        outside: bool,
        available: npt.ArrayLike | None = None,
        weights: Any = None,
        offset: npt.ArrayLike | None = None,
        name: str = "endog",
    ) -> ChoiceData:
        """Check and sort; see :class:`optkit.models.estimation.ConditionalLogit` for shapes and errors."""
        n = len(endog)
        codes, labels = situations(groups, n)
        open_rows = mask_of_rows("available", available, n)
        strange = ~((endog == 0) | (endog == 1))
        if strange.any():
            row = int(strange.argmax())
            raise InputError(
                f"{name} is {endog[row]:g} in row {row} (situation {label(labels, codes[row])}); give 0 or 1"
            )
        taken = np.flatnonzero(endog == 1)
        if open_rows is not None and not open_rows[taken].all():
            row = int(taken[~open_rows[taken]][0])
            raise InputError(f"row {row} (situation {label(labels, codes[row])}) is chosen but not available")
        _one_choice(codes, labels, taken, outside)
        rows, sets, kept = sort_rows(codes, len(labels), open_rows)
        chosen = np.full(len(sets), -1)
        hit = np.flatnonzero(endog[rows] == 1)
        chosen[sets.situation[hit]] = hit
        weight = _per_situation(weights, codes, labels)
        known = None if offset is None else finite_column("offset", offset, n, rows)
        return cls(rows, sets, labels[kept], chosen, None if weight is None else weight[kept], known, outside)

    @property
    def rejections(self) -> float:
        """How many situations chose the outside option, weights counted."""
        rejected = self.chosen < 0
        return float(rejected.sum() if self.weights is None else self.weights[rejected].sum())


def situations(groups: Any, n: int) -> tuple[Integers, pd.Index]:
    """Return the situation of each row, (n,), and the labels in order of first appearance."""
    if isinstance(groups, np.ndarray) and groups.ndim != 1:
        raise InputError(f"groups has shape {groups.shape}; give one label per row")
    try:
        series = groups if isinstance(groups, (np.ndarray, pd.Series, pd.Index)) else pd.Series(list(groups))
        codes, labels = pd.factorize(series)
    except TypeError as error:
        raise InputError(f"groups cannot serve as labels: {error}") from None
    if len(codes) != n:
        raise InputError(f"groups has {len(codes)} labels for {n} rows; give one per row")
    if (codes < 0).any():
        raise InputError(f"groups is missing in row {int((codes < 0).argmax())}; every row belongs to a situation")
    return codes, pd.Index(labels)


def label(labels: pd.Index, place: Any) -> str:
    """Write the label of a situation as its owner would."""
    found = labels[int(place)]
    return repr(found.item() if isinstance(found, np.generic) else found)


def sort_rows(codes: Integers, n_labels: int, available: Bools | None) -> tuple[Integers, ChoiceSets, Bools]:
    """Bring the available rows of each situation together.

    Returns the input rows, (p,), their sets, and which of the labels have a row at all, (n_labels,).
    """
    rows = np.arange(len(codes)) if available is None else np.flatnonzero(available)
    codes = codes[rows]
    if (np.diff(codes) < 0).any():
        order = np.argsort(codes, kind="stable")
        rows, codes = rows[order], codes[order]
    sizes = np.bincount(codes, minlength=n_labels)
    return rows, ChoiceSets.of_sizes(sizes[sizes > 0]), sizes > 0


def mask_of_rows(name: str, mask: npt.ArrayLike | None, n: int) -> Bools | None:
    """Return a boolean mask over the rows; None where all are True."""
    if mask is None:
        return None
    array = np.asarray(mask)
    if array.shape != (n,) or not np.isin(array, [0, 1]).all():
        raise InputError(f"{name}, of shape {array.shape}, is not one True or False for each of the {n} rows")
    flags: Bools = array.astype(bool)
    return None if flags.all() else flags


def finite_column(name: str, values: npt.ArrayLike, n: int, rows: Integers) -> Floats:
    """Return the entries of one column in ``rows``; InputError if it does not fit or is not finite there."""
    try:
        column = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not an array of numbers; give floats") from None
    if column.shape != (n,):
        raise InputError(f"{name} has shape {column.shape}; give one number for each of the {n} rows")
    finite_design(column[:, None], rows, [name])
    picked: Floats = column[rows]
    return picked


def finite_design(exog: Floats, rows: Integers, names: Sequence[str]) -> None:
    """Raise InputError, naming column and row, if the design is not finite in ``rows``."""
    good = np.abs(exog) < 1e100  # beyond, its square overflows; NaN fails too
    if good.all() or (good := good[rows]).all():
        return
    place, column = (int(i) for i in np.argwhere(~good)[0])
    row = int(rows[place])
    raise InputError(f"column {names[column]} is {exog[row, column]} in row {row}; give finite numbers below 1e100")


def _one_choice(codes: Integers, labels: pd.Index, taken: Integers, outside: bool) -> None:
    count = np.bincount(codes[taken], minlength=len(labels))
    if count.max() > 1:
        s = int(count.argmax())
        rows = taken[codes[taken] == s]
        raise InputError(
            f"situation {label(labels, s)} has {count[s]} chosen alternatives (rows {rows[0]} and {rows[1]}); "
            "a situation has one choice: split it, or give it a weight"
        )
    if not outside and count.min() == 0:
        raise InputError(
            f"situation {label(labels, count.argmin())} has no chosen alternative ({(count == 0).sum()} such); "
            "drop it, or set outside_option=True if choosing none is an option"
        )


def _per_situation(weights: Any, codes: Integers, labels: pd.Index) -> Floats | None:
    """Bring weights given by row, by situation or by label to one per situation."""
    if weights is None:
        return None
    n, size = len(codes), len(labels)
    if isinstance(weights, pd.Series) and len(weights) != n:
        weights = weights.reindex(labels)
    try:
        given = np.asarray(weights, dtype=float)
    except (TypeError, ValueError):
        raise InputError("weights is not an array of numbers; give floats") from None
    if given.shape not in ((n,), (size,)):
        raise InputError(
            f"weights has shape {given.shape}; give one per row ({n}) or one per situation in order of "
            f"appearance ({size})"
        )
    weight = given
    if len(given) == n:
        weight = np.empty(size)
        weight[codes] = given
        uneven = ~((weight[codes] == given) | (np.isnan(weight[codes]) & np.isnan(given)))
        if uneven.any():
            raise InputError(f"weights differ within situation {label(labels, codes[uneven.argmax()])}")
    bad = ~(np.isfinite(weight) & (weight >= 0))
    if bad.any():
        s = int(bad.argmax())
        raise InputError(f"the weight of situation {label(labels, s)} is {weight[s]}; give numbers of at least 0")
    if not weight.any():
        raise InputError("all weights are 0; nothing is left to fit")
    return weight
