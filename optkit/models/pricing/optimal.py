"""Optimal compensations for one decision, or for millions at once, and the certificate that proves them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Known
from optkit.basics.errors import InputError
from optkit.models.choice import softmax_with_outside
from optkit.models.decision import Decisions, Given, largest
from optkit.models.pricing import closed_form, enclosure
from optkit.models.pricing.certificate import PriceCertificate, certify

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["PriceCertificate", "Pricing", "certify", "optimal_prices"]


FINEST = 2.0**52
"""Value or profit in units of mu from which a price, the value less the markup, is rounded by mu or more."""


FAR, LOST = 2.0**16, 2.0**42
"""Utilities less that of rejecting, in units of mu, from which what is taken is worked out from differences among the
requests, and from which these are lost in rounding."""


@dataclass(frozen=True)
class Pricing(Known):
    """Compensations and what they lead to.

    Attributes
    ----------
    compensation : (..., n) float
        Money; 0 where a request is not offered.
    acceptance : (..., n) float
        Probability that the worker takes each request.
    rejection : (...) float
        Probability that the worker takes none.
    markup : (...) float
        m = value - compensation, the same for every freely priced request, in money.
    profit : (...) float
        Expected profit ``sum_i P_i (v_i - c_i)``, in money.
    """

    compensation: Floats
    acceptance: Floats
    rejection: Floats
    markup: Floats
    profit: Floats

    def __repr__(self) -> str:
        if np.ndim(self.rejection):
            return f"Pricing({np.size(self.rejection):,} decisions, expected profit {np.sum(self.profit):.6g})"
        with np.printoptions(precision=6, threshold=12, edgeitems=3):
            prices = f"compensation={self.compensation}, acceptance={self.acceptance}"
        return f"Pricing({prices}, rejection={self.rejection:.6g}, profit={self.profit:.6g})"

    def to_frame(self) -> pd.DataFrame:
        """One row per request of each decision: ``decision`` (if there are several), ``compensation``, ``acceptance``.

        Examples
        --------
        >>> optimal_prices([5.0, 6.0], [-1.0, -2.0]).to_frame().round(3)
           compensation  acceptance
        0           1.3       0.365
        1           2.3       0.365
        """
        import pandas as pd

        money, taken = np.asarray(self.compensation), np.asarray(self.acceptance)
        columns: dict[str, Any] = {"compensation": money.ravel(), "acceptance": taken.ravel()}
        if money.ndim > 1:
            decision = np.arange(money[..., 0].size)
            columns = {"decision": np.repeat(decision, money.shape[-1]), **columns}
        return pd.DataFrame(columns)

    def _repr_html_(self) -> str:
        many = f"{np.size(self.rejection):,} decisions" if np.ndim(self.rejection) else "one decision"
        title = f"Prices of {many}, expected profit {np.sum(self.profit):.6g} (money)"
        return f"<p>{title}</p>{self.to_frame().to_html(max_rows=10)}"


def optimal_prices(
    value: npt.ArrayLike,
    utility: npt.ArrayLike,
    mu: npt.ArrayLike = 1.0,
    *,
    outside_utility: npt.ArrayLike = 0.0,
    nonnegative: bool | np.bool_ | Literal["clip"] = True,
    offered: npt.ArrayLike | None = None,
) -> Pricing:
    r"""Profit-maximising compensations under multinomial logit.

    Maximises :math:`\sum_i P_i(c) (v_i - c_i)`. The optimum has one markup: :math:`c_i = \max(0, v_i - m)` with
    m = mu + profit, where m solves an equation in Lambert's W (:mod:`optkit.models.pricing.closed_form`).

    Parameters
    ----------
    value : (..., n) float
        What serving request i now is worth before paying for it: reward, less the penalty if it expires now, less its
        opportunity cost. Money.
    utility : (..., n) float
        Mean utility of the request to the worker, in money; ``-inf`` where the worker cannot serve it.
    mu, outside_utility : (...) float
        Noise scale (positive) and utility of rejecting everything, in money; one number, or one per decision.
    nonnegative : True, False or "clip"
        True (default): exact optimum over c >= 0. False: the paper's Lemma 3, prices of either sign. "clip": Lemma 3
        with negative prices set to 0, as the paper does; it can lose money, and is here for comparison.
    offered : (..., n) bool, optional
        Which requests are on offer; all by default.

    Returns
    -------
    Pricing
        With ``compensation``, ``acceptance``, ``rejection``, ``markup`` and ``profit``. With nothing on offer the
        profit is 0, the rejection 1 and the markup mu.

    Raises
    ------
    InputError
        If an entry is not finite (but for ``-inf`` in ``utility``) or a ratio to mu is beyond any float, mu is not
        positive, the mask is not made of True and False, shapes do not fit, or ``nonnegative`` is unknown; or if value
        or profit are so large against mu, above 4.5e15 times, that floats leave no room for a price.

    See Also
    --------
    certify : prove that given prices are optimal.
    optkit.models.pricing_program.PricingProgram : the same problem for a convex solver.

    Notes
    -----
    Paper section 3.2, Lemma 3 and appendix A.3; ``docs/explanation/nonnegative.md``. An offered request with a negative
    value stays on offer at compensation 0, and a worker who likes it may take it: the profit counts that, and may be
    negative.

    What has labels, as pandas' Series and DataFrames have, goes by them: the same labels in another order are brought
    into that of the first argument that has any, which is that of the results; other labels are refused. Arrays and
    lists go by place.

    Examples
    --------
    The paper's clipping loses money; the exact form does not.

    >>> value, utility = [1.0, 2.0, 6.0], [2.0, 1.0, -3.0]
    >>> [optimal_prices(value, utility, nonnegative=how).profit.round(4) for how in (True, "clip")]
    [np.float64(1.3305), np.float64(1.2903)]
    """
    given = Given.of("value", value, utility, mu, outside_utility, offered)
    d = given.decisions()
    if isinstance(nonnegative, np.bool_):
        nonnegative = bool(nonnegative)
    if nonnegative is True:
        found = closed_form.nonnegative(d)
    elif nonnegative is False or (isinstance(nonnegative, str) and nonnegative == "clip"):
        found = closed_form.unconstrained(d)
    else:
        raise InputError(f"nonnegative = {nonnegative!r} is unknown; it is True, False or 'clip'")
    _fine_enough(d, found)
    markup, profit = d.mu * (1.0 + found.ratio), d.mu * found.ratio
    compensation = d.value - markup
    acceptance, rejection = found.acceptance, found.rejection
    if found.held is not None or nonnegative == "clip":
        compensation = np.maximum(compensation, 0.0)
    if nonnegative == "clip":
        acceptance, rejection = softmax_with_outside(given.at(compensation).log_odds)
        profit = (acceptance * (d.value - compensation)).sum(axis=1, keepdims=True)
    if d.offered is not None:
        compensation = np.where(d.offered, compensation, 0.0)
    far = _far(d, acceptance)
    if far.any():
        acceptance, rejection, profit = np.array(acceptance), np.array(rejection).reshape(-1, 1), np.array(profit)
        (profit[far], _), taken = enclosure.earned(given.rows(np.flatnonzero(far)), compensation[far])
        acceptance[far], rejection[far] = taken[:, :-1], taken[:, -1:]
    n = compensation.shape[1]
    return Pricing(
        compensation=compensation.reshape(*d.shape, n),
        acceptance=acceptance.reshape(*d.shape, n),
        rejection=rejection.reshape(d.shape)[()],
        markup=markup.reshape(d.shape)[()],
        profit=profit.reshape(d.shape)[()],
    )


def _far(d: Decisions, acceptance: Floats) -> Bools:
    """Which decisions, (S,), have utilities in play so far from the outside option that their differences lose digits.

    Raises
    ------
    InputError
        If no digits are left.
    """
    if largest(d.logit) <= FAR:
        return np.zeros(len(d.value), bool)
    size = np.where(acceptance > 1e-12, np.abs(d.logit), 0.0)
    lost = size > LOST
    if lost.any():
        s, i = np.argwhere(lost)[0]
        raise InputError(
            f"the utility of request {i} is {size[s, i]:.2g} times mu = {d.mu[s, 0]:g} away from the outside utility: "
            "floats leave no room for differences among requests; a tenth of that says as much"
        )
    return np.asarray((size > FAR).any(axis=1))


def _fine_enough(d: Decisions, found: closed_form.Solution) -> None:
    """Raise an InputError where rounding a price changes what workers do: a price in play is too large against mu."""
    room = FINEST * d.mu
    if largest(d.value) <= room.min(initial=np.inf) and largest(found.ratio) <= FINEST:
        return
    profit = d.mu * found.ratio
    large = np.maximum(np.abs(d.value), np.abs(profit))
    priced = True if found.held is None else d.value - profit > -1e-15 * large
    coarse = priced & (large > room) & (found.acceptance > 1e-12)
    if coarse.any():
        s, i = np.argwhere(coarse)[0]
        raise InputError(
            f"the price of request {i} is of the size of {large[s, i]:g}, {large[s, i] / d.mu[s, 0]:.2g} times "
            f"mu = {d.mu[s, 0]:g}: floats leave no room for one that fine; give a larger mu, or other values"
        )
