"""Where a path leads."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from optkit.basics.errors import InputError


def resolved(path: str | os.PathLike[str]) -> Path:
    """Return the whole path without links; what it names need not exist.

    Raises
    ------
    InputError
        If a link on the way leads back to itself.

    Examples
    --------
    >>> resolved("notes/../day").name
    'day'
    """
    try:
        os.stat(path)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(f"{os.fspath(path)} is a link that leads back to itself: name another place") from None
    return Path(os.path.realpath(path))
