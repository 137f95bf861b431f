"""Newton's method for a concave log-likelihood, penalised or not, that proves its maximum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from optkit.basics.arrays import Floats
from optkit.models.estimation.likelihood import Likelihood, Slopes

PROVEN = 0.25
"""Newton decrement times reach below which there is a maximum; 1/2 would do but for rounding."""

SETTLED = 1e-6
"""Newton decrement times reach, the log-odds that the next step may still move, at which the search may end."""

RUNAWAY = 1e-5
"""Standard errors: closer to a summit than this without proof that there is one is a climb without a summit."""

FLOOR = 1e-4
"""Standard errors: a decrement below this that no longer falls is as small as rounding lets it be."""

REGULAR = 1e-11
"""Smallest eigenvalue of the curvature, scaled to a unit diagonal, that is not rounding."""

FAR = 1e12
"""Change of the index beyond which an objective that still rises is taken to rise for ever."""

LOST = 1e-9
"""Share of a Newton step below which the curvature has nothing to do with the objective."""


@dataclass(frozen=True)
class Optimum:
    """Where the search ended.

    Attributes
    ----------
    params : (k,) float
        Coefficients.
    value, null : float
        Log-likelihood there and at coefficients of 0, without the penalty.
    share : (p,) float
        Probability of every rival at ``params``.
    information : (k, k) float
        Fisher information at ``params``, without the penalty.
    decrement : float
        Newton decrement ``sqrt(g' A^-1 g)``: how far the summit is, in standard errors.
    iterations : int
        Newton steps taken.
    converged : bool
        Whether there is a maximum, by proof, and it is within the tolerance.
    proven : bool
        Whether the derivatives at ``params`` prove that there is a maximum.
    lost : bool
        Whether no step along Newton's direction helped, because the curvature is that of a flat spot.
    """

    params: Floats
    value: float
    null: float
    share: Floats
    information: Floats
    decrement: float
    iterations: int
    converged: bool
    proven: bool
    lost: bool

    @property
    def flat(self) -> bool:
        """Whether the likelihood is flat although no maximum is proven: there may be none."""
        return not self.proven and self.decrement <= RUNAWAY


def maximise(
    likelihood: Likelihood,
    penalty: Floats,
    start: Floats,
    scale: Floats,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
    watch: bool = True,
) -> Optimum:
    r"""Maximise ``log-likelihood - sum(penalty * params**2) / 2``.

    Parameters
    ----------
    likelihood : Likelihood
    penalty, start, scale : (k,) float
        L2 penalties (at least 0), first guess, and a typical size of each column's differences (positive). A guess
        worse than zeros is not used. The scale only conditions the linear algebra: Newton's method does not depend
        on it.
    tolerance : float
        On the Newton decrement, in standard errors; rounding is allowed for on top.
    max_iterations : int
        Largest number of steps.
    watch : bool
        Stop where the likelihood looks as if it had no maximum, so that the caller can find out. False where a maximum
        is known to exist, however far out.

    Returns
    -------
    Optimum
        Also if it did not converge; its flags say so.

    Notes
    -----
    A flat likelihood is no sign of a maximum: where choices are separated it flattens for ever. What proves one is
    :math:`2 \lambda D < 1`, with the Newton decrement :math:`\lambda` and the reach :math:`D`, the largest
    :math:`\sqrt{d^\top A^{-1} d}` over the differences d between a rival and its choice. Along any direction h the
    third derivative is at most :math:`2 D \|h\|_A` times the second (a third central moment is at most the range times
    the variance), so the slope turns before it could run away (F. Bach (2010), "Self-concordant analysis for logistic
    regression", Electronic Journal of Statistics 4). Separated choices have :math:`\lambda D \ge 1` everywhere.

    Where an offset makes every choice all but certain there is no curvature to follow. Then the search starts anew
    from a small share of the offset, and follows the maximum as the share grows to 1.
    """
    found = _climb(likelihood, penalty, start, scale, tolerance, max_iterations, watch)
    if not found.lost:
        return found
    params, offset = np.zeros_like(start), likelihood.offset
    share = 1.0 if offset is None else min(1.0, 1.0 / float(np.abs(offset).max()))
    while offset is not None and share < 1.0:
        # With coefficients and offset both scaled by the share, the penalty weighs as if divided by it.
        part = replace(likelihood, offset=offset * share)
        near = _climb(part, penalty / share, params * share, scale, 1e-3, max_iterations, True)
        params = near.params / share
        share = min(1.0, 4.0 * share)
    return _climb(likelihood, penalty, params, scale, tolerance, max_iterations, watch)


def _climb(
    likelihood: Likelihood,
    penalty: Floats,
    start: Floats,
    scale: Floats,
    tolerance: float,
    max_iterations: int,
    watch: bool,
) -> Optimum:
    def objective_at(params: Floats) -> tuple[float, Floats, Floats]:
        share, terms = likelihood.at(params)
        objective = likelihood.weigh(terms) - 0.5 * float(penalty @ params**2)
        return objective if np.isfinite(objective) else -np.inf, share, terms

    params = np.zeros_like(start)
    objective, share, terms = objective_at(params)
    null, last, whole, lost = objective, np.inf, False, False
    if start.any():
        with np.errstate(over="ignore", invalid="ignore"):
            guess = objective_at(start)
        if guess[0] >= objective:
            params, (objective, share, terms) = start, guess
    for iteration in range(max_iterations + 1):
        slopes = likelihood.slopes(share, terms)
        gradient = (slopes.gradient - penalty * params) / scale
        curvature = (slopes.information + np.diag(penalty)) / np.outer(scale, scale)
        step = _newton_step(curvature, gradient)
        with np.errstate(over="ignore", invalid="ignore"):  # a flat spot asks for steps beyond all numbers
            gain, direction = float(gradient @ step), step / scale
        gain = max(gain, 0.0) if np.isfinite(gain) else np.inf
        decrement = gain**0.5
        proven, settled, blur = False, False, 0.0
        if decrement <= FLOOR or iteration == max_iterations:
            blur, reach = _reach(likelihood, slopes, penalty, decrement)
            proven, settled = (decrement + blur) * reach <= PROVEN, decrement * reach <= SETTLED
        rounding = 64 * np.finfo(float).eps * abs(float(np.trace(curvature))) ** 0.5
        stuck = decrement <= blur or (whole and last / 2 <= decrement <= FLOOR)
        converged = proven and ((settled and decrement <= max(tolerance, rounding)) or stuck)
        runaway = decrement <= RUNAWAY and not proven and (watch or stuck)
        if converged or runaway or iteration == max_iterations:
            break
        if not np.isfinite(direction).all():
            lost = True
            break
        length = 1.0
        while length >= LOST:
            trial = params + length * direction
            with np.errstate(over="ignore", invalid="ignore"):
                reached, *there = objective_at(trial)
            # Near the summit the objective is flat to rounding; there the full step is right.
            if reached >= objective + 1e-4 * length * gain - 1e-12 * (1.0 + abs(objective)):
                break
            length /= 2
        else:
            # The curvature is that of a flat spot, and knows nothing of where the objective turns: go and see.
            length = _turning_point(likelihood, penalty, params, direction)
            trial = params + length * direction
            with np.errstate(over="ignore", invalid="ignore"):
                reached, *there = objective_at(trial)
            if not reached > objective:
                lost = True
                break
        params, objective, (share, terms), last, whole = trial, reached, there, decrement, length == 1.0
    value = likelihood.weigh(terms)
    information = slopes.information
    return Optimum(params, value, null, share, information, decrement, iteration, converged, proven, lost)


def _turning_point(likelihood: Likelihood, penalty: Floats, params: Floats, direction: Floats) -> float:
    """Return how far along a direction the concave objective stops rising; 0 if it does nowhere within bounds."""

    def rises(length: float) -> bool:
        there = params + length * direction
        slope = likelihood.slopes(*likelihood.at(there)).gradient - penalty * there
        return bool(slope @ direction > 0)

    with np.errstate(over="ignore", invalid="ignore"):
        fastest = float(np.abs(likelihood.rivals @ direction).max())
    if not (np.isfinite(fastest) and fastest > 0):
        return 0.0
    low, high = 0.0, 1.0 / fastest  # one unit of the index
    with np.errstate(over="ignore", invalid="ignore"):
        while rises(high):
            low, high = high, 2.0 * high
            if high * fastest > FAR:
                return 0.0
        while high - low > 1e-3 * max(1.0 / fastest, 1e-12 * high):
            middle = low + (high - low) / 2
            if middle in (low, high):
                break
            low, high = (middle, high) if rises(middle) else (low, middle)
    return low


def _reach(likelihood: Likelihood, slopes: Slopes, penalty: Floats, decrement: float) -> tuple[float, float]:
    """Return what rounding may add to the decrement, and a bound of the reach; inf where they are not known.

    The reach is exact where it decides.
    """
    curvature = slopes.information + np.diag(penalty)
    unit = np.sqrt(np.maximum(np.diag(curvature), 0.0))
    if not (np.isfinite(unit) & (unit > 0)).all():
        return np.inf, np.inf
    values, vectors = np.linalg.eigh(curvature / np.outer(unit, unit))
    if not values[0] >= REGULAR:
        return np.inf, np.inf
    # By Cauchy and Schwarz: the gradient is a sum of terms weight * share * rival, each of them rounded.
    blur = 4 * np.finfo(float).eps * (likelihood.total * float((slopes.moment / unit**2).sum()) / values[0]) ** 0.5
    if not blur <= FLOOR:
        return np.inf, np.inf
    rivals = likelihood.rivals
    with np.errstate(over="ignore", invalid="ignore"):  # on a flat spot the reach is beyond all numbers
        reach = float(np.einsum("ij,ij,j->i", rivals, rivals, unit**-2.0).max() / values[0]) ** 0.5
    if not np.isfinite(reach):
        return np.inf, np.inf
    if (decrement + blur) * reach > PROVEN or decrement * reach > SETTLED:
        reach = float(np.square(rivals @ (vectors / unit[:, None] / np.sqrt(values))).sum(axis=1).max()) ** 0.5
    return blur, reach


def _newton_step(curvature: Floats, gradient: Floats) -> Floats:
    """Solve for the step, with Levenberg's ridge where the curvature is not positive definite to rounding."""
    size = abs(float(np.trace(curvature))) / len(gradient) or 1.0
    for ridge in (0.0, *10.0 ** np.arange(-14.0, 1.0)):
        try:
            step: Floats = cho_solve(cho_factor(curvature + ridge * size * np.eye(len(gradient))), gradient)
        except LinAlgError:
            continue
        if np.isfinite(step).all():
            return step
    return gradient / size
