"""Proof that prices are optimal, or by how much they are not: primal value, dual bound, and what is violated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Known, number
from optkit.basics.errors import InputError
from optkit.models.decision import Decisions, Given, by_label
from optkit.models.pricing import closed_form, enclosure


@dataclass(frozen=True)
class PriceCertificate(Known):
    """What is proven about proposed prices; every attribute has the leading shape of the decisions.

    Attributes
    ----------
    profit : (...) float
        Expected profit of the proposed prices, in money.
    bound : (...) float
        R: no feasible prices earn more, in money. It satisfies the dual constraint, rounding included.
    gap : (...) float
        What any prices earn more than these at most, in money: ``bound - profit`` and the profit's rounding.
    stationarity : (...) float
        Largest derivative of the profit along a feasible change of one price: money per money.
    infeasibility : (...) float
        Largest compensation below 0, as a positive number; always 0 if negative prices are allowed.
    multiplier : (..., n) float
        Multipliers of the constraints c_i >= 0 at the bound, ``max(0, mu + R - v_i)``, money; 0 if there are none.
    optimal : (...) bool
        Whether the prices are proven optimal: gap and infeasibility are at most ``tolerance * (mu + abs(bound))``.
    undecided : (...) bool
        Where they are not, whether rounding hides it: floats cannot tell that the gap is larger than that.
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
    undecided: Bools
    tolerance: float

    def _repr_html_(self) -> str:
        return f"<pre>{self.summary()}</pre>"

    def __repr__(self) -> str:
        optimal, gap = np.atleast_1d(self.optimal), np.max(self.gap, initial=0.0)
        told = f"{optimal.sum()} of {optimal.size} decisions optimal"
        return f"PriceCertificate({told}, gap={gap:.3g}, tolerance={self.tolerance:g})"

    def summary(self) -> str:
        """Return a few lines for a person; for many decisions, the worst of each figure."""
        optimal, undecided = np.atleast_1d(self.optimal), np.atleast_1d(self.undecided)
        profit, bound = np.sum(self.profit), np.sum(self.bound)
        verdict = "NOT optimal"
        if (optimal | undecided).all():
            verdict = "optimal" if optimal.all() else "undecided: within rounding of the tolerance"
        lines = [
            f"verdict        {verdict}"
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
    evaluated here with all rounding against it (:func:`optkit.models.pricing.enclosure.optimum`). It does not matter
    where R came from.

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
        The verdict allows a gap of ``tolerance * (mu + |bound|)``, all rounding included, and prices as far below 0.

    Returns
    -------
    PriceCertificate
        Profit, bound and gap of each decision, and the verdict.

    Raises
    ------
    InputError
        As :func:`optkit.models.pricing.optimal_prices`, or if the tolerance is not a finite number above 0.

    Notes
    -----
    What has labels, as pandas' Series and DataFrames have, goes by them: the same labels in another order are brought
    into that of the first argument that has any, which is that of the results; other labels are refused. Arrays and
    lists go by place.

    Examples
    --------
    >>> from optkit.models.pricing import optimal_prices
    >>> prices = optimal_prices([5.0, 6.0], [-1.0, -2.0]).compensation
    >>> certify(prices, [5.0, 6.0], [-1.0, -2.0]).optimal
    np.True_
    >>> certify(prices + [0.1, 0.0], [5.0, 6.0], [-1.0, -2.0]).optimal
    np.False_
    """
    tolerance = number("tolerance", tolerance, above=0.0)
    if not isinstance(nonnegative, bool | np.bool_):
        raise InputError(
            f"nonnegative = {nonnegative!r}: a certificate is for c >= 0 (True) or for either sign (False)"
        )
    compensation, value, utility, offered, mu, outside_utility = by_label(
        {"compensation": compensation, "value": value, "utility": utility, "offered": offered},
        {"mu": mu, "outside_utility": outside_utility},
    )
    given = Given.of("value", value, utility, mu, outside_utility, offered)
    d, c = given.decisions(), given.prices(compensation).money
    shown = np.ones(c.shape, bool) if given.offered is None else given.offered
    (profit, error), taken = enclosure.earned(given, c)
    gradient = taken[:, :-1] * ((d.value - c - profit) / d.mu - 1.0)
    infeasibility = np.zeros_like(profit)
    if nonnegative:
        gradient = np.where(c <= 0, np.maximum(gradient, 0.0), gradient)
        infeasibility = np.where(shown, -c, 0.0).max(axis=1, keepdims=True, initial=0.0)
    best = closed_form.nonnegative(d) if nonnegative else closed_form.unconstrained(d)
    bound, below = enclosure.optimum(given, d.mu * best.ratio, bool(nonnegative), polish=30)
    multiplier = np.where(shown, np.maximum(d.mu + bound - d.value, 0.0), 0.0) if nonnegative else np.zeros(c.shape)
    gap = bound - profit + error
    allowed = tolerance * (d.mu + np.abs(bound))
    feasible = infeasibility <= allowed
    optimal = feasible & (gap <= allowed)
    undecided = feasible & ~optimal & (gap - below - 2.0 * error <= allowed)
    one = d.shape
    return PriceCertificate(
        profit=profit.reshape(one)[()],
        bound=bound.reshape(one)[()],
        gap=gap.reshape(one)[()],
        stationarity=np.abs(gradient).max(axis=1, initial=0.0).reshape(one)[()],
        infeasibility=(infeasibility + 0.0).reshape(one)[()],
        multiplier=multiplier.reshape(*one, c.shape[1]),
        optimal=optimal.reshape(one)[()],
        undecided=undecided.reshape(one)[()],
        tolerance=tolerance,
    )


def dual_bound(d: Decisions, nonnegative: bool) -> tuple[Floats, Floats]:
    """Return a feasible R of the dual for decisions in logarithms, and their rounding, both (S, 1), in money.

    :func:`certify` proves prices of given money; this is for decisions that are made of others, as those of many
    requests of one kind, whose logits are all that there is.

    Examples
    --------
    >>> d = Given.of("value", [[3.0, 2.0]], [[0.0, 1.0]], 1.0, 0.0, None).decisions()
    >>> bound, rounding = dual_bound(d, True)
    >>> float((bound - closed_form.nonnegative(d).ratio).item()) < 1e-13, float(rounding.item()) < 1e-13
    (True, True)
    """
    ratio = (closed_form.nonnegative(d) if nonnegative else closed_form.unconstrained(d)).ratio
    magnitude = np.abs(d.value) / d.mu + np.abs(d.logit)
    if d.offered is not None:
        magnitude = np.where(d.offered, magnitude, 0.0)
    size = magnitude.max(axis=1, keepdims=True, initial=0.0) + np.abs(ratio) + 1.0
    rounding = 16 * np.finfo(float).eps * size
    bound, step = ratio + rounding, rounding
    while (short := closed_form.dual_slack(d, bound, nonnegative) < 0).any():
        step = np.where(short, 2 * step, step)
        bound = np.where(short, bound + step, bound)
    return d.mu * bound, 4 * rounding * d.mu
