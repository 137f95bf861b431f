"""Columns of a user's tables: found by name, and read without guessing; an error names the row as the table does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, floats, ints
from optkit.basics.errors import InstanceError
from optkit.basics.printable import listed
from optkit.instances.labels import Identifiers, identifiers

if TYPE_CHECKING:
    import pandas as pd

REQUESTS = ("request_id", "arrival", "expiry", "reward", "penalty", "pickup", "dropoff")
"""Columns of a table of requests, beside utilities and features."""

WORKERS = ("worker_id", "joined", "step", "group")
"""Columns of a table of workers."""

PREFIX = "utility_"


def frame(name: str, table: Any) -> pd.DataFrame:
    """Return a table of pandas, polars or pyarrow as a DataFrame whose columns are called by text.

    Raises
    ------
    InstanceError
        If it is no table.
    """
    import pandas as pd

    if not isinstance(table, pd.DataFrame) and hasattr(table, "to_pandas"):
        table = table.to_pandas()
    if isinstance(table, Mapping):
        table = pd.DataFrame(dict(table))
    if not isinstance(table, pd.DataFrame) or table.columns.nlevels > 1:
        raise InstanceError(f"{name} is a {type(table).__name__}: give a table of pandas, polars or pyarrow")
    labels = [name for name in table.index.names if name is not None]
    if len(labels) == table.index.nlevels and not {*labels} & {*table.columns}:
        table = table.reset_index()  # a named index is a column
    named: pd.DataFrame = table.set_axis([str(column) for column in table.columns], axis=1)
    return named if named.index.is_unique else named.reset_index(drop=True)  # messages name rows


def numbers_of(name: str, column: pd.Series, *, flags: bool = False) -> Floats:
    """Return a column as numbers; ``flags`` lets True and False in as 1 and 0.

    Raises
    ------
    InstanceError
        If an entry is no finite number; it names the row as the table does.
    """
    return floats(name, column if len(column) else [], (None,), flags=flags, rows=column.index, error=InstanceError)


def whole_numbers_of(name: str, column: pd.Series) -> Ints:
    """Return a column as whole numbers; errors as of :func:`numbers_of`."""
    return ints(name, column if len(column) else [], (None,), rows=column.index, error=InstanceError)


def identifiers_of(name: str, column: pd.Series) -> Identifiers:
    """Return a column as identifiers; errors as of :func:`optkit.instances.labels.identifiers`."""
    return identifiers(name, column.to_numpy(dtype=object), len(column), column.index)


def no_misspelling(table: str, own: pd.DataFrame, known: Sequence[str]) -> None:
    """Refuse a column that nearly has the name of one that is not there: it would count as 0 in silence."""
    absent = [name for name in known if name not in own]
    for column in own.columns:
        near = get_close_matches(column.strip().lower(), absent, n=1, cutoff=0.75) if column not in known else []
        if near:
            raise InstanceError(
                f"the {table} table has a column {column!r} and none {near[0]!r}: rename it, or drop it if that is "
                "something else"
            )


def need(table: str, own: pd.DataFrame, columns: Sequence[str], remedy: str = "rename") -> None:
    """Raise an error unless the columns are there, once; ``joined|step`` is one that may be called either."""
    missing = [c for c in columns if not any(name in own for name in c.split("|"))]
    if missing:
        have, named = listed(own.columns), ", ".join(repr(c).replace("|", "' or '") for c in missing)
        what = [c.partition("|")[0] for c in missing]
        raise InstanceError(f"the {table} table has no column {named}; it has: {have}. {_mend(remedy, what)}")
    once(table, own, columns)


def _mend(remedy: str, missing: Sequence[str]) -> str:
    one = "it is" if len(missing) == 1 else "they are"
    if remedy == "rename":
        return f"Rename what {one} called otherwise"
    return f"Say what {one} called: {remedy} {','.join(f'{name}=COLUMN' for name in missing)}"


def once(table: str, own: pd.DataFrame, columns: Sequence[str]) -> None:
    """Raise an error if one of some columns is there twice."""
    times = Counter(own.columns)
    double = next((c for c in columns if times[c] > 1), None)
    if double is not None:
        raise InstanceError(f"the {table} table has the column {double!r} twice; leave one")


def matrix(name: str, own: pd.DataFrame, columns: list[str], flags: bool = False) -> Floats:
    """Return columns of a table as a matrix, (rows, columns); an error names the column."""
    matrix = np.empty((len(own), len(columns)))
    for c, column in enumerate(columns):
        label = column if column.startswith(name) else f"{name} {column!r}"
        matrix[:, c] = numbers_of(label, own[column], flags=flags)
    return matrix


def optional(requests: pd.DataFrame, name: str, whole: bool = False) -> npt.NDArray[Any]:
    """Return a column that may be left out, and is 0 then."""
    if name not in requests:
        return np.zeros(len(requests), np.int64 if whole else float)
    column = (whole_numbers_of if whole else numbers_of)(name, requests[name])
    wrong = column < 0 if whole else column > 0
    if wrong.any():
        i = int(wrong.argmax())
        why = "is negative; locations count from 0" if whole else "is positive; write a cost of expiry as a number <= 0"
        raise InstanceError(f"{name} in row {requests.index[i]} = {column[i]} {why}")
    return column
