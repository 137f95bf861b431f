r"""Between which amounts a profit lies, and the optimum: every rounding is counted, each term's by its own weight.

Workers choose by differences of utility. So every option's weight is taken against the option that workers like best,
with differences that :func:`~optkit.models.pricing.compensated.compensated_sum` keeps; what hardly anybody takes, like
a request of utility -1e16, hardly counts, with its rounding. The floats that are given count as exact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optkit.basics.arrays import Bools, Floats
from optkit.models.decision import Given
from optkit.models.pricing.compensated import EPS, compensated_sum

SMALLEST = 4 * float(np.finfo(float).smallest_subnormal)
LARGEST_EXPONENT = 600.0


class Enclosure(NamedTuple):
    """An amount of money for each of S decisions, (S, 1), and how far the exact one may be from it, either way."""

    value: Floats
    error: Floats


def earned(given: Given, compensation: Floats) -> tuple[Enclosure, Floats]:
    """Expected profit of prices (S, n), which need not be good, and what is taken, (S, n + 1), nothing the last."""
    weight, error = _weights(given, [_aside(compensation)])
    shown = _shown(given)
    margin = np.where(shown, _aside(given.money) - _aside(compensation), 0.0)
    total = weight.sum(axis=1, keepdims=True)
    share = weight / total
    profit = (share * margin).sum(axis=1, keepdims=True)
    with np.errstate(over="ignore"):
        spread = (error * np.abs(margin - profit)).sum(axis=1, keepdims=True)
    summed = (margin.shape[1] + 8) * EPS * (share * np.abs(margin)).sum(axis=1, keepdims=True)
    # Whatever the weights are, the profit is a mean of the margins and of 0.
    most = 2.0 * np.abs(margin).max(axis=1, keepdims=True)
    sure = np.maximum(weight - error, 0.0).sum(axis=1, keepdims=True)
    return Enclosure(profit, np.minimum(spread / sure + summed, most)), share


def optimum(given: Given, start: Floats, nonnegative: bool, polish: int = 0) -> Enclosure:
    r"""Return a bound (S, 1) that no prices' profit exceeds, near a start, and how far below it the optimum may be.

    With ``w_i = exp((u_i - u_0)/mu)`` the function

    .. math:: h(R) = R - \sum_i \max_c \, w_i e^{c/\mu} (v_i - c - R)

    increases and is concave, and its root is the optimum. Any R with h(R) >= 0 bounds the profit of every price vector:
    multiply by P_0 and add up. So R is raised until h(R) is at least 0 with all rounding against it; and the optimum is
    not below any R with h(R) <= 0, nor below the root of a tangent.

    Parameters
    ----------
    given : Given
        The decisions, their money being the values.
    start : (S, 1) float
        A guess of the optimum, in money; it may be anybody's.
    nonnegative : bool
        Whether c >= 0 is asked for.
    polish : int
        Number of tries for a lower bound where the guess is worse than rounding; 0 only raises it.
    """
    bound, least, floor = np.full_like(start, np.inf), np.full_like(start, -np.inf), np.full_like(start, -np.inf)
    rows, tries = np.arange(len(start)), 0
    rise = EPS * ((given.money.shape[1] + 40) * given.mu + 2.0 * np.abs(start))  # what ordinary data need, at once
    R, fine, reach = start + rise, 8.0 * rise, 8.0 * rise
    while rows.size:
        low, high, slope = _dual(given, R, nonnegative)
        proven = low >= 0
        bound[rows] = np.where(proven, R, bound[rows])
        least[rows] = np.maximum(least[rows], R - np.maximum(high, 0.0) / slope)
        floor[rows] = np.where(proven, floor[rows], R)
        newton = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * low + 0.5 * high, 0.0) / slope
        rise = np.where(proven, rise, np.maximum(-1.25 * newton, 2.0 * rise))
        to = R + np.where(proven, -np.minimum(newton, reach), rise)
        reach = np.where(proven, 1e3 * reach, reach)
        width = bound[rows] - floor[rows]
        within = np.isinf(width) | ((to < bound[rows]) & (to > floor[rows]))
        to = np.where(within, to, R - np.where(proven, 0.5, -0.5) * np.where(within, 0.0, width))
        rough = ~proven | (newton > 4.0 * (high - low) / slope + fine)
        go = np.flatnonzero(np.isinf(bound[rows]) | (rough & (width > 2.0 * fine) & (tries < polish)))
        tries += 1
        rows, given, R, rise, fine, reach = rows[go], given.rows(go), to[go], rise[go], fine[go], reach[go]
    return Enclosure(bound, bound - least)


def _dual(given: Given, R: Floats, nonnegative: bool) -> tuple[Floats, Floats, Floats]:
    """Return h(R) at least and at most, and its slope at least, all divided by the largest weight, (S, 1)."""
    v, mu, shown = given.money, given.mu, _shown(given)
    beyond, doubt = compensated_sum(v, -R, -mu)
    # The free price's formula bounds the best price of either sign, so it serves where it is in doubt which one holds.
    free = beyond + doubt > 0 if nonnegative else np.ones(v.shape, bool)
    gain = np.concatenate([np.where(free, mu, v - R), -R], axis=1)
    paid = [_aside(np.where(free, part, 0.0)) for part in (v, -R, -mu)]
    weight, error = _weights(given, paid)
    least, most = np.maximum(weight - error, 0.0), weight + error
    room = (gain.shape[1] + 8) * EPS
    bounds = []
    for share, side in ((np.where(gain > 0, most, least), -1.0), (np.where(gain > 0, least, most), 1.0)):
        with np.errstate(over="ignore"):  # what is that uncertain counts as infinite
            each = np.where(shown, share * gain, 0.0)
        loose = room * np.abs(each).sum(axis=1, keepdims=True) + gain.shape[1] * SMALLEST
        bounds.append(side * loose - each.sum(axis=1, keepdims=True))
    return bounds[0], bounds[1], least.sum(axis=1, keepdims=True)


def _weights(given: Given, paid: list[Floats]) -> tuple[Floats, Floats]:
    """Weights of the requests and of the outside option, relative to about the largest, and their errors, (S, n + 1).

    ``paid`` are amounts, each (S, n + 1) and 0 for the outside option, whose sum each option is paid.
    """
    shown, mu = _shown(given), given.mu
    liked = np.concatenate([given.utility, given.outside_utility], axis=1)
    top = np.where(shown, sum(paid, liked - given.outside_utility), -np.inf).argmax(axis=1)[:, None]
    for _ in range(8):
        others = [-np.take_along_axis(liked, top, axis=1)]
        for part in paid:
            others += [part, -np.take_along_axis(part, top, axis=1)]
        difference, lost = compensated_sum(liked, *others)
        x = np.where(shown, difference / mu, -np.inf)
        ahead = x.max(axis=1, keepdims=True) > 1.0
        if not ahead.any():
            break
        top = np.where(ahead, x.argmax(axis=1)[:, None], top)  # utilities so large that their floats hid the largest
    spread = np.where(shown, lost / mu + EPS * (np.abs(difference / mu) + 8.0), 0.0)
    with np.errstate(under="ignore"):
        weight = np.exp(np.minimum(x, LARGEST_EXPONENT))
        error = np.minimum(spread, 1e30) * np.exp(np.minimum(x + spread, LARGEST_EXPONENT))
    return weight, np.where(shown, error + SMALLEST, 0.0)


def _aside(part: Floats) -> Floats:
    """Give an array (S, n) about requests a column of zeros for the outside option."""
    return np.concatenate([part, np.zeros((len(part), 1))], axis=1)


def _shown(given: Given) -> Bools:
    """Which options there are, (S, n + 1): the outside option always."""
    if given.offered is None:
        return np.ones((len(given.money), given.money.shape[1] + 1), bool)
    return np.concatenate([given.offered, np.ones((len(given.money), 1), bool)], axis=1)
