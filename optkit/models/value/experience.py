"""What simulated rounds teach about the value of waiting: visited sets, and Lemma 1's targets for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints, Known, ReadOnlyArrays, locked
from optkit.basics.errors import InputError
from optkit.models.decision import Decisions
from optkit.models.pricing.closed_form import nonnegative
from optkit.models.value.request_sets import KnownRequests, RequestSets, SetValue, costs_of, costs_without, values_of


@dataclass(frozen=True, eq=False)
class Workers(Known, ReadOnlyArrays):
    """What is known of the workers in advance.

    Attributes
    ----------
    presence : (T, K) float
        Probability that a worker is seen at a step, if in the k steps before it, but not in the one before these, there
        was one; the last column is for K - 1 such steps and more. With K = 1 the past says nothing. Workers queue, so
        that a long busy stretch foretells another worker.
    share : (D,) float
        Probability of each group.
    mu : (D,) float
        Noise scale of each group, money.
    """

    presence: Floats
    share: Floats
    mu: Floats


@dataclass(frozen=True, eq=False)
class Experience(ReadOnlyArrays):
    """Visited post-decision sets of many instances, with the requests that joined each a step later.

    Attributes
    ----------
    requests : KnownRequests
        All requests; the last entry is padding.
    workers : Workers
        In expectation over these, targets are taken.
    owner : (N,) int
        Instance of each request; N does not count the padding.
    last : (N,) int
        Last step after whose decision each request was still waiting; below its arrival if it never waited.
    busy : (T, B) int
        For how many steps, up to and with each, every instance has seen a worker without a break.
    discount : float
        Of the future, in [0, 1].
    """

    requests: KnownRequests
    workers: Workers
    owner: Ints
    last: Ints
    busy: Ints
    discount: float = 1.0

    @property
    def horizon(self) -> int:
        """Number of steps T."""
        return len(self.workers.presence)

    @cached_property
    def _visited(self) -> list[tuple[RequestSets, Bools, Floats] | None]:
        return [self._visit(step) for step in range(self.horizon)]

    def _visit(self, step: int) -> tuple[RequestSets, Bools, Floats] | None:
        """Sets after a decision, with next arrivals at the end of each row, who is open then, and how surely a worker.

        None if nobody waits, or the decision is the last.
        """
        N = self.owner.size
        arrival = self.requests.arrival[:N]
        waits = (arrival <= step) & (self.last >= step)
        if step + 1 >= self.horizon or not waits.any():
            return None
        has = np.zeros(int(self.owner.max()) + 1, dtype=bool)
        has[self.owner[waits]] = True
        index = np.flatnonzero((waits | (arrival == step + 1)) & has[self.owner])
        index = index[np.lexsort((index, arrival[index] == step + 1, self.owner[index]))]
        row = np.cumsum(has)[self.owner[index]] - 1
        count = np.bincount(row)
        place = np.arange(index.size) - np.repeat(np.cumsum(count) - count, count)
        padded = np.full((count.size, int(count.max())), N, dtype=np.int64)
        padded[row, place] = index
        old = (padded < N) & (self.requests.arrival[padded] <= step)
        before = self.busy[step, np.flatnonzero(has)]
        known = self.workers.presence[step + 1, np.minimum(before, self.workers.presence.shape[1] - 1)]
        then = padded < N
        return RequestSets(self.requests, step, *locked((padded, old, before))), *locked((then, known))

    def sets(self, step: int) -> RequestSets | None:
        """Visited post-decision sets of a step, b of them; None if nobody waited anywhere."""
        found = self._visited[step]
        return None if found is None else found[0]

    def target(self, value: SetValue, step: int) -> Floats:
        """Lemma 1's value of the states that followed each set of ``sets(step)``, (b,), money.

        The worker and the group of the next step enter in expectation, the new requests as they came.
        """
        open_, presence, waiting = self._next(value, step)
        future = sum(chance * values_of(value, sets) for chance, sets in waiting)
        profit = self._profit(open_, costs_of(value, waiting[0][1]))
        return np.asarray(self.discount * future + _expiring(open_).sum(axis=1) + presence * profit)

    def target_differences(self, value: SetValue, step: int) -> Floats:
        """Target of each set less that of the set without each member, the same arrivals after both, (b, w), money.

        What the future loses with a member is its opportunity cost, so the value function is asked for nothing else.
        """
        open_, presence, waiting = self._next(value, step)
        costs = [costs_of(value, sets) for _, sets in waiting]
        future = sum(chance[:, None] * cost for (chance, _), cost in zip(waiting, costs, strict=True))
        b, i = np.nonzero(self._found(step)[0].member)
        less = self._profit(open_.without(b, i), costs_without(value, waiting[0][1], b, i))
        difference = np.zeros(open_.member.shape)
        difference[b, i] = presence[b] * (self._profit(open_, costs[0])[b] - less)
        difference[b, i] += (self.discount * future + _expiring(open_))[b, i]
        return difference

    def _found(self, step: int) -> tuple[RequestSets, Bools, Floats]:
        found = self._visited[step]
        if found is None:
            raise InputError(f"nobody waited after step {step}: there is no target")
        return found

    def _next(self, value: SetValue, step: int) -> tuple[RequestSets, Floats, list[tuple[Floats, RequestSets]]]:
        """Next step's open requests, the probability of a worker, and what waits on if one comes and if none does.

        What waits on comes with the probability of each; of one kind, if the busy stretch does not matter.
        """
        sets, then, presence = self._found(step)
        open_ = RequestSets(self.requests, step + 1, sets.index, then)
        member = locked(then & (open_.steps_left > 0))
        if not getattr(value, "sees_busy", False):
            return open_, presence, [(np.ones(len(sets)), replace(open_, member=member))]
        assert sets.busy is not None  # every visit tells it
        waits, idle = (replace(open_, member=member, busy=locked(busy)) for busy in (sets.busy + 1, 0 * sets.busy))
        return open_, presence, [(presence, waits), (1.0 - presence, idle)]

    def _profit(self, open_: RequestSets, cost: Floats) -> Floats:
        """Expected optimal profit from a worker of unknown group, (b,), money; requests may expire now."""
        requests, workers = self.requests, self.workers
        worth = requests.reward[open_.index] - _expiring(open_) - self.discount * cost
        profit = np.zeros(len(open_))
        for group in np.flatnonzero(workers.share > 0):
            mu = workers.mu[group]
            d = Decisions.of(worth, requests.utility[group][open_.index], mu, 0.0, open_.member)
            profit += workers.share[group] * mu * nonnegative(d).ratio[:, 0]
        return profit


def _expiring(open_: RequestSets) -> Floats:
    """Penalties of those open requests that expire now, (b, w), money."""
    return np.where(open_.member & (open_.steps_left <= 0), open_.penalty, 0.0)


@runtime_checkable
class Estimator(SetValue, Protocol):
    """A value function that can be fitted; see CONTRIBUTING.md for one's own."""

    def fit(self, experience: Experience) -> Any:
        """Fit to one round of experience, keeping what earlier rounds taught if that helps."""
        ...
