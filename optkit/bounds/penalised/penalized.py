"""The penalised bound: the arrival-information bound, with foresight charged for."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.basics.errors import InputError
from optkit.bounds.arrival.exact import check_limit, checked_multipliers
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import Bound, SolverRecord, Verdict
from optkit.bounds.penalised.charges import Charges, KeptCharges
from optkit.bounds.penalised.foresight import Foresight, join_requests
from optkit.bounds.rounding import sum_up
from optkit.instances.instance import Instance
from optkit.models.value.request_sets import SetValue

KIND = "penalised arrival information"

LIMIT = 14
"""Requests that may wait after a step and are told apart: 16,384 subsets."""

CHARGED = 10
"""Of these, requests that are charged for: 1,024 subsets, each valued with every arrival that is drawn.

On scenario I.3, where mostly more than 12 wait at once, the gap to a trained policy is 0.75 points of full information
so, 1.17 with 8 charged for in half the time, and 1.95 with 10 of 10 (40 instances; half-widths 0.2, 0.3 and 0.4).
"""


@dataclass(frozen=True, eq=False)
class PenalizedCertificate:
    """Tables of the backward induction with charges, one per step.

    Attributes
    ----------
    tables : tuple of (2^k,) float
        As in :class:`optkit.bounds.arrival.exact.SubsetCertificate`, by subset of the tracked requests, money.
    limit : int
        Number of waiting requests up to which a new one is told apart, see :func:`tracked_requests`.
    multipliers : (n,) float
        l_i >= 0 for the others, money.
    charges : Charges
        What makes the charges anew: the value function, the distribution, and the seed.
    """

    proves = KIND

    tables: tuple[Floats, ...]
    limit: int
    multipliers: Floats
    charges: Charges

    @property
    def tracked(self) -> Bools:
        """Requests that are told apart, (n,)."""
        return tracked_requests(self.charges.instance, self.limit)

    def check(self, instance: Instance) -> Verdict:
        """Work the charges out again, and prove the bound of this path from them and the tables.

        Returns
        -------
        Verdict
            The path's bound. That it bounds the mean over paths follows from the mean of the charges, which is zero
            if the distribution in ``charges.foresight`` is that of the instances.

        Raises
        ------
        InputError
            If the tables or the charges belong to another instance, or a multiplier is negative.
        """
        if _silent(instance) != _silent(self.charges.instance):
            raise InputError("these charges were made for another instance")
        multipliers = checked_multipliers(self.multipliers, instance.n_requests)
        program = penalized_program(instance, self.tracked, multipliers)
        charges = KeptCharges.anew(self.charges)
        bound, attained = program.check(list(self.tables), charges)
        idle = [-charge for charge in charges.idle_terms(idle_steps(program))]
        return Verdict(bound=sum_up([bound, *idle]), attained=attained + math.fsum(idle), residual=0.0)


def penalized(
    instance: Instance,
    value: SetValue,
    foresight: Foresight,
    *,
    seed: int | np.random.SeedSequence = 0,
    limit: int = LIMIT,
    charged: int = CHARGED,
) -> Bound:
    """Bound the mean reward of any policy by the mean of this over independent instances.

    Who knows all arrivals pays :class:`~optkit.bounds.penalised.charges.Charges` for it, which cost nobody else
    anything on average. A single instance's value bounds nothing: it may lie above or below what a policy earns there.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    value : SetValue
        Any post-decision value function; the better it is, the tighter the bound. It must be fitted neither to this
        instance nor to the pool of ``foresight``.
    foresight : Foresight
        The distribution that the instance comes from.
    seed : int or SeedSequence
        Of the arrivals that stand for the others that might have come: another one for each instance.
    limit : int
        Largest number of waiting requests that are told apart. Those that arrive beyond it are held back by
        multipliers alone, as in :func:`optkit.bounds.arrival.arrival_information.arrival_hybrid`, and not charged for.
    charged : int
        Largest number of those told apart that are charged for, the largest surplus first. It is what takes time.

    Returns
    -------
    Bound
        Its ``solver.details`` have ``largest_lattice``, ``states`` and the number of ``tracked`` requests.

    Raises
    ------
    InputError
        If a limit is no whole number of at least 0, or the distribution does not fit the instance.

    Notes
    -----
    Not in the paper; ``docs/explanation/bounds.md``, "Charging for foresight".

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds import arrival_information
    >>> from optkit.bounds.penalised.foresight import fifo_presence
    >>> from optkit.models.value.request_sets import ZeroSetValue
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> foresight = Foresight(fifo_presence(0.5), np.ones(1))
    >>> bound = penalized(day, ZeroSetValue(), foresight)
    >>> bool(abs(bound.certificate.check(day).gap) < 1e-8)
    True
    """
    started = time.perf_counter()
    check_limit(limit)
    check_limit(charged)
    tracked = tracked_requests(instance, limit)
    multipliers = np.where(tracked, 0.0, _multipliers(instance, tracked))
    program = penalized_program(instance, tracked, multipliers)
    charges = Charges(instance, value, foresight, seed, charged)
    kept = KeptCharges.of(charges)
    tables = tuple(program.tables(kept))
    path, _ = program.check(list(tables), kept)
    details = {
        "largest_lattice": max((stage.uncertain for stage in program.stages), default=0),
        "states": sum(stage.states for stage in program.stages),
        "tracked": int(tracked.sum()),
        "limit": limit,
        "charged": charged,
    }
    method = "exact" if tracked.all() else "hybrid"
    record = SolverRecord(method, "solved", time.perf_counter() - started, details)
    certificate = PenalizedCertificate(tables, limit, multipliers, charges)
    idle = [-charge for charge in kept.idle_terms(idle_steps(program))]
    return Bound(sum_up([path, *idle]), KIND, certificate, record)


def penalized_program(instance: Instance, tracked: Bools, multipliers: Floats) -> SubsetProgram:
    """Return the induction over every step, with what is not tracked left to multipliers (n,), money."""
    return SubsetProgram(instance, stages(instance, every_step=True, tracked=tracked), multipliers, tracked)


def idle_steps(program: SubsetProgram) -> Ints:
    """Steps but the last, and -1, after which nothing tracked can wait: their charges are not in the induction."""
    busy = [stage.step - 1 for stage in program.stages if stage.uncertain]
    return np.setdiff1d(np.arange(-1, program.instance.horizon - 1), busy)


def tracked_requests(instance: Instance, limit: int) -> Bools:
    """Which requests to tell apart: whoever finds fewer than ``limit`` of these waiting on arrival, (n,).

    Of those that arrive together the largest mean surplus ``r - beta + u - u_0`` comes first. Unlike that of
    :func:`optkit.bounds.arrival.arrival_information.choose_tracked` this choice knows nothing of the future, and must
    not: charges on requests that had been chosen with foresight would no longer have mean zero.

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 0, 1, 2], expiry=[2, 1, 3, 3], reward=[30.0, 40.0, 99.0, 20.0],
    ...                penalty=[0.0] * 4, features=[[]] * 4, pickup=[0] * 4, dropoff=[0] * 4, worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0] * 4], mu=[1.0])
    >>> tracked_requests(day, limit=1)  # the second waits no longer when the third arrives
    array([False,  True,  True, False])
    """
    surplus = join_requests([instance]).mean_surplus
    tracked, load = np.zeros(instance.n_requests, bool), np.zeros(instance.steps, np.int64)
    for i in np.lexsort((-surplus, instance.arrival)):
        begin, end = instance.arrival[i], instance.expiry[i]
        if begin == end or load[begin] < limit:
            load[begin:end] += 1
            tracked[i] = True
    return tracked


def _multipliers(instance: Instance, tracked: Bools) -> Floats:
    """Multipliers for requests that are not tracked, (n,), money."""
    if tracked.all():
        return np.zeros(instance.n_requests)
    from optkit.bounds.arrival.dual import arrival_dual

    multipliers: Floats = arrival_dual(instance).certificate.multipliers  # type: ignore[attr-defined]
    return multipliers


def _silent(instance: Instance) -> Instance:
    """The instance without its noise, which plays no part."""
    return replace(instance, noise=None, outside_noise=None)
