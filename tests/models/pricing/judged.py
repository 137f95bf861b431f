"""Verdicts about prices against a judge who calculates with as many digits as it takes.

``python -m tests.models.pricing.judged 300`` judges random decisions of all scales for 300 seconds and says how many; a
second number is the first seed.
"""

from __future__ import annotations

import math
import sys
import time
import traceback
from collections import Counter
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import mpmath
import numpy as np

from optkit.basics.errors import InputError, SolverError
from optkit.models.choice import acceptance_probabilities
from optkit.models.pricing import certify, optimal_prices
from optkit.models.pricing_program import ACCURACY, PricingProgram

KINDS = ("ordinary", "ordinary", "scales", "scales", "cancelling", "far", "tied", "loved", "huge")


@dataclass(frozen=True)
class Case:
    """One decision, what it is an example of, and somebody's prices."""

    kind: str
    value: np.ndarray
    utility: np.ndarray
    mu: float
    outside_utility: float
    nonnegative: bool
    offered: np.ndarray

    @property
    def facts(self) -> dict[str, Any]:
        """Arguments that go by name."""
        return {"outside_utility": self.outside_utility, "offered": self.offered}

    def scaled(self, unit: float) -> Case:
        """The same in another unit of money."""
        money = (unit * x for x in (self.value, self.utility, self.mu, self.outside_utility))
        return Case(self.kind, *money, self.nonnegative, self.offered)


def draw(rng: np.random.Generator) -> Case:
    """A decision: gig work, amounts of any scale, opposite amounts, ties, a utility far from 0 or beyond all reason."""
    kind = KINDS[rng.integers(len(KINDS))]
    n = int(rng.choice([1, 2, 3, 5, 12]))
    mu = 10.0 ** rng.uniform(-12, 12)

    def any_scale(low: float, high: float) -> np.ndarray:
        return rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(low, high, n)

    value, utility, outside = mu * rng.uniform(-5, 60, n), -mu * rng.uniform(-5, 60, n), 0.0
    if kind == "scales":
        reach = rng.uniform(-3, 12)
        value, utility, outside = mu * any_scale(-6, reach), mu * any_scale(-6, reach), mu * any_scale(-6, reach)[0]
    elif kind == "cancelling":
        value = mu * any_scale(0, rng.uniform(0, 14))
        utility = -value + mu * rng.normal(0, 3, n)
    elif kind == "far":
        outside = mu * any_scale(0, 16)[0]
        utility = utility + outside * rng.integers(0, 2)
    elif kind == "tied":
        value, utility = mu * np.round(rng.uniform(-5, 9, n)), mu * np.round(rng.uniform(-9, 5, n))
    elif kind == "loved":
        value, utility = mu * rng.uniform(-50, 10, n), mu * rng.uniform(-20, 20, n)
    elif kind == "huge":
        mu = max(mu, 1.0)
        value, utility = mu * rng.uniform(-5, 60, n), -mu * rng.uniform(-5, 60, n)
        some = rng.random(n) < 0.5
        utility = np.where(some, any_scale(0, 300), utility)
        value = np.where(rng.random(n) < 0.2, any_scale(0, 300), value)
    if rng.random() < 0.3:
        utility = np.where(rng.random(n) < 0.3, -np.inf, utility)
    offered = rng.random(n) < (0.7 if rng.random() < 0.3 else 2.0)
    return Case(kind, value, utility, mu, float(outside), bool(rng.random() < 0.7), offered)


def proposals(case: Case, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Prices good and bad."""
    best = optimal_prices(case.value, case.utility, case.mu, nonnegative=case.nonnegative, **case.facts).compensation
    n = len(best)
    near = best + case.mu * 10.0 ** rng.uniform(-14, 1, n) * rng.choice([-1.0, 0.0, 1.0], n)
    one = best.copy()
    one[rng.integers(n)] *= 1.0 + rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-16, 0)
    found = {
        "best": best,
        "near": near,
        "one off": one,
        "nothing": 0.0 * best,
        "all": np.where(case.offered, case.value, 0),
    }
    if case.nonnegative:
        found |= {"near": np.maximum(near, 0.0), "all": np.maximum(found["all"], 0.0)}
    return found


class Judge:
    """What prices earn and whether an amount bounds all profits, in arithmetic that rounds nothing that matters."""

    def __init__(self, case: Case) -> None:
        served = case.offered & np.isfinite(case.utility)
        self.case, self.served = case, np.flatnonzero(served)
        money = [case.mu, case.outside_utility, *case.value[served], *case.utility[served]]
        largest = max(map(abs, money))
        self.digits = 60 + max(0, math.ceil(math.log10(largest / case.mu)))

    def _exactly(self, x: np.ndarray) -> list[Any]:
        return [mpmath.mpf(float(x[i])) for i in self.served]

    def earned(self, prices: np.ndarray) -> Any:
        """Expected profit of prices."""
        with mpmath.workdps(self.digits):
            mu, outside = mpmath.mpf(self.case.mu), mpmath.mpf(self.case.outside_utility)
            c, v, u = map(self._exactly, (prices, self.case.value, self.case.utility))
            weight = [mpmath.exp((ui + ci - outside) / mu) for ui, ci in zip(u, c, strict=True)]
            return mpmath.fsum(w * (vi - ci) for w, vi, ci in zip(weight, v, c, strict=True)) / (
                1 + mpmath.fsum(weight)
            )

    def bounds(self, amount: Any) -> bool:
        """Whether no prices earn more than an amount R: sum_i max_c w_i e^(c/mu) (v_i - c - R) <= R."""
        with mpmath.workdps(self.digits):
            mu, outside, R = mpmath.mpf(self.case.mu), mpmath.mpf(self.case.outside_utility), mpmath.mpf(amount)
            more = []
            for v, u in zip(self._exactly(self.case.value), self._exactly(self.case.utility), strict=True):
                price = v - mu - R
                if self.case.nonnegative and price < 0:
                    price = mpmath.mpf(0)
                more.append(mpmath.exp((u + price - outside) / mu) * (v - price - R))
            return bool(mpmath.fsum(more) <= R)


def finite(result: Any) -> None:
    """No number of a result is NaN or infinite."""
    for field in fields(result):
        x = getattr(result, field.name)
        assert isinstance(x, str) or np.isfinite(x).all(), field.name


def judge_certificates(case: Case, rng: np.random.Generator) -> Counter[str]:
    """Certify good and bad prices, and hold every verdict and bound against the judge."""
    judge, told = Judge(case), Counter()
    for name, prices in proposals(case, rng).items():
        more = {"tolerance": float(rng.choice([1e-9, 1e-9, 1e-6, 1e-16])), "nonnegative": case.nonnegative}
        proof = certify(prices, case.value, case.utility, case.mu, **more, **case.facts)
        finite(proof)
        with mpmath.workdps(judge.digits):
            assert judge.bounds(float(proof.bound)), f"{name}: the bound {proof.bound} is exceeded"
            earned = judge.earned(prices)
            assert float(proof.bound) - earned <= float(proof.gap) * (1 + 1e-12) + 1e-300, (
                f"{name}: the gap {proof.gap} is larger"
            )
            allowed = mpmath.mpf(proof.tolerance) * (mpmath.mpf(case.mu) + abs(mpmath.mpf(float(proof.bound))))
            close = judge.bounds(earned + allowed)
            feasible = proof.infeasibility <= allowed
        assert close or not proof.optimal, f"{name}: called optimal"
        assert not (proof.optimal and proof.undecided)
        assert proof.optimal or proof.undecided or not (close and feasible), f"{name}: called not optimal"
        verdict = "optimal" if proof.optimal else "undecided" if proof.undecided else "not optimal"
        told[f"{case.kind}, {name}: {verdict}"] += 1
        if case.kind == "ordinary" and proof.tolerance >= 1e-9:
            assert not proof.undecided, f"{name}: undecided"
            assert proof.optimal or name != "best"
        unit = 2.0 ** (-40 if case.kind == "huge" else rng.choice([-40, 40]))
        there = case.scaled(unit)
        again = certify(unit * prices, there.value, there.utility, there.mu, **more, **there.facts)
        same = (again.optimal, again.undecided) == (proof.optimal, proof.undecided)
        assert same, f"{name}: another verdict in units of {unit}"
    return told


@cache
def program(n: int, nonnegative: bool) -> PricingProgram:
    """One program for each size: building one takes longer than solving it."""
    return PricingProgram(n, nonnegative)


def judge_program(case: Case, rng: np.random.Generator) -> str:
    """Solve the concave program, and hold its bound and its prices against the judge; return how it ended."""

    def solve(case: Case) -> Any:
        facts = case.value, case.utility, case.mu, case.outside_utility
        try:
            return program(len(case.value), case.nonnegative).solve(*facts, offered=case.offered)
        except SolverError:
            return None

    found, judge = solve(case), Judge(case)
    unit = 2.0 ** (-40 if case.kind == "huge" else rng.choice([-40, 40]))
    assert (solve(case.scaled(unit)) is None) == (found is None), f"program: another end in units of {unit}"
    if found is None:
        assert case.kind != "ordinary", "program: refused"
        return "refused"
    finite(found)
    assert judge.bounds(found.bound), "program: the bound is exceeded"
    with mpmath.workdps(judge.digits):
        allowed = 1.001 * ACCURACY * (mpmath.mpf(case.mu) + abs(mpmath.mpf(found.profit)))
        assert judge.bounds(judge.earned(found.compensation) + allowed), "program: the prices earn too little"
    return "solved"


def attempt(seed: int) -> Counter[str]:
    """Judge everything about the decision of a seed; return what was said.

    Raises
    ------
    AssertionError
        If something that was said is not so.
    """
    rng = np.random.default_rng(seed)
    case = draw(rng)
    try:
        priced = optimal_prices(case.value, case.utility, case.mu, nonnegative=case.nonnegative, **case.facts)
    except InputError:
        return Counter({f"{case.kind}: refused": 1})
    finite(priced)
    for probability in acceptance_probabilities(priced.compensation, case.utility, case.mu, **case.facts):
        assert np.isfinite(probability).all()
    told = judge_certificates(case, rng)
    if rng.random() < 0.1:
        told[f"{case.kind}, program: {judge_program(case, rng)}"] += 1
    return told


def main(seconds: float, first: int = 0) -> int:
    """Judge for some time; print what was said how often and each failure, and return how many fail."""
    told: Counter[str] = Counter()
    end, seed, failed = time.monotonic() + seconds, first, 0
    while time.monotonic() < end:
        try:
            told += attempt(seed)
        except Exception:
            failed += 1
            print(f"seed {seed}: {traceback.format_exc(limit=-1).splitlines()[-1][:300]}", flush=True)
        seed += 1
    for what, times in sorted(told.items()):
        print(f"{what:45s} {times:9,}")
    print(f"{seed - first:,} decisions from seed {first}: {failed} failures")
    return failed


if __name__ == "__main__":
    sys.exit(bool(main(float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)))
