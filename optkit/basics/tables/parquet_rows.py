"""Columns of a parquet file, those that pandas calls an index among them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from optkit.basics.tables.table import Table, tidy
from optkit.basics.tables.text import open_bytes, reading


class ParquetTable(Table):
    """A parquet file; see :func:`optkit.basics.tables.read.open_table`.

    Parameters
    ----------
    path : Path
        The file.
    remedy : str
        What to give instead of a file that cannot be read.
    """

    def __init__(self, path: Path, remedy: str) -> None:
        import pyarrow.parquet as pq

        self.path, self._remedy = path, remedy
        with reading(path, remedy, text=False):
            self._file = open_bytes(path)
        try:
            with reading(path, remedy, text=False):
                self._parquet = pq.ParquetFile(self._file)
                schema = self._parquet.schema_arrow
                self._header, raw, rows = list(schema.names), schema.metadata or {}, self._parquet.metadata.num_rows
            marks = {_text(key): _text(value) for key, value in raw.items()}
            index, self._ranges = _index(marks.get("pandas", ""), self._header, rows)
            super().__init__(path, [*self._header, *self._ranges], marks)
        except BaseException:
            self._file.close()
            raise
        self.index = frozenset(tidy(name) for name in (*index, *self._ranges))
        self.names = [name for name in self.names if not re.fullmatch(r"__index_level_\d+__", name)]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _pieces(self, places: Sequence[int], size: int) -> Iterator[Sequence[Any]]:
        all_names = [*self._header, *self._ranges]
        names = [all_names[place] for place in places]
        with reading(self.path, self._remedy, text=False):
            batches = self._parquet.iter_batches(size, columns=[name for name in names if name not in self._ranges])
        begun = False
        while True:
            with reading(self.path, self._remedy, text=False):
                batch = next(batches, None)
                if batch is None and not begun:
                    batch = self._parquet.schema_arrow.empty_table()
            if batch is None:
                return
            rows = range(self.rows, self.rows + batch.num_rows)
            yield [
                [self._ranges[name][row] for row in rows] if name in self._ranges else batch.column(name)
                for name in names
            ]
            begun = True


def _index(told: str, header: list[str], rows: int) -> tuple[list[str], dict[str, range]]:
    """Return which columns are a DataFrame's index, and the index that is told by its ends instead of in a column."""
    names: list[str] = []
    ranges: dict[str, range] = {}
    try:
        for one in json.loads(told)["index_columns"]:
            if isinstance(one, str):
                names.append(one)
            elif isinstance(one["name"], str) and one["name"] not in header:
                steps = range(one["start"], one["stop"], one["step"])
                if len(steps) == rows:
                    ranges[one["name"]] = steps
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        pass  # somebody else's mark
    return names, ranges


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")
