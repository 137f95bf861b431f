"""Finding trip files and reading the few columns that matter, piece by piece."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TypeAlias

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from optkit.basics.errors import DataError

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
            records = sorted(p for p in path.iterdir() if p.name.lower().endswith(SUFFIXES) and p.is_file())
            inside = [p for p in records if "tripdata" in p.name.lower()] or records
            if not inside:
                raise DataError(f"the folder {path} holds no trip records: no file ends in {', '.join(SUFFIXES)}")
        for file in inside:
            if not file.exists():
                raise DataError(f"there is no file {file}: check the path of the trip records")
            if not file.name.lower().endswith(SUFFIXES):
                raise DataError(f"{file} is no trip file: its name must end in {', '.join(SUFFIXES)}")
            found.setdefault(file.resolve(), file)
    if not found:
        raise DataError("no trip file is named: pass a TLC file, several, or a folder of them")
    return list(found.values())


def read_pieces(path: Path) -> Iterator[pd.DataFrame]:
    """Yield the columns of :data:`COLUMNS` of a file, or raise a DataError that says why it cannot be read."""
    try:
        if path.suffix.lower() == ".parquet":
            with pq.ParquetFile(path) as file:
                names = _columns(path, file.schema_arrow.names)
                for batch in file.iter_batches(CHUNK, columns=list(names)):
                    yield batch.to_pandas().rename(columns=names)
            return
        names = _columns(path, pd.read_csv(path, nrows=0, index_col=False).columns)
        with pd.read_csv(path, usecols=list(names), dtype=str, chunksize=CHUNK, index_col=False) as chunks:
            for chunk in chunks:
                yield chunk.rename(columns=names)
    except (OSError, ValueError, EOFError, zlib.error, pa.ArrowException) as error:
        why = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"cannot read {path}: {why}; check that it is complete, or fetch it again") from error


def _columns(path: Path, present: Sequence[str] | pd.Index[str]) -> dict[str, str]:
    plain = {str(name).strip().lower(): str(name) for name in present}
    found = {name: next((plain[w] for w in wanted if w in plain), None) for name, wanted in COLUMNS.items()}
    official = {"from": "PULocationID", "to": "DOLocationID"}
    missing = [official.get(name, COLUMNS[name][0]) for name, column in found.items() if column is None]
    if missing:
        raise DataError(
            f"{path} has no column {', '.join(missing)}; it has {_short(present)}; TLC's have them since July 2016"
        )
    return {str(column): name for name, column in found.items()}


def _short(present: Sequence[str] | pd.Index[str]) -> str:
    text = " ".join(", ".join(map(str, present)).split())
    return text if len(text) <= 400 else f"{text[:400]} ..."
