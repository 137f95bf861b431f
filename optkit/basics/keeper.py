"""Finished work, kept as it comes, so that what was interrupted goes on where it was.

An entry is a JSON object that says what it is, which version wrote it and what work it belongs to, and that holds a
digest of all of this. What is damaged is worked out again or told; what another version wrote, and what is not ours, is
refused by name and stays.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.basics.files import append_line, cannot_write, clear_staging, locked, locked_folder, write_whole
from optkit.basics.plain_json import is_sealed, parse_object, sealed, to_json
from optkit.basics.version import __version__


def work_key(*parts: Any) -> str:
    """Digest of all that a piece of work depends on, every float to its last bit.

    Besides plain data, bytes and arrays it takes objects that tell their parameters; of others it takes what ``repr``
    tells, which with an address in it is another in each process.

    Examples
    --------
    >>> import math
    >>> work_key("bounds", {"limit": 0.1}) == work_key("bounds", {"limit": math.nextafter(0.1, 1)})
    False
    """
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=_told).encode()).hexdigest()


def _told(value: Any) -> Any:
    if isinstance(value, bytes):
        return ["bytes", value.hex()]
    if isinstance(value, np.generic | np.ndarray):
        plain = value.tolist() if value.dtype == object else hashlib.sha256(value.tobytes()).hexdigest()
        return [str(value.dtype), value.shape, plain]
    name = f"{type(value).__module__}.{type(value).__qualname__}"
    if is_dataclass(value) and not isinstance(value, type):
        return [name, {one.name: getattr(value, one.name) for one in fields(value)}]
    if callable(getattr(value, "get_params", None)):
        return [name, value.get_params()]
    return [name, repr(value)]


@dataclass(frozen=True)
class Form:
    """A kind of entry.

    Attributes
    ----------
    format : str
        Entry ``format`` of its objects.
    version : int
        Raised when the objects come to mean something else.
    what : str
        Such objects in words, for example "a cell of a study".
    remedy : str
        What else to choose where something is in the way.
    any_release : bool
        Whether the numbers are the same whichever release of optkit made them.
    is_whole : callable
        Whether an object is as it was written; by its entry ``sha256`` of all the others.
    """

    format: str
    version: int
    what: str
    remedy: str = "choose another --checkpoint"
    any_release: bool = False
    is_whole: Callable[[dict[str, Any]], bool] = is_sealed

    def entry(self, key: str, told: dict[str, Any]) -> dict[str, Any]:
        """Return the object to write for a piece of work, with what is ``told`` of it."""
        return sealed({"format": self.format, "version": self.version, "optkit": __version__, "key": key, **told})

    def read(self, raw: bytes, place: str | os.PathLike[str]) -> dict[str, Any] | None:
        """Return the object that bytes hold, or None if they are such an object cut off or damaged.

        Raises
        ------
        DataError
            If they are something else, or another version's.
        """
        found = parse_object(raw)
        if found is None and self._cut_off(raw):
            return None
        if found is None or found.get("format") != self.format:
            raise DataError(f"{place} is not {self.what}, so it stays: move it away, or {self.remedy}")
        version, release = found.get("version", found.get("schema")), found.get("optkit")
        other = None
        if type(version) is not int or version != self.version:
            other = f"is of version {version!s:.40}, this optkit's is {self.version}"
        elif not self.any_release and release != __version__:
            other = f"was written by optkit {release!s:.40}, and this is optkit {__version__}"
        if other is not None:
            raise DataError(f"{place} {other}: move it away, or {self.remedy}")
        return found if self.is_whole(found) else None

    def _cut_off(self, raw: bytes) -> bool:
        begun = "".join(json.dumps({"format": self.format})[:-1].split()).encode()
        have = b"".join(raw[:1000].split())
        return have.startswith(begun) or begun.startswith(have)


def read_regular(path: Path, remedy: str) -> bytes | None:
    """Return what a file holds, or None if there is none.

    Raises
    ------
    InputError
        If it is a folder, or no file that ends.
    OptkitError
        If the disk refuses.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(f"{path} is {'a folder' if path.is_dir() else 'no regular file'}: {remedy}")
        with open(path, "rb") as file, locked(file.fileno()):
            return file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise OptkitError(f"{path} cannot be read ({error.strerror or error}): {remedy}") from error


class KeptFiles:
    """A folder of one file per entry, each whole or not there at all.

    Parameters
    ----------
    folder : path
        Made if it is not there.
    form : Form
        Of the entries.

    Attributes
    ----------
    damaged : int
        Entries met that are not as they were written: they count as missing, and are replaced.

    Raises
    ------
    OptkitError
        If the folder cannot be made or written to.

    Examples
    --------
    >>> form = Form("a test", 1, "an entry of a test")
    >>> with tempfile.TemporaryDirectory() as place:
    ...     KeptFiles(place, form).put("a", {"score": 1.5})
    ...     KeptFiles(place, form).get("a")["score"]
    1.5
    """

    def __init__(self, folder: str | os.PathLike[str], form: Form) -> None:
        self.folder, self.form, self.damaged = Path(folder), form, 0
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                pass
            clear_staging(self.folder)
        except OSError as error:
            raise cannot_write(self.folder, error, self._how_to_go_on) from error

    @property
    def _how_to_go_on(self) -> str:
        return f"what is finished stays, and the same command goes on from there; {self.form.remedy} if need be"

    def path(self, key: str) -> Path:
        """Where an entry is, or would be."""
        return self.folder / f"{key}.json"

    def get(self, key: str) -> dict[str, Any] | None:
        """Return an entry, or None if it is not there or damaged.

        Raises
        ------
        DataError
            If another version's entry, or something else, is in its place.
        OptkitError
            If the disk refuses.
        """
        raw = read_regular(self.path(key), self.form.remedy)
        if raw is None:
            return None
        found = self.form.read(raw, self.path(key))
        if found is None or found.get("key") != key:
            self.damaged += 1
            return None
        return found

    def put(self, key: str, told: dict[str, Any]) -> None:
        """Keep an entry.

        Raises
        ------
        DataError
            If another version's entry, or something else, is in its place.
        OptkitError
            If the disk refuses; what was there before stays.
        """
        with locked_folder(self.folder):
            before = read_regular(self.path(key), self.form.remedy)
            if before is not None:
                self.form.read(before, self.path(key))
            write_whole(self.path(key), to_json(self.form.entry(key, told)) + "\n", self._how_to_go_on)

    def forget(self, keys: Iterable[str]) -> None:
        """Remove entries.

        Raises
        ------
        DataError
            If something else is in the place of one.
        """
        for key in keys:
            raw = read_regular(self.path(key), self.form.remedy)
            if raw is not None:
                self.form.read(raw, self.path(key))
                self.path(key).unlink(missing_ok=True)


class KeptRows:
    """A file of one line per entry, of which the first says what work the others belong to.

    Each line is flushed to the disk before the next is worked out. One that was cut off when the machine stopped is
    dropped, and worked out again.

    Parameters
    ----------
    path : path or None
        None keeps the rows in memory only.
    form : Form
        Of the first line.
    key : str
        What the work depends on, see :func:`work_key`; rows of other work are not mixed with these.

    Attributes
    ----------
    rows : dict of int to dict
        Rows by number.
    found : frozenset of int
        Numbers of the rows that were there already.

    Raises
    ------
    InputError
        If the file holds rows of other work.
    DataError
        If it is another version's, damaged elsewhere than at its end, or something else.
    OptkitError
        If the disk refuses.

    Examples
    --------
    >>> form = Form("a test", 1, "a file of a test")
    >>> with tempfile.TemporaryDirectory() as place:
    ...     KeptRows(f"{place}/rows.jsonl", form, "a").add(3, {"bound": 1.5})
    ...     KeptRows(f"{place}/rows.jsonl", form, "a").rows
    {3: {'bound': 1.5}}
    """

    def __init__(self, path: str | os.PathLike[str] | None, form: Form, key: str) -> None:
        self.path, self.form, self.key = None if path is None else Path(path), form, key
        self.rows: dict[int, dict[str, Any]] = {}
        if self.path is not None:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                with locked_folder(self.path.parent):
                    self._open(self.path, key)
            except OSError as error:
                raise cannot_write(self.path, error, form.remedy) from error
        self.found = frozenset(self.rows)

    def _open(self, path: Path, key: str) -> None:
        raw = read_regular(path, self.form.remedy) or b""
        first, line_break, rest = raw.partition(b"\n")
        head = self.form.read(first, path) if raw else None
        if not line_break:  # begun at most
            write_whole(path, json.dumps(self.form.entry(key, {})) + "\n", self.form.remedy)
            return
        if head is None:
            raise self._damaged(1)
        if head["key"] != key:
            raise InputError(f"{path} holds rows of other instances, policies or settings: {self.form.remedy}")
        *lines, cut = rest.split(b"\n")
        for number, line in enumerate(lines, start=2):
            row = parse_object(line)
            kinds = None if row is None or not is_sealed(row) else (type(row.get("number")), type(row.get("row")))
            if row is None or kinds != (int, dict):
                raise self._damaged(number)
            if row.get("of", key[:16]) != key[:16]:  # rows of earlier releases do not say it
                raise InputError(f"{path} has a row of other work in line {number}: {self.form.remedy}")
            self.rows[row["number"]] = row["row"]
        if cut:
            self._drop_cut_line(path)

    @staticmethod
    def _drop_cut_line(path: Path) -> None:
        """Take away what stands behind the last line break by now: another process may be writing lines."""
        with open(path, "rb+") as file, locked(file.fileno()):
            file.truncate(file.read().rfind(b"\n") + 1)

    def _damaged(self, line: int) -> DataError:
        what = "remove the file to begin again" if line == 1 else "remove this line, and its row is worked out again"
        return DataError(f"{self.path} is damaged in line {line}: {what}, or {self.form.remedy}")

    def add(self, number: int, row: dict[str, Any]) -> None:
        """Keep a row of plain data.

        Raises
        ------
        OptkitError
            If the disk refuses.
        """
        if self.path is None:
            self.rows[number] = row
            return
        entry = sealed({"of": self.key[:16], "number": number, "row": row})
        self.rows[number] = entry["row"]  # as it will be read again
        try:
            append_line(self.path, json.dumps(entry).encode())
        except OSError as error:
            raise cannot_write(self.path, error, "rows that were done are kept") from error

    def missing(self, numbers: Iterable[int]) -> list[int]:
        """Which of these have no row yet."""
        return [number for number in numbers if number not in self.rows]
