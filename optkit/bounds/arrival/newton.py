r"""The dual of a market minimised by Newton's method: a smooth convex problem with one number per request.

The Hessian of the dual D(l) of :mod:`optkit.bounds.arrival.market` is

.. math:: H = \Lambda - A^\top C A, \qquad \Lambda_i = \sum_t \frac{q_t P_{ti}}{\mu_t}, \qquad
   C_t = \frac{q_t}{\mu_t} \Big(1 + \frac{1}{1 + y_t}\Big),

with A = (P_ti) the sparse (J, n) matrix of acceptances. The matrix inversion lemma moves the linear system to the
workers, ``(C^-1 - A Lambda^-1 A^T) z = A Lambda^-1 g``, where it is banded, because workers far apart in time share no
request. Three things make the method reliable where mu is small against the rewards, and D nearly piecewise linear:

- mu is first multiplied by a factor that makes the market smooth, which is then halved down to 1;
- the quadratic model is minimised over the box l >= 0 by a primal-dual active set, not cut off at 0;
- steps are shortened where they are long against mu, request by request: a line search alone would make a long horizon
  wait for its worst hour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from optkit.basics.arrays import Floats, number, whole_number
from optkit.bounds.arrival.market import OpenPairs

LOOSE = 0.03
"""Mean part of a request that may be served too often, or too little, when the factor on mu is halved."""

SMOOTH = 6.0
"""The first factor on mu is the power of two that brings the largest advantage to about this many mu."""

REACH = 2.0
"""Length of a step, in units of mu, beyond which it is shortened; it doubles with every step that went as foreseen."""

MINOR = 1e-6
"""Acceptance, as a part of the worker's largest, below which a request has no say in the length of his steps."""

DENSE = 20_000
"""Workers times requests up to which dense matrices are quicker than sparse ones."""

DENSE_WORKERS = 150
"""Workers up to which the linear system is solved densely."""

ROUNDS = 30
"""Most rounds of the active set per step; one or two are usual."""


@dataclass(frozen=True)
class Solved:
    """Where Newton's method ended: multipliers (n,) in money, its own words, steps taken, and the relative gap."""

    multipliers: Floats
    status: str
    iterations: int
    gap: float


def check_options(tolerance: float, max_iterations: int) -> None:
    """Raise an InputError unless both are positive."""
    number("tolerance", tolerance, above=0.0)
    whole_number("max_iterations", max_iterations, least=1)


def minimise(
    market: OpenPairs, tolerance: float = 1e-9, max_iterations: int = 500, start: Floats | None = None
) -> Solved:
    """Minimise the dual of any market over l >= 0.

    Parameters
    ----------
    market : OpenPairs
        Of an instance, or of a scenario's expected numbers.
    tolerance, max_iterations : float, int
        As in :func:`optkit.bounds.arrival.dual.arrival_dual`.
    start : (n,) float, optional
        Multipliers to begin with, in money; mu is not enlarged then.
    """
    if not market.size:
        return Solved(np.zeros(market.count.size), "optimal", 0, 0.0)
    prices, scale = (np.zeros(market.count.size), _smoothing(market)) if start is None else (start, 1.0)
    here, reach, idle, iterations = _Point.at(market, prices, scale), REACH, 0, 0
    while True:
        while here.scale > 1.0 and (idle > 1 or here.unrest() <= LOOSE):
            here, reach, idle = _Point.at(market, here.prices, here.scale / 2.0), REACH, 0
        done = here.scale == 1.0 and (idle > 1 or here.relative_gap() <= tolerance)
        if done or iterations == max_iterations:
            break
        found, reach = _step(here, reach)
        iterations += 1
        # Twice without a decrease: the sums of D have no digits left.
        idle = 0 if found is not None and found.gain < here.gain else idle + 1
        here = here if found is None else found
    gap = _Point.at(market, here.prices, 1.0).relative_gap()
    status = "optimal"
    if gap > tolerance:
        why = "without further progress" if done else f"by the limit of {max_iterations} steps"
        status = f"stopped {why}: valid, but up to {gap:.1e} above the optimum"
    return Solved(here.prices, status, iterations, gap)


def _smoothing(market: OpenPairs) -> float:
    """The first factor on mu, a power of two, at least 1."""
    steepest = float((market.advantage / market.mu[market.worker]).max())
    return float(2.0 ** np.ceil(np.log2(max(steepest / SMOOTH, 1.0))))


@dataclass(frozen=True, eq=False)
class _Point:
    """Multipliers, the workers' response to them, and the dual's value and gradient."""

    market: OpenPairs
    scale: float
    prices: Floats
    ratio: Floats
    acceptance: Floats
    gain: float
    slope: Floats

    @classmethod
    def at(cls, market: OpenPairs, prices: Floats, scale: float) -> _Point:
        ratio, acceptance = market.respond(prices, scale)
        gain = market.gain(prices, ratio, scale)
        return cls(market, scale, prices, ratio, acceptance, gain, market.count - market.served(acceptance))

    def relative_gap(self) -> float:
        """Distance to what a feasible solution earns, as a part of the gain, for scale 1."""
        short = self.gain - self.market.feasible_gain(self.prices, self.ratio, self.acceptance)
        return short / self.gain if short > 0 else 0.0

    def unrest(self) -> float:
        """How far from optimal a request is in the mean: 0 at the optimum, in units of the request, or of mu."""
        market = self.market
        idle = np.minimum(self.prices / (self.scale * market.least_mu), self.slope / market.count)
        return float(np.abs(idle).sum() / market.by_request[1].size)


def _step(here: _Point, reach: float) -> tuple[_Point | None, float]:
    """One Newton step over the box l >= 0, None if nothing lowers the dual, and how far the next one may reach."""
    model = _Model(here)
    free = (here.prices > 0) | (here.slope < 0)
    for _ in range(ROUNDS):
        free_move = model.minimise(free, -here.prices)
        move = np.maximum(free_move, -here.prices)
        length = _length(here, move)
        for within in sorted({reach, REACH, REACH / 2, REACH / 4}, reverse=True):
            found = _search(here, move * (within / np.maximum(length, within)), 1)
            if found is not None:
                return found, max(2.0 * within, REACH)
        still_free = np.where(free, here.prices + free_move >= 0, here.slope + model.times(free_move) < 0)
        if (still_free == free).all():  # the exact minimum over the box: a descent direction
            return _search(here, move, 40), REACH
        free = still_free
    return None, REACH


def _search(here: _Point, move: Floats, trials: int) -> _Point | None:
    """Halve the move until D falls enough (Armijo's rule), within the rounding of D."""
    share = 1.0
    for _ in range(trials):
        prices = np.maximum(here.prices + share * move, 0.0)
        descent = float(here.slope @ (prices - here.prices))
        there = _Point.at(here.market, prices, here.scale)
        if descent <= 0 and there.gain <= here.gain + 1e-4 * descent + 1e-13 * here.gain:
            return there
        share /= 2.0
    return None


def _length(here: _Point, move: Floats) -> Floats:
    """How far each request's workers are asked to move, in units of their mu, (n,): far, the model may say nothing."""
    market, acceptance = here.market, here.acceptance
    longest = np.abs(move)
    if longest.max() <= REACH / 4 * here.scale * market.mu.min():
        return np.zeros_like(move)  # all steps are short
    matters = acceptance > MINOR * market.largest_by_worker(acceptance)[market.worker]
    length = market.largest_by_worker(np.where(matters, longest[market.request], 0.0)) / (here.scale * market.mu)
    return market.largest_by_request(np.where(matters, length[market.worker], 0.0))


class _Model:
    """The quadratic model of the dual at a point, ``g.d + d.H.d / 2``."""

    def __init__(self, here: _Point) -> None:
        market = here.market
        mu = here.scale * market.mu
        self.here, self.market = here, market
        self.within = (market.presence / mu) * (1.0 + 1.0 / (1.0 + here.ratio))
        self.curvature = np.bincount(
            market.request, here.acceptance * (market.presence / mu)[market.worker], market.count.size
        )
        # Requests that nobody wants at their price have no curvature, and fall to where they matter, or to 0.
        self.curvature += 1e-10 * market.count / mu.max()
        self.dense: Floats | None = None
        if market.mu.size * market.count.size <= DENSE:
            self.dense = np.zeros((market.mu.size, market.count.size))
            self.dense[market.worker, market.request] = here.acceptance

    def times(self, move: Floats) -> Floats:
        """H d, (n,)."""
        market, acceptance = self.market, self.here.acceptance
        if self.dense is not None:
            return self.curvature * move - (self.within * (self.dense @ move)) @ self.dense
        together = self.within * np.add.reduceat(acceptance * move[market.request], market.starts)
        pulled = np.bincount(market.request, acceptance * together[market.worker], market.count.size)
        return self.curvature * move - pulled

    def minimise(self, free: npt.NDArray[np.bool_], others: Floats) -> Floats:
        """Minimise over the moves (n,) of the free requests, the others moving as given."""
        fixed = np.where(free, 0.0, others)
        slope = self.here.slope + (self.times(fixed) if fixed.any() else 0.0)
        inverse = np.where(free, 1.0 / self.curvature, 0.0)
        try:
            pulled = self._pull(free, inverse, slope)
        except (np.linalg.LinAlgError, RuntimeError):  # singular to the last digit: the curvature alone is enough
            pulled = np.zeros_like(slope)
        return np.where(free, -inverse * (slope + pulled), fixed)

    def _pull(self, free: npt.NDArray[np.bool_], inverse: Floats, slope: Floats) -> Floats:
        """What the workers' choices add to the slopes (n,) in the optimum of the model."""
        if self.dense is not None:
            spread = self.dense * inverse
            system = np.diag(1.0 / self.within) - spread @ self.dense.T
            return np.asarray(np.linalg.solve(system, spread @ slope) @ self.dense)
        from scipy.sparse.linalg import splu

        market, acceptance = self.market, self.here.acceptance
        top = market.largest_by_worker(acceptance)[market.worker]
        kept = np.flatnonzero(free[market.request] & (acceptance > 1e-13 * top))
        shape = (market.mu.size, market.count.size)
        starts = np.searchsorted(kept, np.append(market.starts, market.size))
        request, weight = market.request[kept], acceptance[kept]
        matrix: Any = sparse.csr_array((weight, request, starts), shape=shape)
        scaled: Any = sparse.csr_array((weight * inverse[request], request, starts), shape=shape)
        banded: Any = sparse.diags_array(1.0 / self.within) - scaled @ matrix.T.tocsr()
        if shape[0] <= DENSE_WORKERS:
            return np.asarray(matrix.T @ np.linalg.solve(banded.toarray(), scaled @ slope))
        # Positive definite and in the order of time: no pivoting, and hardly any fill.
        factors = splu(banded.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return np.asarray(matrix.T @ factors.solve(scaled @ slope))
