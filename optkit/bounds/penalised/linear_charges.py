r"""Charges for foresight that are linear in which requests are still open.

After step t a request i that is still open is charged

.. math:: q_i(t+1) = \theta \cdot \psi(\text{surplus}_i, \text{steps left}_i) \,
          (\xi_{t+1} - E[\xi_{t+1} \mid \text{past}])

with xi whether a worker comes next and how many requests arrive, and psi products of hat functions
(``docs/explanation/bounds.md``, "Charging for foresight"). Its mean is zero whatever one does without foresight, for
any theta. Serving the request at step s spares :math:`Q_i(s)`, the sum of q_i(t+1) over s <= t < expiry_i, so that a
program which values each service on its own keeps its form: pairs are worth Q more, and ``sum_i Q_i(arrival_i)`` is
subtracted, see :mod:`optkit.bounds.penalised.penalized_dual`. A request's surplus, where a worker comes, is that to the
worker's own group.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, floats, number
from optkit.bounds.penalised.foresight import Foresight
from optkit.instances.instance import Instance
from optkit.models.value.ranked_term import hats, knots


class ChargeBasis(NamedTuple):
    """What one instance is charged per unit of each of the K coefficients.

    Attributes
    ----------
    pairs : (p, K) float
        What each compatible pair of a worker and a request spares, in the order of :meth:`optkit.Instance.pairs`.
    total : (K,) float
        What is paid if nothing is served. Its mean over instances is zero: a control variate.
    magnitude : (K,) float
        The same with every term positive, for the rounding.
    """

    pairs: Floats
    total: Floats
    magnitude: Floats


@dataclass(frozen=True, eq=False)
class DayCharges:
    """Linear charges of one instance: what waits is charged for by itself.

    Attributes
    ----------
    instance : Instance
    so_far : (m + 1,) float
        Running sums of the charges of all requests, one after the other, step by step, money.
    start : (n,) int
        Where each request's begin.
    """

    instance: Instance
    so_far: Floats
    start: Ints

    def __call__(self, step: int, requests: Ints) -> Floats:
        """Charge of every subset of the k requests that wait after a step, (2^k,), money."""
        at = self.start[requests] + step - self.instance.arrival[requests]
        table = np.zeros(1)
        for one in self.so_far[at + 1] - self.so_far[at]:
            table = np.concatenate([table, table + one])
        return table

    def idle(self, steps: Ints) -> float:
        """Charge after steps at which nothing waits: nothing."""
        return 0.0

    def along(self, last: npt.ArrayLike) -> Floats:
        """Charge of M runs, (M,), money; ``last`` as in :meth:`LinearCharges.along`."""
        waited = np.maximum(np.asarray(last) - self.instance.arrival + 1, 0)
        return np.asarray((self.so_far[self.start + waited] - self.so_far[self.start]).sum(axis=1))


@dataclass(frozen=True, eq=False)
class LinearCharges:
    """Charges linear in openness, for any instance of one distribution.

    Parameters
    ----------
    theta : (1 or 2, a, b) float
        Coefficients in money: of a worker's presence and, if ``request_rate`` is known, of each new request.
    surplus_knots : (a,) float, increasing
        Knots in ``r - beta + u - u_0``, money.
    time_knots : (b,) float, increasing
        Knots in steps left after the one that has been decided.
    foresight : Foresight
        How workers come; its pool of arrivals plays no part.
    request_rate : float, optional
        Mean number of requests that arrive in a step, independently of the past. Unless it is given, only workers are
        charged for.

    Raises
    ------
    InputError
        If a shape is wrong, a coefficient is not finite, or the rate is no number of at least 0.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.penalised.foresight import fifo_presence
    >>> workers = Foresight(fifo_presence(0.5), [1.0])
    >>> charges = LinearCharges(np.ones((2, 2, 2)), [50.0, 90.0], [1.0, 9.0], workers, 0.5)
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> spared, paid = charges.shifts(day)
    >>> spared.shape == day.pairs()[0].shape
    True
    """

    theta: Floats
    surplus_knots: Floats
    time_knots: Floats
    foresight: Foresight
    request_rate: float | None = None

    def __post_init__(self) -> None:
        for name in ("surplus_knots", "time_knots"):
            object.__setattr__(self, name, knots(name, getattr(self, name)))
        if self.request_rate is not None:
            object.__setattr__(self, "request_rate", number("request_rate", self.request_rate, least=0.0))
        shape = (1 if self.request_rate is None else 2, self.surplus_knots.size, self.time_knots.size)
        object.__setattr__(self, "theta", floats("theta", self.theta, shape))

    def basis(self, instance: Instance) -> ChargeBasis:
        """Charges per unit of each coefficient, in the order of ``theta.ravel()``; the noise is not looked at.

        Raises
        ------
        InputError
            If the instance has other groups than the foresight.
        """
        terms, start, length = self._terms(instance)
        so_far = np.concatenate([np.zeros((1, terms.shape[1])), np.cumsum(terms, axis=0)])
        worker, request = instance.pairs()
        at = start[request] + instance.worker_step[worker] - instance.arrival[request]
        pairs = so_far[(start + length)[request]] - so_far[at]
        return ChargeBasis(pairs, terms.sum(axis=0), np.abs(terms).sum(axis=0))

    def shifts(self, instance: Instance) -> tuple[Floats, float]:
        """What each compatible pair spares, (p,), and what is paid if nothing is served, money."""
        basis = self.basis(instance)
        theta = self.theta.ravel()
        return basis.pairs @ theta, float(basis.total @ theta)

    def along(self, instance: Instance, last: npt.ArrayLike) -> Floats:
        """Charge of M runs, (M,), money.

        Parameters
        ----------
        instance : Instance
            Whose runs they are.
        last : (M, n) int
            Last step after which each request was still open; below its arrival if it never was.
        """
        return self.on(instance).along(last)

    def on(self, instance: Instance) -> DayCharges:
        """Charges of one instance, as inductions over subsets of its requests take them."""
        terms, start, _ = self._terms(instance)
        return DayCharges(instance, np.concatenate([[0.0], np.cumsum(terms @ self.theta.ravel())]), start)

    def _terms(self, instance: Instance) -> tuple[Floats, Ints, Ints]:
        """Charges per unit for each request and each step it may wait after, and where each request's begin.

        Shapes are (m, K), (n,) and (n,): the last is the number of such steps.
        """
        seen = self.foresight.of_workers(instance)
        length = instance.expiry - instance.arrival
        start = np.cumsum(length) - length
        i = np.repeat(np.arange(instance.n_requests), length)
        step = instance.arrival[i] + np.arange(i.size) - start[i]
        now = step + 1
        surplus = instance.surplus.T
        by_group = hats(surplus, self.surplus_knots)  # (n, D, a)
        expected = np.einsum("nda,d->na", by_group, self.foresight.share)
        came = np.where((seen.group[now] >= 0)[:, None], by_group[i, seen.group[now]], 0.0)
        surprise = [came - seen.presence[now, None] * expected[i]]
        if self.request_rate is not None:
            arrived = np.bincount(instance.arrival, minlength=instance.steps)
            surprise.append(expected[i] * (arrived[now] - self.request_rate)[:, None])
        left = hats((instance.expiry[i] - step).astype(float), self.time_knots)
        terms = np.stack(surprise, axis=1)[..., None] * left[:, None, None, :]
        return terms.reshape(i.size, self.theta.size), start, length
