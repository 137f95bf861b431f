"""Folders that appear whole or not at all."""

from __future__ import annotations

import glob
import os
import shutil
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def publish(target: Path, contents: dict[str, bytes], replacing: bool) -> None:
    """Write files into a folder beside ``target``, flush them, and rename it into place.

    An exception leaves what was there. Replacing takes two renames; if the machine stops between them, both folders are
    whole in a hidden one beside ``target``, and :func:`set_aside` finds the old one.

    Parameters
    ----------
    target : Path
        Resolved; its parents are created.
    contents : dict
        Bytes of each file, by name.
    replacing : bool
        Whether ``target`` exists and is to be replaced.

    Raises
    ------
    OSError
        If the disk refuses.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".tmp", dir=target.parent))
    new, old = staging / "new", staging / "old"
    try:
        new.mkdir()
        for name, data in contents.items():
            with open(new / name, "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        _sync(new)
        if replacing:
            os.replace(target, old)
        os.replace(new, target)
        _sync(target.parent)
    except BaseException:
        if old.exists() and not target.exists():
            os.replace(old, target)
        raise
    finally:
        if target.exists() or not old.exists():  # never delete the only copy
            shutil.rmtree(staging, ignore_errors=True)


def set_aside(folder: Path) -> Path | None:
    """Return where an interrupted save left what ``folder`` should hold."""
    folder = folder.resolve()
    if folder.exists():
        return None
    found = folder.parent.glob(f".{glob.escape(folder.name)}.*.tmp/old")
    return next((old for old in found if old.parent.name.count(".") == folder.name.count(".") + 3), None)


def _sync(folder: Path) -> None:
    with suppress(OSError):  # Windows does not open folders, and some network disks do not flush them
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def foreign_entry(folder: Path, own: Iterable[str]) -> str | None:
    """Return the first name in a folder that is not among its own, or None: what is not ours is not replaced."""
    return min({entry.name for entry in folder.iterdir()} - set(own), default=None)


def writable_parent(target: Path) -> bool:
    """Whether the nearest folder above ``target`` that exists may be written to."""
    parent = next((above for above in target.resolve().parents if above.exists()), None)
    return parent is not None and parent.is_dir() and os.access(parent, os.W_OK)
