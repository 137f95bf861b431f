"""Text that a terminal shows as it is: names from files may hold what moves its cursor or turns its lines around."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

MOST = 400
"""Characters of a list of names in a message."""


def printable(text: object) -> str:
    r"""Return text on one line, with everything that is not to be seen as an escape.

    Control characters of both kinds (C0, C1), line breaks, marks of writing direction, other invisible characters and
    halves of surrogate pairs become ``\n``, ``\x1b``, ``\u202e`` and the like; all else, of any script, stays. What
    has been through it stays as it is.

    Parameters
    ----------
    text : object
        Text, or what ``str`` makes text of.

    Returns
    -------
    str

    Examples
    --------
    >>> print(printable("caf\u00e9 \x1b[2J\n\u202etac"))
    café \x1b[2J\n\u202etac
    """
    text = str(text)
    return text if text.isprintable() else "".join(map(_shown, text))


def encodable(text: object, encoding: str | None) -> str:
    r"""Return text on one line, also with everything as an escape that an encoding lacks.

    Examples
    --------
    >>> print(encodable("caf\u00e9", "ascii"), encodable("caf\u00e9", "utf-8"))
    caf\xe9 café
    """
    shown, code = printable(text), encoding or "utf-8"
    return shown.encode(code, "backslashreplace").decode(code)


def listed(names: Iterable[object]) -> str:
    """Return names by commas, cut off where there are too many for a message.

    Examples
    --------
    >>> listed(["a", "b"]), len(listed(range(1_000_000))) < 450, listed([])
    ('a, b', True, 'none')
    """
    every, length = list(names), 0
    shown: list[str] = []
    for name in map(printable, every):
        length += len(name) + 2
        if length > MOST and shown:
            return f"{', '.join(shown)} and {len(every) - len(shown)} more"
        shown.append(name if len(name) <= MOST else f"{name[:MOST]} ...")
    return ", ".join(shown) or "none"


def _shown(one: str) -> str:
    # Spaces other than the usual one are seen for what they are.
    if one.isprintable() or unicodedata.category(one) == "Zs":
        return one
    return one.encode("unicode_escape").decode()
