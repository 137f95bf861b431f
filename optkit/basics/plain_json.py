"""JSON that every reader takes, that a person can read, and that says itself whether it was changed."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

from optkit.basics.strict_json import object_of


def to_json(data: Any) -> str:
    """Write plain data as JSON, in printable ASCII; NaN and infinity have no place there, and become null.

    Examples
    --------
    >>> print(to_json({"a": [1.5, float("nan")]}))
    {
     "a": [
      1.5,
      null
     ]
    }
    """
    # JSON leaves DEL as it is, and terminals do not.
    return json.dumps(_finite(data), indent=1, allow_nan=False).replace("\x7f", "\\u007f")


def parse_object(raw: bytes | str) -> dict[str, Any] | None:
    """Return the JSON object that a file holds, every key once, or None if it holds anything else.

    Examples
    --------
    >>> parse_object(b'{"a": 1}'), parse_object(b"[1]"), parse_object(b"[" * 100_000)
    ({'a': 1}, None, None)
    """
    try:
        return object_of(raw.encode() if isinstance(raw, str) else raw)
    except ValueError:
        return None


def sealed(document: dict[str, Any], entry: str = "sha256") -> dict[str, Any]:
    """Return a document as JSON would give it back, with a digest of all its other entries.

    Parameters
    ----------
    document : dict
        Plain data.
    entry : str
        Name of the digest.

    Examples
    --------
    >>> one = sealed({"bound": 1.5})
    >>> is_sealed(one), is_sealed(one | {"bound": 1.6})
    (True, False)
    """
    plain: dict[str, Any] = json.loads(to_json({name: value for name, value in document.items() if name != entry}))
    return plain | {entry: _digest(plain)}


def is_sealed(document: dict[str, Any], entry: str = "sha256") -> bool:
    """Whether a document that was read is, to the last digit, what :func:`sealed` made."""
    rest = {name: value for name, value in document.items() if name != entry}
    try:
        return document.get(entry) == _digest(rest)
    except (RecursionError, ValueError):
        return False


def _digest(plain: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
