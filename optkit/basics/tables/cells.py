"""The cells of one column, and what they are read as: labels, numbers, whole numbers, flags."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import DataError
from optkit.basics.tables.arrow_values import plain

Column: TypeAlias = npt.NDArray[Any]

_WHOLE = re.compile(r"(0|[1-9][0-9]*)(\.0*)?")
_FLAGS = {"0": 0, "1": 1, "0.0": 0, "1.0": 1, "false": 0, "true": 1}


class Literal(str):
    """A number as it stands in a JSON file: ``1e3``, ``20240101.10``."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Return it without quotes: it has none in the file."""
        return str(self)


@dataclass(frozen=True)
class Cells:
    """Some rows of a column.

    Attributes
    ----------
    path : Path
        The file.
    name : str
        The column.
    first : int
        Number of the first of the rows; the row below the header is row 1.
    given : list or Arrow array
        The cells as the file holds them.
    """

    path: Path
    name: str
    first: int
    given: Any

    @cached_property
    def values(self) -> list[Any] | Column:
        """The cells as plain values, None where a cell is empty; an array where all are numbers or booleans."""
        if isinstance(self.given, list):
            return self.given
        return plain(self.path, self.name, self.given)

    def wrong(self, i: int, why: str) -> DataError:
        """Return the error that the cell ``i`` is not what it should be."""
        value = self.values[i]
        empty = value is None or (isinstance(value, str) and not value.strip())
        shown = "empty" if empty else repr(value.item() if isinstance(value, np.generic) else value)
        if len(shown) > 80:
            shown = f"{shown[:80]} ..."
        return DataError(f"{self.path}: {self.name} in row {self.first + i} is {shown}{why}")


Converter: TypeAlias = Callable[[Cells], Column]

LARGEST = 1e100
"""Numbers beyond it, of either sign, are no money and no measurement."""

MOST = 10_000
"""Groups and places are numbered from 0 to this at most."""


def labels(cells: Cells) -> Column:
    """Return names as text, as they stand in the file: ``007`` and ``7`` are two, ``NA`` is one like any other.

    Raises
    ------
    DataError
        If one is empty, true or false, or no plain value.
    """
    values = cells.values
    names = np.empty(len(values), dtype=object)
    if isinstance(values, list) and set(map(type, values)) <= {str} and all(map(str.strip, values)):
        names[:] = values
        return names
    for i, value in enumerate(values.tolist() if isinstance(values, np.ndarray) else values):
        missing = value is None or (isinstance(value, float) and not np.isfinite(value))
        if missing or (isinstance(value, str) and not value.strip()):
            raise cells.wrong(i, ": every row needs one")
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise cells.wrong(i, ", neither text nor a number")
        names[i] = str.__str__(value) if isinstance(value, str) else str(value)
    return names


def numbers(cells: Cells) -> Column:
    """Return finite numbers of at most :data:`LARGEST` as floats.

    Raises
    ------
    DataError
        If a cell is empty or holds anything else; true and false are not numbers.
    """
    values = cells.values
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf":
        found = values.astype(np.float64)
    else:
        found = _parsed(values)
    wrong = ~(np.abs(found) <= LARGEST)
    if wrong.any():
        i = int(wrong.argmax())
        raise cells.wrong(i, ", beyond any money" if np.isfinite(found[i]) else ", not a finite number")
    return found


def flags(cells: Cells) -> Column:
    """Return 0 or 1 from 0, 1, true and false in any case.

    Raises
    ------
    DataError
        If a cell is anything else.
    """
    return _whole_numbers(cells, lambda text: _FLAGS.get(text.strip().lower()), ", neither 0 nor 1")


def counts(cells: Cells) -> Column:
    """Return whole numbers from 0 to :data:`MOST`, written in one way only: 7, or 7.0, but neither 007 nor 7e0.

    Raises
    ------
    DataError
        If a cell is anything else.
    """
    return _whole_numbers(cells, _count, f", no whole number from 0 to {MOST:,}; count from 0 without gaps")


def groups(cells: Cells) -> Column:
    """Return numbers of groups, as :func:`counts` does, or their names, as :func:`labels` does, if none is a number.

    Raises
    ------
    DataError
        If a cell is empty, or a number where the first is a name, or the reverse.
    """
    texts = [None if value is None else str(value).strip() for value in cells.values]
    numeric = [text is not None and text != "" and not math.isnan(_number(text)) for text in texts]
    if all(numeric):
        return counts(cells)
    named = [bool(text) and not number for text, number in zip(texts, numeric, strict=True)]
    if any(numeric) and any(named):
        i = numeric.index(not numeric[0])
        raise cells.wrong(i, f", and row {cells.first} {texts[0]}: count from 0 without gaps, or give all a name")
    return labels(cells)


def _count(text: str) -> int | None:
    match = _WHOLE.fullmatch(text.strip())
    number = int(match[1]) if match and len(match[1]) < 20 else -1
    return number if 0 <= number <= MOST else None


def _whole_numbers(cells: Cells, parse: Callable[[str], int | None], why: str) -> Column:
    """Return what the cells' texts say, each text read once; true is no text that says 1 unless ``parse`` says so."""
    texts = [value if type(value) is str else str(value) for value in cells.values]
    said = {text: parse(text) for text in set(texts)}
    if None in said.values():
        raise cells.wrong(next(i for i, text in enumerate(texts) if said[text] is None), why)
    return np.array([said[text] for text in texts], dtype=np.int64)


KINDS: dict[str, Converter] = {"labels": labels, "numbers": numbers, "flags": flags, "counts": counts, "groups": groups}
"""Converters by name, for those who may not import them."""


def _parsed(values: Any) -> Column:
    """Return floats, NaN where there is no number."""
    try:
        if set(map(type, values)) <= {str, Literal} and "_" not in "".join(values):
            return np.array(values, dtype=np.float64)
    except ValueError:
        pass
    return np.array([_number(value) for value in values], dtype=np.float64)


def _number(value: Any) -> float:
    if isinstance(value, str) and "_" not in value:
        try:
            return float(value)
        except ValueError:
            return np.nan
    try:
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else np.nan
    except OverflowError:
        return np.inf
