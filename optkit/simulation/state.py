"""What a policy sees when it decides: one worker and the open requests, in many instances at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Ints, ReadOnlyArrays, locked
from optkit.simulation.batch import Batch


@dataclass(frozen=True)
class State(ReadOnlyArrays):
    """b decisions at the same step of different instances, each over up to w open requests.

    All arrays are read-only, those of the batch too. Requests go along the last axis; where ``offered`` is False there
    is padding, and whatever stands there is ignored. A policy may use everything here but ``utility``, ``mu`` and
    ``outside_utility``, which are the workers' true preferences and belong to :class:`optkit.policies.TrueChoice`.

    Attributes
    ----------
    batch : Batch
        All instances that are simulated, with what is yet to come; the properties below are for policies.
    step : int
        The current step.
    row : (b,) int
        The simulated run, for policies that treat runs differently.
    instance : (b,) int
        Position of the instance in the list that is simulated.
    worker : (b,) int
        The worker, numbered across all instances.
    request : (b, w) int
        The requests, numbered across all instances.
    offered : (b, w) bool
        Which entries are open requests.
    """

    batch: Batch
    step: int
    row: Ints
    instance: Ints
    worker: Ints
    request: Ints
    offered: Bools

    def _of(self, per_request: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return locked(per_request.take(self.request, axis=0))

    @cached_property
    def reward(self) -> Floats:
        """Rewards, (b, w), money."""
        return self._of(self.batch.reward)

    @cached_property
    def penalty(self) -> Floats:
        """Penalties, (b, w), money, at most 0."""
        return self._of(self.batch.penalty)

    @cached_property
    def features(self) -> Floats:
        """Features, (b, w, k)."""
        return self._of(self.batch.features)

    @cached_property
    def pickup(self) -> Ints:
        """Pick-up locations, (b, w)."""
        return self._of(self.batch.pickup)

    @cached_property
    def dropoff(self) -> Ints:
        """Drop-off locations, (b, w)."""
        return self._of(self.batch.dropoff)

    @cached_property
    def steps_left(self) -> Ints:
        """Steps after this one in which the request can still be served, (b, w)."""
        return locked(self._of(self.batch.expiry) - self.step)

    @cached_property
    def expiring(self) -> Bools:
        """Whether the request expires at this step, (b, w)."""
        return locked(self.offered & (self.steps_left == 0))

    @cached_property
    def group(self) -> Ints:
        """The worker's group, (b,)."""
        return locked(self.batch.worker_group[self.worker])

    @cached_property
    def busy(self) -> Ints:
        """For how many steps in a row, this one included, a worker has been seen, (b,)."""
        return locked(self.batch.busy[self.step, self.instance])

    @cached_property
    def utility(self) -> Floats:
        """True mean utility of each request to the worker, (b, w), money."""
        true = self.batch.utility
        return locked(true[0].take(self.request) if len(true) == 1 else true[self.group[:, None], self.request])

    @cached_property
    def mu(self) -> Floats:
        """True noise scale of the worker, (b,), money."""
        return locked(self.batch.worker_mu[self.worker])

    @cached_property
    def outside_utility(self) -> Floats:
        """True mean utility of rejecting, (b,), money."""
        return locked(self.batch.worker_outside[self.worker])
