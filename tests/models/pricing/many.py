"""Verdicts about millions of decisions, against sums in extended precision.

``python -m tests.models.pricing.many 300`` judges batches for 300 seconds and says how many decisions; a second number
is the first seed. What needs more digits than these have is judged one by one (:mod:`tests.models.pricing.judged`).
"""

from __future__ import annotations

import sys
import time
from collections import Counter

import numpy as np

from optkit.models.pricing import certify, optimal_prices

BATCH = 500
"""Decisions judged at once."""

DIGITS = 64 * np.finfo(np.longdouble).eps
"""What the judge's own sums may be wrong by, of the money in them."""


def draw(rng):
    """Decisions of gig work: values, utilities, noise scales, outside utilities, what is offered, the sign of pay."""
    n, mu = int(rng.integers(1, 13)), 10.0 ** rng.uniform(-9, 9, BATCH)
    size = rng.choice([1.0, 10.0, 100.0])
    value = mu[:, None] * size * rng.uniform(-0.3, 3, (BATCH, n))
    utility = -mu[:, None] * size * rng.uniform(-0.3, 3, (BATCH, n))
    if rng.random() < 0.3:
        value, utility = (mu[:, None] * np.round(x / mu[:, None]) for x in (value, utility))
    if rng.random() < 0.3:
        utility = np.where(rng.random(utility.shape) < 0.2, -np.inf, utility)
    outside = mu * rng.normal(0, 10, BATCH) * rng.integers(0, 2)
    offered = rng.random(value.shape) < (0.8 if rng.random() < 0.3 else 2.0)
    return value, utility, mu, outside, offered, bool(rng.random() < 0.7)


class Judge:
    """Profits, and whether amounts bound all profits, of many decisions; everything in units of mu."""

    def __init__(self, value, utility, mu, outside, offered, nonnegative):
        wide = np.longdouble
        self.mu, self.nonnegative = wide(mu), nonnegative
        self.v = wide(value) / self.mu[:, None]
        u = (wide(utility) - wide(outside)[:, None]) / self.mu[:, None]
        self.u = np.where(offered, u, -np.inf)

    def earned(self, prices):
        """Expected profit, (B,)."""
        c = np.longdouble(prices) / self.mu[:, None]
        weight = np.exp(self.u + np.where(np.isfinite(self.u), c, 0))
        return (weight * (self.v - c)).sum(axis=1) / (1 + weight.sum(axis=1))

    def excess(self, R):
        """What all requests together promise beyond R: at most 0 where no prices earn more than R, (B,)."""
        c = self.v - 1 - R[:, None]
        c = np.maximum(c, 0) if self.nonnegative else c
        weight = np.exp(self.u + np.where(np.isfinite(self.u), c, 0))
        return (weight * (self.v - c - R[:, None])).sum(axis=1) - R

    def optimum(self):
        """Two amounts that enclose the best profit, by bisection: (B,) each."""
        low = np.minimum(self.earned(np.zeros(self.v.shape)), -1.0)
        high = (np.where(np.isfinite(self.u), self.v + np.maximum(self.u, 0), 0)).max(axis=1).clip(min=0) + 4
        for _ in range(90):
            middle = (low + high) / 2
            above = self.excess(middle) > 0
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        return low, high


def attempt(seed):
    """Judge everything that is said of a batch; return how often what was said.

    Raises
    ------
    AssertionError
        If something is not so.
    """
    rng = np.random.default_rng([5, seed])
    value, utility, mu, outside, offered, nonnegative = case = draw(rng)
    facts = {"outside_utility": outside, "nonnegative": nonnegative, "offered": offered}
    judge, told = Judge(*case), Counter()
    low, high = judge.optimum()
    play = np.where(np.isfinite(judge.u), np.abs(judge.v) + np.abs(judge.u), 0).max(axis=1) + 1
    slack = DIGITS * play
    best = optimal_prices(value, utility, mu, **facts)
    assert np.isfinite(best.compensation).all()
    assert (np.abs(best.profit / judge.mu - low) <= 1e-12 * play).all(), "the profit is another"
    off = best.compensation * (1 + rng.choice([-1.0, 0.0, 1.0], value.shape) * 10.0 ** rng.uniform(-12, 0, value.shape))
    for name, prices in {"best": best.compensation, "off": off, "nothing": 0.0 * off}.items():
        for tolerance in (1e-9, 1e-6):
            proof = certify(prices, value, utility, mu, tolerance=tolerance, **facts)
            bound, earned = proof.bound / judge.mu, judge.earned(prices)
            assert (bound >= low - slack).all(), f"{name}: a bound is exceeded"
            allowed, gap = tolerance * (1 + np.abs(bound)), high - earned
            assert not (proof.optimal & (gap > allowed * (1 + 1e-6) + slack)).any(), f"{name}: called optimal"
            assert (bound - earned <= proof.gap / judge.mu * (1 + 1e-12) + slack).all(), f"{name}: the gap is larger"
            surely = gap < allowed * (1 - 1e-3) - 1e-11 * play
            assert not (~proof.optimal & ~proof.undecided & surely).any(), f"{name}: called not optimal"
            if name == "best":
                assert proof.optimal.all(), "the best prices are not proven"
            told["optimal"] += int(proof.optimal.sum())
            told["undecided"] += int(proof.undecided.sum())
            told["not optimal"] += int((~proof.optimal & ~proof.undecided).sum())
    return told


def main(seconds, first=0):
    """Judge for some time; print what was said how often and each failure, and return how many batches fail."""
    told, end, seed, failed = Counter(), time.monotonic() + seconds, first, 0
    while time.monotonic() < end:
        try:
            told += attempt(seed)
        except AssertionError as error:
            failed += 1
            print(f"seed {seed}: {error}", flush=True)
        seed += 1
    print(f"{(seed - first) * BATCH:,} decisions, {sum(told.values()):,} verdicts: {dict(told)}; {failed} failures")
    return failed


if __name__ == "__main__":
    sys.exit(bool(main(float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)))
