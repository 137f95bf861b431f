r"""Arrival- and full-information bounds whose foresight is paid for by charges linear in openness.

With :math:`Q_i(s)` as in :mod:`optkit.bounds.penalised.linear_charges`, the dual of :mod:`optkit.bounds.arrival.market`
becomes

.. math:: D_\theta(l) = \sum_i \big(\beta_i - Q_i(\text{arrival}_i) + l_i\big)
          + \sum_t \mu_t W_0\Big(\sum_i e^{(a_{ti} + Q_i(t) - l_i)/\mu_t - 1}\Big), \quad l \ge 0,

jointly convex in theta and l, and the full-information bound the same matching with values :math:`v_{ij} + Q_i(s_j)`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.basics.errors import InputError
from optkit.bounds.arrival.market import OpenPairs
from optkit.bounds.arrival.newton import check_options, minimise
from optkit.bounds.bound import Bound, SolverRecord, Verdict
from optkit.bounds.full.edges import Edges, pair_values
from optkit.bounds.full.shadow_prices import repair
from optkit.bounds.full.windows import solve_by_windows, value_of_pairs
from optkit.bounds.penalised.linear_charges import LinearCharges
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
        return Verdict(verdict.bound - paid, verdict.attained - paid, verdict.residual)


@dataclass(frozen=True, eq=False)
class ChargedAssignment:
    """A matching of requests to workers under charges, and prices that show none is better.

    Attributes
    ----------
    worker, request : (m,) int
        The pairs that are matched.
    request_dual : (n,) float
        Shadow prices y, in money; see :class:`optkit.bounds.full.assignment.AssignmentCertificate`.
    charges : LinearCharges
        What foresight costs.
    """

    worker: Ints
    request: Ints
    request_dual: Floats
    charges: LinearCharges

    def check(self, instance: Instance) -> Verdict:
        """Recompute everything from the instance.

        Returns
        -------
        Verdict
            The path's bound, see :meth:`ChargedMultipliers.check`. ``residual`` is how often too often a request or a
            worker is used, or 1 if a pair is worth nothing or never meets; ``attained`` is ``-inf`` then.

        Raises
        ------
        InputError
            If there are not n prices, one is NaN, or the charges are for other groups.
        InstanceError
            If the noise is not realised.
        """
        graph = charged_edges(instance, self.charges)
        prices = np.asarray(self.request_dual, float)
        if prices.shape != (graph.n_requests,) or np.isnan(prices).any():
            raise InputError(f"request_dual has shape {prices.shape}: give each of the {graph.n_requests} a number")
        y, z = repair(graph, prices)
        bound = graph.constant + float(y.sum()) + float(z.sum())
        known = np.isin(self.worker * graph.n_requests + self.request, graph.worker * graph.n_requests + graph.request)
        if not known.all():
            return Verdict(bound, -np.inf, 1.0)
        overuse = max(np.bincount(side).max(initial=1) - 1 for side in (self.worker, self.request))
        earned = float(value_of_pairs(graph, self.worker, self.request).sum())
        return Verdict(bound, -np.inf if overuse else graph.constant + earned, float(overuse))


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
    Design section 4, "Penalised bound"; not in the paper.

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
    return Bound(verdict.bound - paid, "penalised arrival information", certificate, record)


def penalized_assignment(instance: Instance, charges: LinearCharges) -> Bound:
    """Bound the mean reward of any policy by the mean of this: full information, with arrivals paid for.

    It stays a matching. Who knows the noise too is not charged for that, so the bound is far above
    :func:`penalized_dual`.

    Parameters
    ----------
    instance : Instance
        With its noise realised.
    charges : LinearCharges
        Fitted to other instances.

    Raises
    ------
    InputError
        If the charges are for other groups.
    InstanceError
        If the noise is not realised.
    SolverError
        If the matching is not proven optimal.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds import full_information
    >>> from optkit.bounds.penalised.foresight import Foresight, fifo_presence
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> free = LinearCharges(np.zeros((1, 2, 2)), [50.0, 90.0], [1.0, 9.0], Foresight(fifo_presence(0.5), [1.0]))
    >>> bool(np.isclose(penalized_assignment(day, free).value, full_information(day).value))
    True
    """
    started = time.perf_counter()
    graph = charged_edges(instance, charges)
    nobody = np.zeros(0, np.int64)
    certificate = ChargedAssignment(nobody, nobody, np.zeros(graph.n_requests), charges)
    if graph.size:
        found = solve_by_windows(graph)
        certificate = ChargedAssignment(found.worker, found.request, found.request_dual, charges)
    y, z = repair(graph, certificate.request_dual)
    value = graph.constant + float(y.sum()) + float(z.sum())
    details = {"edges": graph.size}
    record = SolverRecord("assignment", "certified", time.perf_counter() - started, details)
    return Bound(value, "penalised full information", certificate, record)


def charged_market(instance: Instance, charges: LinearCharges) -> tuple[OpenPairs, float]:
    """The market with each pair worth what it spares, and what is paid if nothing is served, less rounding; money."""
    basis, theta = charges.basis(instance), charges.theta.ravel()
    market = OpenPairs.of(instance)
    spared = basis.pairs @ theta
    size = float(basis.magnitude @ np.abs(theta))
    rounding = EPS * (theta.size + 2) * size
    charged = replace(market, advantage=market.advantage + spared, money=market.money + np.abs(spared))
    return charged, float(basis.total @ theta) - rounding


def charged_edges(instance: Instance, charges: LinearCharges) -> Edges:
    """The graph of an instance with noise, each pair worth what it spares too; its constant is less what is paid."""
    worker, request, value = pair_values(instance)
    spared, paid = charges.shifts(instance)
    value = value + spared
    keep = value > 0
    constant = float(instance.penalty.sum()) - paid
    return Edges(worker[keep], request[keep], value[keep], instance.n_workers, instance.n_requests, constant)
