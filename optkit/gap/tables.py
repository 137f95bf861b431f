r"""The tables of a gap report: means, gaps and their intervals, from one row per instance.

Let :math:`y` be a policy's mean reward on an instance given its arrivals, :math:`z` its charge
(:mod:`optkit.gap.rows`; mean zero), :math:`U` a bound, and :math:`d` the full-information bound less all penalties.
What is reported is

.. math:: 100\, \frac{\bar U - \overline{(y - z)}}{\bar d},

a ratio of *means*: charges have mean zero in money, and no longer after a division by an instance's own d. Its standard
error is that of the mean of :math:`U - (y - z) - R\,d`, divided by :math:`\bar d` (delta method). Only penalised
bounds need z here: without charges, luck with the arrivals is on both sides. A mean in money has nothing to be compared
with, and z takes most of the luck out of it: it is a control variate. The plain mean of the rows stands beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from optkit.basics.arrays import Floats, number
from optkit.basics.errors import InputError
from optkit.gap.rows import CHARGED, Kind
from optkit.simulation.metrics import ROUNDING, MeanInterval

if TYPE_CHECKING:
    import pandas as pd


def ratio_of_means(numerator: npt.ArrayLike, denominator: npt.ArrayLike, confidence: float = 0.95) -> MeanInterval:
    """Ratio of two means over the same instances, with the interval of the delta method.

    Parameters
    ----------
    numerator, denominator : (B,) float
        Same instances, same order.
    confidence : float
        Coverage of the interval.

    Returns
    -------
    MeanInterval
        NaN throughout if the mean of the denominator is not positive: there is nothing to measure by.

    Examples
    --------
    >>> found = ratio_of_means([1.0, 2.0, 3.1], [10.0, 20.0, 30.0])
    >>> round(found.mean, 4), bool(found.low < 0.1 < found.high)
    (0.1017, True)
    """
    if not 0 < number("confidence", confidence) < 1:
        raise InputError(f"confidence = {confidence} is not between 0 and 1")
    y, d = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    nan = float("nan")
    scale = float(d.mean())
    if not scale > 0:
        return MeanInterval(nan, nan, nan, nan, y.size)
    ratio = float(y.mean()) / scale
    if y.size == 1:
        return MeanInterval(ratio, nan, nan, nan, 1)
    std = float((y - ratio * d).std(ddof=1)) / scale
    half = float(stdtrit(y.size - 1, 0.5 + confidence / 2)) * std / np.sqrt(y.size)
    return MeanInterval(ratio, std, ratio - half, ratio + half, y.size)


class GapTables(NamedTuple):
    """The four tables of a :class:`optkit.gap.report.GapReport`."""

    bounds: pd.DataFrame
    policies: pd.DataFrame
    gaps: pd.DataFrame
    rows: pd.DataFrame


def gap_tables(
    kept: Mapping[int, Mapping[str, Any]], names: Sequence[str], kinds: Sequence[Kind], confidence: float
) -> GapTables:
    """Make the tables of a report.

    Parameters
    ----------
    kept : mapping from instance to row
        From :func:`optkit.gap.rows.gap_row`, without failures.
    names, kinds : sequence of str
        Policies and bounds. What the best policy was charged tells the luck of the arrivals; without a penalised bound
        among the kinds, charges count for nothing.
    confidence : float
        Of all intervals and claims.
    """
    import pandas as pd

    rows = list(kept.values())

    def column(part: str, name: str, entry: str) -> Floats:
        return np.array([row[part][name][entry] for row in rows], dtype=float)

    penalty = np.array([row["penalty"] for row in rows])
    charges = {
        kind: {name: column("policies", name, CHARGED[kind]) for name in names} for kind in CHARGED if kind in kinds
    }
    # The luck is told by the charges of the bound that knows most of it.
    telling = next(iter(charges.values()), {name: np.zeros(len(rows)) for name in names})
    best = max(names, key=lambda name: float((column("policies", name, "reward") - telling[name]).mean()))
    luck = telling[best]
    full = column("bounds", "full", "value")
    # A proof rounds up: what lies above the penalties by no more than that is nothing that could be gained.
    worth = np.where(full - penalty <= ROUNDING * (np.abs(full) + np.abs(penalty)), 0.0, full - penalty)

    def level(value: Floats, charge: Floats, plain: Floats) -> dict[str, float]:
        money, share = _mean(value - charge, confidence), ratio_of_means(value - penalty, worth, confidence)
        raw = _mean(plain, confidence)
        return {
            "money": money.mean,
            "money_half_width": money.high - money.mean,
            "raw_money": raw.mean,
            "raw_half_width": raw.high - raw.mean,
            "points": 100 * share.mean,
            "half_width": 100 * (share.high - share.mean),
        }

    table = pd.DataFrame({"instance": list(kept), **{k: [row[k] for row in rows] for k in ("requests", "workers")}})
    table["penalty"] = penalty
    bounds, policies, gaps = [], [], []
    for kind in kinds:
        proof, residual = column("bounds", kind, "gap"), column("bounds", kind, "residual")
        methods = sorted({row["bounds"][kind]["method"] for row in rows})
        cost = float(column("bounds", kind, "seconds").mean())
        worst = {"certificate_gap": float(proof.max()), "residual": float(residual.max())}
        # What is charged already is compared with what was earned with the luck that it is charged for.
        plain = column("bounds", kind, "value")
        own = charges[kind][best] if kind in charges else luck
        value = plain + own if kind in charges else plain
        found = {**level(value, own, plain), "seconds": cost, **worst, "methods": ", ".join(methods)}
        bounds.append({"kind": kind, **found})
        table[f"bound: {kind}"] = plain
    for name in names:
        reward, charge = column("policies", name, "reward"), telling[name]
        exact = column("policies", name, "exact") > 0
        paid = _mean(charge, confidence)
        more = {"charge": paid.mean, "charge_half_width": paid.high - paid.mean, "exact": int(exact.sum())}
        policies.append({"policy": name, **level(reward, charge, reward), **more})
        table[f"policy: {name}"], table[f"charge: {name}"] = reward, charge
        table[f"exact: {name}"] = exact
        for kind in kinds:
            short = column("bounds", kind, "value") - reward + (charges[kind][name] if kind in charges else 0.0)
            smallest = float(short[exact].min()) if exact.any() and kind != "full" else float("nan")
            raw = float((column("bounds", kind, "value") - reward).mean())
            more = {"raw_money": raw, "smallest": smallest}
            gaps.append({"policy": name, "bound": kind, **_gap(short, worth, confidence), **more})
    return GapTables(pd.DataFrame(bounds), pd.DataFrame(policies), pd.DataFrame(gaps), table)


def _mean(x: Floats, confidence: float) -> MeanInterval:
    return ratio_of_means(x, np.ones(x.size), confidence)


def _gap(short: Floats, worth: Floats, confidence: float) -> dict[str, float]:
    money, share = _mean(short, confidence), ratio_of_means(short, worth, confidence)
    # One-sided: Student's quantile of the confidence itself.
    quantile = float(stdtrit(short.size - 1, confidence)) / np.sqrt(short.size) if short.size > 1 else float("nan")
    return {
        "money": money.mean,
        "money_low": money.low,
        "money_high": money.high,
        "points": 100 * share.mean,
        "points_low": 100 * share.low,
        "points_high": 100 * share.high,
        "claim": 100 * (share.mean + quantile * share.std),
        "claim_money": money.mean + quantile * money.std,
    }
