"""Verdicts about thousands of decisions at once, against sums in extended precision."""

import numpy as np
import pytest

from optkit.models.pricing import enclosure
from tests.models.pricing.many import attempt

pytestmark = pytest.mark.skipif(
    np.finfo(np.longdouble).eps > 1e-18, reason="this machine has no floats of more digits than usual"
)


@pytest.mark.slow
def test_profits_bounds_gaps_and_verdicts_are_right():
    """Ten batches of 500; ``python -m tests.models.pricing.many SECONDS`` judges millions."""
    for seed in range(10):
        attempt(seed)


def test_a_judge_finds_a_bound_too_low(monkeypatch):
    right = enclosure.optimum

    def wrong(*given, **more):
        found = right(*given, **more)
        return enclosure.Enclosure(found.value * (1 - 1e-12), found.error)

    monkeypatch.setattr(enclosure, "optimum", wrong)
    with pytest.raises(AssertionError, match="exceeded"):
        [attempt(seed) for seed in range(10)]
