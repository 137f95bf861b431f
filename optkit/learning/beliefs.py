"""What a platform believes of the requests and workers of a batch: the link from instances to value functions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optkit.basics.arrays import Floats, locked
from optkit.basics.users_code import name_of, users_code
from optkit.learning.worker_presence import presence_after
from optkit.models.preferences.preferences import Preferences
from optkit.models.value.experience import Workers
from optkit.models.value.request_sets import KnownRequests, RequestSets, SetValue, costs_of
from optkit.simulation.batch import Batch
from optkit.simulation.state import State


def believed_requests(batch: Batch, preferences: Preferences | None = None) -> KnownRequests:
    """Requests of a batch with their utilities: the true ones, or those of a model.

    Parameters
    ----------
    batch : Batch
        Its padding entry comes last in the result too.
    preferences : Preferences, optional
        The choice model; the truth by default.
    """
    if preferences is None:
        utility = batch.utility - _outside(batch)
    else:
        preferences = preferences.of_instances(batch.instances)
        groups = np.arange(batch.groups)[:, None]
        utility = preferences.utility_of(batch.features, batch.pickup, batch.dropoff, groups)
    places = (batch.features, batch.pickup, batch.dropoff)
    return KnownRequests(batch.reward, batch.penalty, batch.arrival, batch.expiry, locked(utility), *places)


def believed_workers(batch: Batch, preferences: Preferences | None = None) -> Workers:
    """How workers come in a batch, and their noise scales: the true ones, or those of a model."""
    group = batch.worker_group[: int(batch.worker_start[-1])]
    share = np.bincount(group, minlength=batch.groups) / max(group.size, 1)
    if preferences is None:
        mu = np.ones(batch.groups)
        for one in batch.instances:
            mu[: one.n_groups] = one.mu
    else:
        preferences = preferences.of_instances(batch.instances)
        mu = preferences.scale[preferences.model_of(np.arange(batch.groups))]
    within = np.arange(batch.horizon)[:, None] < np.array([one.horizon for one in batch.instances])
    return Workers(*locked((presence_after(batch.worker_at >= 0, within), share, mu)))


def _outside(batch: Batch) -> Floats:
    """Utility of rejecting, by group and instance, laid out like the batch's utilities, (D, N + 1), money."""
    outside = np.zeros(batch.utility.shape)
    for one, start in zip(batch.instances, batch.request_start[:-1], strict=True):
        outside[: one.n_groups, start : start + one.n_requests] = one.outside_by_group[:, None]
    return outside


@dataclass(frozen=True)
class BelievedValue:
    """A value function of sets as the value function of a policy (:class:`optkit.policies.ValueFunction`).

    Parameters
    ----------
    value : SetValue
        For example a fitted :class:`optkit.models.value.LinearValue`, or one's own.
    preferences : Preferences, optional
        Whose utilities make the surplus; the true ones by default.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> from optkit.models.value.request_sets import ZeroSetValue
    >>> from optkit.policies import PostDecisionPricing
    >>> days = scenario("I.2", seed=0).sample(2, seed=1)
    >>> nothing = PostDecisionPricing(value_function=BelievedValue(ZeroSetValue()))
    >>> bool((simulate(days, nothing).reward == simulate(days, PostDecisionPricing()).reward).all())
    True
    """

    value: SetValue
    preferences: Preferences | None = None
    _seen: dict[int, tuple[Batch, KnownRequests]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def opportunity_cost(self, state: State) -> Floats:
        """Value lost by serving each request now, (b, w), in money; 0 where it expires now.

        Raises
        ------
        PolicyError
            If the value function fails.
        InputError
            If it does not return a number for each request.
        TrainingError
            If it returns NaN or infinity.
        """
        waits = locked(state.offered & (state.steps_left > 0))
        busy = state.busy if getattr(self.value, "sees_busy", False) else None
        sets = RequestSets(self._requests(state.batch), state.step, state.request, waits, busy)
        with users_code(f"the opportunity_cost of {name_of(self.value)}, at step {state.step},"):
            return costs_of(self.value, sets)

    def __getstate__(self) -> dict[str, Any]:
        # What was priced last does not go along with the policy that priced it.
        return {**vars(self), "_seen": {}}

    def _requests(self, batch: Batch) -> KnownRequests:
        """Return what is believed of the batch's requests, worked out once for each batch in a row."""
        if self._seen.get(0, (None,))[0] is not batch:
            self._seen[0] = (batch, believed_requests(batch, self.preferences))
        return self._seen[0][1]
