"""Fitting the value of waiting by approximate value iteration (paper section 3.3, Algorithm 1), on differences.

Prices depend on the value function through opportunity costs alone, so these are what is fitted: for every visited
post-decision set S and every i in it, V(S) - V(S without i) is regressed on the difference of Lemma 1's targets with
the same new arrivals. No level is needed, the worker's arrival and group enter in expectation, and one backward sweep
over the steps suffices because the target of step t uses the coefficients of step t + 1 only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optkit.batch import Batch
from optkit.collection import Explore, check_seed
from optkit.errors import InputError
from optkit.instance import Floats, Instance, Ints
from optkit.models.closed_form import nonnegative
from optkit.models.decision import Decisions
from optkit.models.preferences import Preferences
from optkit.models.ranked_value import Bools, RankedValue
from optkit.policies import ChoiceModel, PostDecisionPricing, TrueChoice
from optkit.simulator import simulate
from optkit.state import State

TIME_KNOTS, RANK_KNOTS = (1.0, 3.0, 10.0), (0.0, 1.0, 4.0)
"""Steps left and ranks at which the value function bends; surplus bends at its 3 and 97 per cent quantiles."""


@dataclass(frozen=True)
class RankedPolicyValue:
    """A :class:`~optkit.models.ranked_value.RankedValue` as the value function of a policy.

    Attributes
    ----------
    value : RankedValue
        The fitted function.
    preferences : Preferences or None
        Whose utilities the surplus is made of; None for the true ones.
    """

    value: RankedValue
    preferences: Preferences | None = None

    def opportunity_cost(self, state: State) -> Floats:
        """Value lost by serving each request now, (b, w), in money; 0 where it expires now."""
        surplus = _surplus(state.batch, self.preferences)[state.request]
        member = state.offered & (state.steps_left > 0)
        return self.value.opportunity_cost(state.step, surplus, state.steps_left.astype(float), member)


@dataclass(frozen=True)
class Trained:
    """A trained policy and how it came about.

    Attributes
    ----------
    policy : PostDecisionPricing
        Optimal prices with the fitted opportunity costs.
    value : RankedValue
        The fitted value function.
    record : list of dict
        One entry per round: ``round``, ``deviation`` (money), ``states``, ``residual`` (root mean square, money) and
        ``seconds``.
    """

    policy: PostDecisionPricing
    value: RankedValue
    record: list[dict[str, Any]]


def train_ranked_value(
    instances: Sequence[Instance],
    *,
    preferences: Preferences | None = None,
    deviations: Sequence[float] = (8.0, 4.0),
    ridge: float = 1.0,
    discount: float = 1.0,
    seed: int = 0,
    progress: Callable[[int, int], object] | None = None,
) -> Trained:
    """Fit a ranked value function in rounds of simulating with exploration and one backward sweep.

    Parameters
    ----------
    instances : sequence of Instance
        Training instances of one horizon; their noise must be realised.
    preferences : Preferences, optional
        The choice model to price with; the true one by default.
    deviations : sequence of float
        Standard deviation of the exploration noise of each round, in money.
    ridge : float
        Penalty that draws the coefficients of a step to those of the next, at least 0.
    discount : float
        Of the future, in [0, 1]; the problem itself is undiscounted.
    seed : int
        Source of the randomness.
    progress : callable, optional
        Called with the number of rounds done and their number.

    Raises
    ------
    InputError
        If an argument is out of range, or there are no instances or no requests.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> split = scenario("I.1", seed=0, split=(200, 60, 0)).split()
    >>> trained = train_ranked_value(split.train)
    >>> patient, myopic = (simulate(split.test, p).reward.mean() for p in (trained.policy, PostDecisionPricing()))
    >>> bool(patient > myopic)
    True
    """
    check_seed(seed)
    if not (ridge >= 0 and 0 <= discount <= 1 and len(deviations) and min(deviations) >= 0):
        raise InputError(f"ridge = {ridge}, discount = {discount}, deviations = {deviations}: out of range")
    batch = Batch.of(instances)
    N = int(batch.request_start[-1])
    if N == 0:
        raise InputError("training needs instances with requests")
    choice: ChoiceModel = TrueChoice() if preferences is None else preferences
    low, high = np.quantile(_surplus(batch, preferences)[:N], [0.03, 0.97])
    knots = (np.array([low, max(high, low + 1e-6)]), np.array(TIME_KNOTS), np.array(RANK_KNOTS))
    value = RankedValue(*knots, np.zeros((batch.horizon, 2 * len(TIME_KNOTS) * len(RANK_KNOTS))))
    policy = PostDecisionPricing(choice=choice)
    record = []
    for number, deviation in enumerate(deviations):
        started = time.perf_counter()
        left = _visited(batch, Explore(policy, deviation, seed=seed + number))
        value, states, residual = _sweep(batch, left, value, preferences, ridge, discount)
        policy = PostDecisionPricing(choice=choice, value_function=RankedPolicyValue(value, preferences))
        seconds = time.perf_counter() - started
        record.append({"round": number + 1, "deviation": deviation, "states": states, "residual": residual})
        record[-1]["seconds"] = round(seconds, 3)
        if progress is not None:
            progress(number + 1, len(deviations))
    return Trained(policy, value, record)


def _surplus(batch: Batch, preferences: Preferences | None) -> Floats:
    """Reward less penalty plus mean utility over groups, (N + 1,), in money."""
    if preferences is None:
        utility = batch.utility.mean(axis=0)
    else:
        groups = np.arange(batch.groups)[:, None]
        utility = preferences.utility_of(batch.features, batch.pickup, batch.dropoff, groups).mean(axis=0)
    return np.asarray(batch.reward - batch.penalty + utility)


def _visited(batch: Batch, policy: Explore) -> Ints:
    """Last step after which each request was still waiting in a simulation, (N,)."""
    N = int(batch.request_start[-1])
    gone = batch.expiry[:N].copy()

    def look(state: State, _: Floats, taken: Ints) -> None:
        at = np.flatnonzero(taken >= 0)
        gone[state.request[at, taken[at]]] = state.step

    simulate(batch, policy, observe=look)
    return gone - 1


def _sweep(
    batch: Batch, left: Ints, value: RankedValue, preferences: Preferences | None, ridge: float, discount: float
) -> tuple[RankedValue, int, float]:
    """Fit the coefficients of every step, from the last but one to the first."""
    N, T = int(batch.request_start[-1]), batch.horizon
    surplus = _surplus(batch, preferences)
    owner = np.repeat(np.arange(len(batch)), np.diff(batch.request_start))
    theta = np.zeros_like(value.coefficients)
    target = _Target(batch, preferences, surplus, discount)
    states, squares, differences = 0, 0.0, 0
    for step in range(T - 2, -1, -1):
        waits = (batch.arrival[:N] <= step) & (left >= step)
        new = batch.arrival[:N] == step + 1
        request, member = _rows(owner, waits | new, np.where(waits, 0, 1), N, len(batch))
        old = member & (batch.arrival[request] <= step)
        keep = old.any(axis=1)
        if not keep.any():
            theta[step] = theta[step + 1]
            continue
        request, member, old = request[keep], member[keep], old[keep]
        current = RankedValue(value.surplus_knots, value.time_knots, value.rank_knots, theta)
        whole = target(current, step + 1, request, member)
        b, i = np.nonzero(old)
        without = member[b].copy()
        without[np.arange(b.size), i] = False
        y = whole[b] - target(current, step + 1, request[b], without)
        steps_left = (batch.expiry[request] - step).astype(float)
        X = value.basis_differences(surplus[request], steps_left, old)[b, i]
        A = X.T @ X + ridge * np.eye(X.shape[1])
        theta[step] = np.linalg.solve(A, X.T @ y + ridge * theta[step + 1])
        states, differences = states + len(request), differences + b.size
        squares += float(((X @ theta[step] - y) ** 2).sum())
    fitted = RankedValue(value.surplus_knots, value.time_knots, value.rank_knots, theta)
    return fitted, states, float(np.sqrt(squares / max(differences, 1)))


def _rows(owner: Ints, chosen: Bools, late: Ints, N: int, B: int) -> tuple[Ints, Bools]:
    """Chosen requests of every instance as padded rows, (B, w), those with ``late`` set last; padding points at N."""
    index = np.flatnonzero(chosen)
    index = index[np.lexsort((index, late[index], owner[index]))]
    count = np.bincount(owner[index], minlength=B)
    place = np.arange(index.size) - np.repeat(np.cumsum(count) - count, count)
    request = np.full((B, int(count.max(initial=0))), N, dtype=np.int64)
    request[owner[index], place] = index
    return request, request < N


class _Target:
    """Lemma 1's value of a pre-decision set, the worker's arrival and group in expectation."""

    def __init__(self, batch: Batch, preferences: Preferences | None, surplus: Floats, discount: float) -> None:
        self.batch, self.surplus, self.discount = batch, surplus, discount
        present = batch.worker_at >= 0
        self.presence = present.mean(axis=1)
        group = batch.worker_group[: int(batch.worker_start[-1])]
        self.share = np.bincount(group, minlength=batch.groups) / max(group.size, 1)
        if preferences is None:
            first = batch.instances[0]
            self.utility, self.mu, self.outside = batch.utility, first.mu, first.outside_by_group
        else:
            groups = np.arange(batch.groups)
            places = (batch.features, batch.pickup, batch.dropoff)
            self.utility = preferences.utility_of(*places, groups[:, None])
            self.mu, self.outside = preferences.scale[preferences.model_of(groups)], np.zeros(batch.groups)

    def __call__(self, value: RankedValue, step: int, request: Ints, member: Bools) -> Floats:
        """Return the target of each row, (b,), in money."""
        batch = self.batch
        left = batch.expiry[request] - step
        waits, expires = member & (left > 0), member & (left <= 0)
        surplus, steps_left = self.surplus[request], left.astype(float)
        future = self.discount * value.value(step, surplus, steps_left, waits)
        cost = self.discount * value.opportunity_cost(step, surplus, steps_left, waits)
        penalty = np.where(expires, batch.penalty[request], 0.0)
        worth = batch.reward[request] - penalty - cost
        profit = np.zeros(len(request))
        for group, share in enumerate(self.share):
            if share > 0:
                u, mu, u0 = self.utility[group][request], self.mu[group], self.outside[group]
                d = Decisions.of(worth, u, mu, u0, member)
                profit += share * mu * nonnegative(d).ratio[:, 0]
        return np.asarray(future + penalty.sum(axis=1) + self.presence[step] * profit)
