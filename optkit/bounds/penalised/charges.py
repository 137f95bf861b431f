r"""What knowing the next step is worth, and what it is charged at.

With S the set that waits after step t, xi what the next step brings, and G the one-step value of a value function V,

.. math:: z_t(S) = G_{t+1}(S, \xi_{t+1}) - E\,[G_{t+1}(S, \xi) \mid \text{past}], \qquad
          G_{t+1}(S, \xi) = \sum_{i \in S' \text{ expires}} \beta_i + 1[\text{worker of group } g]\, \varphi_g(S')
          + V_{t+1}(S' \setminus \text{expired}), \quad S' = S \cup \text{arrivals}

has mean zero whatever one does without foresight, for any V at all (information relaxation: Brown, Smith and Sun 2010;
``docs/explanation/bounds.md``). Worker and group enter the expectation exactly, arrivals by independent draws.
What the first step brings is charged too, at t = -1 with nothing waiting: with the exact V the charges then take all
luck out, and every path is worth the exact value. Zero mean needs an S that was known at t: who looks at some of the
waiting requests only must choose them without foresight.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.bounds.penalised.foresight import Foresight, Outlook, Surroundings, surroundings
from optkit.instances.instance import Instance
from optkit.models.decision import Decisions
from optkit.models.pricing.closed_form import nonnegative
from optkit.models.value.request_sets import RequestSets, SetValue

CHUNK = 1 << 14
"""Sets valued at once."""


@dataclass(frozen=True, eq=False)
class Charges:
    """Charges of one instance, as :data:`optkit.bounds.arrival.subsets.Charge` wants them.

    Attributes
    ----------
    instance : Instance
        The instance.
    value : SetValue
        V.
    foresight : Foresight
        The distribution of what is not known.
    seed : int or SeedSequence
        Of the arrivals that are drawn.
    most : int or None
        Largest number of waiting requests that are looked at: beyond it, those of the largest mean surplus.
    """

    instance: Instance
    value: SetValue
    foresight: Foresight
    seed: int | np.random.SeedSequence
    most: int | None = None

    @cached_property
    def _around(self) -> Surroundings:
        return surroundings(self.instance, self.foresight, np.random.default_rng(self.seed))

    @cached_property
    def _workers(self) -> Outlook:
        return self.foresight.of_workers(self.instance)

    def __call__(self, step: int, requests: Ints) -> Floats:
        """Charge of every subset of the k requests that wait after a step, (2^k,), money."""
        seen = self._looked_at(requests)
        subsets = (np.arange(1 << seen.size)[:, None] >> np.arange(seen.size) & 1).astype(bool)
        table = self._charge(step, requests[seen], subsets)
        if seen.size == requests.size:
            return table
        bit = np.zeros(requests.size, np.int64)
        bit[seen] = 1 << np.arange(seen.size)
        place = np.zeros(1, np.int64)
        for one in bit:
            place = np.concatenate([place, place + one])
        return np.asarray(table[place])

    def _looked_at(self, requests: Ints) -> Ints:
        """Positions of those that are looked at among the requests that wait (k,), in order."""
        if self.most is None or requests.size <= self.most:
            return np.arange(requests.size)
        # Ties by number, so that it does not matter in which order the requests are listed.
        order = np.lexsort((requests, -self._around.requests.mean_surplus[requests]))
        return np.sort(order[: self.most])

    def idle(self, steps: Ints) -> float:
        """Charge after steps at which nothing waits that is looked at, money: the same for all policies.

        Step -1 is before the first.
        """
        nobody = np.zeros(0, np.int64)
        return float(sum(self._charge(step, nobody, np.zeros((1, 0), bool))[0] for step in steps))

    def along(self, last: Ints, tracked: Bools) -> Floats:
        """Charge of M runs, (M,), money.

        Parameters
        ----------
        last : (M, n) int
            Last step after which each request waited; below its arrival if it never did.
        tracked : (n,) bool
            Requests that the charge looks at. Which they are must not depend on what comes after they have arrived.
        """
        total = np.zeros(len(last))
        for step in range(-1, self.instance.horizon - 1):
            there = np.flatnonzero(tracked & (self.instance.arrival <= step) & (self.instance.expiry > step))
            requests = there[self._looked_at(there)]
            total += self._charge(step, requests, last[:, requests] >= step)
        return total

    def _charge(self, step: int, requests: Ints, wait: Bools) -> Floats:
        around, now = self._around, step + 1
        came = self._one_step(now, requests, wait, around.own[now], known=True)
        if not self.foresight.arrivals:
            return came - self._one_step(now, requests, wait, around.own[now], known=False)
        expected = np.zeros(len(wait))
        for arrivals, p in zip(around.drawn[now], around.weight[now], strict=True):
            expected += p * self._one_step(now, requests, wait, arrivals[arrivals >= 0], known=False)
        return came - expected

    def _one_step(self, step: int, requests: Ints, wait: Bools, arrivals: Ints, known: bool) -> Floats:
        """G of every subset with the same arrivals; the worker as he came, or in expectation, (2^k,), money."""
        index = np.concatenate([requests, arrivals])
        parts = []
        for start in range(0, len(wait), CHUNK):
            some = wait[start : start + CHUNK]
            open_ = np.concatenate([some, np.ones((len(some), arrivals.size), bool)], axis=1)
            parts.append(self._lemma_1(step, np.broadcast_to(index, open_.shape), open_, known))
        return np.concatenate(parts)

    def _lemma_1(self, step: int, index: Ints, open_: Bools, known: bool) -> Floats:
        table = self._around.requests
        left = table.expiry[index[:1]] > step
        penalty = np.where(left, 0.0, table.penalty[index[:1]])
        group, p = int(self._workers.group[step]), float(self._workers.presence[step])
        if known:
            p = float(group >= 0)
            weight = p * (np.arange(self.foresight.share.size) == group)
        else:
            weight = p * self.foresight.share
        stretch = np.full(len(index), self._workers.busy[step] + 1)
        busy = RequestSets(table, step, index, open_ & left, stretch)
        future = open_ @ penalty[0]
        if getattr(self.value, "sees_busy", False):
            idle = RequestSets(table, step, index, open_ & left, np.zeros_like(stretch))
            for sets, chance in ((busy, p), (idle, 1.0 - p)):
                if chance > 0:
                    future = future + chance * self.value.value(sets)
        else:
            future = future + self.value.value(busy)
        if not index.shape[1]:
            return np.asarray(future)
        worth = table.reward[index[:1]] - penalty - self.value.opportunity_cost(busy)
        for g in np.flatnonzero(weight > 0):
            mu = self.instance.mu[g]
            relative = np.broadcast_to(table.utility[g][index[:1]] / mu, worth.shape)
            advantage = np.where(open_, worth / mu + relative, -np.inf)
            scale = np.full((len(worth), 1), mu)
            d = Decisions((len(worth),), worth, relative, scale, open_, advantage)
            future = future + weight[g] * mu * nonnegative(d).ratio[:, 0]
        return np.asarray(future)


class KeptCharges(Charges):
    """Charges that are worked out once and looked at several times."""

    @classmethod
    def of(cls, charges: Charges) -> KeptCharges:
        """Return the same charges, as they are if they are kept already."""
        if isinstance(charges, cls):
            return charges
        return cls(**{field.name: getattr(charges, field.name) for field in fields(Charges)})

    @cached_property
    def _kept(self) -> dict[int, Floats]:
        return {}

    def __call__(self, step: int, requests: Ints) -> Floats:
        """Charge of every subset of the k requests that wait after a step, (2^k,), money."""
        if step not in self._kept:
            self._kept[step] = super().__call__(step, requests)
        return self._kept[step]
