"""The arrival-information bound: what one earns in the mean who knows every arrival in advance, but no noise."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.basics.errors import InputError
from optkit.bounds.arrival.exact import EXACT_LIMIT, arrival_exact, check_limit, checked_multipliers, solve_subsets
from optkit.bounds.arrival.lattice import lattice_bits
from optkit.bounds.bound import Bound
from optkit.instances.instance import Instance

if TYPE_CHECKING:
    from optkit.bounds.arrival.market import MultiplierCertificate

HYBRID_LIMIT = 14
"""Tracked requests at a worker of the hybrid: on I.3 it then lies 0.02 % above the exact bound at most."""

Method = Literal["exact", "hybrid", "lagrangian", "program"]

STATES = 1 << 24
"""States of all workers together that the default goes up to: seconds, and 256 MB while they are solved."""


def arrival_information(instance: Instance, method: Method | None = None) -> Bound:
    """Bound from above what any policy earns in the mean over the noise, by letting it know all arrivals.

    Unlike the full-information bound it need not hold for a single draw of the noise, and is much tighter in the mean.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    method : {None, "exact", "hybrid", "lagrangian", "program"}
        ``"exact"``: backward induction over the subsets of open requests
        (:func:`optkit.bounds.arrival.exact.arrival_exact`). ``"hybrid"``: the same for the most wanted requests, and
        multipliers for the others (:func:`arrival_hybrid`). ``"lagrangian"``: multipliers for all, at any scale
        (:func:`optkit.bounds.arrival.dual.arrival_dual`). ``"program"``: the same bound as a CVXPY program. By default
        the first of these that the size allows; ``solver.details["why"]`` then tells the size.

    Returns
    -------
    Bound
        ``value`` in money. The exact bound is the tightest, the Lagrangian one the loosest.

    Raises
    ------
    InputError
        If the method is unknown.
    SolverError
        If ``"exact"`` is asked for and too many requests are open at once.

    Notes
    -----
    ``docs/explanation/bounds.md``, "Arrival information". Not in the paper.

    Examples
    --------
    >>> from optkit import scenario
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> bound = arrival_information(day)
    >>> bound.solver.method, bound.solver.details["largest_lattice"] <= 18
    ('exact', True)
    """
    if method == "exact":
        return arrival_exact(instance)
    if method == "hybrid":
        return arrival_hybrid(instance)
    if method == "program":
        from optkit.bounds.arrival.program import arrival_program

        return arrival_program(instance)
    if method == "lagrangian":
        return _lagrangian(instance)
    if method is not None:
        raise InputError(f'method = {method!r} is unknown: take "exact", "hybrid", "lagrangian" or "program"')
    bits = lattice_bits(instance)
    most = int(bits.max(initial=0))
    size = f"{most} requests at most may or may not have been served when a worker comes, {_states(bits):.3g} states"
    if most <= EXACT_LIMIT and _states(bits) <= STATES:
        return _because(arrival_exact(instance), size)
    dual = _lagrangian(instance)
    prices = _multipliers(dual)
    for limit in range(HYBRID_LIMIT, 0, -2):
        if _states(lattice_bits(instance, choose_tracked(instance, prices, limit))) <= STATES:
            return _because(arrival_hybrid(instance, limit=limit, multipliers=prices), size)
    return _because(dual, size)


def arrival_hybrid(
    instance: Instance,
    *,
    limit: int = HYBRID_LIMIT,
    multipliers: npt.ArrayLike | None = None,
    nonnegative: bool = True,
) -> Bound:
    """Track the requests that are most wanted, and let multipliers keep the others from being served twice.

    The others are offered in their whole windows, served or not, but each service costs l_i, and l_i is paid back once:

        ``bound = sum_i (beta_i + l_i) + W_0,   v_i = r_i - beta_i - l_i - opportunity cost,   l_i = 0 if tracked.``

    Any l >= 0 is valid: whatever a policy does can be done here, without offering what it has served. A request that it
    serves then earns ``r_i - c_i`` as it should, and one that it does not serve, ``beta_i + l_i >= beta_i``. (To not
    offer a request is a price of minus infinity, so that only tracked requests have the constraint c >= 0.) With
    everything tracked this is the exact bound, with nothing the Lagrangian dual D(l).

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    limit : int
        Largest number of tracked requests that are uncertain at a worker. Requests are taken in decreasing order of
        their multipliers, as long as they fit.
    multipliers : (n,) float, optional
        l >= 0, in money; those of the Lagrangian dual by default. Tuning them again for the others gained a tenth of
        the remaining gap on I.3 at most, and tracking a request in a part of its window a quarter at most.
    nonnegative : bool
        Whether the compensations of tracked requests must be at least 0.

    Returns
    -------
    Bound
        With a :class:`~optkit.bounds.arrival.exact.SubsetCertificate`; ``solver.details`` has the number of ``tracked``
        requests besides the sizes that :func:`~optkit.bounds.arrival.exact.arrival_exact` reports.

    Raises
    ------
    InputError
        If a multiplier is negative or not finite, or their number is wrong.

    Examples
    --------
    >>> from optkit import scenario
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> bool(arrival_hybrid(day, limit=2).value >= arrival_exact(day).value)
    True
    """
    started = time.perf_counter()
    check_limit(limit)
    if multipliers is None:
        prices = _multipliers(_lagrangian(instance))
    else:
        prices = checked_multipliers(multipliers, instance.n_requests)
    tracked = choose_tracked(instance, prices, limit)
    return solve_subsets(instance, "hybrid", tracked, np.where(tracked, 0.0, prices), nonnegative, limit, started)


def choose_tracked(instance: Instance, priority: Floats, limit: int) -> Bools:
    """Take requests in decreasing order of priority (n,) while at most ``limit`` are uncertain at any worker, (n,).

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 0], expiry=[3, 1], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[1.0])
    >>> choose_tracked(day, np.array([8.0, 9.0]), limit=0)  # the second meets one worker: there is nothing to remember
    array([False,  True])
    """
    first = np.searchsorted(instance.worker_step, instance.arrival, side="left") + 1
    end = np.searchsorted(instance.worker_step, instance.expiry, side="right")
    load = np.zeros(instance.n_workers, np.int64)
    tracked = np.zeros(instance.n_requests, bool)
    for i in np.argsort(-priority, kind="stable"):
        window = load[first[i] : end[i]]
        if window.max(initial=0) < limit or not window.size:
            window += 1
            tracked[i] = True
    return tracked


def _lagrangian(instance: Instance) -> Bound:
    from optkit.bounds.arrival.dual import arrival_dual

    return arrival_dual(instance)


def _multipliers(dual: Bound) -> Floats:
    return cast("MultiplierCertificate", dual.certificate).multipliers


def _states(bits: Ints) -> float:
    return float(np.exp2(bits).sum())


def _because(bound: Bound, why: str) -> Bound:
    return replace(bound, solver=replace(bound.solver, details={**bound.solver.details, "why": why}))
