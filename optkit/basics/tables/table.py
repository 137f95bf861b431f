"""A table in a file, whatever its format: names of columns, and columns as what they are asked to be."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from optkit.basics.errors import DataError
from optkit.basics.printable import listed
from optkit.basics.tables.cells import KINDS, Cells, Column, Converter

PIECE = 50_000
"""Rows that are read at once."""


def tidy(name: object) -> str:
    """Return the name of a column without blanks at its ends and line breaks."""
    return " ".join(str(name).split())


class Table(ABC):
    """An open file; :func:`optkit.basics.tables.read.open_table` makes one, and it is to be closed, or used in a with.

    Attributes
    ----------
    path : Path
        The file.
    names : list of str
        Columns in their order, blanks at the ends and line breaks taken out. A column without a name is called ``""``;
        of several only the first is here.
    index : frozenset of str
        Those of the columns that are the index of the DataFrame that a parquet file was written from.
    marks : mapping of str to str
        What a parquet file says about itself beside its columns.
    rows : int
        Number of rows read so far.
    """

    def __init__(self, path: Path, header: Sequence[object], marks: Mapping[str, str] | None = None) -> None:
        names = [tidy(name) for name in header]
        double = [name for name, times in Counter(names).items() if times > 1 and name]
        if double:
            raise DataError(f"{path} has the column {double[0]!r} twice; leave one")
        self._place = {name: place for place, name in reversed(list(enumerate(names)))}
        self.path, self.names, self.marks, self.rows = path, list(dict.fromkeys(names)), marks or {}, 0
        self.index: frozenset[str] = frozenset()
        self._unparted = len(header) == 1 and any(mark in str(header[0]) for mark in ";\t|")

    def pieces(self, wanted: Mapping[str, Converter], size: int = PIECE) -> Iterator[dict[str, Any]]:
        """Yield the wanted columns, some rows at a time, at least once; read from top to bottom, one time only.

        Raises
        ------
        DataError
            If the file cannot be read on, or a cell is not what its column is wanted to be.
        """
        places = [self._place[name] for name in wanted]
        for columns in self._pieces(places, size):
            cells = (Cells(self.path, name, self.rows + 1, given) for name, given in zip(wanted, columns, strict=True))
            piece = {cell.name: convert(cell) for cell, convert in zip(cells, wanted.values(), strict=True)}
            self.rows += len(columns[0]) if columns else 0
            yield piece

    def columns(self, wanted: Mapping[str, Converter | str]) -> dict[str, Column]:
        """Return the wanted columns whole, each as a converter or what :data:`KINDS` calls so; errors as in pieces."""
        how = {name: KINDS[kind] if isinstance(kind, str) else kind for name, kind in wanted.items()}
        pieces = list(self.pieces(how))
        return {name: np.concatenate([piece[name] for piece in pieces]) for name in wanted}

    def need(self, *wanted: str, among: Iterable[str] | None = None) -> None:
        """Raise a DataError that names columns that are missing; ``value|reward`` is one that may be called either.

        ``among`` are the names that are there, if they are not as the file writes them.
        """
        there = set(self.names if among is None else among)
        missing = [one for one in wanted if there.isdisjoint(one.split("|"))]
        if missing:
            hint = ": write commas between the columns" if self._unparted else ""
            what = " and no ".join(" or ".join(map(repr, one.split("|"))) for one in missing)
            raise DataError(f"{self.path} has no column {what}; it has {listed(self.names)}{hint}")

    @abstractmethod
    def _pieces(self, places: Sequence[int], size: int) -> Iterator[Sequence[Any]]:
        """Yield the columns at these places of the header, some rows at a time, at least once."""

    def close(self) -> None:  # noqa: B027  # what is in memory needs none
        """Close the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
