"""JSON that every reader takes: what is not finite becomes null."""

from __future__ import annotations

import json
import math
from typing import Any


def to_json(data: Any) -> str:
    """Write plain data as JSON; NaN and infinity have no place there, and become null.

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
    return json.dumps(_finite(data), indent=1, allow_nan=False)


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
