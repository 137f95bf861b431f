"""The arrival-information bound by backward induction over subsets of open requests, and its certificate."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from optkit.basics.arrays import Bools, Floats, flag, floats, whole_number
from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.lattice import lattice_bits, stages
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import Bound, SolverRecord, Verdict
from optkit.instances.instance import Instance

KIND = "arrival information"

MOST_TOLD_APART = 62
"""Requests of one step that are told apart at most: subsets of more have no number of 64 bits."""

EXACT_LIMIT = 18
"""Uncertain requests at a worker up to which all are tracked: 2^18 states take about 50 ms and 4 MB."""


@dataclass(frozen=True, eq=False)
class SubsetCertificate:
    r"""Tables of the backward induction, one per worker who meets requests.

    They prove the bound by the inequality :math:`W_j(S) \ge F_j(S) + \varphi_j(S)` at every subset that can occur,
    whoever made them, see :meth:`optkit.bounds.arrival.subsets.SubsetProgram.check`.

    Attributes
    ----------
    tables : tuple of (2^k,) float
        What the worker and all later ones add, by the subset of uncertain requests that are unserved; in money.
    tracked : (n,) bool
        Requests whose service is remembered; the others are open in their whole windows, whether served or not.
    multipliers : (n,) float
        l_i >= 0, in money: what each service costs on top, paid back once.
    nonnegative : bool
        Whether the compensation of tracked requests must be at least 0.

    Examples
    --------
    >>> from optkit import scenario
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> bound = arrival_exact(day)
    >>> verdict = bound.certificate.check(day)
    >>> bool(abs(verdict.bound - bound.value) < 1e-8 and abs(verdict.gap) < 1e-8)
    True
    """

    proves = KIND

    tables: tuple[Floats, ...]
    tracked: Bools
    multipliers: Floats
    nonnegative: bool

    def check(self, instance: Instance) -> Verdict:
        """Recompute everything from the instance; its noise is not looked at.

        Returns
        -------
        Verdict
            ``attained`` is what the prices that the tables imply earn: in the mean over the noise, of a policy that
            knows the arrivals, if all requests are tracked; else in the relaxation at these multipliers. Its residual
            is 0, because such prices are always feasible.

        Raises
        ------
        InputError
            If a shape does not fit the instance, a table is not finite, or a multiplier is negative.
        """
        n = instance.n_requests
        tracked = np.asarray(self.tracked)
        if tracked.shape != (n,) or tracked.dtype != bool:
            raise InputError(f"tracked has shape {tracked.shape}: give each of the {n} requests True or False")
        program = _program(
            instance, tracked, checked_multipliers(self.multipliers, n), flag("nonnegative", self.nonnegative)
        )
        bound, attained = program.check(list(self.tables))
        return Verdict(bound=bound, attained=attained, residual=0.0)


def arrival_exact(instance: Instance, *, limit: int = EXACT_LIMIT, nonnegative: bool = True) -> Bound:
    """Best mean reward of who knows all arrivals, but no worker's noise, computed exactly.

    Every policy that does not foresee the noise earns at most this in the mean over the noise.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    limit : int
        Largest number of uncertain requests, open at one worker and at the one before: time and memory are
        proportional to 2 to that power.
    nonnegative : bool
        Whether compensations must be at least 0 (default). Without, the bound is valid, but looser or equal.

    Returns
    -------
    Bound
        With a :class:`SubsetCertificate`; ``solver.details`` has the ``largest_open_set``, the ``largest_lattice``
        (uncertain requests), and the number of ``states``.

    Raises
    ------
    SolverError
        If more requests are uncertain than the limit allows.

    See Also
    --------
    optkit.bounds.arrival.arrival_information : for more open requests, and to choose by size.

    Notes
    -----
    ``docs/explanation/bounds.md``, "The same, exactly"; the recursion is in :mod:`optkit.bounds.arrival.subsets`.

    Examples
    --------
    One request meets one worker; the bound is the optimal price's profit, and the penalty if he declines.

    >>> day = Instance(horizon=2, arrival=[0], expiry=[1], reward=[30.0], penalty=[-5.0], features=[[]], pickup=[0],
    ...                dropoff=[0], worker_step=[1], worker_group=[0], utility=[[-10.0]], mu=[1.0])
    >>> from optkit.models.pricing import optimal_prices
    >>> bool(np.isclose(arrival_exact(day).value, optimal_prices([35.0], [-10.0]).profit - 5.0))
    True
    """
    started = time.perf_counter()
    check_limit(limit)
    bits = lattice_bits(instance)
    if bits.max(initial=0) > limit:
        worker = int(bits.argmax())
        raise SolverError(
            f"{bits[worker]} requests are open at step {instance.worker_step[worker]} and may or may not have been "
            f'served: 2^{bits[worker]} states exceed limit = {limit}; take method="hybrid" or "lagrangian", or raise it'
        )
    everything = np.ones(instance.n_requests, bool)
    return solve_subsets(instance, "exact", everything, np.zeros(instance.n_requests), nonnegative, limit, started)


def solve_subsets(
    instance: Instance,
    method: str,
    tracked: Bools,
    multipliers: Floats,
    nonnegative: bool,
    limit: int,
    started: float,
) -> Bound:
    """Solve with some requests tracked and multipliers on the others, and put the tables into a certificate."""
    program = _program(instance, tracked, multipliers, nonnegative)
    tables = tuple(program.tables())
    value, _ = program.check(list(tables))
    details = {
        "largest_open_set": max((stage.requests.size for stage in program.stages), default=0),
        "largest_lattice": max((stage.uncertain for stage in program.stages), default=0),
        "states": sum(stage.states for stage in program.stages),
        "tracked": int(tracked.sum()),
        "limit": limit,
    }
    record = SolverRecord(method, "solved", time.perf_counter() - started, details)
    return Bound(value, KIND, SubsetCertificate(tables, tracked, multipliers, nonnegative), record)


def _program(instance: Instance, tracked: Bools, multipliers: Floats, nonnegative: bool) -> SubsetProgram:
    signed = tracked if nonnegative else np.zeros_like(tracked)
    return SubsetProgram(instance, stages(instance, tracked=tracked), multipliers, signed)


def checked_multipliers(multipliers: Any, n: int) -> Floats:
    """Return multipliers (n,) in money, or raise an InputError unless they are finite and at least 0."""
    found = floats("multipliers", multipliers, (n,))
    if (found < 0).any():
        i = int((found < 0).argmax())
        raise InputError(f"multipliers[{i}] = {found[i]} is negative; a request's multiplier is at least 0")
    return found


def check_limit(limit: int) -> None:
    """Raise an InputError unless the limit is a whole number of at least 0 that tables of subsets can have."""
    whole_number("limit", limit, least=0, most=MOST_TOLD_APART)
