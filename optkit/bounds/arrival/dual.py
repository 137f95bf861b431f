"""The arrival-information bound by its Lagrangian dual, in closed form per worker."""

from __future__ import annotations

import time

import numpy.typing as npt

from optkit.bounds.arrival.exact import checked_multipliers
from optkit.bounds.arrival.market import MultiplierCertificate, OpenPairs
from optkit.bounds.arrival.newton import check_options, minimise
from optkit.bounds.bound import Bound, SolverRecord
from optkit.instances.instance import Instance


def arrival_dual(
    instance: Instance,
    *,
    tolerance: float = 1e-9,
    max_iterations: int = 500,
    multipliers: npt.ArrayLike | None = None,
) -> Bound:
    r"""Bound from above what any policy earns, in the mean over the noise, by letting it know all arrivals.

    Given the arrivals, a policy's mean acceptance probabilities are feasible for the concave program of
    :mod:`optkit.bounds.arrival.market`, whose optimum this computes through its dual

    .. math:: D(l) = \sum_i \beta_i + \sum_i l_i + \sum_t \mu_t W_0\Big(\sum_i e^{(a_{ti} - l_i)/\mu_t - 1}\Big),
              \quad l \ge 0.

    Parameters
    ----------
    instance : Instance
        Its noise, if realised, is not looked at.
    tolerance : float
        Largest gap to the program's optimum, as a part of what the bound adds to paying all penalties.
    max_iterations : int
        Newton steps after which to stop; the bound is valid then too, but looser.
    multipliers : (n,) float, optional
        Prices l_i >= 0 to begin with, in money, for example those of a similar instance.

    Returns
    -------
    Bound
        Its ``value`` (money) is D(l) as the certificate, a
        :class:`~optkit.bounds.arrival.market.MultiplierCertificate`, proves it. ``solver.status`` is ``"optimal"``
        where the gap is within the tolerance, and otherwise says why not; ``solver.details`` has the certified gap in
        money.

    Raises
    ------
    InputError
        If the tolerance or the number of steps is not positive, or the multipliers are not n finite numbers >= 0.

    See Also
    --------
    optkit.bounds.arrival.program : the same program for a conic solver.

    Notes
    -----
    ``docs/explanation/bounds.md``, "Arrival information". Compensations of either sign are allowed here.
    Demanding c >= 0 per worker would be valid only with the option to withhold requests, which may be gone in truth.
    Where utilities are well below the outside option it changes nothing; in nyc-strong it would lower the bound by
    0.006 % at most.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds import full_information
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> bound = arrival_dual(day)
    >>> bound.solver.status, bound.value < full_information(day).value
    ('optimal', True)
    """
    started = time.perf_counter()
    check_options(tolerance, max_iterations)
    market = OpenPairs.of(instance)
    start = None if multipliers is None else checked_multipliers(multipliers, instance.n_requests)
    solved = minimise(market, tolerance, max_iterations, start)
    certificate = MultiplierCertificate(solved.multipliers)
    verdict = market.verdict(solved.multipliers)
    details = {"iterations": solved.iterations, "pairs": market.size, "gap": verdict.gap}
    record = SolverRecord("lagrangian", solved.status, time.perf_counter() - started, details)
    return Bound(verdict.bound, "arrival information", certificate, record)
