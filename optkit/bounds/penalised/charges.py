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

import math
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
        return math.fsum(self.idle_terms(steps))

    def idle_terms(self, steps: Ints) -> list[float]:
        """Return what :meth:`idle` adds up, for sums that count their rounding."""
        return [self._nobody(int(step)) for step in steps]

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
            if requests.size:  # many runs let the same requests wait
                wait, run = np.unique(last[:, requests] >= step, axis=0, return_inverse=True)
                total += self._charge(step, requests, wait)[run.ravel()]
            else:
                total += self._nobody(step)
        return total

    def _nobody(self, step: int) -> float:
        return float(self._charge(step, np.zeros(0, np.int64), np.zeros((1, 0), bool))[0])

    def _charge(self, step: int, requests: Ints, wait: Bools) -> Floats:
        """Charge of S sets of the k requests that wait after a step, (S,), money: all that may come, at once."""
        arrivals, came, chance = self._cases(step + 1)
        parts = []
        for start in range(0, len(chance) * len(wait), CHUNK):
            case, row = np.divmod(np.arange(start, min(start + CHUNK, len(chance) * len(wait))), len(wait))
            index = np.concatenate([np.broadcast_to(requests, (case.size, requests.size)), arrivals[case]], axis=1)
            open_ = np.concatenate([wait[row], came[case]], axis=1)
            parts.append(self._one_step(step + 1, index, open_, chance[case]))
        return np.asarray(np.concatenate(parts).reshape(len(chance), -1).sum(axis=0))

    def _cases(self, step: int) -> tuple[Ints, Bools, Floats]:
        """What may arrive at a step, and how much more probable it is to one who knows what comes.

        Returns
        -------
        arrivals : (C, a) int
            Requests, in padded rows, no two alike.
        came : (C, a) bool
            Which of them are no padding.
        chance : (C, 2 + D) float
            Probability of each case with a worker, without one, and with one of each group: 1 or 0 for what comes, less
            what it is to those without foresight.
        """
        around, share = self._around, self.foresight.share
        group, p = int(self._workers.group[step]), float(self._workers.presence[step])
        sure = float(group >= 0)
        own = around.own[step]
        cases = {tuple(own.tolist()): np.array([sure, 1.0 - sure, *(np.arange(share.size) == group)])}
        likely = np.array([p, 1.0 - p, *(p * share)])
        rows, weight = (around.drawn[step], around.weight[step]) if self.foresight.arrivals else ([own], np.ones(1))
        for row, q in zip(rows, weight, strict=True):
            one = tuple(row[row >= 0].tolist())
            cases[one] = cases.get(one, 0.0) - q * likely
        size = np.array([len(one) for one in cases])
        came = np.arange(size.max()) < size[:, None]
        # Padding is a request that arrives now: nothing about it is out of the ordinary.
        arrivals = np.full(came.shape, max(cases, key=len)[0] if size.max() else 0)
        arrivals[came] = [request for one in cases for request in one]
        return arrivals, came, np.array(list(cases.values()))

    def _one_step(self, step: int, index: Ints, open_: Bools, chance: Floats) -> Floats:
        """G of S sets of open requests (S, m), in expectation over the worker: ``chance`` (S, 2 + D), (S,) money."""
        table = self._around.requests
        left = table.expiry[index] > step
        penalty = np.where(left, 0.0, table.penalty[index])
        stretch = np.full(len(index), self._workers.busy[step] + 1)
        busy = RequestSets(table, step, index, open_ & left, stretch)
        worker, nobody, groups = chance[:, 0], chance[:, 1], chance[:, 2:]
        total = (worker + nobody) * np.where(open_, penalty, 0.0).sum(axis=1)
        if getattr(self.value, "sees_busy", False):
            idle = RequestSets(table, step, index, open_ & left, np.zeros_like(stretch))
            for sets, p in ((busy, worker), (idle, nobody)):
                if p.any():
                    total += p * self.value.value(sets)
        elif (worker + nobody).any():
            total += (worker + nobody) * self.value.value(busy)
        if not index.shape[1] or not groups.any():
            return np.asarray(total)
        worth = table.reward[index] - penalty - self.value.opportunity_cost(busy)
        for g in np.flatnonzero(groups.any(axis=0)):
            mu, s = self.instance.mu[g], np.flatnonzero(groups[:, g])
            relative = table.utility[g][index[s]] / mu
            advantage = np.where(open_[s], worth[s] / mu + relative, -np.inf)
            d = Decisions((s.size,), worth[s], relative, np.full((s.size, 1), mu), open_[s], advantage)
            total[s] += groups[s, g] * mu * nonnegative(d).ratio[:, 0]
        return np.asarray(total)


class KeptCharges(Charges):
    """Charges that are worked out once and looked at several times."""

    @classmethod
    def of(cls, charges: Charges) -> KeptCharges:
        """Return the same charges, as they are if they are kept already."""
        return charges if isinstance(charges, cls) else cls.anew(charges)

    @classmethod
    def anew(cls, charges: Charges) -> KeptCharges:
        """Return the same charges with nothing kept: whoever checks does not believe what somebody worked out."""
        return cls(**{field.name: getattr(charges, field.name) for field in fields(Charges)})

    @cached_property
    def _kept(self) -> dict[int, Floats]:
        return {}

    @cached_property
    def _kept_nobody(self) -> dict[int, float]:
        return {}

    def __call__(self, step: int, requests: Ints) -> Floats:
        """Charge of every subset of the k requests that wait after a step, (2^k,), money."""
        if step not in self._kept:
            self._kept[step] = super().__call__(step, requests)
        return self._kept[step]

    def _nobody(self, step: int) -> float:
        if step not in self._kept_nobody:
            self._kept_nobody[step] = super()._nobody(step)
        return self._kept_nobody[step]
