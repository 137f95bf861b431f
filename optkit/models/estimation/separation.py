"""Separation: a direction in which the likelihood of the choices rises for ever."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, hstack

from optkit.basics.errors import SolverError
from optkit.models.decision import Bools, Floats
from optkit.models.estimation.likelihood import Likelihood

TOLERANCE = 1e-6
"""What counts as a tie, relative to the largest margin; the linear program is solved to 1e-7."""


def separating_direction(likelihood: Likelihood, scale: Floats, free: Bools, seed: int = 0) -> Floats | None:
    """Find a change of the coefficients that no choice speaks against and some choice speaks for.

    With such a direction the likelihood has no maximum (perfect or quasi-complete separation); without one, and
    with columns that are not collinear, it has exactly one.

    Parameters
    ----------
    likelihood : Likelihood
    scale : (k,) float
        Typical size of each column's differences.
    free : (k,) bool
        Coefficients that may move; a penalised one may not, for its penalty would win in the end.
    seed : int
        Of the rows that the linear program starts from; the answer to *whether* does not depend on it.

    Returns
    -------
    (k,) float or None
        The direction, its largest entry 1 in absolute value after scaling; None if there is none.

    Raises
    ------
    SolverError
        If the linear program is not solved.

    Notes
    -----
    The linear program of K. Konis (2007), "Linear programming algorithms for detecting separated data in binary
    logistic regression models", on a working set of rows of full rank that grows by the rows that it violates.

    Examples
    --------
    >>> from optkit.models.estimation.choices import ChoiceSets
    >>> rivals = np.array([[-1.0, 2.0], [-3.0, -1.0], [0.0, 1.0], [0.0, -1.0]])
    >>> all_ones = ChoiceSets.of_sizes([1, 1, 1, 1])
    >>> likelihood = Likelihood(all_ones, rivals, None, None, np.ones(2), 0)
    >>> separating_direction(likelihood, np.ones(2), np.array([True, True]))
    array([1., 0.])
    """
    columns = np.flatnonzero(free)
    if not columns.size:
        return None
    margins = -likelihood.rivals[:, columns] / scale[columns]
    found = _single_column(margins)
    if found is None:
        found = _by_linear_program(margins, np.random.default_rng(seed))
    if found is None:
        return None
    direction = np.zeros(len(scale))
    direction[columns] = found
    return direction / scale


def _single_column(margins: Floats) -> Floats | None:
    """Return a direction along one column: the clearest thing to say, where it is true."""
    low, high = margins.min(axis=0), margins.max(axis=0)
    up, down = (low >= 0) & (high > 0), (high <= 0) & (low < 0)
    if not (up | down).any():
        return None
    column = int((up | down).argmax())
    unit = np.zeros(margins.shape[1])
    unit[column] = 1.0 if up[column] else -1.0
    return unit


def _by_linear_program(margins: Floats, rng: np.random.Generator) -> Floats | None:
    n, k = margins.shape
    working = rng.choice(n, min(n, 500), replace=False)
    # Full rank makes the working set decisive: a direction that it ties everywhere is no direction at all.
    for _ in range(k):
        unseen = _null_space(margins[working])
        reach = np.abs(margins @ unseen).max(axis=1, initial=0.0)
        if reach.max() <= TOLERANCE:
            break
        working = np.union1d(working, np.argsort(-reach, kind="stable")[:k])
    while True:
        part = margins[working]
        # max sum z  subject to  z <= part @ d,  0 <= z <= 1,  |d| <= 1
        slack = hstack([csr_array(-part), eye_array(len(working))], format="csr")
        cost = np.concatenate([np.zeros(k), -np.ones(len(working))])
        bounds = [(-1.0, 1.0)] * k + [(0.0, 1.0)] * len(working)
        solved = linprog(cost, A_ub=slack, b_ub=np.zeros(len(working)), bounds=bounds, method="highs")
        if solved.x is None:
            raise SolverError(f"the linear program that looks for separation failed: {solved.message}")
        direction: Floats = solved.x[:k]
        length = float(np.abs(direction).max())
        if length <= TOLERANCE:
            return None
        direction = np.where(np.abs(direction) <= TOLERANCE * length, 0.0, direction / length)
        margin = margins @ direction
        tie = TOLERANCE * float(np.abs(margin).max())
        if float((part @ direction).max()) <= tie:
            return None
        against = np.flatnonzero(margin < -tie)
        new = np.setdiff1d(against, working)
        if not new.size:
            return direction if not against.size else None
        working = np.concatenate([working, new[np.argsort(margin[new], kind="stable")[:1000]]])


def _null_space(rows: Floats) -> Floats:
    """Return an orthonormal basis of the directions that the rows do not see, (k, any number)."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    return vectors[:, values <= 1e-12 * values[-1]]
