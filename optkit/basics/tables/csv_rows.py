"""Rows of a CSV file: none is shifted, cut off or filled up."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

from optkit.basics.errors import DataError
from optkit.basics.tables.table import Table
from optkit.basics.tables.text import lines, open_text, reading


class CsvTable(Table):
    """A CSV file; see :func:`optkit.basics.tables.read.open_table`.

    Parameters
    ----------
    path : Path
        ``.csv``, or gzipped with a name that ends in ``.gz``.
    remedy : str
        What to give instead of a file that cannot be read.
    trailing : bool
        Take rows that end in more commas than the header, as some months of trip records do.
    """

    def __init__(self, path: Path, remedy: str, trailing: bool = False) -> None:
        self.path, self._remedy, self._trailing = path, remedy, trailing
        with reading(path, remedy):
            self._file = open_text(path)
        try:
            with reading(path, remedy):
                self._reader = csv.reader(lines(path, self._file), strict=True)
                header = next((row for row in self._rows(0) if row), None)
            if header is None:
                raise DataError(f"cannot read {path} (it is empty); {remedy}")
            super().__init__(path, header)
            self._width = len(header)
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _pieces(self, places: Sequence[int], size: int) -> Iterator[Sequence[Any]]:
        take = itemgetter(*places) if len(places) > 1 else lambda row: [row[place] for place in places]
        records = self._records()
        begun = False
        while True:
            with reading(self.path, self._remedy):
                rows = [take(row) for row in islice(records, size)]
            if begun and not rows:
                return
            yield [list(column) for column in zip(*rows, strict=True)] if rows else [[] for _ in places]
            begun = True

    def _records(self) -> Iterator[list[str]]:
        """Yield rows that are as wide as the header; blank lines are none."""
        number, width = 0, self._width
        for row in self._rows(1):
            if len(row) != width:
                if not row or (len(row) == 1 and not row[0].strip()):
                    continue
                if not (self._trailing and len(row) > width and not any(row[width:])):
                    much = "is a name missing in the header?" if len(row) > width else "is the file complete?"
                    raise DataError(f"{self.path}: row {number + 1} has {len(row)} entries for {width} columns: {much}")
            number += 1
            yield row

    def _rows(self, number: int) -> Iterator[list[str]]:
        """Yield what the CSV reader finds; an error says after how many rows it came."""
        try:
            for row in self._reader:
                number += bool(row)
                yield row
        except csv.Error as error:
            why = "a quotation mark is not closed" if "end of data" in str(error) else str(error)
            where = f"row {number}" if number else "the first row"
            raise DataError(f"cannot read {self.path} ({where}: {why}); {self._remedy}") from None
