"""Light value functions of sets of waiting requests: linear in hat functions, or in a kernel's features.

Both are sums of :class:`~optkit.models.value.ranked_term.RankedTerm`, fitted as
:mod:`optkit.models.value.linear_in_terms` says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optkit.basics.arrays import flag, number, whole_number
from optkit.models.value.features import HatFeatures, KernelFeatures, coordinates, surplus_knots
from optkit.models.value.linear_in_terms import LinearInTerms, SetExperience, Term
from optkit.models.value.ranked_term import RankedTerm, knots
from optkit.models.value.request_sets import KnownRequests


class LinearValue(LinearInTerms):
    """Ridge regression on hat functions of surplus, steps left and rank.

    Parameters
    ----------
    surplus_knots : int
        Number of knots between the 3 and 97 per cent quantiles of the surplus.
    time_knots, rank_knots : sequence of float
        Knots in steps left and in requests that come before.
    busy_knots : sequence of float, optional
        Knots in the number of steps in a row that have seen a worker. Prices gain little by it, penalised bounds a
        fifth of the gap.
    by_group : bool
        One term for each worker group, ranked by the surplus to it, and one ranked by urgency, in place of one ranked
        by mean surplus. Alone it gains nothing in scenario II, at twice the work.
    ridge : float
        Penalty that draws the coefficients of a step to those of the next, at least 0.
    memory : float
        Weight of the next step's data, of 1 to pool all later steps, in the regression of a step; each step before that
        counts as much less again. 0 fits every step apart; 0.5 gains 0.1 points where instances are few, as in New
        York, and nothing elsewhere; 1 loses 0.3.
    terms : sequence of Term, optional
        Terms of one's own, in place of all these.

    Attributes
    ----------
    coef_ : (T, p) float
        Coefficients of each step, money; zero at the last, after which nothing waits.
    terms_ : list of Term
        What they are coefficients of.
    residual_ : float
        Root mean square residual of the differences, money.

    Examples
    --------
    >>> LinearValue(ridge=10.0).get_params()["ridge"]
    10.0
    """

    kind = "LinearValue"

    def __init__(
        self,
        surplus_knots: int = 2,
        time_knots: Sequence[float] = (1.0, 3.0, 10.0),
        rank_knots: Sequence[float] = (0.0, 1.0, 4.0),
        busy_knots: Sequence[float] | None = None,
        by_group: bool = False,
        ridge: float = 1.0,
        memory: float = 0.0,
        terms: Sequence[Term] | None = None,
    ) -> None:
        self.surplus_knots = surplus_knots
        self.time_knots = time_knots
        self.rank_knots = rank_knots
        self.busy_knots = busy_knots
        self.by_group = by_group
        self.ridge = ridge
        self.memory = memory
        self.terms = terms

    def _make_terms(self, experience: SetExperience) -> Sequence[Term]:
        if self.terms is not None:
            return list(self.terms)
        by_group = flag("by_group", self.by_group)
        spots = whole_number("surplus_knots", self.surplus_knots, least=2)
        requests = experience.requests
        time, rank = knots("time_knots", self.time_knots), knots("rank_knots", self.rank_knots)
        busy = None if self.busy_knots is None else knots("busy_knots", self.busy_knots)
        known = _known(requests)

        def hat(group: int | None) -> HatFeatures:
            return HatFeatures(group, surplus_knots(requests, spots, group, known), time)

        if not by_group:
            return [RankedTerm(hat(None), "surplus", rank, busy)]
        ranked = [RankedTerm(hat(group), group, rank, busy) for group in range(requests.surplus.shape[1])]
        return [*ranked, RankedTerm(hat(None), "urgency", rank, busy)]


class KernelValue(LinearInTerms):
    """A Gaussian set kernel: requests are alike that have similar surpluses to every group, time left and rank.

    The kernel of two sets is the sum over pairs of their requests; landmarks found by k-means on the visited requests
    make it a ridge regression on few features (Nystroem).

    Parameters
    ----------
    landmarks : int
        Number of landmarks.
    gamma : float
        The kernel is exp(-gamma * squared distance) in standard deviations.
    rank_knots : sequence of float
        Knots of the hat functions of the rank.
    busy_knots : sequence of float, optional
        As in :class:`LinearValue`.
    ridge : float
        Penalty that draws the coefficients of a step to those of the next, at least 0.
    memory : float
        As in :class:`LinearValue`.
    seed : int
        For k-means.

    Attributes
    ----------
    coef_, terms_, residual_
        As in :class:`LinearValue`.

    Examples
    --------
    >>> KernelValue(landmarks=12).get_params()["landmarks"]
    12
    """

    kind = "KernelValue"

    def __init__(
        self,
        landmarks: int = 12,
        gamma: float = 0.1,
        rank_knots: Sequence[float] = (0.0, 1.0, 4.0),
        busy_knots: Sequence[float] | None = None,
        ridge: float = 1.0,
        memory: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.landmarks = landmarks
        self.gamma = gamma
        self.rank_knots = rank_knots
        self.busy_knots = busy_knots
        self.ridge = ridge
        self.memory = memory
        self.seed = seed

    def _make_terms(self, experience: SetExperience) -> Sequence[Term]:
        landmarks = whole_number("landmarks", self.landmarks, least=1)
        gamma = number("gamma", self.gamma, above=0.0)
        from sklearn.cluster import KMeans

        seen = [s for step in range(experience.horizon - 1) if (s := experience.sets(step)) is not None]
        groups = experience.requests.surplus.shape[1]
        points = np.concatenate([np.zeros((0, groups + 1)), *(coordinates(s)[s.member] for s in seen)])
        if not len(points):
            points = np.zeros((1, groups + 1))
        rng = np.random.default_rng(self.seed)
        # k-means needs no more points than this to place its centres.
        points = points[rng.permutation(len(points))[:5000]]
        center, scale = points.mean(axis=0), np.maximum(points.std(axis=0), 1e-6)
        standard = (points - center) / scale
        count = min(landmarks, len(np.unique(standard, axis=0)))
        means = KMeans(count, n_init=1, random_state=self.seed).fit(standard).cluster_centers_
        rank = knots("rank_knots", self.rank_knots)
        busy = None if self.busy_knots is None else knots("busy_knots", self.busy_knots)
        return [RankedTerm(KernelFeatures(center, scale, means, gamma), "surplus", rank, busy)]


def _known(requests: KnownRequests) -> int:
    """Number of requests without the padding at the end, if there is any."""
    return max(len(requests.reward) - 1, 1)
