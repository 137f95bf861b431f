"""The conditional logit log-likelihood in the differences between each alternative and the chosen one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optkit.models.decision import Bools, Floats
from optkit.models.estimation.choice_sets import ChoiceSets
from optkit.models.estimation.choices import ChoiceData


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
        rival = np.ones(len(data.rows), bool)
        if not data.outside:
            rival[data.chosen] = False
        if data.weights is not None:
            rival &= (data.weights > 0)[sets.situation]
        place = np.flatnonzero(rival)
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
        kept = sizes > 0
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

    def equal_shares(self) -> Floats:
        """Return the probability of every rival when all coefficients are 0 and there is no offset, (p,)."""
        share = np.reciprocal((1 + self.sets.sizes).astype(np.float64))
        return share[self.sets.situation]

    def weigh(self, x: Floats) -> float:
        """Sum over the situations, weights counted."""
        return float(x.sum() if self.weights is None else x @ self.weights)

    def value(self, params: Floats) -> float:
        """Return the log-likelihood."""
        return self.weigh(self.at(params)[1])

    def slopes(self, share: Floats) -> tuple[Floats, Floats]:
        """Return gradient, (k,), and Fisher information, (k, k), where the rivals have these probabilities."""
        rivals, weights = self.rivals, self.weights
        if weights is not None:
            share = share * weights[self.sets.situation]
        pulled = share[:, None] * rivals
        mean = self.sets.sum(pulled)
        spread = mean if weights is None else mean / weights[:, None]
        information = rivals.T @ pulled - mean.T @ spread
        return -mean.sum(axis=0), (information + information.T) / 2

    def scores(self, share: Floats) -> Floats:
        """Return the gradient of each situation's log-likelihood, (S, k), weights not counted."""
        return -self.sets.sum(share[:, None] * self.rivals)


def _seen(data: ChoiceData) -> Bools:
    return np.ones(len(data.sets), bool) if data.weights is None else data.weights > 0
