"""Proof that prices are optimal, or by how much they are not: primal value, dual bound, and what is violated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InputError
from optkit.models.choice import softmax_with_outside
from optkit.models.decision import Bools, Decisions, Floats
from optkit.models.pricing import closed_form


@dataclass(frozen=True)
class PriceCertificate:
    """What is proven about proposed prices; every attribute has the leading shape of the decisions.

    Attributes
    ----------
    profit : (...) float
        Expected profit of the proposed prices, in money.
    bound : (...) float
        R: no feasible prices earn more, in money. It satisfies the dual constraint, rounding included.
    gap : (...) float
        ``bound - profit``, in money, at least 0 up to rounding.
    stationarity : (...) float
        Largest derivative of the profit along a feasible change of one price: money per money.
    infeasibility : (...) float
        Largest compensation below 0, as a positive number; always 0 if negative prices are allowed.
    multiplier : (..., n) float
        Multipliers of the constraints c_i >= 0 at the bound, ``max(0, mu + R - v_i)``, money; 0 if there are none.
    optimal : (...) bool
        The verdict: feasible, and the gap is below the tolerance.
    tolerance : float
        The relative tolerance of the verdict.
    """

    profit: Floats
    bound: Floats
    gap: Floats
    stationarity: Floats
    infeasibility: Floats
    multiplier: Floats
    optimal: Bools
    tolerance: float

    def summary(self) -> str:
        """Return a few lines for a person; for many decisions, the worst of each figure."""
        optimal = np.atleast_1d(self.optimal)
        profit, bound = np.sum(self.profit), np.sum(self.bound)
        lines = [
            f"verdict        {'optimal' if optimal.all() else 'NOT optimal'}"
            + (f" ({optimal.sum()} of {optimal.size} decisions)" if optimal.size > 1 else ""),
            f"profit         {profit:.10g}" + (" in total" if optimal.size > 1 else ""),
            f"upper bound    {bound:.10g}",
            f"gap            {np.max(self.gap, initial=0.0):.3g}  (largest; tolerance {self.tolerance:g} relative)",
            f"stationarity   {np.max(self.stationarity, initial=0.0):.3g}",
            f"infeasibility  {np.max(self.infeasibility, initial=0.0):.3g}",
        ]
        return "\n".join(lines)


def certify(
    compensation: npt.ArrayLike,
    value: npt.ArrayLike,
    utility: npt.ArrayLike,
    mu: npt.ArrayLike = 1.0,
    *,
    outside_utility: npt.ArrayLike = 0.0,
    nonnegative: bool = True,
    offered: npt.ArrayLike | None = None,
    tolerance: float = 1e-9,
) -> PriceCertificate:
    """Certify any prices, whoever proposed them.

    The bound is a dual solution: R bounds the profit of every price vector if it satisfies one inequality, which is
    evaluated here (:func:`optkit.models.pricing.closed_form.dual_slack`). It does not matter where R came from.

    Parameters
    ----------
    compensation : (..., n) float
        The proposed prices, in money.
    value, utility : (..., n) float
        As in :func:`optkit.models.pricing.optimal_prices`, in money.
    mu, outside_utility : (...) float
        Noise scale (positive) and utility of rejecting everything, in money.
    nonnegative : bool
        Whether prices must be at least 0 (default), or may have either sign.
    offered : (..., n) bool, optional
        Which requests are on offer; all by default.
    tolerance : float
        The verdict allows a gap of ``tolerance * (mu + |bound|)``, and the rounding of the inputs' magnitude.

    Returns
    -------
    PriceCertificate
        Profit, bound and gap of each decision, and the verdict.

    Raises
    ------
    InputError
        As :func:`optkit.models.pricing.optimal_prices`, or if the tolerance is not positive.

    Examples
    --------
    >>> from optkit.models.pricing import optimal_prices
    >>> prices = optimal_prices([5.0, 6.0], [-1.0, -2.0]).compensation
    >>> certify(prices, [5.0, 6.0], [-1.0, -2.0]).optimal
    np.True_
    >>> certify(prices + [0.1, 0.0], [5.0, 6.0], [-1.0, -2.0]).optimal
    np.False_
    """
    if not tolerance > 0:
        raise InputError(f"tolerance = {tolerance} must be positive")
    if not isinstance(nonnegative, bool | np.bool_):
        raise InputError(
            f"nonnegative = {nonnegative!r}: a certificate is for c >= 0 (True) or for either sign (False)"
        )
    d = Decisions.of(value, utility, mu, outside_utility, offered)
    seen = Decisions.at_prices(compensation, utility, mu, outside_utility, offered)
    if seen.shape != d.shape or seen.log_odds.shape != d.advantage.shape:
        raise InputError(
            f"compensation has shape {np.shape(compensation)}; the decisions are {(*d.shape, d.value.shape[1])}"
        )
    c = seen.compensation
    shown = np.ones(c.shape, bool) if d.offered is None else d.offered
    margin = d.value - c
    acceptance, _ = softmax_with_outside(seen.log_odds)
    profit = (acceptance * np.where(shown, margin, 0.0)).sum(axis=1, keepdims=True)
    gradient = acceptance * ((margin - profit) / d.mu - 1.0)
    if nonnegative:
        gradient = np.where(c <= 0, np.maximum(gradient, 0.0), gradient)
    infeasibility = (
        np.where(shown, -c, 0.0).max(axis=1, keepdims=True, initial=0.0) if nonnegative else np.zeros_like(profit)
    )
    bound, rounding = dual_bound(d, nonnegative)
    multiplier = np.where(shown, np.maximum(d.mu + bound - d.value, 0.0), 0.0) if nonnegative else np.zeros(c.shape)
    gap = bound - profit
    allowed = tolerance * (d.mu + np.abs(bound)) + rounding
    one = d.shape
    return PriceCertificate(
        profit=profit.reshape(one)[()],
        bound=bound.reshape(one)[()],
        gap=gap.reshape(one)[()],
        stationarity=np.abs(gradient).max(axis=1, initial=0.0).reshape(one)[()],
        infeasibility=(infeasibility + 0.0).reshape(one)[()],
        multiplier=multiplier.reshape(*one, c.shape[1]),
        optimal=((gap <= allowed) & (infeasibility <= allowed)).reshape(one)[()],
        tolerance=tolerance,
    )


def dual_bound(d: Decisions, nonnegative: bool) -> tuple[Floats, Floats]:
    """Return a certified R, (S, 1), and the rounding of the data that it allows for, (S, 1), both in money."""
    ratio = (closed_form.nonnegative(d) if nonnegative else closed_form.unconstrained(d)).ratio
    magnitude = np.abs(d.value) / d.mu + np.abs(d.logit)
    if d.offered is not None:
        magnitude = np.where(d.offered, magnitude, 0.0)
    size = magnitude.max(axis=1, keepdims=True, initial=0.0) + np.abs(ratio) + 1.0
    step = 16 * np.finfo(float).eps * size
    rounding = step * d.mu
    bound = ratio + step
    for _ in range(60):
        short = closed_form.dual_slack(d, bound, nonnegative) < 0
        if not short.any():
            break
        step = np.where(short, 2 * step, step)
        bound = np.where(short, bound + step, bound)
    return d.mu * bound, 4 * rounding
