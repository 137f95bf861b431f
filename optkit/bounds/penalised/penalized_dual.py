r"""Arrival-information bounds whose foresight is paid for by charges linear in openness.

With :math:`Q_i(s)` as in :mod:`optkit.bounds.penalised.linear_charges`, the dual of :mod:`optkit.bounds.arrival.market`
becomes

.. math:: D_\theta(l) = \sum_i \big(\beta_i - Q_i(\text{arrival}_i) + l_i\big)
          + \sum_t \mu_t W_0\Big(\sum_i e^{(a_{ti} + Q_i(t) - l_i)/\mu_t - 1}\Big), \quad l \ge 0,

jointly convex in theta and l.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from optkit.basics.arrays import Floats
from optkit.bounds.arrival.market import OpenPairs
from optkit.bounds.arrival.newton import check_options, minimise
from optkit.bounds.bound import Bound, SolverRecord, Verdict
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.bounds.rounding import sum_up
from optkit.instances.instance import Instance

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class ChargedMultipliers:
    """A price l_i >= 0 on "request i is served at most once", under charges: a proof of a path's bound.

    Attributes
    ----------
    multipliers : (n,) float
        l_i, in money.
    charges : LinearCharges
        What foresight costs.
    """

    proves = "penalised arrival information"

    multipliers: Floats
    charges: LinearCharges

    def check(self, instance: Instance) -> Verdict:
        """Recompute the dual from the instance; its noise is not looked at.

        Returns
        -------
        Verdict
            The path's bound. That it bounds the mean over paths follows from the mean of the charges, which is zero if
            the instances come from the distribution in ``charges``.

        Raises
        ------
        InputError
            If there are not n multipliers, one is NaN or infinite, or the charges are for other groups.
        """
        market, paid = charged_market(instance, self.charges)
        verdict = market.verdict(self.multipliers)
        return Verdict(sum_up([verdict.bound, -paid]), verdict.attained - paid, verdict.residual)


def penalized_dual(
    instance: Instance, charges: LinearCharges, *, tolerance: float = 1e-9, max_iterations: int = 500
) -> Bound:
    """Bound the mean reward of any policy by the mean of this over independent instances.

    It is :func:`~optkit.bounds.arrival.dual.arrival_dual` with foresight paid for: milliseconds an instance, at any
    number of open requests. A single instance's value bounds nothing.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    charges : LinearCharges
        From :func:`optkit.bounds.penalised.charge_fit.fit_linear_charges`, fitted to other instances.
    tolerance, max_iterations : float, int
        As in :func:`~optkit.bounds.arrival.dual.arrival_dual`; a bound is valid wherever it stops.

    Raises
    ------
    InputError
        If the tolerance or the number of steps is not positive, or the charges are for other groups.

    Notes
    -----
    Not in the paper; ``docs/explanation/bounds.md``, "Charging for foresight".

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.arrival.dual import arrival_dual
    >>> from optkit.bounds.penalised.foresight import Foresight, fifo_presence
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> free = LinearCharges(np.zeros((1, 2, 2)), [50.0, 90.0], [1.0, 9.0], Foresight(fifo_presence(0.5), [1.0]))
    >>> bool(np.isclose(penalized_dual(day, free).value, arrival_dual(day).value))
    True
    """
    started = time.perf_counter()
    check_options(tolerance, max_iterations)
    market, paid = charged_market(instance, charges)
    solved = minimise(market, tolerance, max_iterations)
    verdict = market.verdict(solved.multipliers)
    details = {"iterations": solved.iterations, "pairs": market.size, "gap": verdict.gap, "paid": paid}
    record = SolverRecord("lagrangian", solved.status, time.perf_counter() - started, details)
    certificate = ChargedMultipliers(solved.multipliers, charges)
    return Bound(sum_up([verdict.bound, -paid]), "penalised arrival information", certificate, record)


def charged_market(instance: Instance, charges: LinearCharges) -> tuple[OpenPairs, float]:
    """The market with each pair worth what it spares, and what is paid if nothing is served, less rounding; money."""
    basis, theta = charges.basis(instance), charges.theta.ravel()
    market = OpenPairs.of(instance)
    spared = basis.pairs @ theta
    size = float(basis.magnitude @ np.abs(theta))
    rounding = EPS * (theta.size + 2) * size
    charged = replace(market, advantage=market.advantage + spared, money=market.money + np.abs(spared))
    return charged, float(basis.total @ theta) - rounding
