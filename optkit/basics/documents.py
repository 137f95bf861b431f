"""Results in files of JSON that say what they are, of which version, and whether somebody changed them since."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from optkit.basics.errors import DataError, OptkitError
from optkit.basics.files import write_whole
from optkit.basics.plain_json import is_sealed, sealed, to_json
from optkit.basics.strict_json import object_of


def write_document(path: str | os.PathLike[str], plain: dict[str, Any], what: str) -> Path:
    """Write plain data with a digest of them, whole or not at all; ``what`` they are is for the error.

    Raises
    ------
    OptkitError
        If the path names no file, or the disk refuses.
    """
    target = Path(path)
    if not target.name:
        raise OptkitError(f"{os.fspath(path)!r} names no file to write {what} to")
    return write_whole(target, document_text(plain))


def document_text(plain: dict[str, Any]) -> str:
    """Return what :func:`write_document` writes."""
    return to_json(sealed(plain)) + "\n"


def read_document(path: str | os.PathLike[str], form: str, version: int, what: str) -> dict[str, Any]:
    """Read what :func:`write_document` wrote; who edits such a file takes its entry ``sha256`` out.

    Raises
    ------
    DataError
        If the file cannot be read, holds something else, has another version, or was changed since.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     file = write_document(f"{place}/a.json", {"format": "a form", "version": 1, "x": 0.5}, "a result")
    ...     read_document(file, "a form", 1, "a result")["x"]
    0.5
    """
    source = Path(path)
    try:
        plain = object_of(source.read_bytes())
    except OSError as error:
        raise DataError(f"{source} cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise DataError(f"{source} holds no {what} ({error})") from None
    if plain.get("format") != form:
        raise DataError(f"{source} holds no {what}")
    if plain.get("version") != version or isinstance(plain["version"], bool):
        raise DataError(f"{source} has version {plain.get('version')!r}; this optkit reads version {version}")
    if "sha256" in plain and not is_sealed(plain):
        raise DataError(f"{source} was changed or damaged (its sha256 differs; after an edit, delete that entry)")
    return plain
