"""Rows of a long computation, kept as they come, so that what was interrupted goes on where it was."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from optkit.basics.errors import DataError, InputError, OptkitError

FORMAT = "optkit rows"


class RowLog:
    """A file of one line of JSON per row, each flushed to the disk before the next is worked out.

    A line that was cut off when the machine stopped is dropped, and its row worked out again.

    Parameters
    ----------
    path : path or None
        None keeps the rows in memory only.
    key : str
        What the computation consists of; rows of another are not mixed with these.

    Attributes
    ----------
    rows : dict of int to dict
        Rows by number.

    Raises
    ------
    InputError
        If the file holds rows of another computation.
    DataError
        If it is no such file, or damaged elsewhere than at its end.
    OptkitError
        If the disk refuses.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     RowLog(f"{place}/rows.jsonl", "a").add(3, {"bound": 1.5})
    ...     RowLog(f"{place}/rows.jsonl", "a").rows
    {3: {'bound': 1.5}}
    """

    def __init__(self, path: str | os.PathLike[str] | None, key: str) -> None:
        self.path = None if path is None else Path(path)
        self.rows: dict[int, dict[str, Any]] = {}
        if self.path is None:
            return
        head = {"format": FORMAT, "key": key}
        try:
            if self.path.exists() and self.path.read_bytes().count(b"\n"):
                self._read(self.path, head)
            else:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self.path.write_text(json.dumps(head) + "\n", encoding="utf-8")
        except OSError as error:
            raise OptkitError(f"{self.path} cannot be written ({error.strerror or error})") from error

    def _read(self, path: Path, head: dict[str, str]) -> None:
        whole, _, rest = path.read_bytes().rpartition(b"\n")
        try:
            first, *lines = [json.loads(line) for line in whole.split(b"\n")]
            if not isinstance(first, dict) or first.get("format") != FORMAT:
                raise DataError(f"{path} holds no rows of optkit: choose another file")
            self.rows = {int(line["number"]): dict(line["row"]) for line in lines}
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"{path} is damaged ({error}): remove it to begin again") from None
        if first != head:
            raise InputError(f"{path} holds rows of other instances, policies or settings: choose another folder")
        if rest:
            os.truncate(path, len(whole) + 1)

    def add(self, number: int, row: dict[str, Any]) -> None:
        """Keep a row of plain data.

        Raises
        ------
        OptkitError
            If the disk refuses.
        """
        self.rows[number] = row
        if self.path is None:
            return
        try:
            with open(self.path, "ab") as file:
                file.write(json.dumps({"number": number, "row": row}).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OptkitError(f"{self.path} cannot be written ({error.strerror or error})") from error

    def missing(self, numbers: Iterable[int]) -> list[int]:
        """Which of these have no row yet."""
        return [number for number in numbers if number not in self.rows]
