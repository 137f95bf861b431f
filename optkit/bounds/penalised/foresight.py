"""What nobody knows of the next step: whether a worker comes, of which group, and which requests arrive.

A penalised bound (:mod:`optkit.bounds.penalised.penalized`) charges who knows it for knowing it. Charges are worth
their expectation to everybody else, so the distribution here must be the one that the instances come from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, floats, whole_number
from optkit.basics.errors import InputError
from optkit.bounds.penalised.presence import CERTAIN as CERTAIN
from optkit.bounds.penalised.presence import LONGEST as LONGEST
from optkit.bounds.penalised.presence import fifo_presence as fifo_presence
from optkit.instances.instance import Instance
from optkit.models.value.request_sets import KnownRequests

HAND = 60
"""Instances of the pool that suffice one instance: at 0.3 requests a step, one step without any is one in 10^8."""


@dataclass(frozen=True, eq=False)
class Foresight:
    """Distribution of the next step's worker and requests, given what has been seen.

    Attributes
    ----------
    presence : (K,) or (T, K) float
        Probability of a worker after 0, 1, ..., K - 1 or more steps in a row that saw one, the same at each step of the
        day or one row for each; :func:`~optkit.bounds.penalised.presence.fifo_presence` makes either from rates.
    share : (D,) float
        Probability of each group.
    arrivals : tuple of Instance
        Instances drawn from the same distribution, independent of those to be bounded and of those that the value
        function was fitted to: what arrives in them at a step stands for what might have arrived. Empty: arrivals are
        not charged for, which is always valid. A pool that many instances share gives all of them the same error,
        which their standard error does not show: :meth:`dealt` gives each its own.
    nothing : float or None
        Probability that no request arrives in a step, if known: it spares drawing that case.
    weight : (len(arrivals),) float or None
        Probabilities of the pool's instances, if they are all that can be: then nothing is drawn, and the expectation
        is exact.
    draws : int
        Number of arrival sets drawn for each step of each instance. Any number is valid; more make a tighter bound.

    Raises
    ------
    InputError
        If something is no probability, probabilities do not add up to 1, or the pool's instances do not fit together.
    """

    presence: Floats
    share: Floats
    arrivals: tuple[Instance, ...] = ()
    nothing: float | None = None
    weight: Floats | None = None
    draws: int = 8

    def __post_init__(self) -> None:
        object.__setattr__(self, "presence", _probabilities("presence", self.presence, by_step=True))
        object.__setattr__(self, "share", _probabilities("share", self.share))
        _adds_up("share", self.share)
        object.__setattr__(self, "draws", whole_number("draws", self.draws, least=1))
        pool = tuple(self.arrivals)
        object.__setattr__(self, "arrivals", pool)
        for i, one in enumerate(pool):
            if not isinstance(one, Instance):
                raise InputError(f"element {i} of the pool is a {type(one).__name__}, not an Instance")
        if self.nothing is not None:
            object.__setattr__(self, "nothing", float(_probabilities("nothing", [self.nothing])[0]))
        if self.weight is not None:
            if self.nothing is not None:
                raise InputError("weight and nothing exclude each other: the weights say how often nothing arrives")
            object.__setattr__(self, "weight", _probabilities("weight", self.weight))
            if np.shape(self.weight) != (len(pool),):
                raise InputError(f"weight has {np.size(self.weight)} entries for {len(pool)} instances in the pool")
            _adds_up("weight", self.weight)

    def dealt(self, count: int) -> list[Foresight]:
        """Deal the pool out to some instances, so that they share none of it and their errors are independent.

        Where that would leave fewer than :data:`HAND` for each, or the pool is all that can be, everyone has it whole.

        Parameters
        ----------
        count : int
            Number of instances to be bounded.

        Returns
        -------
        list of Foresight
            One for each instance, each with its own part of the pool, or all with the whole.

        Examples
        --------
        >>> from optkit import scenario
        >>> others = Foresight(fifo_presence(0.5), [1.0], scenario("I.2", seed=0).sample(180, seed=1))
        >>> [len(one.arrivals) for one in others.dealt(3)], len(others.dealt(4)[0].arrivals)
        ([60, 60, 60], 180)
        """
        size = len(self.arrivals) // max(count, 1)
        if size < HAND or self.weight is not None:
            return [self] * count
        return [replace(self, arrivals=self.arrivals[i * size : (i + 1) * size]) for i in range(count)]

    def of_workers(self, instance: Instance) -> Outlook:
        """Say how likely a worker was at each step of an instance, given what had been seen before.

        Raises
        ------
        InputError
            If the shares are those of other groups, or the day is longer than the rows of ``presence``.
        """
        if self.share.size != instance.n_groups:
            raise InputError(f"share has {self.share.size} groups; the instance to be bounded has {instance.n_groups}")
        step = np.arange(instance.steps)
        group = np.full(instance.horizon, -1)
        group[instance.worker_step] = instance.worker_group
        idle = np.maximum.accumulate(np.where(group < 0, step, -1))
        busy = np.concatenate([[0], (step - idle)[:-1]])
        return Outlook(group, busy, self.presence_after(step, busy))

    def presence_after(self, step: Ints, busy: Ints) -> Floats:
        """Probability of a worker at each step, given for how many in a row one had been seen.

        Raises
        ------
        InputError
            If a step lies beyond the rows of ``presence``.
        """
        stretch = np.minimum(busy, self.presence.shape[-1] - 1)
        if self.presence.ndim == 1:
            return np.asarray(self.presence[stretch])
        if step.max(initial=-1) >= len(self.presence):
            raise InputError(
                f"presence has a row for each of {len(self.presence)} steps; the instance to be bounded has "
                f"{int(step.max()) + 1}: give a rate for each of its steps"
            )
        return np.asarray(self.presence[step, stretch])


class Outlook(NamedTuple):
    """Workers of one instance, step by step.

    Attributes
    ----------
    group : (T,) int
        Group of the worker who came; -1 where there is none.
    busy : (T,) int
        For how many steps in a row, up to the one before, a worker had been seen.
    presence : (T,) float
        Probability of a worker, given that.
    """

    group: Ints
    busy: Ints
    presence: Floats


def _probabilities(name: str, value: npt.ArrayLike, by_step: bool = False) -> Floats:
    """Return a row of numbers from 0 to 1, or a row for each step if that is allowed; or raise an InputError."""
    p = floats(name, value, None)
    if p.ndim not in ((1, 2) if by_step else (1,)) or not p.size:
        raise InputError(f"{name} has shape {p.shape}; give a row of probabilities{', or one a step' * by_step}")
    wrong = ~((p >= 0) & (p <= 1))
    if wrong.any():
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise InputError(f"{name}[{', '.join(map(str, at))}] = {p[at]:g} is no probability; give numbers from 0 to 1")
    return p


def _adds_up(name: str, p: Floats) -> None:
    if abs(p.sum() - 1.0) > 1e-9:
        raise InputError(f"{name} adds up to {p.sum():.9g}, not to 1: give the probability of every case")


@dataclass(frozen=True, eq=False)
class Surroundings:
    """One instance's requests, and those that might have arrived, in one table.

    Attributes
    ----------
    requests : KnownRequests
        The instance's own n first, then the pool's.
    own : list of (m,) int
        The instance's arrivals of each step.
    drawn : list of (K, w) int
        Other arrivals of each step, -1 for padding.
    weight : list of (K,) float
        Their probabilities.
    """

    requests: KnownRequests
    own: list[Ints]
    drawn: list[Ints]
    weight: list[Floats]


def surroundings(instance: Instance, foresight: Foresight, rng: np.random.Generator) -> Surroundings:
    """Put an instance among what might have been.

    Raises
    ------
    InputError
        If the pool's instances have other groups, features or another horizon.
    """
    pool = _usable(instance, foresight.arrivals)
    start = np.cumsum([0, instance.n_requests, *(one.n_requests for one in pool)])
    requests = join_requests([instance, *pool])
    T = instance.horizon
    own = [np.flatnonzero(instance.arrival == step) for step in range(T)]
    if not pool:
        nothing = np.zeros((1, 0), np.int64)
        return Surroundings(requests, own, [nothing] * T, [np.ones(1)] * T)
    owner = np.repeat(np.arange(len(pool)), np.diff(start[1:]))
    arrival = requests.arrival[instance.n_requests :]
    drawn, weight = [], []
    for step in range(T):
        at = np.flatnonzero(arrival == step)
        rows, p = _draw(owner[at], at + instance.n_requests, len(pool), foresight, rng)
        drawn.append(rows)
        weight.append(p)
    return Surroundings(requests, own, drawn, weight)


def _draw(owner: Ints, request: Ints, pool: int, foresight: Foresight, rng: np.random.Generator) -> tuple[Ints, Floats]:
    """Draw arrival sets of one step, as padded rows (K, w), with their probabilities (K,)."""
    some = np.unique(owner)
    if foresight.weight is not None:
        picked, p = np.arange(pool), foresight.weight
    elif foresight.nothing is None:
        picked = rng.choice(pool, min(foresight.draws, pool), replace=False)
        p = np.full(picked.size, 1.0 / picked.size)
    elif some.size or foresight.nothing == 1.0:
        picked = rng.choice(some, min(foresight.draws, some.size), replace=False)
        p = np.full(picked.size, (1.0 - foresight.nothing) / max(picked.size, 1))
        picked, p = np.append(picked, -1), np.append(p, foresight.nothing)
    else:
        raise InputError("no instance of the pool has arrivals at some step: give more of them, or leave nothing out")
    # Requests go by owner; the last entry is that of -1, who has none.
    each = np.append(np.bincount(owner, minlength=pool), 0)
    count, start = each[picked], (each.cumsum() - each)[picked]
    place = np.arange(int(count.max(initial=0)))
    rows, there = np.full((picked.size, place.size), -1, dtype=np.int64), place < count[:, None]
    rows[there] = request[(start[:, None] + place)[there]]
    return rows, p


def _usable(instance: Instance, pool: Sequence[Instance]) -> Sequence[Instance]:
    for i, one in enumerate(pool):
        if one.n_groups != instance.n_groups or one.features.shape[1] != instance.features.shape[1]:
            raise InputError(f"instance {i} of the pool has other groups or features than the one to be bounded")
        if one.horizon != instance.horizon:
            raise InputError(f"instance {i} of the pool has horizon {one.horizon}, not {instance.horizon}")
    return pool


def join_requests(instances: Sequence[Instance]) -> KnownRequests:
    """All requests of some instances, with their true utilities, in one table."""

    def joined(name: str) -> npt.NDArray[np.float64]:
        return np.concatenate([getattr(one, name) for one in instances])

    utility = np.concatenate([one.relative_utility for one in instances], axis=1)
    arrival, expiry, pickup, dropoff = (
        joined(name).astype(np.int64) for name in ("arrival", "expiry", "pickup", "dropoff")
    )
    return KnownRequests(
        joined("reward"), joined("penalty"), arrival, expiry, utility, joined("features"), pickup, dropoff
    )
