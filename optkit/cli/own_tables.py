"""Tables of a user's own in files: columns by their meaning, read without guessing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optkit.basics.errors import DataError, InputError
from optkit.basics.tables.cells import Cells, Column, Converter, labels, numbers
from optkit.basics.tables.read import open_table
from optkit.instances.columns import PREFIX, REQUESTS, WORKERS

if TYPE_CHECKING:
    import pandas as pd

    from optkit.learning.trained import Trained

TIMES = ("arrival", "expiry", "joined", "step")
"""Columns of steps, or of dates and times."""


def read_table(
    path: Path, table: str, renamed: Mapping[str, str], features: Sequence[str], day: str | None
) -> pd.DataFrame:
    """Read a table of requests or of workers; all columns are there, those of no meaning as None.

    Parameters
    ----------
    path : Path
    table : {"requests", "workers"}
    renamed : mapping of str to str
        What columns mean, by what the file calls them.
    features : sequence of str
        Columns of ``requests`` that are features, as the file calls them.
    day : str, optional
        Column of days, as the file calls it.

    Raises
    ------
    DataError
        If the file cannot be read, two columns mean the same, or a cell is not what its column holds.
    """
    import pandas as pd

    with open_table(path, remedy=f"give a CSV, JSON or parquet file of {table}") as opened:
        meaning = {name: renamed.get(name, name) for name in opened.names}
        for name, what in meaning.items():
            twice = [other for other, same in meaning.items() if same == what and other != name]
            if twice:
                raise DataError(f"{path}: {name!r} and {twice[0]!r} both mean {what}: leave one, or mend --map")
        how = {name: _converter(what, table, name in features, name == day) for name, what in meaning.items()}
        found = opened.columns({name: convert for name, convert in how.items() if convert is not None})
        rows = opened.rows
        if not found:  # nothing is known here: its rows are still to be counted
            list(opened.pieces({}))
            rows = opened.rows
    columns = {
        what: _values(path, name, what, found[name]) if name in found else [None] * rows
        for name, what in meaning.items()
    }
    found_table = pd.DataFrame(columns, index=range(1, rows + 1))  # as other messages about files count
    for name, zone in _zones(path).items():
        what = meaning[name]
        if what in TIMES and rows:
            moments = pd.to_datetime(found_table[what], utc=True, format="ISO8601")
            found_table[what] = moments.dt.tz_convert(zone)
    return found_table


def _zones(path: Path) -> dict[str, str]:
    """Return the time zones of a parquet file's columns, whose text has their offsets alone."""
    if path.suffix.lower() not in (".parquet", ".pq"):
        return {}
    import pyarrow as pa
    import pyarrow.parquet as pq

    return {one.name: one.type.tz for one in pq.read_schema(path) if pa.types.is_timestamp(one.type) and one.type.tz}


def _converter(what: str, table: str, feature: bool, day: bool) -> Converter | None:
    if feature:
        return _numbers_or_flags
    if day or what in (*TIMES, "request_id", "worker_id", "group"):
        return labels
    known = REQUESTS if table == "requests" else WORKERS
    return numbers if what in known or what == "utility" or what.startswith(PREFIX) else None


def _numbers_or_flags(cells: Cells) -> Column:
    words = {"true": 1.0, "false": 0.0}
    listed = list(cells.values)
    if listed and all(str(value).strip().lower() in words for value in listed):
        return np.array([words[str(value).strip().lower()] for value in listed])
    return numbers(cells)


def _values(path: Path, name: str, what: str, column: Column) -> Column:
    """Return steps and numbers of groups as numbers; an identifier stays text, however it looks."""
    if what not in (*TIMES, "group"):
        return column
    number = [_is_number(text) for text in column]
    if what in TIMES and any(number) and not all(number):
        i, j = number.index(False), number.index(True)
        raise DataError(
            f"{path}: {name} in row {i + 1} is {column[i]!r}, and {column[j]} in row {j + 1}: give steps or times"
        )
    return np.array([float(text) for text in column]) if all(number) else column


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def read_open_requests(path: Path, trained: Trained) -> tuple[pd.DataFrame, list[str]]:
    """Read a table of open requests, with the features that a policy was trained on; name columns of no meaning.

    Raises
    ------
    DataError
        If the file cannot be read, or a cell is not what its column holds.
    """
    believed = trained.preferences
    learned = believed.attributes.names if believed is not None else ()
    features = list(trained.source.get("feature_names") or learned)
    with open_table(path, remedy="give a CSV, JSON or parquet file of requests") as opened:
        names = opened.names
    features = features or [name for name in names if name.startswith("feature_")]
    renamed = {"request": "request_id"} if "request" in names and "request_id" not in names else {}
    table = read_table(path, "requests", renamed, features, None)
    for name in ("decision", "offered"):
        if name in table:
            raise DataError(f"{path} has a column {name!r}, which goes without --policy: leave out what does not count")
    known = (*REQUESTS, *features, "utility")
    ignored = [name for name in table.columns if name not in known and not name.startswith(PREFIX)]
    return table.drop(columns=ignored), ignored


def parsed_map(texts: Sequence[str]) -> dict[str, dict[str, str]]:
    """Read MEANING=COLUMN pairs, several with commas between; return for each table what its columns mean.

    Raises
    ------
    InputError
        If one is no pair, means nothing that is known, or a meaning or a column of a table is there twice.

    Examples
    --------
    >>> parsed_map(["arrival=time,reward=fare", "joined=time"])
    {'requests': {'time': 'arrival', 'fare': 'reward'}, 'workers': {'time': 'joined'}}
    """
    found: dict[str, dict[str, str]] = {"requests": {}, "workers": {}}
    for pair in [part for text in texts for part in text.split(",")]:
        what, equals, column = (part.strip() for part in pair.partition("="))
        if not equals or not what or not column:
            raise InputError(f"--map {pair} is not of the form MEANING=COLUMN, like reward=fare")
        table = "workers" if what in WORKERS else "requests"
        if table == "requests" and what not in (*REQUESTS, "utility") and not what.startswith(PREFIX):
            known = ", ".join((*REQUESTS, "utility", f"{PREFIX}GROUP", *WORKERS))
            raise InputError(f"--map {pair}: nothing is called {what!r}; there are {known}")
        own = found[table]
        if what in own.values():
            raise InputError(f"--map says twice what {what} is")
        if column in own:
            raise InputError(f"--map says two things of {column}: {own[column]} and {what}")
        own[column] = what
    return found


def by_group(option: str, text: str) -> float | dict[str, float]:
    """Read one number, or GROUP=NUMBER pairs with commas between.

    Raises
    ------
    InputError
        If it is neither.
    """
    pairs = [part.rpartition("=") for part in text.split(",")]
    try:
        found = float(text) if "=" not in text else {name.strip(): float(value) for name, _, value in pairs}
    except ValueError:
        raise InputError(f"--{option} {text} is neither a number nor of the form bike=1.2,car=0.8") from None
    if isinstance(found, dict) and len(found) < len(pairs):
        raise InputError(f"--{option} {text} gives a group twice")
    return found
