"""Results of cells on the disk, one file each, whole or not there at all."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optkit.basics.keeper import Form, KeptFiles
from optkit.basics.plain_json import is_sealed
from optkit.studies.cells import SCHEMA, Cell


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

    What was damaged since, as its own digest tells, is worked out again; see :mod:`optkit.basics.keeper`.

    Parameters
    ----------
    folder : path
        Made if it is not there.

    Raises
    ------
    OptkitError
        If the folder cannot be made or written to.

    Examples
    --------
    >>> import tempfile
    >>> cell = Cell("policy", {"scenario": "I.1", "world": 0}, {"policy": "PP", "seed": 0})
    >>> with tempfile.TemporaryDirectory() as place:
    ...     CellStore(place).put(cell, {"score": 1.5}, seconds=0.2)
    ...     CellStore(place).get(cell)
    Stored(result={'score': 1.5}, seconds=0.2)
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self._kept = KeptFiles(folder, FORM)
        self.folder = self._kept.folder

    @property
    def damaged(self) -> int:
        """Files met that do not hold what they should."""
        return self._kept.damaged

    def path(self, cell: Cell) -> Path:
        """Where a cell's result is, or would be."""
        return self._kept.path(cell.key)

    def get(self, cell: Cell) -> Stored | None:
        """Return a cell's result, or None if it is not there or damaged.

        Raises
        ------
        DataError
            If another version's cell, or something else, is in its place.
        """
        found = self._kept.get(cell.key)
        return None if found is None else Stored(found["result"], float(found["seconds"]))

    def put(self, cell: Cell, result: dict[str, Any], seconds: float) -> None:
        """Keep a result.

        Raises
        ------
        OptkitError
            If the disk refuses; what was there before stays.
        """
        self._kept.put(cell.key, {**cell.describe(), "seconds": seconds, "result": result})

    def forget(self, cells: Iterable[Cell]) -> None:
        """Remove the results of these cells."""
        self._kept.forget(cell.key for cell in cells)


def _is_whole(found: dict[str, Any]) -> bool:
    if "schema" not in found:
        return is_sealed(found)
    # As 0.1.0 wrote them at first: the digest is of the result alone.
    result, seconds = found.get("result"), found.get("seconds")
    timed = isinstance(seconds, int | float) and math.isfinite(seconds)
    digest = hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
    return timed and isinstance(result, dict) and found.get("sha256") == digest


FORM = Form(
    "optkit cell", SCHEMA, "a cell of a study", "choose another folder with --out", any_release=True, is_whole=_is_whole
)
