"""Optima of small instances and models in 60 digits, from the definitions of the process and of the duals."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import product
from typing import Any

import mpmath as mp
import numpy as np

mp.mp.dps = 60


def best_profit(value: list[Any], logit: list[Any], mu: Any, nonnegative: bool = True) -> Any:
    """Optimal profit of one decision: the root of mu sum_i w_i g((v_i - R)/mu) = R, by halves, then by Newton."""
    if not value:
        return mp.mpf(0)

    def sides(R: Any) -> tuple[Any, Any]:
        total, slope = -R / mu, mp.mpf(1)
        for v, z in zip(value, logit, strict=True):
            x = (v - R) / mu
            held = nonnegative and x < 1
            q = mp.exp(z) if held else mp.exp(z + x - 1)
            total += q * x if held else q
            slope += q
        return total, slope

    # Between ends, the left one where the sum is positive; Newton's method crawls by mu a step until it is near.
    R = min([mp.mpf(0), *value]) if nonnegative else mp.mpf(0)
    right = max(abs(R), mu)
    while sides(right)[0] > 0:
        right *= 2
    while right - R > mu / 4:
        middle = (R + right) / 2
        R, right = (middle, right) if sides(middle)[0] > 0 else (R, middle)
    for _ in range(1_000):
        total, slope = sides(R)
        step = mu * total / slope
        R += step
        if abs(step) <= mp.mpf(10) ** -50 * (abs(R) + mu):
            return R - abs(step) - mp.mpf(10) ** -45 * (abs(R) + mu)
    raise AssertionError("Newton's method has not ended")


def full_optimum(day: Any) -> Fraction:
    """Best of all matchings, in fractions: no rounding at all."""
    exact = Fraction

    @cache
    def rest(j: int, free: frozenset[int]) -> Fraction:
        if j == day.n_workers:
            return exact(0)
        step, d, best = day.worker_step[j], day.worker_group[j], rest(j + 1, free)
        for i in free:
            if day.arrival[i] <= step <= day.expiry[i]:
                idle = exact(float(day.outside_by_group[d])) + exact(float(day.outside_noise[j]))
                taken = exact(float(day.utility[d, i])) + exact(float(day.noise[j, i]))
                gain = exact(float(day.reward[i])) - exact(float(day.penalty[i])) - max(exact(0), idle - taken)
                best = max(best, gain + rest(j + 1, free - {i}))
        return best

    return sum((exact(float(b)) for b in day.penalty), exact(0)) + rest(0, frozenset(range(day.n_requests)))


def arrival_optimum(day: Any, charge: Any = None) -> Any:
    """What one earns in the mean who knows the arrivals, less ``charge(step, those who wait)`` after each step."""
    worker = dict(zip(day.worker_step.tolist(), range(day.n_workers), strict=True))
    reward, penalty = ([mp.mpf(float(x)) for x in column] for column in (day.reward, day.penalty))

    @cache
    def after(step: int, waiting: frozenset[int]) -> Any:
        expired = sum((penalty[i] for i in waiting if day.expiry[i] == step), mp.mpf(0))
        stay = frozenset(i for i in waiting if day.expiry[i] > step)
        fee = mp.mpf(charge(step, stay)) if charge is not None else mp.mpf(0)
        return expired - fee + before(step + 1, stay)

    @cache
    def before(step: int, waiting: frozenset[int]) -> Any:
        if step == day.horizon:
            return mp.mpf(0)
        open_ = waiting | {i for i in range(day.n_requests) if day.arrival[i] == step}
        base = after(step, open_)
        if step not in worker:
            return base
        d, members = day.worker_group[worker[step]], sorted(open_)
        mu, outside = mp.mpf(float(day.mu[d])), mp.mpf(float(day.outside_by_group[d]))
        value = [reward[i] - base + after(step, open_ - {i}) for i in members]
        return base + best_profit(value, [(mp.mpf(float(day.utility[d, i])) - outside) / mu for i in members], mu)

    first = mp.mpf(charge(-1, frozenset())) if charge is not None else mp.mpf(0)
    return before(0, frozenset()) - first


def dual_value(market: Any, multipliers: Any) -> Any:
    """D(l) of :mod:`optkit.bounds.arrival.market` at ``max(l, 0)``, from a :class:`Market` of plain numbers."""
    prices = [mp.mpf(max(float(x), 0.0)) for x in multipliers]
    total = sum((n * (b + price) for n, b, price in zip(market.count, market.penalty, prices, strict=True)), mp.mpf(0))
    for q, mu, pairs in market.workers:
        value = [advantage - prices[i] for i, advantage in pairs]
        logs = [mp.log(market.count[i]) for i, _ in pairs]
        total += q * best_profit(value, logs, mu, nonnegative=False)
    return total


class Market:
    """Workers with their chances, scales and open requests: of an instance, or of a fluid model."""

    def __init__(self, subject: Any) -> None:
        number = lambda x: mp.mpf(float(x))  # noqa: E731
        self.penalty = [number(x) for x in subject.penalty]
        self.count = [number(x) for x in getattr(subject, "count", np.ones(len(self.penalty)))]
        if hasattr(subject, "presence"):
            seen = [(t, d, number(q)) for (t, d), q in np.ndenumerate(subject.presence) if q > 0]
            outside = subject.outside_utility
        else:
            seen = [(t, d, mp.mpf(1)) for t, d in zip(subject.worker_step, subject.worker_group, strict=True)]
            outside = subject.outside_by_group
        self.workers = []
        for t, d, q in seen:
            open_ = [i for i in range(len(self.penalty)) if subject.arrival[i] <= t <= subject.expiry[i]]
            pairs = [
                (i, number(subject.reward[i]) - self.penalty[i] + number(subject.utility[d, i]) - number(outside[d]))
                for i in open_
            ]
            self.workers.append((q, number(subject.mu[d]), pairs))


def model_optimum(model: Any) -> Any:
    """The exact value of a small model, step by step from its definition."""
    K, T, Q = model.reward.size, model.horizon, model.queue
    number = lambda x: mp.mpf(float(x))  # noqa: E731
    penalty, reward = [number(x) for x in model.penalty], [number(x) for x in model.reward]
    arriving = [
        (sum(counts), mp.fprod(number(p) for _, p in path))
        for path in product(*(list(zip(s.count, s.probability, strict=True)) for s in model.streams))
        for counts in [[count for count, _ in path] or [np.zeros(K, int)]]
    ]

    @cache
    def after(step: int, open_: tuple[tuple[int, int], ...], queue: int) -> Any:
        """Requests are (type, last step)."""
        expired = sum((penalty[k] for k, last in open_ if last == step), mp.mpf(0))
        return expired + before(step + 1, tuple(one for one in open_ if one[1] > step), queue)

    @cache
    def before(step: int, waiting: tuple[tuple[int, int], ...], queue: int) -> Any:
        if step == T:
            return mp.mpf(0)
        total = mp.mpf(0)
        for counts, chance in arriving:
            came = [(k, min(step + int(model.lifetime[k]), T - 1)) for k in range(K) for _ in range(int(counts[k]))]
            open_ = tuple(sorted([*waiting, *came]))
            for joined, p in enumerate(model.workers):
                left = min(max(queue + joined - 1, 0), Q)
                base = after(step, open_, left)
                if queue + joined > 0:
                    base += sum(
                        (number(s) * profit(step, open_, left, d) for d, s in enumerate(model.share)), mp.mpf(0)
                    )
                total += chance * number(p) * base
        return total

    @cache
    def profit(step: int, open_: tuple[tuple[int, int], ...], queue: int, d: int) -> Any:
        base, mu = after(step, open_, queue), number(model.mu[d])
        value = [reward[k] - base + after(step, open_[:i] + open_[i + 1 :], queue) for i, (k, _) in enumerate(open_)]
        outside = number(model.outside_by_group[d])
        return best_profit(value, [(number(model.utility[d, k]) - outside) / mu for k, _ in open_], mu)

    return before(0, (), 0)
