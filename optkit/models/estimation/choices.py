"""Observed choices, checked and sorted by situation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from optkit.basics.arrays import Bools, Floats, Ints, unmasked
from optkit.basics.errors import InputError
from optkit.models.estimation.choice_sets import ChoiceSets
from optkit.models.estimation.inputs import BEYOND, numbers
from optkit.models.estimation.situations import Situations, entries, label, situation_of
from optkit.models.rows import Rows, written


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
    situations : Situations
        Which situation each input row belongs to.
    """

    rows: Ints
    sets: ChoiceSets
    labels: pd.Index
    chosen: Ints
    weights: Floats | None
    offset: Floats | None
    outside: bool
    situations: Situations

    @classmethod
    def of(
        cls,
        endog: Floats,
        groups: Any,
        *,
        outside: bool,
        available: Any = None,
        weights: Any = None,
        offset: Any = None,
        name: str = "endog",
        rows: Rows | None = None,
    ) -> ChoiceData:
        """Check and sort; see :class:`optkit.models.estimation.ConditionalLogit` for shapes and errors.

        ``rows`` says what the rows are called, and so what the labels of ``weights`` stand for.
        """
        n = len(endog)
        table = rows or Rows(n)
        codes, labels = situation_of(groups, table)
        open_rows = mask_of_rows("available", available, table)
        strange = ~((endog == 0) | (endog == 1))
        if open_rows is not None:
            strange &= open_rows
        if strange.any():
            row = int(strange.argmax())
            where = f"{table.called(row)} (situation {label(labels, codes[row])})"
            raise InputError(f"{name} is {endog[row]:g} in {where}; give 0 or 1")
        taken = np.flatnonzero(endog == 1)
        if open_rows is not None and not open_rows[taken].all():
            row = int(taken[~open_rows[taken]][0])
            raise InputError(f"{table.called(row)} (situation {label(labels, codes[row])}) is chosen but not available")
        _one_choice(codes, labels, taken, outside, table)
        used, sets, kept = sort_rows(codes, len(labels), open_rows)
        chosen = np.full(len(sets), -1)
        hit = np.flatnonzero(endog[used] == 1)
        chosen[sets.situation[hit]] = hit
        situations = Situations(table, codes, labels, used, kept)
        weight = None if weights is None else _weights(situations.each("weights", weights), labels[kept])
        known = None if offset is None else finite_column("offset", offset, table, used)
        return cls(used, sets, labels[kept], chosen, weight, known, outside, situations)

    @property
    def rejections(self) -> float:
        """How many situations chose the outside option, weights counted."""
        rejected = self.chosen < 0
        return float(rejected.sum() if self.weights is None else self.weights[rejected].sum())


def sort_rows(codes: Ints, n_labels: int, available: Bools | None) -> tuple[Ints, ChoiceSets, Bools]:
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


def mask_of_rows(name: str, mask: Any, rows: Rows) -> Bools | None:
    """Return a boolean mask over the rows; None where all are True."""
    if mask is None:
        return None
    unmasked(name, mask)
    array = np.asarray(mask) if hasattr(mask, "__array__") else entries(name, mask)
    if array.shape != (rows.n,):
        raise InputError(f"{name} has shape {array.shape}; give True or False for each of the {rows.n} rows")
    if array.dtype.kind != "b":
        allowed = bool | np.bool_ | int | float | np.integer | np.floating
        strange = [i for i, x in enumerate(array.tolist()) if not (isinstance(x, allowed) and x in (0, 1))]
        if strange:
            value = written(array[strange[0]])
            raise InputError(f"{name} is {value} in {rows.called(strange[0])}, neither True nor False")
    flags: Bools = array.astype(bool)
    return None if flags.all() else flags


def finite_column(name: str, values: Any, rows: Rows, used: Ints) -> Floats:
    """Return the entries of one column in the ``used`` rows; InputError if it does not fit or is not finite there."""
    column = np.asarray(numbers(name, values))
    if column.shape != (rows.n,):
        raise InputError(f"{name} has shape {column.shape}; give one number for each of the {rows.n} rows")
    finite_design(column[:, None], used, [name], rows)
    picked: Floats = column[used]
    return picked


def finite_design(exog: Floats, used: Ints, names: Sequence[str], rows: Rows) -> None:
    """Raise InputError, naming column and row, if the design is not finite in the ``used`` rows."""
    good = np.abs(exog) < BEYOND  # NaN fails too
    if good.all() or (good := good[used]).all():
        return
    place, column = (int(i) for i in np.argwhere(~good)[0])
    row = int(used[place])
    value = f"column {names[column]} is {exog[row, column]} in {rows.called(row)}"
    raise InputError(f"{value}; give finite numbers below {BEYOND:g}")


def _one_choice(codes: Ints, labels: pd.Index, taken: Ints, outside: bool, table: Rows) -> None:
    count = np.bincount(codes[taken], minlength=len(labels))
    if count.max() > 1:
        s = int(count.argmax())
        rows = [table.called(int(row)) for row in taken[codes[taken] == s][:2]]
        raise InputError(
            f"situation {label(labels, s)} has {count[s]} chosen alternatives ({rows[0]} and {rows[1]}); "
            "a situation has one choice: split it, or give it a weight"
        )
    if not outside and count.min() == 0:
        raise InputError(
            f"situation {label(labels, count.argmin())} has no chosen alternative ({(count == 0).sum()} such); "
            "drop it, or set outside_option=True if choosing none is an option"
        )


def _weights(given: npt.NDArray[Any], labels: pd.Index) -> Floats:
    weight: Floats = np.asarray(numbers("weights", given))
    bad = ~((weight >= 0) & (weight < BEYOND))
    if bad.any():
        s = int(bad.argmax())
        raise InputError(
            f"the weight of situation {label(labels, s)} is {weight[s]}; give numbers of at least 0, below {BEYOND:g}"
        )
    if not weight.any():
        raise InputError("all weights are 0; nothing is left to fit")
    return weight
