"""How many workers join the queue at each time of day, learned from days on which one was seen a step at most.

Who joined is not recorded, only who was seen; how likely that is follows from the rates
(:func:`~optkit.bounds.penalised.presence.fifo_presence`), so that they are those under which the days are most likely.
Rates are piecewise constant: pieces begin where the days tell them apart, by as much as the Bayesian information
criterion asks for. A prior as weak as a day's glance, log-normal around the day's mean, keeps rates above 0 where
nobody was ever seen, and finite where somebody always was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from optkit.basics.arrays import Floats, Ints, Known
from optkit.basics.errors import InputError
from optkit.bounds.penalised.presence import CERTAIN, fifo_presence
from optkit.instances.instance import Instance
from optkit.instances.queue import busy_steps

SLOTS = 24
"""Parts of the day, as that of 24 hours, at whose ends a piece may begin."""

STRETCH = 40
"""Busy steps beyond which all stretches count alike while rates are learned."""

PRIOR = 2.0
"""Standard deviation of the logarithm of a rate, before anything is seen."""

NUDGE = 0.01
"""Change of the logarithm of a rate by which the likelihood's slope is taken."""


@dataclass(frozen=True, eq=False)
class WorkerRates(Known):
    """Rates by time of day, and what is not known of them.

    Attributes
    ----------
    rate : (T,) float
        Mean number of workers who join the queue at each step (Poisson).
    start : (B,) int
        First step of each piece.
    covariance : (B, B) float
        Of the errors of the logarithms of the pieces' rates.
    group_count : (D,) float
        Workers seen of each group, and a half.
    days : int
        Number of days that this was learned from.
    """

    rate: Floats
    start: Ints
    covariance: Floats
    group_count: Floats
    days: int

    @property
    def presence(self) -> Floats:
        """Probability of a worker at each step after each busy stretch, (T, T)."""
        return fifo_presence(self.rate)

    @property
    def share(self) -> Floats:
        """Probability of each group, (D,)."""
        return np.asarray(self.group_count / self.group_count.sum())

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw rates that might be the true ones, (count, T)."""
        error = rng.multivariate_normal(np.zeros(self.start.size), self.covariance, count, method="eigh")
        pieces = np.diff(np.append(self.start, self.rate.size))
        return np.asarray(np.minimum(self.rate * np.exp(np.repeat(error, pieces, axis=1)), CERTAIN))

    def __str__(self) -> str:
        """Rates in words."""
        ends = np.append(self.start[1:], self.rate.size) - 1
        told = [f"{self.rate[a]:.2f} at steps {a} to {b}" for a, b in zip(self.start, ends, strict=True)]
        return ", ".join(told if len(told) <= 6 else [*told[:5], f"and {len(told) - 5} pieces more"])


def learn_worker_rates(instances: Sequence[Instance]) -> WorkerRates:
    """Learn rates by time of day from days; none of them may be one that is bounded by what was learned.

    Parameters
    ----------
    instances : sequence of Instance
        Days of one length.

    Returns
    -------
    WorkerRates
        The most likely, and the errors they may have.

    Raises
    ------
    InputError
        If there are no days, their horizons or groups differ, or they have more than
        :data:`~optkit.bounds.penalised.presence.LARGEST` steps.

    Examples
    --------
    >>> from optkit import scenario
    >>> rates = learn_worker_rates(scenario("I.2", seed=0, horizon=20).sample(40, seed=1))
    >>> rates.start.tolist(), bool(abs(rates.rate[0] - 0.5) < 0.1)
    ([0], True)
    """
    if not instances:
        raise InputError("rates of workers are learned from days: give at least one")
    T, groups = instances[0].steps, instances[0].n_groups
    for b, one in enumerate(instances):
        if one.horizon != T or one.n_groups != groups:
            raise InputError(
                f"day {b} has {one.horizon} steps and {one.n_groups} group(s), the first {T} and {groups}: "
                "rates by time of day are learned from days of one form"
            )
    seen = np.zeros((T, len(instances)), bool)
    group = np.full(groups, 0.5)
    for b, one in enumerate(instances):
        seen[one.worker_step, b] = True
        group += np.bincount(one.worker_group, minlength=groups)
    likelihood = _Likelihood.of(seen)
    start = np.unique(np.linspace(0, T, min(T, SLOTS), endpoint=False).round().astype(np.int64))
    fine, error = likelihood.maximum(start, np.full(start.size, likelihood.centre), rounds=2)
    start, rough = _pieces(start, fine, np.sqrt(np.diag(error)), T, float(np.log(max(seen.sum(), 2))))
    log_rate, covariance = likelihood.maximum(start, rough, rounds=5)
    rate = np.repeat(np.exp(log_rate), np.diff(np.append(start, T)))
    return WorkerRates(rate, start, covariance, group, len(instances))


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """How often a worker was seen, and not, at each step after each busy stretch, (T, K); log of the day's mean."""

    seen: Floats
    missed: Floats
    centre: float

    @classmethod
    def of(cls, seen: np.ndarray) -> _Likelihood:
        T, B = seen.shape
        K = min(T, STRETCH + 1)
        before = np.minimum(np.concatenate([np.zeros((1, B), np.int64), busy_steps(seen)[:-1]]), K - 1)
        cell = np.arange(T)[:, None] * K + before
        count = [np.bincount(cell[seen == one], minlength=T * K).reshape(T, K).astype(float) for one in (True, False)]
        return cls(count[0], count[1], float(np.log(np.clip(seen.mean(), 0.5 / seen.size, 0.95))))

    def maximum(self, start: Ints, log_rate: Floats, rounds: int) -> tuple[Floats, Floats]:
        """Most likely logarithms of the rates of pieces, and their covariance, by Fisher's scoring."""
        T, K = self.seen.shape
        length = np.diff(np.append(start, T))
        count = self.seen + self.missed
        inverse: Floats = np.eye(start.size)
        for _ in range(rounds):
            p = self._table(np.repeat(log_rate, length))
            slope = np.empty((start.size, T, K))
            for b in range(start.size):
                nudged = log_rate + NUDGE * (np.arange(start.size) == b)
                slope[b] = (self._table(np.repeat(nudged, length)) - p) / NUDGE
            # At one of the ends nothing is learned: there the slope is 0 too.
            spread = np.maximum(p * (1.0 - p), 1e-9)
            score = (slope * ((self.seen - count * p) / spread)).sum(axis=(1, 2))
            flat = slope.reshape(start.size, -1)
            information = (flat * (count / spread).ravel()) @ flat.T + np.eye(start.size) / PRIOR**2
            inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)
            step = inverse @ (score + (self.centre - log_rate) / PRIOR**2)
            log_rate = np.minimum(log_rate + np.clip(step, -1.5, 1.5), np.log(CERTAIN))
        return log_rate, inverse

    def _table(self, log_rate: Floats) -> Floats:
        return fifo_presence(np.exp(log_rate), self.seen.shape[1] - 1)


def _pieces(start: Ints, log_rate: Floats, error: Floats, T: int, log_size: float) -> tuple[Ints, Floats]:
    """Join neighbouring slots: the best division by weighted least squares, with a price for each piece."""
    # Square roots of rates have errors that depend less on the rate.
    root = np.exp(0.5 * log_rate)
    weight = 1.0 / np.maximum(0.5 * root * error, 1e-9) ** 2
    sums = [np.concatenate([[0.0], np.cumsum(weight * root**k)]) for k in (0, 1, 2)]
    n = start.size
    best, last = np.zeros(n + 1), np.zeros(n + 1, np.int64)
    for j in range(1, n + 1):
        w, x, xx = (s[j] - s[:j] for s in sums)
        cost = best[:j] + np.maximum(xx - x**2 / w, 0.0) + 2.0 * log_size
        last[j] = int(cost.argmin())
        best[j] = cost[last[j]]
    ends = [n]
    while ends[-1]:
        ends.append(int(last[ends[-1]]))
    edges = np.array(ends[::-1])
    level = [(sums[1][b] - sums[1][a]) / (sums[0][b] - sums[0][a]) for a, b in pairwise(edges)]
    return start[edges[:-1]], 2.0 * np.log(np.array(level))
