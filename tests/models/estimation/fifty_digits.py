"""Choices that are hard to fit, and their maximum likelihood estimate in 50 digits.

``python -m tests.models.estimation.fifty_digits 300`` fits new ones for five minutes: refused, or the estimate.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter
from dataclasses import dataclass
from typing import Any

import mpmath as mp
import numpy as np

from optkit.models.estimation import ConditionalLogit, NotIdentifiedError


def draw(seed: int, most_sets: int = 80) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw arguments of ConditionalLogit and of its fit.

    Columns in any units, one of them steep, offsets, dummies that are perhaps never chosen, alone or mixed with other
    columns, noise from nearly none to much, far starts, loose tolerances.
    """
    rng = np.random.default_rng(seed)
    S, k, J = int(rng.integers(12, most_sets)), int(rng.integers(1, 5)), int(rng.integers(2, 5))
    outside, n = bool(rng.random() < 0.4), S * J
    x = rng.normal(size=(n, k))
    if outside and rng.random() < 0.7:
        x[:, 0] = 1.0
    theta = rng.normal(size=k)
    if rng.random() < 0.5:  # a steep column, finite because some sets offer nearly the same of it
        steep = 10.0 ** rng.uniform(-3, 6)
        column, near = x[:, -1].reshape(S, J), rng.random(S) < rng.choice([0.3, 0.7, 1.0])
        if steep > 1:
            column[near] = column[near][:, :1] * (not outside) + rng.normal(size=(near.sum(), J)) / steep
        theta[-1] = steep * rng.choice([-1, 1])
    offset = None
    if rng.random() < 0.5:
        size = 10.0 ** rng.uniform(-2, 5)
        offset = size * rng.normal(size=n) * (rng.random(n) < rng.choice([0.5, 1.0]))
        if rng.random() < 0.3:
            offset[::J] += size
    banned = np.zeros(n, bool)
    if rng.random() < 0.5:
        dummy = (rng.random(n) < rng.choice([0.05, 0.3])) & (np.arange(n) % J != 0)
        x, never = np.column_stack([x, dummy]), rng.random() < 0.6
        banned |= dummy & never
        theta = np.append(theta, 0.0 if never else rng.normal())
        if rng.random() < 0.4:
            x[:, 0] += x[:, -1] * rng.normal()
    noise = rng.choice([1.0, 1.0, 1.0, 0.01, 30.0])
    utility = x @ theta + (0.0 if offset is None else offset) + noise * rng.gumbel(size=n)
    if rng.random() < 0.15:  # choices that have nothing to do with the columns
        utility = rng.normal(size=n)
    utility[banned] = -1e15
    utility = utility.reshape(S, J)
    chosen = utility.argmax(axis=1)[:, None] == np.arange(J)
    if outside:
        chosen &= (utility.max(axis=1) > noise * rng.gumbel(size=S))[:, None]
    units = 10.0 ** rng.uniform(-6, 6, x.shape[1]) if rng.random() < 0.5 else np.ones(x.shape[1])
    start = rng.normal(size=x.shape[1]) * 10.0 ** rng.uniform(-3, 8) / units if rng.random() < 0.5 else None
    tolerance = 10.0 ** rng.uniform(-12, -1) if rng.random() < 0.5 else 1e-10
    data = {"endog": chosen.ravel() * 1.0, "exog": x * units, "groups": np.repeat(np.arange(S), J)}
    return data | {"outside_option": outside, "offset": offset}, {"start_params": start, "tol": tolerance}


@dataclass(frozen=True)
class Estimate:
    """Coefficients, their standard errors, and the log-likelihood."""

    params: list[Any]
    errors: list[Any]
    loglike: Any


class FiftyDigits:
    """The log-likelihood of the very doubles that the estimator was given."""

    def __init__(self, endog, exog, groups, outside_option=False, offset=None):
        self.k, offset = exog.shape[1], np.zeros(len(endog)) if offset is None else offset
        idle = ([mp.mpf(0)] * self.k, mp.mpf(0))
        self.sets = []
        for s in range(groups.max() + 1):
            rows = np.flatnonzero(groups == s)
            every = [([mp.mpf(float(v)) for v in exog[r]], mp.mpf(float(offset[r]))) for r in rows]
            every += [idle] * outside_option
            taken = np.flatnonzero(np.append(endog[rows] == 1, outside_option))[0]
            (x, o), rest = every[taken], every[:taken] + every[taken + 1 :]
            self.sets.append([([a - b for a, b in zip(v, x, strict=True)], w - o) for v, w in rest])

    def at(self, params):
        """Minus the log-likelihood, its gradient and its second derivatives, as sums about the mean of each set."""
        k, value = self.k, mp.mpf(0)
        gradient, curvature = [mp.mpf(0)] * k, mp.matrix(k, k)
        for rivals in self.sets:
            index = [sum(a * b for a, b in zip(d, params, strict=True)) + o for d, o in rivals]
            top = max([mp.mpf(0), *index])
            weight = [mp.exp(max(v - top, -(10**6))) for v in [mp.mpf(0), *index]]
            total = sum(weight)
            value += top + mp.log(total)
            points = [([mp.mpf(0)] * k, weight[0] / total)]
            points += [(d, w / total) for (d, _), w in zip(rivals, weight[1:], strict=True)]
            mean = [sum(p * d[j] for d, p in points) for j in range(k)]
            for j in range(k):
                gradient[j] += mean[j]
                for i in range(j + 1):
                    curvature[i, j] += sum(p * (d[i] - mean[i]) * (d[j] - mean[j]) for d, p in points)
                    curvature[j, i] = curvature[i, j]
        return value, gradient, curvature

    def estimate(self, start, steps=60) -> Estimate | None:
        """Newton's method to 20 digits; None if that ends without proof that a maximum exists."""
        with mp.workdps(50):
            params = [mp.mpf(float(v)) for v in start]
            value, gradient, curvature = self.at(params)
            for _ in range(steps):
                unit = [mp.sqrt(max(curvature[i, i], 0)) for i in range(self.k)]
                if min(unit) == 0:
                    return None
                scaled = mp.matrix(self.k, self.k)
                for i in range(self.k):
                    for j in range(self.k):
                        scaled[i, j] = curvature[i, j] / unit[i] / unit[j]
                try:
                    inverse = scaled**-1
                except ZeroDivisionError:
                    return None
                for i in range(self.k):
                    for j in range(self.k):
                        inverse[i, j] /= unit[i] * unit[j]
                step = [-sum(inverse[i, j] * gradient[j] for j in range(self.k)) for i in range(self.k)]
                gain = -sum(a * b for a, b in zip(step, gradient, strict=True))
                if gain < 0:
                    return None
                if gain < mp.mpf(10) ** -40:
                    proven = 2 * mp.sqrt(gain) * self.reach(inverse) < 1
                    errors = [mp.sqrt(inverse[i, i]) for i in range(self.k)]
                    return Estimate(params, errors, -value) if proven else None
                length = mp.mpf(1)
                while length > mp.mpf(10) ** -60:
                    trial = [a + length * b for a, b in zip(params, step, strict=True)]
                    there = self.at(trial)
                    if there[0] <= value - length * gain / 10_000:
                        break
                    length /= 2
                params, (value, gradient, curvature) = trial, there
        return None

    def reach(self, inverse):
        """Largest sqrt(d' A^-1 d) over the rivals d."""
        k = range(self.k)
        return mp.sqrt(max(sum(d[i] * inverse[i, j] * d[j] for i in k for j in k) for s in self.sets for d, _ in s))


def outcome(seed, most_sets=80):
    """Fit the choices of a seed; say "refused" or "right", or raise."""
    data, options = draw(seed, most_sets)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* are few")
        warnings.filterwarnings("ignore", ".* the outside option, so the level")
        warnings.filterwarnings("error", category=RuntimeWarning)
        try:
            results = ConditionalLogit(**data).fit(**options)
        except NotIdentifiedError:
            return "refused"
    reference = FiftyDigits(**data).estimate(results.params)
    assert reference is not None, f"seed {seed}: there is no maximum, and fit returned {results.params}"
    off = [abs((float(a) - b) / s) for a, b, s in zip(results.params, reference.params, reference.errors, strict=True)]
    # In standard errors: the tolerance of the search, or what rounding of indices of 1e6 leaves of it.
    assert max(off) <= max(1.5 * options["tol"], 1e-6), f"seed {seed}: off by {float(max(off)):.1e} standard errors"
    assert np.allclose(results.bse, np.array([float(s) for s in reference.errors]), rtol=1e-5, atol=0), f"seed {seed}"
    slack = max(options["tol"] ** 2, 1e-9, 1e-9 * abs(float(reference.loglike)))
    assert abs(results.llf - float(reference.loglike)) <= slack, f"seed {seed}"
    assert results.converged, f"seed {seed}"
    return "right"


def main(seconds: float, first: int = 1000) -> int:
    """Fit new choices for so many seconds; print what came out, and each seed that went wrong."""
    end, found, seed = time.monotonic() + seconds, Counter(), first
    while time.monotonic() < end:
        try:
            found[outcome(seed, most_sets=40)] += 1
        except Exception as error:
            found["wrong"] += 1
            print(f"{type(error).__name__}: {error}", flush=True)
        seed += 1
    print(dict(found), f"seeds {first} to {seed - 1}")
    return found["wrong"]


if __name__ == "__main__":
    sys.exit(bool(main(*map(int, sys.argv[1:]))))
