"""From a likelihood to an optimum that exists and can be trusted, and to its covariance."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from statsmodels.tools.sm_exceptions import ConvergenceWarning

from optkit.basics.arrays import Floats
from optkit.basics.errors import InputError, SolverError
from optkit.models.estimation.columns import (
    NotIdentifiedError,
    check_columns,
    combination,
    refuse_flatness,
    refuse_separation,
)
from optkit.models.estimation.identification import EstimationWarning
from optkit.models.estimation.likelihood import Likelihood
from optkit.models.estimation.newton import Optimum, maximise

FEW = 10
"""Situations per coefficient below which the standard errors, which are asymptotic, are doubtful."""


def find_optimum(
    likelihood: Likelihood,
    names: Sequence[str],
    penalties: Floats,
    rejections: float | None,
    start: Floats,
    *,
    max_iterations: int,
    tolerance: float,
) -> Optimum:
    """Check that there is a maximum, find it, and warn of what it rests on.

    ``rejections`` is the number of situations that chose the outside option; None if there is no such option. See
    :meth:`optkit.models.estimation.ConditionalLogit.fit` for errors and warnings.
    """
    free = penalties == 0
    if not len(likelihood.sets):
        raise InputError("no situation has an alternative to its choice; nothing is left to fit")
    if likelihood.dropped:
        _warn(f"{likelihood.dropped} situations offer nothing but what was chosen; they carry no information")
    scale = check_columns(likelihood, names, free)
    if not free.all():
        try:
            check_columns(likelihood, names, np.ones_like(free))
        except NotIdentifiedError as error:
            _warn(f"the penalty alone settles what the data leave open: {error}")
    if likelihood.total < FEW * len(names):
        _warn(
            f"{likelihood.total:g} situations are few for {len(names)} coefficients; standard errors are "
            f"asymptotic, and doubtful below {FEW} situations per coefficient"
        )
    one_sided = rejections in (0, likelihood.total)
    if rejections and rejections < FEW and likelihood.total >= FEW * len(names):
        _warn(f"{rejections:g} rejections are few: the level of the utility is poorly known")
    if rejections and 0 < likelihood.total - rejections < FEW * len(names) <= likelihood.total:
        _warn(f"{likelihood.total - rejections:g} choices are few for {len(names)} coefficients")
    if one_sided:
        refuse_separation(likelihood, names, scale, free, rejections)
    unit = np.where(scale > 0, scale, 1.0)
    optimum = maximise(likelihood, penalties, start, unit, tolerance=tolerance, max_iterations=max_iterations)
    if not optimum.proven:
        if not one_sided:
            refuse_separation(likelihood, names, scale, free, rejections)
        if optimum.flat:  # nothing is separated, so there is a maximum, far out: go on to it
            optimum = maximise(
                likelihood,
                penalties,
                optimum.params,
                unit,
                tolerance=tolerance,
                max_iterations=max_iterations,
                watch=False,
            )
        if optimum.flat:
            refuse_flatness(optimum.information / np.outer(unit, unit), names, unit)
    if optimum.lost and not optimum.converged:
        refuse_flatness(optimum.information / np.outer(unit, unit), names, unit)
    if not optimum.converged:
        warnings.warn(
            f"Newton's method stopped after {optimum.iterations} steps, {optimum.decrement:.2g} standard errors "
            "from the maximum; raise maxiter, or look at identification(model)",
            ConvergenceWarning,
            stacklevel=3,
        )
    if one_sided:
        unseen = "no situation chose" if rejections == 0 else "every situation chose"
        weakest = np.linalg.eigh(optimum.information / np.outer(unit, unit))[1][:, 0]
        _warn(
            f"{unseen} the outside option, so the level of the utility rests on the penalty or on the choice of "
            f"columns; the data know least about {combination(weakest, names, 0.01)} (per standard deviation)"
        )
    return optimum


def covariance(penalties: Floats, optimum: Optimum) -> Floats:
    """Return the inverse information, the penalty's included, (k, k).

    Raises
    ------
    SolverError
        If the search was cut short where there is no curvature.
    """
    inverse = _inverse(optimum.information + np.diag(penalties))
    if inverse is None:
        raise SolverError(
            f"the search was cut short after {optimum.iterations} steps, where the likelihood is flat and has no "
            "standard errors; raise maxiter"
        )
    return inverse


def _inverse(precision: Floats) -> Floats | None:
    """Invert; None if not positive definite, which only a search that did not converge can leave behind."""
    diagonal = np.diag(precision)
    if diagonal.min() > 0:
        # Scaled to a unit diagonal, so that the units of the columns do not cost digits.
        unit = np.outer(np.sqrt(diagonal), np.sqrt(diagonal))
        with suppress(np.linalg.LinAlgError):
            inverse: Floats = cho_solve(cho_factor(precision / unit), np.eye(len(unit))) / unit
            return inverse if np.isfinite(inverse).all() else None
    return None


def _warn(message: str) -> None:
    warnings.warn(message, EstimationWarning, stacklevel=4)
