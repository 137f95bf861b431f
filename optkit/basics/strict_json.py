"""JSON from files: a key that stands twice is seen, and numbers can be had as they are written."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from typing import Any


class Twice(dict[str, Any]):
    """An object of a JSON file in which, or in something inside which, a key stands twice.

    Attributes
    ----------
    key : str
        The key.
    """

    key: str


def from_json(text: str, number: Callable[[str], Any] | None = None) -> Any:
    """Read JSON; an object in which a key stands twice comes as :class:`Twice`, and so does all that holds it.

    Parameters
    ----------
    text : str
        Without a mark at its beginning.
    number : callable, optional
        What makes a number of its text; as ``json`` does by default. ``NaN`` and ``Infinity`` are floats.

    Raises
    ------
    ValueError
        If it is no JSON, or nested too deeply.

    Examples
    --------
    >>> from_json('{"id": 20240101.10}', number=str)
    {'id': '20240101.10'}
    >>> from_json('[{"a": 1, "a": 2}]')[0].key
    'a'
    """
    how: dict[str, Any] = {} if number is None else dict.fromkeys(("parse_int", "parse_float"), number)
    try:
        return json.loads(text, object_pairs_hook=_object, **how)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def object_of(raw: bytes) -> dict[str, Any]:
    """Return the JSON object that the bytes of a file hold, every key of which stands once.

    Raises
    ------
    ValueError
        If they hold anything else; the message says what.

    Examples
    --------
    >>> object_of(b'{"mu": [1.0]}')
    {'mu': [1.0]}
    >>> object_of(b'{"mu": [1.0], "mu": [2.0]}')
    Traceback (most recent call last):
        ...
    ValueError: the key 'mu' stands twice
    """
    try:
        found = from_json(raw.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(f"no JSON: no UTF-8 at byte {error.start}") from None
    except ValueError as error:
        raise ValueError(f"no JSON: {error}") from None
    if isinstance(found, Twice):
        raise ValueError(f"the key {found.key!r} stands twice")
    if not isinstance(found, dict):
        raise ValueError("no JSON object")
    return found


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    key = None
    if len(found) < len(pairs):
        key = next(name for name, times in Counter(name for name, _ in pairs).items() if times > 1)
    else:
        key = next((inner for value in found.values() if (inner := _twice(value)) is not None), None)
    if key is None:
        return found
    double = Twice(found)
    double.key = key
    return double


def _twice(value: Any) -> str | None:
    """Return a key that stands twice in an object, or in objects of a list."""
    if isinstance(value, Twice):
        return value.key
    if isinstance(value, list):
        return next((key for one in value if (key := _twice(one)) is not None), None)
    return None
