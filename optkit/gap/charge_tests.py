"""Whether charges and the penalised bound are what they must be if the process is the one assumed.

Who does not foresee is charged nothing in the mean, and earns less than the bound in the mean. Policies that do not
foresee are at hand, those of the report: a mean charge beyond its error, or a bound below a policy beyond the error of
their paired difference, says that the process is another one, whatever the tests of workers and requests have seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import stdtr

from optkit.basics.arrays import Floats
from optkit.gap.rows import CHARGED, ROUNDING, Kind
from optkit.gap.simulated_test import ProcessTest


def charge_test(
    kept: Mapping[int, Mapping[str, Any]],
    names: Sequence[str],
    kinds: Sequence[Kind] = ("penalised",),
    *,
    learned_from: int | None = None,
) -> ProcessTest:
    """Test charges and the penalised bound against what policies were charged and what they earned.

    Parameters
    ----------
    kept : mapping from instance to row
        From :func:`optkit.gap.rows.gap_row`, with penalised bounds.
    names : sequence of str
        The policies.
    kinds : sequence of str
        The bounds that charge.
    learned_from : int, optional
        Number of other days that the process was learned from: its own error then counts too.

    Returns
    -------
    ProcessTest
        By Student's distribution, over the number of comparisons (Bonferroni).

    Examples
    --------
    >>> row = {"bounds": {"penalised": {"value": 9.0}}, "policies": {"half": {"reward": 10.0, "charge": 0.1}}}
    >>> rows = {i: {**row, "policies": {"half": {"reward": 10.0 + i % 3, "charge": i % 5 - 2.0}}} for i in range(30)}
    >>> charge_test(rows, ["half"]).told
    'the penalised bound lies 2.00 money an instance below what half earns'
    """
    rows = list(kept.values())
    error = 1.0 if learned_from is None else float(np.sqrt(1.0 + len(rows) / learned_from))
    found = []
    for kind in kinds:
        called = "the penalised bound" if kind == "penalised" else f"the {kind} bound"
        bound = np.array([row["bounds"][kind]["value"] for row in rows])
        for name in names:
            reward, charge = (np.array([row["policies"][name][x] for row in rows]) for x in ("reward", CHARGED[kind]))
            above = float((reward - bound).mean())
            told = f"{called} lies {above:.2f} money an instance below what {name} earns"
            found.append((_tail(reward - bound, error), told))
            told = f"{name}, which does not foresee, is charged {charge.mean():.2f} money an instance for foresight"
            found.append((2.0 * _tail(charge * np.sign(charge.mean()), error), told))
    p, told = min(found)
    return ProcessTest(min(1.0, p * len(found)), told)


def _tail(x: Floats, error: float) -> float:
    """Probability of a mean as high, if the true one is 0; 1 for one number, which tells nothing."""
    if x.size < 2:
        return 1.0
    spread = float(x.std(ddof=1)) / np.sqrt(x.size) * error
    if spread <= ROUNDING * max(1.0, float(np.abs(x).max())):  # the same each day: there is no error to be within
        return float(x.mean() <= ROUNDING * max(1.0, float(np.abs(x).max())))
    return float(stdtr(x.size - 1, -x.mean() / spread))
