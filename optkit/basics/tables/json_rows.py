"""Rows of a JSON file: a list of objects that all have the same keys, each once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from optkit.basics.errors import DataError
from optkit.basics.printable import listed
from optkit.basics.strict_json import Twice, from_json
from optkit.basics.tables.cells import Literal
from optkit.basics.tables.table import Table
from optkit.basics.tables.text import lines, open_text, reading


class JsonTable(Table):
    """A JSON file; see :func:`optkit.basics.tables.read.open_table`.

    Parameters
    ----------
    path : Path
        A list of objects.
    remedy : str
        What to give instead of a file that cannot be read.
    under : str, optional
        Key of an object that may hold the list, and nothing else.
    """

    def __init__(self, path: Path, remedy: str, under: str | None = None) -> None:
        with reading(path, remedy), open_text(path) as file:
            content = from_json("".join(lines(path, file)), number=Literal)
        if isinstance(content, dict) and under is not None:
            if set(content) != {under} or isinstance(content, Twice):
                raise DataError(f"{path} is an object with {listed(content) or 'nothing'}; it takes {under} alone")
            content = content[under]
        if not isinstance(content, list) or not all(isinstance(row, dict) for row in content):
            raise DataError(f"cannot read {path} (no list of objects); {remedy}")
        header = list(content[0]) if content else []
        for number, row in enumerate(content, 1):
            if isinstance(row, Twice):
                raise DataError(f"{path}: row {number} gives {row.key!r} twice; leave one")
            if row.keys() != content[0].keys():
                odd = next(key for key in (*row, *header) if (key in row) != (key in content[0]))
                what = f"has {odd!r}, which the first has not" if odd in row else f"lacks {odd!r}, which the first has"
                raise DataError(f"{path}: row {number} {what}")
        self._content, self._keys = content, header
        super().__init__(path, header)

    def _pieces(self, places: Sequence[int], size: int) -> Iterator[Sequence[Any]]:
        yield [[row[self._keys[place]] for row in self._content] for place in places]
