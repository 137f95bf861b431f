"""Checked, read-only arrays: errors say which entry of which field is wrong."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InstanceError

if TYPE_CHECKING:
    from optkit.basics.tables.table import Table

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Shape = tuple[int | None, ...]


def whole_number(name: str, value: Any) -> int:
    """Return one whole number, or raise an InstanceError."""
    try:
        number = int(value)
        if isinstance(value, bool | str) or np.ndim(value) != 0 or number != value:
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise InstanceError(f"{name} = {' '.join(repr(value).split())[:80]} is not a whole number") from None
    return number


def count(name: str, value: Any) -> int:
    """Return the number of entries, or raise an InstanceError if they make no array."""
    try:
        return np.asarray(value).size
    except ValueError:
        raise InstanceError(f"{name} is ragged: its rows differ in length; give an array") from None


def ints(name: str, value: Any, shape: Shape) -> Ints:
    """Return whole numbers as a read-only copy, floats that hold whole numbers included.

    Raises
    ------
    InstanceError
        If the shape is wrong (None allows any length), or an entry is not a whole number.
    """
    array = shaped(name, value, shape)
    if array.dtype.kind not in "iu":
        array = floats(name, array, shape)
    wrong = (array != np.floor(array)) | (np.abs(array) > 2**53) if array.dtype.kind == "f" else np.zeros(0, bool)
    if wrong.any():
        i = int(wrong.argmax())
        raise InstanceError(f"{name}[{i}] = {array[i]:.17g} is not a whole number of moderate size")
    return _sealed(np.array(array, dtype=np.int64))


def floats(name: str, value: Any, shape: Shape) -> Floats:
    """Return finite floats as a read-only copy.

    Raises
    ------
    InstanceError
        If the shape is wrong (None allows any length), or an entry is not a finite number.
    """
    array = shaped(name, value, shape)
    try:
        array = np.array(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise InstanceError(f"{name} has entries that are not numbers (dtype {array.dtype}); give floats") from None
    if not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        place = f"[{', '.join(map(str, index))}]" if index else ""
        raise InstanceError(f"{name}{place} is {array[index]}: drop the row or fill it in; optkit never guesses")
    return _sealed(array)


def shaped(name: str, value: Any, shape: Shape) -> npt.NDArray[Any]:
    """Return an array of the shape, or raise an InstanceError; None allows any length."""
    count(name, value)
    array = np.asarray(value)
    kinds = {"c": "complex numbers", "U": "text", "S": "text", "M": "dates", "m": "time spans", "V": "records"}
    if array.dtype.kind in kinds:
        real = "real numbers" if array.dtype.kind == "c" else "numbers"
        raise InstanceError(
            f"{name} holds {kinds[array.dtype.kind]} (dtype {array.dtype}), not {real}; give floats or ints"
        )
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "")
        raise InstanceError(f"{name} has shape {array.shape}; it needs ({wanted}), see the Instance docstring")
    return array


def _sealed(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.flags.writeable = False
    return array


def open_table(path: str | os.PathLike[str], remedy: str) -> Table:
    """Open a file whose columns are to become arrays, see :func:`optkit.basics.tables.read.open_table`.

    For packages that know arrays and not files.
    """
    from optkit.basics.tables.read import open_table

    return open_table(path, remedy=remedy)


Bools = npt.NDArray[np.bool_]


def is_finite(value: Any) -> bool:
    """Whether something is one finite number."""
    try:
        return math.isfinite(value)
    except TypeError:
        return False
