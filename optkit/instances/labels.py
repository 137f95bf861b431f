"""What users call their requests, workers, groups and features: identifiers that are unique, and names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import unmasked, whole_number
from optkit.basics.errors import InputError, InstanceError

Identifiers = npt.NDArray[Any]
"""Whole numbers (int64), or text (objects)."""


def identifiers(name: str, values: Any, count: int, rows: Any = None) -> Identifiers:
    """Return identifiers as a read-only array: all text, or all whole numbers; no two alike.

    ``rows`` is what a table calls its rows, for messages.

    Raises
    ------
    InstanceError
        If there are not so many, one is missing or there twice, or they are neither text nor whole numbers.

    Examples
    --------
    >>> identifiers("request_id", ["007", "7"], 2).tolist(), identifiers("worker_id", [7.0, 8.0], 2).tolist()
    (['007', '7'], [7, 8])
    """
    unmasked(name, values, error=InstanceError)
    array = np.asarray(values)
    if array.shape != (count,):
        raise InstanceError(f"{name} has shape {array.shape}; it needs ({count},), one for each")
    at = [f"{name}[{i}]" if rows is None else f"{name} in row {rows[i]}" for i in range(count)]
    listed = [_plain(where, value) for where, value in zip(at, array.tolist(), strict=True)]
    text = [isinstance(value, str) for value in listed]
    if any(text) and not all(text):
        i = text.index(not text[0])
        raise InstanceError(f"{at[0]} = {listed[0]!r} and {at[i]} = {listed[i]!r}: write all as text, or none")
    first: dict[Any, int] = {}
    for i, value in enumerate(listed):
        if first.setdefault(value, i) != i:
            other = at[first[value]]
            raise InstanceError(f"{at[i]} = {value!r} is the same as {other}: each has one of its own")
    made = np.array(listed, dtype=object if any(text) else np.int64)
    made.flags.writeable = False
    return made


def _plain(where: str, value: Any) -> Any:
    if isinstance(value, str):
        return value
    if value is None or value != value:
        raise InstanceError(f"{where} is missing: give each an identifier, or leave all out")
    try:
        return whole_number(where, value, error=InstanceError)
    except InstanceError:
        raise InstanceError(f"{where} = {value!r} is neither text nor a whole number") from None


def group_of(group: str | int | None, names: Sequence[str]) -> int:
    """Return the number of a group from its name, or from its number where no name is one; of one, also from nothing.

    Raises
    ------
    InputError
        If it is none of them, or none is given and there are several.

    Examples
    --------
    >>> group_of("car", ["bike", "car"]), group_of(1, ["0", "1"]), group_of(None, ["0"])
    (1, 1, 0)
    """
    if group is None and len(names) > 1:
        raise InputError(f"say of which group the worker is: {', '.join(names)}")
    if group is None:
        return 0
    if str(group) in names:
        return list(names).index(str(group))
    by_place = isinstance(group, int) and not any(name.isdecimal() for name in names)  # else a number may be a name
    if not by_place or not 0 <= int(group) < len(names):
        raise InputError(f"no group is called {group!r}; there are {', '.join(names)}")
    return int(group)
