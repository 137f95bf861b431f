"""Verdicts and bounds against a judge who calculates with as many digits as it takes."""

from collections import Counter

import numpy as np
import pytest

from optkit.models.pricing import enclosure
from tests.models.pricing.judged import KINDS, attempt

SEEDS = 40
"""Decisions judged here; ``python -m tests.models.pricing.judged SECONDS`` judges more."""


def everything():
    """What is said about all decisions."""
    return sum(map(attempt, range(SEEDS)), Counter())


@pytest.mark.slow
def test_what_is_called_optimal_is_and_bounds_are_never_exceeded_at_any_scale():
    told = everything()
    assert {what.split(",")[0] for what in told if "refused" not in what} == set(KINDS)
    assert {what.split(": ")[1] for what in told} >= {"optimal", "not optimal", "undecided"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("optimum", lambda found: enclosure.Enclosure(found.value - 1e-8 * np.abs(found.value), found.error)),
        ("optimum", lambda found: enclosure.Enclosure(found.value * 2.0, found.value * 2.0)),
        ("earned", lambda found: (enclosure.Enclosure(found[0].value, found[0].error * 1e15), found[1])),
    ],
    ids=["a bound too low", "an optimum said to be unknown", "a profit said to be unknown"],
)
def test_a_judge_finds_what_is_wrong(monkeypatch, name, wrong):
    right = getattr(enclosure, name)
    monkeypatch.setattr(enclosure, name, lambda *given, **more: wrong(right(*given, **more)))
    with pytest.raises(AssertionError):
        everything()
