r"""Coefficients of linear charges by convex minimisation of the mean penalised dual over training instances.

:math:`\min_{l \ge 0} D_\theta(l)` of :mod:`optkit.bounds.penalised.penalized_dual` is convex in theta, and by Danskin's
theorem its gradient at the best l is that of D alone: with P_ti the acceptances and B the charges per unit of theta
(:class:`optkit.bounds.penalised.linear_charges.ChargeBasis`),

.. math:: \nabla_\theta = \sum_{ti} P_{ti} B_{ti} - B_{\text{total}}.

All instances are one market, because they share no request, so that each step is one run of Newton's method from where
the last one ended (pathwise optimisation: Desai, Farias and Moallemi 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, floats, number, whole_number
from optkit.basics.errors import InputError
from optkit.bounds.arrival.market import OpenPairs
from optkit.bounds.arrival.newton import minimise
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.instances.instance import Instance

INNER = 1e-6
"""Tolerance of the dual at each theta: less than what theta still changes when it is left."""

INNER_STEPS = 200
"""Newton steps of the dual at each theta, at most; one that stops early is a bound all the same."""


def fit_linear_charges(
    instances: Sequence[Instance],
    foresight: Foresight,
    request_rate: float | None = None,
    *,
    surplus_knots: int | Sequence[float] = 2,
    time_knots: Sequence[float] = (1.0, 3.0, 10.0),
    ridge: float = 0.01,
    max_iterations: int = 50,
) -> LinearCharges:
    """Choose the charges that make the mean penalised dual of some instances least.

    They are to be used on *other* instances: here they also fit the luck of these, and the more coefficients there are
    the more so. 12 coefficients on 480 instances of scenario I.1 take a fifth more off here than on fresh ones.

    Parameters
    ----------
    instances : sequence of Instance
        To train on; their noise is not looked at.
    foresight : Foresight
        How workers come.
    request_rate : float, optional
        Mean number of requests that arrive in a step; None charges for workers only.
    surplus_knots : int or sequence of float
        Knots in money, or how many to spread over the surplus, 3 to 97 per cent quantile; at least 2.
    time_knots : sequence of float
        Knots in steps left.
    ridge : float
        The mean dual plus ``ridge / 2`` times the sum of squared coefficients is minimised, at least 0; both are money,
        so that it is to be divided by a factor on the currency.
    max_iterations : int
        Steps of L-BFGS. Any theta is valid.

    Raises
    ------
    InputError
        If there are no instances or requests, or an argument is out of range.

    Notes
    -----
    Design section 4, "Penalised bound".

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.arrival.dual import arrival_dual
    >>> from optkit.bounds.penalised.foresight import fifo_presence
    >>> from optkit.bounds.penalised.penalized_dual import penalized_dual
    >>> days = scenario("I.1", seed=0).sample(40, seed=1)
    >>> charges = fit_linear_charges(days, Foresight(fifo_presence(0.5), [1.0]), 0.5)
    >>> free, charged = (np.mean([bound(day).value for day in days])
    ...                  for bound in (arrival_dual, lambda day: penalized_dual(day, charges)))
    >>> bool(charged < free)
    True
    """
    if not any(one.n_requests for one in instances):
        raise InputError("charges need instances with requests to be fitted to")
    ridge, max_iterations = number("ridge", ridge, least=0.0), whole_number("max_iterations", max_iterations, least=0)
    spots = _spread(instances, surplus_knots)
    shape = (1 if request_rate is None else 2, spots.size, len(time_knots))
    charges = LinearCharges(np.zeros(shape), spots, floats("time_knots", time_knots, (None,)), foresight, request_rate)
    from scipy.optimize import minimize

    mean = _MeanDual(instances, charges)
    found = minimize(
        mean.with_gradient,
        np.zeros(charges.theta.size),
        args=(ridge,),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": max_iterations, "ftol": INNER / 10},
    )
    return replace(charges, theta=found.x.reshape(shape))


def _spread(instances: Sequence[Instance], surplus_knots: int | Sequence[float]) -> npt.NDArray[np.float64]:
    """Knots in money, given or spread."""
    if np.ndim(surplus_knots):
        return floats("surplus_knots", surplus_knots, (None,))
    spots = whole_number("surplus_knots", surplus_knots, least=2)
    surplus = [one.surplus.ravel() for one in instances]
    low, high = np.quantile(np.concatenate(surplus), [0.03, 0.97])
    return np.linspace(low, max(high, low + 1e-6), spots)


class _MeanDual:
    """The mean penalised dual of some instances as a function of theta; it remembers the last multipliers."""

    def __init__(self, instances: Sequence[Instance], charges: LinearCharges) -> None:
        self._instances, self._charges = instances, charges
        self._multipliers: Floats | None = None

    @cached_property
    def _market(self) -> OpenPairs:
        """All instances side by side."""
        parts = [OpenPairs.of(one) for one in self._instances]
        workers = np.cumsum([0, *(part.mu.size for part in parts)])
        requests = np.cumsum([0, *(part.count.size for part in parts)])

        return OpenPairs(
            worker=np.concatenate([part.worker + first for part, first in zip(parts, workers, strict=False)]),
            request=np.concatenate([part.request + first for part, first in zip(parts, requests, strict=False)]),
            advantage=np.concatenate([part.advantage for part in parts]),
            money=np.concatenate([part.money for part in parts]),
            mu=np.concatenate([part.mu for part in parts]),
            presence=np.concatenate([part.presence for part in parts]),
            count=np.concatenate([part.count for part in parts]),
            constant=sum(part.constant for part in parts),
        )

    @cached_property
    def _basis(self) -> tuple[Floats, Floats]:
        """Charges per unit of all pairs, (p, K), and their totals' sum, (K,)."""
        bases = [self._charges.basis(one) for one in self._instances]
        return np.concatenate([basis.pairs for basis in bases]), np.sum([basis.total for basis in bases], axis=0)

    def with_gradient(self, theta: Floats, ridge: float) -> tuple[float, Floats]:
        """Mean dual beyond the penalties, plus the ridge, money, and its gradient in theta, (K,)."""
        (pairs, total), n = self._basis, len(self._instances)
        value, slope = -float(total @ theta), -total
        if self._market.size:
            market = replace(self._market, advantage=self._market.advantage + pairs @ theta)
            solved = minimise(market, INNER, INNER_STEPS, self._multipliers)
            self._multipliers = solved.multipliers
            ratio, acceptance = market.respond(solved.multipliers)
            value, slope = value + market.gain(solved.multipliers, ratio), slope + acceptance @ pairs
        return value / n + 0.5 * ridge * float(theta @ theta), slope / n + ridge * theta
