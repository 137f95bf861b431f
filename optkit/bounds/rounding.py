"""Sums and profits rounded up, so that what floating point proves holds for the numbers themselves."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from optkit.basics.arrays import Floats
from optkit.models.decision import Decisions

EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)


def sum_up(terms: Iterable[float]) -> float:
    """Least float that is at least the exact sum; infinite where the terms are not finite or the sum overflows.

    Examples
    --------
    >>> sum_up([0.1] * 10) >= 1.0, sum_up([1e18, 35.0, -1e18])
    (True, 35.0)
    """
    terms = [float(term) for term in terms]
    try:
        total = math.fsum(terms)
        short = math.fsum([*terms, -total]) > 0
    except (OverflowError, ValueError):
        return math.inf
    return (math.nextafter(total, math.inf) if short else total) if math.isfinite(total) else math.inf


def add_up(a: Floats | float, b: Floats | float) -> Floats:
    """Elementwise ``a + b``, rounded up where it is not exact (Knuth's sum with its error)."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = np.asarray(np.add(a, b))
        part = total - a
        short = (a - (total - part)) + (b - part)
    return np.where(short > 0, np.nextafter(total, np.inf), total)


def sufficient_rise(
    above: Floats, below: Floats, slope: Floats, ratio: Floats, terms: Floats | int, one: Floats | float = 1.0
) -> Floats:
    r"""How much trial profits must rise to be proven, in units of mu.

    With x_i = (v_i - R)/mu, a decision's dual constraint is :math:`\sum_i w_i g(x_i) \le R/\mu`, where g(x) is x for a
    request held at compensation 0 (x < 1) and exp(x - 1) for a free one. As R/mu rises by t, held terms fall by t w_i,
    and free ones by at least a factor :math:`e^{-t} \le 1 - t + t^2/2`. So t = 2 e / s is enough while it is at most
    1/2, where e is by how much the constraint is broken and s = 1 + the sum of all w_i g'(x_i); and t = e always is.

    Parameters
    ----------
    above, below : (...) float
        Sums of the constraint's positive and of its negative terms, each rounded up, times ``one``.
    slope : (...) float
        Sum of w_i g'(x_i), times ``one``; one that is too small is safe.
    ratio : (...) float
        The trial profits R/mu.
    terms : int or (...) int
        Number of terms that were added up, for the rounding.
    one : float or (...) float
        Factor on weights against overflow.
    """
    summed = EPS * (2.0 * terms + 8.0)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        size = above - below + np.abs(ratio) * one
        excess = np.maximum(above + below - ratio * one + summed * size + TINY * (terms + np.abs(ratio)), 0.0)
        steep = (one + slope) * (1.0 - summed)
        return np.where(4.0 * excess <= steep, 2.0 * excess / steep, excess / one)


def proven_rise(d: Decisions, ratio: Floats, error: Floats) -> Floats:
    """How much trial profits (S, 1) of decisions with c >= 0 must rise to be proven, (S, 1), all in units of mu.

    Parameters
    ----------
    d : Decisions
        With a mask of what is offered.
    ratio : (S, 1) float
        The trial profits.
    error : (S, n) float
        Bound on the rounding of v_i / mu - ratio and of a request's exponent, in units of mu.

    Examples
    --------
    >>> d = Decisions.of([5.0, 6.0], [-1.0, -2.0], 1.0, 0.0, [True, True])
    >>> from optkit.models.pricing.closed_form import nonnegative
    >>> best = nonnegative(d).ratio
    >>> proven_rise(d, best, np.full((1, 2), 1e-14)) < 1e-12, proven_rise(d, best - 0.1, np.zeros((1, 2))) > 0.1
    (array([[ True]]), array([[ True]]))
    """
    with np.errstate(over="ignore", invalid="ignore"):
        shown = np.ones(d.value.shape, bool) if d.offered is None else d.offered
        x, logit = d.value / d.mu - ratio + error, np.where(shown, d.logit + error, -np.inf)
        lift = np.maximum(logit.max(axis=1, keepdims=True, initial=0.0), 0.0)
        sure, weight = np.exp(-4.0 * error), np.exp(np.where(shown, np.maximum(x, 1.0), 0.0) + logit - 1.0 - lift)
        term = weight * np.where(shown, np.minimum(x, 1.0), 0.0)
        negative = np.minimum(term, 0.0)
        above, below, slope = (y.sum(axis=1, keepdims=True) for y in (term - negative, sure * negative, sure * weight))
        return sufficient_rise(above, below, slope, ratio, shown.sum(axis=1, keepdims=True), np.exp(-lift))
