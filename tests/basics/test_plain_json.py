"""Plain JSON."""

import json
import math

from optkit.basics.plain_json import to_json


def test_what_is_not_finite_becomes_null():
    """NaN and infinities, however deep, become null; everything else comes back as it was."""
    data = {"a": [1, 2.5, math.nan, {"b": -math.inf}], "c": "nan", "d": None, "e": (True, 3)}
    assert json.loads(to_json(data)) == {"a": [1, 2.5, None, {"b": None}], "c": "nan", "d": None, "e": [True, 3]}
