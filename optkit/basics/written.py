"""Which files optkit wrote here: digests of those that have no place for a mark, such as tables in CSV."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

from optkit.basics.errors import OptkitError
from optkit.basics.files import append_line, write_whole

KEPT = 10_000
"""Digests that are kept; of the oldest nobody writes again."""


def remember(data: bytes) -> None:
    """Keep that these bytes are optkit's; where the record cannot be written, they will count as somebody else's.

    The record lies in the user's folder for state, ``$XDG_STATE_HOME/optkit`` or ``~/.local/state/optkit``.

    Examples
    --------
    >>> remember(b"1,2")
    >>> remembered(b"1,2"), remembered(b"1,2,3")
    (True, False)
    """
    with suppress(OSError, RuntimeError, OptkitError):  # a home that is not there
        record = _record()
        record.parent.mkdir(parents=True, exist_ok=True)
        known = record.read_bytes().split() if record.exists() else []
        if len(known) >= KEPT:
            write_whole(record, b"".join(one + b"\n" for one in known[KEPT // 2 :]))
        if _digest(data) not in known:
            append_line(record, _digest(data))


def remembered(data: bytes) -> bool:
    """Return whether optkit wrote these very bytes here."""
    try:
        return _digest(data) in _record().read_bytes().split()
    except (OSError, RuntimeError):
        return False


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode()


def _record() -> Path:
    place = os.environ.get("XDG_STATE_HOME")
    return (Path(place) if place else Path.home() / ".local" / "state") / "optkit" / "written"
