"""A process tested by simulation: whether what was seen stands out among what the process itself would have shown.

Several statistics are looked at, and one p-value comes of all: each is standardised over the observed and the simulated
data together, and the observed data's largest is ranked among theirs. If the process is the true one, all are alike, so
the p-value is exact whatever the statistics are and however they depend on each other (Davison and Hinkley 1997,
section 4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats, Known

DRAWS = 999
"""Simulated data sets: the smallest p-value is one in a thousand."""

LEVEL = 0.003
"""Of each of the three tests of a report: workers, requests, and bounds and charges beside policies. A report whose
process is the true one is refused in less than one case of a hundred."""


@dataclass(frozen=True)
class ProcessTest(Known):
    """What a test of a process found.

    Attributes
    ----------
    p : float
        Probability of data that stand out as much, if the process is the true one.
    told : str
        What was looked at, and what stands out most.
    """

    p: float
    told: str

    @property
    def contradicted(self) -> bool:
        """Whether the data contradict the process."""
        return self.p <= LEVEL


def stands_out(observed: Floats, simulated: Floats, both_tails: Sequence[bool]) -> tuple[float, int]:
    """Return the p-value of several statistics at once, and the number of the one that stands out most.

    Parameters
    ----------
    observed : (M,) float
        Statistics of the data; more is stranger. Infinite where the process cannot show such data at all.
    simulated : (R, M) float
        The same of data that were drawn from the process.
    both_tails : (M,) bool
        Where less is strange too.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> stands_out(np.array([0.1, 9.0]), rng.normal(size=(999, 2)), [False, True])
    (0.001, 1)
    """
    if not np.isfinite(observed).all():
        return 0.0, int((~np.isfinite(observed)).argmax())
    rows = np.vstack([observed, simulated])
    spread = rows.std(axis=0)
    score = (rows - rows.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    score = np.where(both_tails, np.abs(score), score)
    largest = score.max(axis=1)
    # Rounding must not part what is equal.
    return float((largest >= largest[0] - 1e-9).mean()), int(score[0].argmax())
