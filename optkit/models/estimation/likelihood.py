"""The conditional logit log-likelihood in the differences between each alternative and the chosen one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf

from optkit.basics.arrays import Bools, Floats
from optkit.models.estimation.choice_sets import ChoiceSets
from optkit.models.estimation.choices import ChoiceData

RESOLVED = 1e-6
"""Smallest eigenvalue, relative to the terms of the sum, to which the fast form of the information is trusted."""


class Slopes(NamedTuple):
    """Derivatives of the log-likelihood.

    ``gradient`` (k,); ``information`` (k, k), the negative Hessian; ``moment`` (k,), the sum of weight * share *
    rival**2, against which the rounding of the gradient is measured.
    """

    gradient: Floats
    information: Floats
    moment: Floats


@dataclass(frozen=True)
class Likelihood:
    r"""What S situations say about k coefficients.

    A choice depends on differences alone: with :math:`d_j = x_j - x_{chosen}` over the rivals of the chosen
    alternative, the probability of the choice is :math:`1 / (1 + \sum_j \exp(d_j \cdot \theta))`. In this form nothing
    cancels, neither for columns with a large level nor for choices that are all but certain.

    Attributes
    ----------
    sets : ChoiceSets
        The S situations that carry information, over their p rivals in all.
    rivals : (p, k) float
        d, in the units of the columns. The outside option, if it was on offer and not chosen, is the rival ``-x``.
    offset : (p,) float or None
        The known part of the index, as a difference too.
    weights : (S,) float or None
        Frequency of each situation.
    level : (k,) float
        Largest absolute entry of each column among the choices: what a difference of 0 is measured against.
    dropped : int
        Situations without a rival: choices from a set of one, which say nothing.

    Notes
    -----
    D. McFadden (1974), "Conditional logit analysis of qualitative choice behavior", in P. Zarembka (ed.),
    Frontiers in Econometrics; K. Train, Discrete Choice Methods with Simulation, 2nd ed., sections 3.1 and 3.7.
    """

    sets: ChoiceSets
    rivals: Floats
    offset: Floats | None
    weights: Floats | None
    level: Floats
    dropped: int

    @classmethod
    def of(cls, data: ChoiceData, exog: Floats) -> Likelihood:
        """Take the differences; ``exog`` is (n, k) over the input rows of ``data``."""
        sets, inside = data.sets, data.chosen >= 0
        place = np.flatnonzero(_rivals(data))
        situation = sets.situation[place]

        def choices(x: Floats) -> Floats:
            chosen = np.zeros((len(sets), *x.shape[1:]))
            chosen[inside] = x[data.rows[data.chosen[inside]]]
            return chosen

        def differences(x: Floats, chosen: Floats) -> Floats:
            # take, not x[...]: several times faster on rows of a two-dimensional array.
            rest = x.take(data.rows[place], axis=0)
            if data.outside:  # the outside option, of index 0, takes the place of the chosen one among the rivals
                rest[np.searchsorted(place, data.chosen[inside & _seen(data)])] = 0.0
            rest -= chosen.take(situation, axis=0)
            return rest

        offset = None
        if data.offset is not None:
            full = np.zeros(len(exog))
            full[data.rows] = data.offset
            offset = differences(full, choices(full))
        sizes = np.bincount(situation, minlength=len(sets))
        kept = informative(data)
        chosen = choices(exog)
        return cls(
            sets=ChoiceSets.of_sizes(sizes[kept]),
            rivals=differences(exog, chosen),
            offset=offset,
            weights=None if data.weights is None else data.weights[kept],
            level=np.abs(chosen).max(axis=0, initial=0.0),
            dropped=int((_seen(data) & ~kept).sum()),
        )

    @property
    def total(self) -> float:
        """Number of situations, weights counted."""
        return float(len(self.sets)) if self.weights is None else float(self.weights.sum())

    def at(self, params: Floats) -> tuple[Floats, Floats]:
        """Return the choice probability of every rival, (p,), and the log-likelihood of each situation, (S,)."""
        index = self.rivals @ params
        if self.offset is not None:
            index += self.offset
        share, inclusive = self.sets.shares(index, outside=True)
        return share, -inclusive

    def equal_shares(self) -> tuple[Floats, Floats]:
        """Return what :meth:`at` does when all coefficients are 0 and there is no offset."""
        share = np.reciprocal((1 + self.sets.sizes).astype(np.float64))
        return share[self.sets.situation], np.log(share)

    def weigh(self, x: Floats) -> float:
        """Sum over the situations, weights counted."""
        return float(x.sum() if self.weights is None else x @ self.weights)

    def value(self, params: Floats) -> float:
        """Return the log-likelihood."""
        return self.weigh(self.at(params)[1])

    def slopes(self, share: Floats, terms: Floats) -> Slopes:
        """Return the derivatives where :meth:`at` gave these probabilities and log-likelihoods."""
        rivals, weights = self.rivals, self.weights
        if weights is not None:
            share = share * weights[self.sets.situation]
        pulled = share[:, None] * rivals
        mean = self.sets.sum(pulled)
        spread = mean if weights is None else mean / weights[:, None]
        second = rivals.T @ pulled
        moment = np.diag(second).copy()
        information = second - mean.T @ spread
        if not _resolved(information, moment):
            # Nothing cancels about the mean: a rival that is all but certain, or columns far from 0, cost no digits.
            deviation = rivals - spread.take(self.sets.situation, axis=0)
            stay = np.exp(terms) if weights is None else np.exp(terms) * weights
            information = deviation.T @ (share[:, None] * deviation) + spread.T @ (stay[:, None] * spread)
        return Slopes(-mean.sum(axis=0), (information + information.T) / 2, moment)

    def scores(self, share: Floats) -> Floats:
        """Return the gradient of each situation's log-likelihood, (S, k), weights not counted."""
        return -self.sets.sum(share[:, None] * self.rivals)


def _resolved(information: Floats, moment: Floats) -> bool:
    """Whether a difference of second moments has kept its digits in every direction."""
    root = np.sqrt(moment)
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = information / root / root[:, None]
    scaled.flat[:: len(root) + 1] -= RESOLVED
    # It has a Cholesky factor if every eigenvalue is positive; faster than to compute them. NaN has one of NaN.
    factor, failed = dpotrf(scaled)
    return bool(not failed and np.isfinite(factor[-1, -1]))


def informative(data: ChoiceData) -> Bools:
    """Return which of the situations carry information, (S,): those with a rival to the choice, and a weight."""
    return np.bincount(data.sets.situation[_rivals(data)], minlength=len(data.sets)) > 0


def _rivals(data: ChoiceData) -> Bools:
    rival = np.ones(len(data.rows), bool)
    if not data.outside:
        rival[data.chosen] = False
    return rival if data.weights is None else rival & (data.weights > 0)[data.sets.situation]


def _seen(data: ChoiceData) -> Bools:
    return np.ones(len(data.sets), bool) if data.weights is None else data.weights > 0
