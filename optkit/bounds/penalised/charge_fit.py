r"""Coefficients of linear charges by convex minimisation of the mean penalised dual over training instances.

:math:`\min_{l \ge 0} D_\theta(l)` of :mod:`optkit.bounds.penalised.penalized_dual` is convex in theta, and by Danskin's
theorem its gradient at the best l is that of D alone: with P_ti the acceptances and B the charges per unit of theta
(:class:`optkit.bounds.penalised.linear_charges.ChargeBasis`),

.. math:: \nabla_\theta = \sum_{ti} P_{ti} B_{ti} - B_{\text{total}}.

What is paid if nothing is served, :math:`B_{\text{total}}\theta`, has mean zero. Its mean over the training
instances is luck, which coefficients would chase: where dozens of requests wait they chased nothing else. So a first
fit tells how much of it the dual takes back where it serves, and a second one leaves out as much as makes the mean
vary least, a control variate.

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
    time_knots: Sequence[float] | None = None,
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
    time_knots : sequence of float, optional
        Knots in steps left; by default one step, the instances' mean lifetime, and their geometric mean.
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
    ``docs/explanation/bounds.md``, "Charging for foresight".

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.arrival.dual import arrival_dual
    >>> from optkit.bounds.penalised.foresight import fifo_presence
    >>> from optkit.bounds.penalised.penalized_dual import penalized_dual
    >>> days = scenario("I.1", seed=0, horizon=20).sample(20, seed=1)
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
    left = _lifetimes(instances) if time_knots is None else floats("time_knots", time_knots, (None,))
    shape = (1 if request_rate is None else 2, spots.size, left.size)
    charges = LinearCharges(np.zeros(shape), spots, left, foresight, request_rate)
    mean = _MeanDual(instances, charges)
    theta = mean.minimum(np.zeros(charges.theta.size), ridge, max_iterations)
    mean.leave_out_luck(theta)
    return replace(charges, theta=mean.minimum(theta, ridge, max_iterations).reshape(shape))


def _spread(instances: Sequence[Instance], surplus_knots: int | Sequence[float]) -> npt.NDArray[np.float64]:
    """Knots in money, given or spread."""
    if np.ndim(surplus_knots):
        return floats("surplus_knots", surplus_knots, (None,))
    spots = whole_number("surplus_knots", surplus_knots, least=2)
    surplus = [one.surplus.ravel() for one in instances]
    low, high = np.quantile(np.concatenate(surplus), [0.03, 0.97])
    return np.linspace(low, max(high, low + 1e-6), spots)


def _lifetimes(instances: Sequence[Instance]) -> Floats:
    """Knots in steps left: 1, and up to the mean lifetime of the requests that can wait."""
    lifetime = np.concatenate([one.expiry - one.arrival for one in instances])
    return np.geomspace(1.0, max(float(lifetime[lifetime > 0].mean()), 4.0) if lifetime.any() else 4.0, 3)


class _MeanDual:
    """The mean penalised dual of some instances as a function of theta; it remembers the last multipliers."""

    def __init__(self, instances: Sequence[Instance], charges: LinearCharges) -> None:
        self._instances, self._charges = instances, charges
        self._multipliers: Floats | None = None
        self.luck = 1.0
        """How much of what is paid if nothing is served counts: any share of it has mean zero."""

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
        """Charges per unit of all pairs, (p, K), and each instance's total, (n, K)."""
        bases = [self._charges.basis(one) for one in self._instances]
        return np.concatenate([basis.pairs for basis in bases]), np.array([basis.total for basis in bases])

    def minimum(self, theta: Floats, ridge: float, max_iterations: int) -> Floats:
        """The coefficients at which it is least, (K,), from some on."""
        from scipy.optimize import minimize

        found = minimize(
            self.with_gradient,
            theta,
            args=(ridge,),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": max_iterations, "ftol": INNER / 10},
        )
        return np.asarray(found.x)

    def leave_out_luck(self, theta: Floats) -> None:
        """Let as much of the luck count as makes the mean vary least from sample to sample, at these charges."""
        luck = self._basis[1] @ theta
        gain = self._gains(theta) - self._gains(np.zeros(theta.size))
        if luck.size > 2 and luck.var() > 0:
            self.luck = float(np.clip(np.cov(gain, luck)[0, 1] / luck.var(ddof=1), 0.0, 1.0))

    def _gains(self, theta: Floats) -> Floats:
        """Each instance's dual beyond the penalties and what is paid if nothing is served, (n,), money."""
        market = replace(self._market, advantage=self._market.advantage + self._basis[0] @ theta)
        if not market.size:
            return np.zeros(len(self._instances))
        multipliers = minimise(market, INNER, INNER_STEPS, self._multipliers).multipliers
        ratio, _ = market.respond(multipliers)
        parts = [OpenPairs.of(one) for one in self._instances]
        of = [
            np.repeat(np.arange(len(parts)), [x.size for x in side])
            for side in ([part.count for part in parts], [part.mu for part in parts])
        ]
        earned = np.bincount(of[1], market.presence * market.mu * ratio, len(parts))
        return np.asarray(np.bincount(of[0], market.count * multipliers, len(parts)) + earned)

    def with_gradient(self, theta: Floats, ridge: float) -> tuple[float, Floats]:
        """Mean dual beyond the penalties, plus the ridge, money, and its gradient in theta, (K,)."""
        (pairs, totals), n = self._basis, len(self._instances)
        total = self.luck * totals.sum(axis=0)
        value, slope = -float(total @ theta), -total
        if self._market.size:
            market = replace(self._market, advantage=self._market.advantage + pairs @ theta)
            solved = minimise(market, INNER, INNER_STEPS, self._multipliers)
            self._multipliers = solved.multipliers
            ratio, acceptance = market.respond(solved.multipliers)
            value, slope = value + market.gain(solved.multipliers, ratio), slope + acceptance @ pairs
        return value / n + 0.5 * ridge * float(theta @ theta), slope / n + ridge * theta
