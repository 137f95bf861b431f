"""Finding trip files and reading the few columns that matter, piece by piece."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from optkit.basics.errors import DataError
from optkit.basics.paths import resolved
from optkit.basics.printable import listed
from optkit.basics.tables.cells import Cells, Column, Converter
from optkit.basics.tables.read import open_table
from optkit.basics.tables.text import reading

Paths: TypeAlias = str | PathLike[str] | Sequence[str | PathLike[str]]

SUFFIXES = (".parquet", ".csv", ".csv.gz")
CHUNK = 1_000_000
"""Rows per piece."""
COLUMNS = {
    "start": ("tpep_pickup_datetime", "lpep_pickup_datetime"),
    "end": ("tpep_dropoff_datetime", "lpep_dropoff_datetime"),
    "from": ("pulocationid",),
    "to": ("dolocationid",),
}
"""TLC's names, in lower case, of the columns read, by what they become."""


def find_files(paths: Paths) -> list[Path]:
    """Return the trip files that paths name, folders opened, each once, or raise a DataError saying what is amiss."""
    found: dict[Path, Path] = {}
    for given in [paths] if isinstance(paths, str | PathLike) else paths:
        path = Path(given)
        inside = [path]
        if path.is_dir():
            # What begins with a dot is no record: macOS leaves ._NAME beside NAME.
            named = (p for p in path.iterdir() if p.name.lower().endswith(SUFFIXES) and not p.name.startswith("."))
            records = sorted(p for p in named if p.is_file())
            inside = [p for p in records if "tripdata" in p.name.lower()] or records
            if not inside:
                raise DataError(f"the folder {path} holds no trip records: no file ends in {', '.join(SUFFIXES)}")
        for file in inside:
            if not file.exists():
                raise DataError(f"there is no file {file}: check the path of the trip records")
            if not file.name.lower().endswith(SUFFIXES):
                raise DataError(f"{file} is no trip file: its name must end in {', '.join(SUFFIXES)}")
            found.setdefault(resolved(file), file)
    if not found:
        raise DataError("no trip file is named: pass a TLC file, several, or a folder of them")
    return list(found.values())


def read_pieces(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the columns of :data:`COLUMNS` of a file: moments as pandas has them, zones as numbers.

    Raises
    ------
    DataError
        If the file cannot be read, lacks a column, or a row has more or fewer entries than the header.
    """
    with open_table(path, remedy="check that it is complete, or fetch it again", trailing=True) as table:
        names = _columns(path, table.names)
        how: dict[str, Converter] = {name: zones if what in ("from", "to") else moments for name, what in names.items()}
        for piece in table.pieces(how, CHUNK):
            yield {names[name]: column for name, column in piece.items()}


def moments(cells: Cells) -> Any:
    """Return times as a Series: of dates if the file holds dates, else of text, and nothing where a cell is blank."""
    import pandas as pd

    if isinstance(cells.given, list):
        return pd.Series([one if isinstance(one, str) and one.strip() else None for one in cells.given], dtype=object)
    import pyarrow as pa

    if not (pa.types.is_timestamp(cells.given.type) or pa.types.is_date(cells.given.type)):
        return pd.Series([one if isinstance(one, str | None) else "" for one in cells.values], dtype=object)
    with reading(cells.path, "write the table anew", text=False):
        return cells.given.to_pandas(date_as_object=False)


def zones(cells: Cells) -> Column:
    """Return zones as floats: NaN where a cell is empty, 0 where it holds no number that a zone can have."""
    if isinstance(cells.values, np.ndarray) and cells.values.dtype.kind in "iuf":
        return cells.values.astype(np.float64)
    import pandas as pd

    codes, texts = pd.factorize(pd.Series(list(cells.values), dtype=object))
    return np.array([*map(_zone, texts), np.nan])[codes]


def _zone(text: Any) -> float:
    if isinstance(text, str) and not text.strip():
        return np.nan
    number = re.fullmatch(r"\s*([1-9][0-9]{0,2})(\.0*)?\s*", str(text))
    return float(number[1]) if number else 0.0


def _columns(path: Path, present: Sequence[str]) -> dict[str, str]:
    plain = {name.lower(): name for name in present}
    found = {name: next((plain[w] for w in wanted if w in plain), None) for name, wanted in COLUMNS.items()}
    official = {"from": "PULocationID", "to": "DOLocationID"}
    missing = [official.get(name, COLUMNS[name][0]) for name, column in found.items() if column is None]
    if missing:
        have = listed(present)
        raise DataError(f"{path} has no column {', '.join(missing)}; it has {have}; TLC's have them since July 2016")
    times = Counter(map(str.lower, present))
    double = next((column for column in found.values() if times[str(column).lower()] > 1), None)
    if double is not None:
        raise DataError(f"{path} has the column {double!r} twice, but for case; leave one")
    return {str(column): name for name, column in found.items()}
