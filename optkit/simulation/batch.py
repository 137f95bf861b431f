"""Many instances as flat arrays, so that the simulator can step through all of them at once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from optkit.basics.arrays import Floats, Ints, ReadOnlyArrays, locked
from optkit.basics.errors import InputError, InstanceError
from optkit.instances.instance import Instance
from optkit.instances.queue import busy_steps

STEP_BYTES, MOST_BYTES = 24, 8e9
"""Memory for one step of one instance, and for all of them."""


class Noise(Protocol):
    """Realised noise by worker and request, both numbered across the batch."""

    def __call__(self, worker: Ints, request: Ints) -> Floats:
        """Noise of workers (b,) for requests (b, w), shape (b, w), in money."""
        ...


@dataclass(frozen=True, eq=False)
class DenseNoise(ReadOnlyArrays):
    """Noise of all pairs: that of worker j and request i stands at ``base[j] + i``."""

    flat: Floats
    base: Ints

    def __call__(self, worker: Ints, request: Ints) -> Floats:
        """Noise of workers (b,) for requests (b, w), shape (b, w), in money."""
        return self.flat.take(self.base[worker][:, None] + request, mode="clip")


@dataclass(frozen=True, eq=False)
class PairNoise(ReadOnlyArrays):
    """Noise of the pairs that meet: that of worker j and request i stands where ``key`` is ``j * width + i``."""

    key: Ints
    value: Floats
    width: int

    def __call__(self, worker: Ints, request: Ints) -> Floats:
        """Noise of workers (b,) for requests (b, w), shape (b, w), in money."""
        return self.value[np.searchsorted(self.key, worker[:, None] * self.width + request)]


@dataclass(frozen=True)
class Batch(ReadOnlyArrays):
    """B instances laid end to end: N requests and M workers in all. All arrays are read-only.

    Attributes
    ----------
    instances : tuple of Instance
    request_start, worker_start : (B + 1,) int
        Where the requests and the workers of each instance begin.
    """

    instances: tuple[Instance, ...]
    request_start: Ints
    worker_start: Ints

    @classmethod
    def of(cls, instances: Instance | Sequence[Instance] | Batch) -> Batch:
        """Lay instances end to end.

        Raises
        ------
        InputError
            If an element is not an Instance, the numbers of features differ, or all steps of all instances together
            take more than :data:`MOST_BYTES`.
        InstanceError
            If the noise of an instance is not realised, or it has too many steps.
        """
        if isinstance(instances, Batch):
            return instances
        if not isinstance(instances, Instance | Iterable):
            raise InputError(f"a {type(instances).__name__} is no list of instances")
        listed = (instances,) if isinstance(instances, Instance) else tuple(instances)
        for b, one in enumerate(listed):
            if not isinstance(one, Instance):
                raise InputError(f"element {b} is a {type(one).__name__}, not an Instance")
            if one.noise is None:
                raise InstanceError(f"the noise of instance {b} is not realised: call its with_noise(seed) first")
        widths = {one.features.shape[1] for one in listed}
        if len(widths) > 1:
            raise InputError(f"instances with {sorted(widths)} features cannot be simulated together; run them apart")
        size = STEP_BYTES * len(listed) * max((one.steps for one in listed), default=0)
        if size > MOST_BYTES:
            steps = f"{len(listed)} instances of up to {max(one.horizon for one in listed):,} steps"
            raise InputError(f"{steps} take {size / 1e9:.0f} GB to simulate together: take fewer at a time")
        starts = [np.cumsum([0, *sizes]) for sizes in ([i.n_requests for i in listed], [i.n_workers for i in listed])]
        return cls(listed, locked(starts[0]), locked(starts[1]))

    def __len__(self) -> int:
        return len(self.instances)

    def _join(self, name: str) -> Floats:
        # One more entry at the end, so that padding has something harmless to point at.
        parts = [getattr(one, name) for one in self.instances]
        last = [np.zeros((1, *parts[0].shape[1:]), parts[0].dtype)] if parts else [np.zeros(1)]
        return locked(np.concatenate([*parts, *last]))

    @cached_property
    def reward(self) -> Floats:
        """Rewards, (N + 1,), money."""
        return self._join("reward")

    @cached_property
    def penalty(self) -> Floats:
        """Penalties, (N + 1,), money."""
        return self._join("penalty")

    @cached_property
    def arrival(self) -> Ints:
        """First steps, (N + 1,)."""
        return locked(self._join("arrival").astype(np.int64))

    @cached_property
    def expiry(self) -> Ints:
        """Last steps, (N + 1,)."""
        return locked(self._join("expiry").astype(np.int64))

    @cached_property
    def features(self) -> Floats:
        """Features, (N + 1, k)."""
        return self._join("features")

    @cached_property
    def pickup(self) -> Ints:
        """Pick-up locations, (N + 1,)."""
        return locked(self._join("pickup").astype(np.int64))

    @cached_property
    def dropoff(self) -> Ints:
        """Drop-off locations, (N + 1,)."""
        return locked(self._join("dropoff").astype(np.int64))

    @cached_property
    def horizon(self) -> int:
        """Steps until the last instance ends."""
        return max((one.horizon for one in self.instances), default=0)

    @cached_property
    def groups(self) -> int:
        """Largest number of worker groups D."""
        return max((one.n_groups for one in self.instances), default=1)

    @cached_property
    def utility(self) -> Floats:
        """Mean utilities, (D, N + 1), money; 0 for groups that an instance does not have."""
        joined = np.zeros((self.groups, self.request_start[-1] + 1))
        for one, start in zip(self.instances, self.request_start[:-1], strict=True):
            joined[: one.n_groups, start : start + one.n_requests] = one.utility
        return locked(joined)

    @cached_property
    def worker_group(self) -> Ints:
        """Groups of all workers, (M + 1,)."""
        return locked(self._join("worker_group").astype(np.int64))

    @cached_property
    def worker_mu(self) -> Floats:
        """Noise scale of every worker, (M,), money."""
        return locked(np.concatenate([one.mu[one.worker_group] for one in self.instances] or [np.zeros(0)]))

    @cached_property
    def worker_outside(self) -> Floats:
        """Mean outside utility of every worker, (M,), money."""
        parts = [one.outside_by_group[one.worker_group] for one in self.instances]
        return locked(np.concatenate(parts or [np.zeros(0)]))

    @cached_property
    def outside_noise(self) -> Floats:
        """Realised noise of every worker's outside option, (M + 1,), money."""
        return self._join("outside_noise")

    @cached_property
    def worker_at(self) -> Ints:
        """Worker seen at each step, numbered across the batch, (T, B); -1 where there is none."""
        at = np.full((self.horizon, len(self)), -1, dtype=np.int64)
        owner = np.repeat(np.arange(len(self)), np.diff(self.worker_start))
        at[self._join("worker_step")[: owner.size].astype(np.int64), owner] = np.arange(owner.size)
        return locked(at)

    @cached_property
    def busy(self) -> Ints:
        """For how many steps, up to and with each, a worker has been seen without a break, (T, B)."""
        return locked(busy_steps(self.worker_at >= 0))

    @cached_property
    def arrivals(self) -> tuple[Ints, Ints]:
        """Requests by instance and arrival, (N,), and where those of instance b and step t begin in it, (T + 1, B)."""
        n = self.request_start[-1]
        owner = np.repeat(np.arange(len(self)), np.diff(self.request_start))
        key = owner * (self.horizon + 1) + self.arrival[:n]
        count = np.bincount(key, minlength=(self.horizon + 1) * len(self))
        begin = (np.cumsum(count) - count).reshape(len(self), self.horizon + 1)
        return locked((np.argsort(key, kind="stable"), np.ascontiguousarray(begin.T)))

    @cached_property
    def noise(self) -> Noise:
        """Realised noise as a function of worker and request."""
        if any(sparse.issparse(one.noise) for one in self.instances):
            return self._pair_noise()
        n = np.array([one.n_requests for one in self.instances], dtype=np.int64)
        J = np.array([one.n_workers for one in self.instances], dtype=np.int64)
        flat = np.concatenate([*(np.ravel(one.noise) for one in self.instances), [0.0]])  # type: ignore[arg-type]
        begin = np.cumsum(n * J) - n * J - self.request_start[:-1]
        owner = np.repeat(np.arange(len(self)), J)
        base = begin[owner] + (np.arange(J.sum()) - self.worker_start[owner]) * n[owner]
        return DenseNoise(locked(flat), locked(base))

    def _pair_noise(self) -> Noise:
        keys, data, width = [], [], int(self.request_start[-1]) + 1
        for one, request0, worker0 in zip(self.instances, self.request_start, self.worker_start, strict=False):
            worker, request = one.pairs()
            keys.append((worker + worker0) * width + request + request0)
            data.append(one.pair_noise())
        key, value = np.concatenate(keys), np.concatenate([*data, [0.0]])
        return PairNoise(locked(key), locked(value), width)
