"""Separation: a direction in which the likelihood of the choices rises for ever."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, hstack

from optkit.basics.arrays import Bools, Floats
from optkit.basics.errors import SolverError
from optkit.models.estimation.likelihood import Likelihood

SUPPORT = 1e-6
"""Margin above which a choice speaks for a direction, relative to its terms; the linear program is solved to 1e-7."""

ENOUGH = 1e-3
"""Margin that counts in full: a direction that every choice speaks for is better than one that some shout for."""

TIE = 1e-9
"""Margin that rounding may leave of a tie, relative to its terms."""

NOISE = 1e-12
"""Difference between two alternatives that rounding may leave of none, relative to the level of the column."""


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
    margins = -likelihood.rivals[:, columns]
    margins[np.abs(margins) <= NOISE * likelihood.level[columns]] = 0.0
    margins /= scale[columns]
    # A small difference decides a choice as well as a large one: each row by its own size.
    size = np.abs(margins).max(axis=1)
    margins = margins[size > 0] / size[size > 0, None]
    if not len(margins):
        return None
    found = _single_column(margins)
    if found is None:
        found = _by_linear_program(margins, np.random.default_rng(seed))
    if found is None:
        return None
    direction = np.zeros(len(scale))
    direction[columns] = found
    return direction / scale


def supporters(likelihood: Likelihood, direction: Floats) -> Bools:
    """Return which situations speak for a direction, (S,): their choice gains on some rival."""
    gain = -(likelihood.rivals @ direction) - SUPPORT * (np.abs(likelihood.rivals) @ np.abs(direction))
    return likelihood.sets.max(gain) > 0


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
        if reach.max() <= SUPPORT:
            break
        working = np.union1d(working, np.argsort(-reach, kind="stable")[:k])
    while True:
        part = margins[working]
        # max sum z  subject to  z <= part @ d,  0 <= z <= ENOUGH,  |d| <= 1
        slack = hstack([csr_array(-part), eye_array(len(working))], format="csr")
        cost = np.concatenate([np.zeros(k), -np.ones(len(working))])
        bounds = [(-1.0, 1.0)] * k + [(0.0, ENOUGH)] * len(working)
        solved = linprog(cost, A_ub=slack, b_ub=np.zeros(len(working)), bounds=bounds, method="highs")
        if solved.x is None:
            raise SolverError(f"the linear program that looks for separation failed: {solved.message}")
        direction = _sharpened(part, solved.x[:k])
        margin, terms = part @ direction, np.abs(part) @ np.abs(direction)
        if not (margin > SUPPORT * terms).any() or (margin < -TIE * terms).any():
            return None
        margin, terms = margins @ direction, np.abs(margins) @ np.abs(direction)
        against = np.flatnonzero(margin < -TIE * terms)
        if not against.size:
            return direction
        new = np.setdiff1d(against, working)
        working = np.concatenate([working, new[np.argsort(margin[new], kind="stable")[:1000]]])


def _sharpened(rows: Floats, direction: Floats) -> Floats:
    """Solve for the ties of an approximate direction; its largest entry is 1 in absolute value, or it is 0."""
    for _ in range(2):  # the second time without the entries that were rounding
        length = float(np.abs(direction).max())
        if length <= SUPPORT:
            return np.zeros_like(direction)
        direction = np.where(np.abs(direction) <= SUPPORT * length, 0.0, direction / length)
        shown = np.flatnonzero(direction)
        ties = rows[np.abs(rows @ direction) <= SUPPORT * (np.abs(rows) @ np.abs(direction))][:, shown]
        if ties.size:
            direction[shown] -= np.linalg.lstsq(ties, ties @ direction[shown])[0]
    return direction


def _null_space(rows: Floats) -> Floats:
    """Return an orthonormal basis of the directions that the rows do not see, (k, any number)."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    return vectors[:, values <= 1e-12 * values[-1]]
