"""Results of cells on the disk, one file each, whole or not there at all."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optkit.basics.errors import OptkitError
from optkit.basics.version import __version__
from optkit.studies.cells import SCHEMA, Cell

FORMAT = "optkit cell"


@dataclass(frozen=True)
class Stored:
    """A finished cell.

    Attributes
    ----------
    result : dict
        Plain data, a function of the cell alone.
    seconds : float
        What it took, which is not.
    """

    result: dict[str, Any]
    seconds: float


class CellStore:
    """A folder of finished cells.

    A result is written beside its place, flushed to the disk, and renamed; so a file that is there is whole. What was
    damaged since, as its own digest tells, is worked out again.

    Parameters
    ----------
    folder : path
        Made if it is not there.

    Attributes
    ----------
    damaged : int
        Files met that do not hold what they should.

    Raises
    ------
    OptkitError
        If the folder cannot be made or written to.

    Examples
    --------
    >>> cell = Cell("policy", {"scenario": "I.1", "world": 0}, {"policy": "PP", "seed": 0})
    >>> with tempfile.TemporaryDirectory() as place:
    ...     CellStore(place).put(cell, {"score": 1.5}, seconds=0.2)
    ...     CellStore(place).get(cell)
    Stored(result={'score': 1.5}, seconds=0.2)
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.damaged = 0
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                pass
        except OSError as error:
            raise self._refused(error) from error
        self._clear()

    def path(self, cell: Cell) -> Path:
        """Where a cell's result is, or would be."""
        return self.folder / f"{cell.key}.json"

    def get(self, cell: Cell) -> Stored | None:
        """Return a cell's result, or None if it is not there or damaged."""
        try:
            data = self.path(cell).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise OptkitError(f"{self.path(cell)} cannot be read ({error.strerror or error})") from error
        try:
            told = json.loads(data)
            if told["format"] == FORMAT and told["sha256"] == _digest(told["result"]) and told["key"] == cell.key:
                return Stored(told["result"], float(told["seconds"]))
        except (KeyError, TypeError, ValueError):
            pass
        self.damaged += 1
        return None

    def put(self, cell: Cell, result: dict[str, Any], seconds: float) -> None:
        """Keep a result.

        Raises
        ------
        OptkitError
            If the disk refuses; what was there before stays.
        """
        about = {"format": FORMAT, "schema": SCHEMA, "optkit": __version__, "key": cell.key, **cell.describe()}
        text = json.dumps({**about, "seconds": seconds, "sha256": _digest(result), "result": result})
        staging = self.path(cell).with_name(f".{cell.key}.{os.getpid()}.tmp")
        try:
            with open(staging, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(staging, self.path(cell))
        except OSError as error:
            with suppress(OSError):
                staging.unlink(missing_ok=True)
            raise self._refused(error) from error

    def forget(self, cells: Iterable[Cell]) -> None:
        """Remove the results of these cells."""
        for cell in cells:
            self.path(cell).unlink(missing_ok=True)

    def _refused(self, error: OSError) -> OptkitError:
        return OptkitError(
            f"{self.folder} cannot be written ({error.strerror or error}): what is finished stays, and the same "
            "command goes on from there; choose another folder with --out if need be"
        )

    def _clear(self) -> None:
        """Remove what a killed process left half written; another that is alive keeps its own."""
        for left in self.folder.glob(".*.tmp"):
            number = left.name.split(".")[-2]
            if number.isdigit() and not _alive(int(number)):
                left.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _digest(result: Any) -> str:
    return hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
