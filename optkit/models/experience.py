"""What simulated rounds teach about the value of waiting: visited sets, and Lemma 1's targets for them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optkit.errors import InputError
from optkit.instance import Floats, Ints
from optkit.models.closed_form import nonnegative
from optkit.models.decision import Decisions
from optkit.models.request_sets import Bools, Requests, RequestSets, SetValue


@dataclass(frozen=True, eq=False)
class Workers:
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
class Experience:
    """Visited post-decision sets of many instances, with the requests that joined each a step later.

    Attributes
    ----------
    requests : Requests
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

    requests: Requests
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
        return RequestSets(self.requests, step, padded, old, before), padded < N, known

    def sets(self, step: int) -> RequestSets | None:
        """Visited post-decision sets of a step, b of them; None if nobody waited anywhere."""
        found = self._visited[step]
        return None if found is None else found[0]

    def target(self, value: SetValue, step: int) -> Floats:
        """Lemma 1's value of the states that followed each set of ``sets(step)``, (b,), money.

        The worker and the group of the next step enter in expectation, the new requests as they came.
        """
        sets, then, presence = self._found(step)
        return self._lemma_1(value, RequestSets(self.requests, step + 1, sets.index, then, sets.busy), presence)

    def target_differences(self, value: SetValue, step: int) -> Floats:
        """Target of each set less that of the set without each member, the same arrivals after both, (b, w), money."""
        sets, then, presence = self._found(step)
        after = RequestSets(self.requests, step + 1, sets.index, then, sets.busy)
        b, i = np.nonzero(sets.member)
        fewer = after.rows(b)
        fewer.member[np.arange(b.size), i] = False
        difference = np.zeros(sets.member.shape)
        difference[b, i] = self._lemma_1(value, after, presence)[b] - self._lemma_1(value, fewer, presence[b])
        return difference

    def _found(self, step: int) -> tuple[RequestSets, Bools, Floats]:
        found = self._visited[step]
        if found is None:
            raise InputError(f"nobody waited after step {step}: there is no target")
        return found

    def _lemma_1(self, value: SetValue, open_: RequestSets, presence: Floats) -> Floats:
        """Expected optimal value of pre-decision sets, which may hold requests that expire now.

        Their busy stretch is that of the step before.
        """
        requests, workers = self.requests, self.workers
        left = open_.steps_left
        member = open_.member & (left > 0)
        penalty = np.where(open_.member & (left <= 0), requests.penalty[open_.index], 0.0)
        if getattr(value, "sees_busy", False) and open_.busy is not None:
            waits = RequestSets(requests, open_.step, open_.index, member, open_.busy + 1)
            idle = RequestSets(requests, open_.step, open_.index, member, np.zeros_like(open_.busy))
            future = self.discount * (presence * value.value(waits) + (1.0 - presence) * value.value(idle))
        else:
            waits = RequestSets(requests, open_.step, open_.index, member)
            future = self.discount * value.value(waits)
        worth = requests.reward[open_.index] - penalty - self.discount * value.opportunity_cost(waits)
        profit = np.zeros(len(open_))
        for group in np.flatnonzero(workers.share > 0):
            mu = workers.mu[group]
            d = Decisions.of(worth, requests.utility[group][open_.index], mu, 0.0, open_.member)
            profit += workers.share[group] * mu * nonnegative(d).ratio[:, 0]
        return np.asarray(future + penalty.sum(axis=1) + presence * profit)
