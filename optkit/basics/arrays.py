"""Checked numbers and arrays: errors say which entry of which field is wrong, and nothing is taken for what it is not.

One home for the whole kit. ``True`` is never 1 and text is never a number; complex numbers, dates, categories and
masked arrays are refused; a mask is made of True and False, or it is refused. Every function takes the class of the
error that it raises.
"""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Collection, Sequence
from dataclasses import fields
from decimal import Decimal
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InputError, OptkitError

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

    from optkit.basics.tables.table import Table

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Shape = tuple[int | None, ...]
Error = type[OptkitError]
Rows = Any
"""What the entries of a column are called, by their places; None where they have no names."""
T = TypeVar("T")

EXACT = 2**53
"""Up to here every whole number is a float."""

MOST_MONEY = 1e100
"""Beyond, a sum or a square may no longer be a number."""

_STRANGE = {"c": "complex numbers", "U": "text", "S": "text", "M": "dates", "m": "time spans", "V": "records"}


def whole_number(
    name: str, value: Any, *, least: int | None = None, most: int | None = None, error: Error = InputError
) -> int:
    """Return one whole number: 3 and 3.0 are, of whatever width; True, "3", 3.5 and [3] are not.

    Raises
    ------
    InputError
        Or the error class given: if it is not one, or below ``least``, or above ``most``.
    """
    number: int | None = None
    if isinstance(value, float | np.floating):
        number = int(value) if abs(float(value)) <= EXACT and value == np.floor(value) else None
    elif not isinstance(value, bool | np.ma.MaskedArray):
        try:
            number = operator.index(value)
        except TypeError:
            number = None
    if number is None or (least is not None and number < least) or (most is not None and number > most):
        span = f" of at least {least}" if least is not None else ""
        span += "" if most is None else f" {'and' if span else 'of'} at most {most:,}"
        raise error(f"{name} = {_shown(value)} is not a whole number{span}")
    return number


def number(
    name: str,
    value: Any,
    *,
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
    error: Error = InputError,
) -> float:
    """Return one finite number as a float: not True, not text, not complex, not below ``least``, and over ``above``.

    Raises
    ------
    InputError
        Or the error class given: if it is not one, or out of range.
    """
    plain = isinstance(value, int | float | np.integer | np.floating) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
    )
    try:
        found = math.nan if isinstance(value, bool | np.timedelta64 | np.ma.MaskedArray) or not plain else float(value)
    except OverflowError:
        found = math.nan
    if not (math.isfinite(found) and least <= found <= most and found > above):
        span = (
            f" above {above:g}"
            if above > max(least, -math.inf)
            else f" of at least {least:g}"
            if least > -math.inf
            else ""
        )
        span += "" if most == math.inf else f" {'and' if span else 'of'} at most {most:g}"
        raise error(f"{name} = {_shown(value)} is not a finite number{span}")
    return found


def flag(name: str, value: Any, *, error: Error = InputError) -> bool:
    """Return True or False as it is; anything else, 0 and 1 included, is an error."""
    if not isinstance(value, bool | np.bool_):
        raise error(f"{name} = {_shown(value)} is neither True nor False")
    return bool(value)


def one_of(name: str, value: Any, options: Sequence[str], *, error: Error = InputError) -> str:
    """Return one of some words; an error names them all."""
    if not isinstance(value, str) or value not in options:
        raise error(f"{name} = {_shown(value)} is unknown; it is {' or '.join(map(repr, options))}")
    return value


def is_finite(value: Any) -> bool:
    """Whether something is one finite number."""
    try:
        number("", value)
    except InputError:
        return False
    return True


def count(name: str, value: Any, *, error: Error = InputError) -> int:
    """Return the number of entries; an error if they make no array."""
    return _array(name, value, error).size


def floats(
    name: str, value: Any, shape: Shape | None, *, flags: bool = False, rows: Rows = None, error: Error = InputError
) -> Floats:
    """Return finite floats as a read-only copy; ``flags`` lets True and False in as 1 and 0, for characteristics.

    ``rows`` is what the entries of a column are called, for messages.

    Raises
    ------
    InputError
        Or the error class given: if the shape is wrong (None allows any length), or an entry is not a finite number.
    """
    array = real(name, value, flags=flags, rows=rows, error=error)
    check_shape(name, array, shape, error=error)
    return locked(array)


def ints(name: str, value: Any, shape: Shape | None, *, rows: Rows = None, error: Error = InputError) -> Ints:
    """Return whole numbers as a read-only copy, floats that hold whole numbers included; ``rows`` as of :func:`floats`.

    Raises
    ------
    InputError
        Or the error class given: if the shape is wrong (None allows any length), or an entry is not a whole number.
    """
    array = _array(name, value, error)
    if array.dtype.kind not in "iu":
        array = real(name, array, rows=rows, error=error)
        wrong = (array != np.floor(array)) | (np.abs(array) > EXACT)
    else:
        wrong = array > np.iinfo(np.int64).max if array.dtype.kind == "u" else None
    check_shape(name, array, shape, error=error)
    if wrong is not None and wrong.any():
        place = _first(wrong)
        raise error(f"{name}{_written(place, rows)} = {array[place]:.17g} is not a whole number of moderate size")
    return locked(np.asarray(array, dtype=np.int64))


def mask(name: str, value: Any, shape: Shape | None = None, *, error: Error = InputError) -> Bools:
    """Return an array of True and False; what is anything else is refused, 0 and 1 included.

    Raises
    ------
    InputError
        Or the error class given: for NaN, words, numbers and positions, and masked arrays; or if the shape is wrong.
    """
    array = _array(name, value, error, any_kind=True)
    if array.dtype.kind == "O" and all(isinstance(x, bool | np.bool_) for x in array.flat):
        array = array.astype(bool)  # a column that once had gaps
    if array.dtype.kind != "b" and array.size:
        place = next((p for p, x in np.ndenumerate(array) if not isinstance(x, bool | np.bool_)), ())
        raise error(
            f"{name}{_written(place)} is {_shown(array[place])}: a mask is made of True and False, one per entry; "
            "compare to make one, as in column == 1"
        )
    check_shape(name, array, shape, error=error)
    return array.astype(bool, copy=False)


def real(
    name: str,
    value: Any,
    *,
    accept: Literal["finite", "-inf", "any"] = "finite",
    flags: bool = False,
    rows: Rows = None,
    error: Error = InputError,
) -> Floats:
    """Return floats of any shape, the array itself where it holds such: finite ones, or ``-inf`` too, or any.

    Raises
    ------
    InputError
        Or the error class given: if an entry is not such a number.
    """
    array = _array(name, value, error, flags=flags)
    if array.dtype.kind == "O":
        allowed = (bool, np.bool_) if flags else ()
        strange = next((p for p, x in np.ndenumerate(array) if not (_is_real(x) or isinstance(x, allowed))), None)
        if strange is not None:
            entry = f"{name}{_written(strange, rows)} is {_shown(array[strange])}"
            raise error(f"{name} has entries that are not numbers ({entry}); give floats")
    try:
        array = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise error(f"{name} has entries that are not numbers (dtype {array.dtype}); give floats") from None
    good = np.isfinite(array)
    if accept != "any" and not good.all() and not (accept == "-inf" and (good := good | np.isneginf(array)).all()):
        place = _first(~good)
        told = f"{name}{_written(place, rows)} is {array[place]}, not a finite number"
        raise error(f"{told}: drop the row or fill it in; optkit never guesses")
    return array


def check_shape(name: str, array: npt.NDArray[Any], shape: Shape | None, *, error: Error = InputError) -> None:
    """Raise an error unless an array has a shape; None allows any length, or any shape."""
    if shape is None or array.shape == shape:
        return
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if s is None else str(s) for s in shape) + ("," if len(shape) == 1 else "")
        raise error(f"{name} has shape {array.shape}; it needs ({wanted})")


def text_names(name: str, values: Any, count: int | None = None, *, error: Error = InputError) -> tuple[str, ...]:
    """Return names: text, all different and none empty.

    Raises
    ------
    InputError
        Or the error class given: if there are not so many, one is no text or empty, or two are alike.
    """
    listed = [values] if isinstance(values, str) else list(values)
    if count is not None and len(listed) != count:
        raise error(f"{name} has {len(listed)} names; it needs {count}, one for each")
    seen: set[str] = set()
    for i, one in enumerate(listed):
        if not isinstance(one, str) or not one.strip():
            raise error(f"{name}[{i}] = {_shown(one)} is no name")
        if one in seen:
            raise error(f"{name}[{i}] = {one!r} is there twice")
        seen.add(one)
    return tuple(map(str, listed))


def _array(name: str, value: Any, error: Error, *, flags: bool = False, any_kind: bool = False) -> npt.NDArray[Any]:
    """Return what is given as an array, without a copy where it is one: of numbers or objects, or as said."""
    if type(value) is np.ndarray and value.dtype.kind in "fiu":  # most are, and need no more questions
        return value
    kinds = unmasked(name, value, error=error)
    nested = isinstance(value, list | tuple)
    try:
        array = np.asarray(value)
    except ValueError:
        raise error(f"{name} is ragged: its rows differ in length; give an array, rows padded to one length") from None
    kind = array.dtype.kind
    if any_kind:
        return array
    if kind in _STRANGE:
        why = f"{_STRANGE[kind]} (dtype {array.dtype}), not {'real ' if kind == 'c' else ''}numbers"
        raise error(f"{name} holds {why}; give floats or ints")
    if not isinstance(value, np.ndarray) and str(getattr(value, "dtype", "")) == "category":
        raise error(f"{name} holds categories, not numbers; give floats or ints")
    if not flags and (kind == "b" or (nested and kind != "O" and kinds & {bool, np.bool_})):
        raise error(f"{name} holds True or False, not numbers; give floats or ints")
    return array


def unmasked(name: str, value: Any, *, error: Error = InputError) -> set[type]:
    """Refuse masked arrays, alone or in lists; return the types that are there. For labels, which may be anything else.

    Raises
    ------
    InputError
        Or the error class given: if one is there, whether it hides anything or not.
    """
    kinds = _kinds(value) if isinstance(value, list | tuple) else {type(value)}
    if any(issubclass(kind, np.ma.MaskedArray) for kind in kinds):
        raise error(f"{name} is a masked array, and what it hides would count: fill it in or drop those entries")
    return kinds


def _kinds(value: list[Any] | tuple[Any, ...]) -> set[type]:
    """Types of the leaves of nested lists: an array made of them forgets a True among numbers, and what is masked."""
    found = set(map(type, value))
    for inner in [x for x in value if isinstance(x, list | tuple)] if found & {list, tuple} else ():
        found |= _kinds(inner)
    return found


def _is_real(x: Any) -> bool:
    """Whether one object is a real number, or None, a gap, which shows as NaN."""
    return x is None or (isinstance(x, Real | Decimal) and not isinstance(x, bool | np.bool_ | np.timedelta64))


def _first(wrong: Bools) -> tuple[int, ...]:
    """Place of the first True."""
    return tuple(int(i) for i in np.unravel_index(int(wrong.argmax()), wrong.shape))


def _written(place: tuple[int, ...], rows: Rows = None) -> str:
    if rows is not None:
        return f" in row {rows[place[0]]}"
    return f"[{', '.join(map(str, place))}]" if place else ""


def _shown(value: Any) -> str:
    """Write a value as its owner would, on one line and not too long."""
    return " ".join(repr(value.item() if isinstance(value, np.generic) else value).split())[:80]


def locked(value: T) -> T:
    """Return an array, or those of a tuple, as a copy that nobody can make writable: its memory is that of bytes.

    Examples
    --------
    >>> import numpy as np
    >>> one = locked(np.array([1.0, 2.0]))
    >>> one.flags.writeable = True
    Traceback (most recent call last):
    ...
    ValueError: cannot set WRITEABLE flag to True of this array
    """
    part: Any = value
    if isinstance(part, tuple):
        return tuple(map(locked, part))  # type: ignore[return-value]
    if not isinstance(part, np.ndarray) or part.dtype.hasobject or not part.size:
        return read_only(part)  # type: ignore[no-any-return]
    # In the order in which it lies there: sums along an axis then round as before.
    order: Literal["C", "F"] = "F" if part.flags.f_contiguous and not part.flags.c_contiguous else "C"
    flat = np.frombuffer(part.tobytes(order), part.dtype)
    return flat.reshape(part.shape, order=order)  # type: ignore[return-value]


def read_only(value: T) -> T:
    """Make an array read-only, with what it is a view of; also those of a sparse array, and of a tuple.

    Who wants to can make it writable again, see :func:`locked`.
    """
    part: Any = value
    while isinstance(part, np.ndarray):
        part.flags.writeable = False
        part = part.base
    if isinstance(value, tuple):
        for one in value:
            read_only(one)
    elif hasattr(value, "indptr"):
        read_only((value.data, value.indices, value.indptr))  # type: ignore[attr-defined]
    return value


_NAMES: dict[type, tuple[str, ...]] = {}
"""Names of the fields of dataclasses that have been made: some are made a million times."""


def _names(kind: type) -> tuple[str, ...]:
    if kind not in _NAMES:
        _NAMES[kind] = tuple(field.name for field in fields(kind))
    return _NAMES[kind]


def check_finite(what: str, table: pd.DataFrame, unknown: Collection[str] = ()) -> None:
    """Refuse a result that holds NaN or infinity: nobody could tell what it claims.

    :class:`Known` lets every table of a result through here; so do results with rules of their own.

    Parameters
    ----------
    what : str
        What the table is, in words.
    table : DataFrame
        Its columns of numbers are looked at.
    unknown : collection of str
        Columns whose entries may be lacking, as the result's own docstring says.

    Raises
    ------
    InputError
        That names the first entry.

    Examples
    --------
    >>> import pandas as pd
    >>> check_finite("gaps", pd.DataFrame({"money": [1.0, 2.0], "claim": [0.5, float("nan")]}), ["claim"])
    """
    for name, column in table.items():
        if name in unknown or column.dtype.kind != "f" or np.isfinite(column.to_numpy()).all():
            continue
        row = int((~np.isfinite(column.to_numpy())).argmax())
        whose = next((f" of {table[label].iloc[row]}" for label in ("policy", "kind") if label in table), "")
        raise InputError(
            f"{what}: {name}{whose} comes to {column.iloc[row]}: amounts are too large to be added up; "
            "look at the policy's offers and the instances' rewards, or take a larger unit of money"
        )


class Known:
    """Base of frozen dataclasses that are results: what stands there as a number, is one.

    This is the one place where results are looked at for NaN. ``lacking`` names the attributes that may hold it, and
    the class's docstring says what it means there. A certificate is a claim, and may hold anything: its check refuses.

    Raises
    ------
    InputError
        When the result is made.

    Examples
    --------
    >>> from optkit.bounds.bound import SolverRecord
    >>> SolverRecord("by hand", "done", seconds=float("nan"))
    Traceback (most recent call last):
    ...
    optkit.basics.errors.InputError: seconds of SolverRecord comes to NaN: amounts are too large for what is ...
    """

    lacking: ClassVar[Collection[str]] = ()

    def columns_lacking(self, table: str) -> Collection[str]:
        """Columns of a table that may hold NaN or infinity."""
        return ()

    def __post_init__(self) -> None:
        for name in _names(type(self)):
            value = getattr(self, name)
            if hasattr(value, "columns"):
                check_finite(name, value, self.columns_lacking(name))
            elif name not in self.lacking and _holds_nan(value):
                raise InputError(
                    f"{name} of {type(self).__name__} comes to NaN: amounts are too large for what is worked out from "
                    "them, or not numbers; take a larger unit of money"
                )
        getattr(super(), "__post_init__", lambda: None)()


def _holds_nan(value: Any) -> bool:
    """Whether there is NaN in a number, an array, or several of these."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind == "f" and value.size > 0 and math.isnan(value.min())
    if isinstance(value, float):
        return math.isnan(value)
    return isinstance(value, tuple) and any(map(_holds_nan, value))


class ReadOnlyArrays:
    """Base of frozen dataclasses whose arrays nobody writes into: who looks at the world does not change it.

    The arrays that it is made of stay their owner's, who may write into them. It can be pickled and copied, which makes
    arrays writable if nobody takes care; what was worked out on demand stays behind.
    """

    def __post_init__(self) -> None:
        for name in _names(type(self)):
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                seen = value.view()
                seen.flags.writeable = False
                object.__setattr__(self, name, seen)

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in _names(type(self))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, locked(value) if isinstance(value, np.ndarray) else read_only(value))


def open_table(path: str | os.PathLike[str], remedy: str) -> Table:
    """Open a file whose columns are to become arrays, see :func:`optkit.basics.tables.read.open_table`.

    For packages that know arrays and not files.
    """
    from optkit.basics.tables.read import open_table

    return open_table(path, remedy=remedy)


def check_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse what would not fit in memory, see :func:`optkit.basics.memory.check_memory`; errors as there."""
    from optkit.basics.memory import check_memory as check

    check(what, needed, remedy)


def write_document(path: str | os.PathLike[str], plain: dict[str, Any], what: str) -> Path:
    """Write plain data with their digest, see :func:`optkit.basics.documents.write_document`; errors as there."""
    from optkit.basics.documents import write_document

    return write_document(path, plain, what)


def read_document(path: str | os.PathLike[str], form: str, version: int, what: str) -> dict[str, Any]:
    """Read plain data and check their digest, see :func:`optkit.basics.documents.read_document`; errors as there."""
    from optkit.basics.documents import read_document

    return read_document(path, form, version, what)
