"""A check that the policies share."""

from __future__ import annotations

import math
from typing import Any


def is_finite(value: Any) -> bool:
    """Whether something is one finite number."""
    try:
        return math.isfinite(value)
    except TypeError:
        return False
