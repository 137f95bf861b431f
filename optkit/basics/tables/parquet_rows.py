"""Columns of a parquet file, those that pandas calls an index among them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from optkit.basics.tables.table import Table
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
                self._header, raw = list(schema.names), schema.metadata or {}
            super().__init__(path, self._header, {_text(key): _text(value) for key, value in raw.items()})
        except BaseException:
            self._file.close()
            raise
        known = _index(self.marks.get("pandas", ""))
        self.index = frozenset(" ".join(str(name).split()) for name in known)
        self.names = [name for name in self.names if not re.fullmatch(r"__index_level_\d+__", name)]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _pieces(self, places: Sequence[int], size: int) -> Iterator[Sequence[Any]]:
        names = [self._header[place] for place in places]
        with reading(self.path, self._remedy, text=False):
            batches = self._parquet.iter_batches(size, columns=names)
        begun = False
        while True:
            with reading(self.path, self._remedy, text=False):
                batch = next(batches, None)
                if batch is None and not begun:
                    batch = self._parquet.schema_arrow.empty_table()
            if batch is None:
                return
            yield [batch.column(name) for name in names]
            begun = True


def _index(told: str) -> list[str]:
    """Return the names of a DataFrame's index, by what pandas wrote beside its columns."""
    try:
        return [name for name in json.loads(told)["index_columns"] if isinstance(name, str)]
    except (ValueError, KeyError, TypeError, RecursionError):
        return []


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")
