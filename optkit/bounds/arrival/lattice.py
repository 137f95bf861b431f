"""The lattice of subsets of open requests, stage by stage, kept small by bit masks.

A request is *certain* to be open until the first worker who can take it, so that only those open now and at the worker
before are *uncertain*: with k of these a table has 2^k entries, and bit p of an entry's number says whether the p-th is
still unserved. A request may also be *forgotten*, and is then taken to be unserved in its whole window, at a price: see
:func:`optkit.bounds.arrival.arrival_information.arrival_hybrid`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from optkit.basics.arrays import Bools, Ints
from optkit.instances.instance import Instance


@dataclass(frozen=True, eq=False)
class Stage:
    """A decision, or a step without a worker, and the requests that are open at it.

    Attributes
    ----------
    step : int
        When it is.
    worker : int
        Who decides; -1 if nobody comes, or if nothing is open.
    requests : (k + c,) int
        The open requests: first the k uncertain ones, one bit each, then the c certain ones.
    uncertain : int
        k.
    kept : (k + c,) int
        Their bits, as powers of 2, among the uncertain requests of the next stage; 0 if they expire or are forgotten.
    """

    step: int
    worker: int
    requests: Ints
    uncertain: int
    kept: Ints

    @property
    def states(self) -> int:
        """Number of subsets, 2^k."""
        return 1 << self.uncertain

    @cached_property
    def after(self) -> Ints:
        """Where each subset is found among the next stage's if nobody is served, (2^k,)."""
        place = np.array([self.kept[self.uncertain :].sum()])
        for bit in self.kept[: self.uncertain]:
            place = np.concatenate([place, place + bit])
        return place


def lattice_bits(instance: Instance, tracked: Bools | None = None) -> Ints:
    """Number k of uncertain requests at each worker, (J,): the table there has 2^k entries.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    tracked : (n,) bool, optional
        As in :func:`stages`.

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2, 3],
    ...                worker_group=[0, 0, 0], utility=[[-10.0, -12.0]], mu=[1.0])
    >>> lattice_bits(day)
    array([0, 2, 1])
    """
    first = np.searchsorted(instance.worker_step, instance.arrival, side="left") + 1
    end = np.searchsorted(instance.worker_step, instance.expiry, side="right")
    some = first < end if tracked is None else (first < end) & tracked
    length = instance.n_workers + 1
    change = np.bincount(first[some], minlength=length) - np.bincount(end[some], minlength=length)
    return np.asarray(np.cumsum(change)[: instance.n_workers])


def stages(instance: Instance, *, every_step: bool = False, tracked: Bools | None = None) -> list[Stage]:
    """Cut an instance into the stages of the induction, in order of time.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at.
    every_step : bool
        Whether steps without a worker are stages too, as charges need; else only steps at which a worker meets
        requests are.
    tracked : (n,) bool, optional
        Which requests are told apart by whether they are still unserved; the others are always open in their windows.
        All by default.

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[1.0])
    >>> [(stage.step, stage.requests.tolist(), stage.uncertain) for stage in stages(day)]
    [(1, [0, 1], 0), (2, [0, 1], 2)]
    """
    n = instance.n_requests
    step = np.arange(instance.steps) if every_step else instance.worker_step
    first = np.searchsorted(step, instance.arrival, side="left")
    count = np.searchsorted(step, instance.expiry, side="right") - first
    request = np.repeat(np.arange(n), count)
    at = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    certain = at == first[request]
    if tracked is not None:
        certain |= ~tracked[request]
    # Low bits are slow to address, and what expires first is soonest the same in all states: it gets the low bits.
    order = np.lexsort((request, instance.expiry[request], certain, at))
    request, at, certain = request[order], at[order], certain[order]
    begin = np.searchsorted(at, np.arange(step.size + 1))
    uncertain = np.bincount(at[~certain], minlength=step.size)
    worker = np.full(step.size, -1)
    worker[np.searchsorted(step, instance.worker_step)] = np.arange(instance.n_workers)
    worker[begin[1:] == begin[:-1]] = -1
    bit = np.zeros(n, np.int64)
    found: list[Stage] = []
    for j in range(step.size - 1, -1, -1):
        here, k = request[begin[j] : begin[j + 1]], int(uncertain[j])
        if here.size or every_step:
            found.append(Stage(int(step[j]), int(worker[j]), here, k, bit[here]))
            bit[here] = 0
            bit[here[:k]] = 1 << np.arange(k)
    return found[::-1]


def reachable(stages: list[Stage]) -> list[Ints]:
    """Return the subsets that can occur at each stage, as sorted entries of its table: no worker serves two requests.

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 0], expiry=[3, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[1.0])
    >>> [rows.tolist() for rows in reachable(stages(day))]
    [[0], [1, 2, 3]]
    """
    found = [np.zeros(1, np.int64)] if stages else []
    for stage, following in pairwise(stages):
        rows = found[-1]
        occurs = np.zeros(following.states, bool)
        occurs[stage.after[rows]] = True
        if stage.worker >= 0:
            for i, bit in enumerate(stage.kept):
                holding = rows[rows >> i & 1 == 1] if i < stage.uncertain else rows
                if bit:
                    occurs[stage.after[holding] - bit] = True
        found.append(np.flatnonzero(occurs))
    return found
