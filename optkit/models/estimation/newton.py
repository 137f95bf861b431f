"""Newton's method for a concave log-likelihood, penalised or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from optkit.models.decision import Floats
from optkit.models.estimation.likelihood import Likelihood

RUNAWAY = 1e-5
"""Standard errors: an improvement below this, from a step that does not shrink, is a climb without a summit."""

SMALL_STEP = 1e-4
"""A step is small if it moves every coefficient by less than this, relative to the largest."""


@dataclass(frozen=True)
class Optimum:
    """Where the search ended.

    Attributes
    ----------
    params : (k,) float
        Coefficients.
    value : float
        Log-likelihood, without the penalty.
    share : (p,) float
        Probability of every rival at ``params``.
    information : (k, k) float
        Fisher information at ``params``, without the penalty.
    decrement : float
        Newton decrement ``sqrt(g' A^-1 g)``: how far the summit is, in standard errors.
    iterations : int
        Newton steps taken.
    converged : bool
        Whether the decrement met the tolerance with a step that was small.
    runaway : bool
        Whether the objective flattened while the steps did not: the likelihood may have no maximum.
    """

    params: Floats
    value: float
    share: Floats
    information: Floats
    decrement: float
    iterations: int
    converged: bool
    runaway: bool


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
    """Maximise ``log-likelihood - sum(penalty * params**2) / 2``.

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
    """

    def objective_at(params: Floats) -> tuple[float, Floats, Floats]:
        share, terms = likelihood.at(params)
        return likelihood.weigh(terms) - 0.5 * float(penalty @ params**2), share, terms

    params = start
    objective, share, terms = objective_at(params)
    if params.any() and (zero := objective_at(np.zeros_like(params)))[0] > objective:
        params, (objective, share, terms) = np.zeros_like(params), zero
    for iteration in range(max_iterations + 1):
        gradient, information = likelihood.slopes(share)
        gradient = (gradient - penalty * params) / scale
        curvature = (information + np.diag(penalty)) / np.outer(scale, scale)
        step = _newton_step(curvature, gradient)
        gain = max(float(gradient @ step), 0.0)
        decrement = gain**0.5
        rounding = 64 * np.finfo(float).eps * abs(float(np.trace(curvature))) ** 0.5
        small = float(np.abs(step).max()) <= SMALL_STEP * (1.0 + float(np.abs(params * scale).max()))
        runaway = watch and decrement <= RUNAWAY and not small
        converged = decrement <= max(tolerance, rounding) and not runaway
        if converged or runaway or iteration == max_iterations:
            break
        length = 1.0
        while True:
            trial = params + length * step / scale
            reached, share, terms = objective_at(trial)
            # Near the summit the objective is flat to rounding; there the full step is right.
            if reached >= objective + 1e-4 * length * gain - 1e-12 * (1.0 + abs(objective)) or length < 1e-40:
                break
            length /= 2
        params, objective = trial, reached
    value = likelihood.weigh(terms)
    return Optimum(params, value, share, information, decrement, iteration, converged, runaway)


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
