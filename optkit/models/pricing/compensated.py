"""Sums that keep what floating point drops: differences of large amounts are as good as those of small ones."""

from __future__ import annotations

import numpy as np

from optkit.basics.arrays import Floats

EPS = float(np.finfo(float).eps)


def compensated_sum(first: Floats, *others: Floats) -> tuple[Floats, Floats]:
    """Add arrays entry by entry, and bound the error.

    Knuth's two-sum splits each addition into its float and what that drops, exactly; what was dropped is added at the
    end (Ogita, Rump and Oishi 2005, Sum2). No partial sum, in the order given, may overflow.

    Returns
    -------
    total, error : float
        The sum, and how far it is from the exact one at most. The error is that of one rounding, where no more than one
        addition drops anything.

    Examples
    --------
    >>> total, error = compensated_sum(np.array([1e16]), np.array([1.0]), np.array([-1e16]))
    >>> total, bool(error <= 1e-15)
    (array([1.]), True)
    """
    total, dropped, size = first, np.zeros(1), np.zeros(1)
    for x in others:
        s = total + x
        part = s - total
        lost = (total - (s - part)) + (x - part)
        total, dropped, size = s, dropped + lost, size + np.abs(lost)
    found = total + dropped
    return found, EPS * (np.abs(found) + len(others) * size)
