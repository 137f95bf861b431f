"""Arguments of an estimator: numbers with the names of their columns, and what goes by those names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from optkit.basics.arrays import Floats, real
from optkit.basics.errors import InputError
from optkit.models.frames import frame_of
from optkit.models.rows import labelled, written

BEYOND = 1e100
"""Numbers from here on have squares that overflow."""

REMEDY = "give floats; effects of categories, one each, are C(...) in from_formula"


def numbers(name: str, x: Any) -> Any:
    """Return floats, NaN where one is missing: a DataFrame or Series stays one, so that statsmodels finds its names.

    Raises
    ------
    InputError
        For text, also such that looks like numbers, categories, dates and complex numbers.
    """
    x = frame_of(name, x)
    if isinstance(x, pd.DataFrame):
        wrong = [c for c, dtype in enumerate(x.dtypes) if dtype != np.float64]
        if not wrong:
            return x
        columns = {c: x.iloc[:, c] for c in range(x.shape[1])}
        columns |= {c: _floats(f"column {x.columns[c]}", columns[c]) for c in wrong}
        return pd.DataFrame(columns, index=x.index).set_axis(x.columns, axis=1)
    if isinstance(x, pd.Series):
        return _floats(name, x)
    try:
        return real(name, x, accept="any", flags=True)
    except InputError as error:
        raise InputError(f"{name} does not hold numbers ({error}); {REMEDY}") from None


def _floats(name: str, column: Any) -> Any:
    kind = column.dtype
    if pd.api.types.is_numeric_dtype(kind) and not pd.api.types.is_complex_dtype(kind):
        values = column.to_numpy(dtype=float, na_value=np.nan)
    elif pd.api.types.is_object_dtype(kind):
        try:
            values = real("", column.where(column.notna(), None).to_numpy(), accept="any", flags=True)
        except InputError:
            row = next((i for i, value in enumerate(column) if not _number(value)), 0)
            shown = written(column.iloc[row])
            raise InputError(f"{name} does not hold numbers ({shown} in row {row}); {REMEDY}") from None
    else:
        raise InputError(f"{name} does not hold numbers ({kind}); {REMEDY}")
    return pd.Series(values, index=column.index, name=column.name)


def _number(value: Any) -> bool:
    one = np.empty(1, dtype=object)
    one[0] = value
    try:
        real("", one, accept="any", flags=True)
    except InputError:
        return False
    return True


def by_name(name: str, values: Any, names: Sequence[str], default: float | None = None) -> Any:
    """Return one entry for each name: of a dict or a Series those of its keys, of all else what it holds.

    Raises
    ------
    InputError
        If a key is no name, or a name without ``default`` is no key.
    """
    if not (isinstance(values, Mapping) or labelled(values)):
        return values
    if values is not None and not isinstance(values, Mapping):
        if not values.index.is_unique or getattr(values, "ndim", 1) != 1:
            raise InputError(f"{name} names a column twice; give one number for each of {', '.join(names)}")
        values = values.to_dict()
    given = {str(key): value for key, value in values.items()}
    unknown = [key for key in given if key not in names]
    if unknown:
        raise InputError(f"{name} names {unknown[0]!r}; the columns are {', '.join(names)}")
    missing = [one for one in names if one not in given]
    if missing and default is None:
        raise InputError(f"{name} has nothing for {missing[0]}; the columns are {', '.join(names)}")
    return [given.get(one, default) for one in names]


def coefficients(name: str, values: Any, names: Sequence[str]) -> Floats:
    """Return one finite number for each column, (k,), in the order of the columns.

    Raises
    ------
    InputError
        If it is anything else.
    """
    array: Floats = np.asarray(numbers(name, by_name(name, values, names)))
    if array.shape != (len(names),) or not (np.abs(array) < BEYOND).all():
        told = f"{len(names)} finite numbers below {BEYOND:g}, one for each column"
        raise InputError(f"{name}, of shape {array.shape}, is not {told}")
    return array


def contrasts(name: str, given: Any, names: Sequence[str]) -> Any:
    """Return linear combinations of the coefficients in the order of the columns: labelled ones by their names.

    Text and dicts, which statsmodels reads, stay as they are; of a pair (combinations, their values) both are checked.

    Raises
    ------
    InputError
        If the labels are not the names of the columns, an entry is not a finite number, or a row asks nothing.
    """
    if given is None or isinstance(given, str | Mapping):
        return given
    if isinstance(given, list | tuple) and any(isinstance(one, str) for one in given):
        return given
    if isinstance(given, tuple) and len(given) == 2:
        return contrasts(name, given[0], names), real(f"the values of {name}", given[1])
    given = frame_of(name, given)
    if labelled(given):
        axes = [given.columns if isinstance(given, pd.DataFrame) else given.index]
        if name == "cov_p":
            axes.append(given.index)
        for labels in axes:
            if sorted(map(str, labels)) != sorted(names):
                raise InputError(
                    f"{name} has the labels {', '.join(map(str, labels))}, and the columns are {', '.join(names)}: "
                    f"give each of these once, or {name}.to_numpy() if they are in this order"
                )
        order = [[list(map(str, labels)).index(one) for one in names] for labels in axes]
        given = given.iloc[:, order[0]] if isinstance(given, pd.DataFrame) else given.iloc[order[0]]
        given = given.iloc[order[1]] if name == "cov_p" else given
        given = numbers(name, given).to_numpy()
    array = real(name, given)
    k = len(names)
    if array.shape[-1:] != (k,) or array.ndim > 2 or (name == "cov_p" and array.shape != (k, k)):
        raise InputError(f"{name} has shape {array.shape}; give one column for each of {', '.join(names)}")
    if name == "r_matrix" and (empty := ~np.atleast_2d(array).any(axis=1)).any():
        raise InputError(f"r_matrix: all weights of row {int(empty.argmax())} are 0: there is nothing to test")
    return array


def penalties_of(penalty: Any, names: list[str]) -> Floats:
    """Return the L2 penalty of each column, (k,), from a number, a sequence, or a dict or Series by name."""
    given = numbers("penalty", by_name("penalty", penalty, names, default=0.0))
    try:
        full: Floats = np.array(np.broadcast_to(np.asarray(given), len(names)))
    except ValueError:
        raise InputError(f"penalty is not a number, or one for each of the {len(names)} columns") from None
    bad = ~((full >= 0) & (full < BEYOND))
    if bad.any():
        column = int(bad.argmax())
        raise InputError(
            f"the penalty of {names[column]} is {full[column]}; give numbers of at least 0, below {BEYOND:g}"
        )
    return full
