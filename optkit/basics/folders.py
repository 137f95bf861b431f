"""Folders that appear whole or not at all, and of which nothing is replaced but what optkit wrote."""

from __future__ import annotations

import errno
import glob
import hashlib
import itertools
import os
import random
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optkit.basics.errors import InputError
from optkit.basics.files import cannot_write, locked_folder, sync_folder
from optkit.basics.paths import resolved
from optkit.basics.plain_json import is_sealed, parse_object, sealed, to_json

PATIENCE = 5.0
"""Seconds to wait, where there are no locks, for another process that puts a folder in the same place."""


def publish(target: Path, contents: Mapping[str, bytes], replaceable: Callable[[], bool]) -> None:
    """Write files into a folder beside ``target``, flush them, and rename it into place.

    An exception leaves what was there. Replacing takes two renames; if the machine stops between them, both folders are
    whole in a hidden one beside ``target``, and :func:`set_aside` finds the old one. Of several processes that publish
    in the same place one comes after the other, and what the last one wrote stays.

    Parameters
    ----------
    target : Path
        Resolved; its parents are created.
    contents : mapping
        Bytes of each file, by name.
    replaceable : callable
        Asked when all is written: whether ``target`` is there and to be replaced; what it raises ends the matter.

    Raises
    ------
    OSError
        If the disk refuses.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".tmp", dir=target.parent))
    new, old, done = staging / "new", staging / "old", False
    try:
        new.mkdir()
        for name, data in contents.items():
            with open(new / name, "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        sync_folder(new)
        with locked_folder(target.parent):
            _put(new, target, old, replaceable)
            done = True
        sync_folder(target.parent)
    except BaseException:
        if old.exists() and not target.exists():
            with suppress(OSError):  # another process was faster: what it put there stays
                os.replace(old, target)
        raise
    finally:
        if done or target.exists() or not old.exists():  # never delete the only copy
            shutil.rmtree(staging, ignore_errors=True)


def _put(new: Path, target: Path, old: Path, replaceable: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    for number in itertools.count():
        try:
            if replaceable():
                os.replace(target, old if not old.exists() else old.with_name(f"old-{number}"))
            os.replace(new, target)
        except OSError as error:
            # Without a lock another process may have put a folder here since, or taken it away.
            passing = error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOENT)
            if not passing or not new.exists() or time.monotonic() > end:
                raise
            time.sleep(random.uniform(0.0, 0.02))  # not in step with the other
        else:
            return


def set_aside(folder: Path) -> Path | None:
    """Return where an interrupted save left what ``folder`` should hold."""
    folder = resolved(folder)
    if folder.exists() or not folder.parent.is_dir():
        return None
    with locked_folder(folder.parent):  # who is just replacing it is not interrupted
        if folder.exists():
            return None
        found = folder.parent.glob(f".{glob.escape(folder.name)}.*.tmp/old")
        return next((old for old in found if old.parent.name.count(".") == folder.name.count(".") + 3), None)


def _left_aside(folder: Path) -> Path | None:
    """Return what :func:`set_aside` does, once it is clear that no other process is about to put something there."""
    end = time.monotonic() + PATIENCE / 5
    while (found := set_aside(folder)) is not None and time.monotonic() < end:
        time.sleep(0.05)
    return found


def foreign_entry(folder: Path, own: Iterable[str]) -> str | None:
    """Return the first name in a folder that is not among its own, or None: what is not ours is not replaced."""
    return min({entry.name for entry in folder.iterdir()} - set(own), default=None)


def writable_parent(target: Path) -> bool:
    """Whether the nearest folder above ``target`` that exists may be written to."""
    parent = next((above for above in resolved(target).parents if above.exists()), None)
    return parent is not None and parent.is_dir() and os.access(parent, os.W_OK)


@dataclass(frozen=True)
class ResultsFolder:
    """A kind of folder that a run writes whole, and that a later one may replace if it is as it was written.

    Attributes
    ----------
    record : str
        The JSON file that says what the folder is; it holds the digest of every other file, and its own.
    format : str
        Entry ``format`` of that file.
    what : str
        Such a folder in words, for example "the report of a study".
    loose : tuple of str
        Files that may change.
    early : tuple of str
        Files of folders from before digests were kept.
    """

    record: str
    format: str
    what: str
    loose: tuple[str, ...] = ()
    early: tuple[str, ...] = ()

    def files(self, contents: Mapping[str, bytes], told: Mapping[str, Any]) -> dict[str, bytes]:
        """Return the files of a folder with its record added, which tells ``told``."""
        sums = {name: _sha256(data) for name, data in sorted(contents.items()) if name not in self.loose}
        record = sealed({"format": self.format, **told, "sha256": sums}, "seal")
        return {**contents, self.record: (to_json(record) + "\n").encode()}

    def check(
        self, folder: str | os.PathLike[str], differs: Callable[[dict[str, Any]], str | None] | None = None
    ) -> bool:
        """Return whether a folder is there that may be replaced; call it before the work, not after.

        Parameters
        ----------
        folder : path
            Where results are to be.
        differs : callable, optional
            From the record to what else the folder holds than what is to be replaced, or None.

        Raises
        ------
        InputError
            If it holds anything but what was written there, or cannot be made.
        """
        with locked_folder(resolved(folder).parent):  # who is just replacing it is waited for
            end = time.monotonic() + PATIENCE
            while True:
                seen = _identity(folder)
                try:
                    return self._check(Path(folder), differs)
                except (FileNotFoundError, InputError):
                    # Where there are no locks another folder may have come between two looks.
                    if _identity(folder) == seen or time.monotonic() > end:
                        raise

    def _check(self, target: Path, differs: Callable[[dict[str, Any]], str | None] | None) -> bool:
        remedy = "choose another folder with --out"
        aside = _left_aside(target)
        if aside is not None:
            raise InputError(f"{target} is missing: writing was interrupted; what it held is {aside}: move it back")
        if not target.is_dir() and os.path.lexists(target) and not target.is_dir():
            raise InputError(f"{target} is a file, not a folder: {remedy}")
        if not target.is_dir():
            if not writable_parent(target):
                raise InputError(f"{target} cannot be written: {remedy}")
            return False
        told = self.read(target)
        foreign = foreign_entry(target, () if told is None else self._own(told))
        if foreign is not None:
            raise InputError(f"{target} holds {foreign!r}, which is no part of {self.what}: move it, or {remedy}")
        if told is None:  # empty
            return True
        other = None if differs is None else differs(told)
        if other is not None:
            raise InputError(f"{target} holds {other}: {remedy}")
        changed = self._changed(target, told)
        if changed is not None:
            raise InputError(f"{target / changed} was changed since optkit wrote it: move it away, or {remedy}")
        return True

    def read(self, folder: Path) -> dict[str, Any] | None:
        """Return the record of a folder, or None if it is no such folder."""
        try:
            told = parse_object((folder / self.record).read_bytes())
        except OSError:
            return None
        return told if told is not None and told.get("format") == self.format else None

    def _own(self, told: dict[str, Any]) -> set[str]:
        sums = told.get("sha256")
        return {self.record, *self.loose, *(sums if isinstance(sums, dict) else self.early)}

    def _changed(self, folder: Path, told: dict[str, Any]) -> str | None:
        if "seal" in told and not is_sealed(told, "seal"):
            return self.record
        sums = told.get("sha256")
        for name, stated in (sums if isinstance(sums, dict) else {}).items():
            try:
                if _sha256((folder / name).read_bytes()) != stated:
                    return str(name)
            except FileNotFoundError:
                continue  # who took it away will not miss it
            except OSError as error:
                raise cannot_write(folder / name, error) from error
        return None


def _identity(folder: str | os.PathLike[str]) -> int | None:
    try:
        return os.stat(folder).st_ino
    except OSError:
        return None


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
