"""A problem small enough to be solved exactly: few request types, and known probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, check_memory, floats, read_only, real, whole_number
from optkit.basics.errors import InputError
from optkit.basics.seeds import check_count, seed_sequence
from optkit.instances.instance import DENSE_NOISE_LIMIT, Instance, fifo_queue

OVERHEAD = 3_000
"""Bytes of an instance in which nothing happens."""

_ROUNDING = 1e-9
"""How far probabilities may be from adding up to 1: they may have been rounded when they were written down."""


@dataclass(frozen=True, eq=False)
class Stream:
    """Requests that arrive together, independently of all else: ``count`` (m, K) with ``probability`` (m,)."""

    count: Ints
    probability: Floats


class Draw(NamedTuple):
    """An instance, and how many workers are left in the queue after each step, (T,): no policy of the kit sees that."""

    instance: Instance
    queue: Ints


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallModel:
    """Request types and workers with known probabilities, the same at every step and independent between steps.

    K request types, D worker groups, T steps. Everything happens as in :func:`optkit.simulate`: requests and workers
    arrive, the first worker in the queue is seen and leaves, requests whose last step this was expire.

    Parameters
    ----------
    horizon : int
        Number of steps T.
    reward, penalty : (K,) float
        Money for serving a request, and (at most 0) for letting it expire.
    lifetime : (K,) int
        Steps that a request waits: one that arrives at step s can be served at s..min(s + lifetime, T - 1).
    utility : (D, K) float
        Mean utility of a request to a worker, in money.
    mu : (D,) float
        Scale of the Gumbel noise of each group, in money, positive.
    workers : (a + 1,) float
        Probabilities that 0..a workers join the queue in a step.
    arrivals : (K,) or (K, c + 1) float
        Independent types: the probability that a request of the type arrives in a step, or the probabilities of
        0..c such requests (a truncated Poisson distribution, say). Leave it out if ``joint_arrivals`` is given.
    joint_arrivals : sequence of ((K,) int, float), optional
        Dependent types: numbers of requests of each type that arrive in a step, and the probability of that.
    outside_utility : float or (D,) float
        Utility of rejecting everything, in money.
    share : (D,) float, optional
        Probability of each group; equal by default.
    queue : int
        How many workers at most wait for a later step; who finds the queue full leaves. With 0, the default, a worker
        is there with probability 1 - workers[0] at each step, independently: nothing is hidden from policies.
    features : (K, k) float, optional
        Characteristics of a type, for the instances that are sampled; one indicator for each type by default.

    Raises
    ------
    InputError
        If a shape, a sign or a sum of probabilities is wrong; the message names the argument.

    Notes
    -----
    Paper section 2; ``docs/explanation/values.md``.

    Examples
    --------
    >>> model = SmallModel(horizon=3, reward=[30.0, 50.0], penalty=[-5.0, -5.0], lifetime=[1, 2],
    ...                    utility=[[-10.0, -12.0]], mu=[1.0], arrivals=[0.5, 0.2], workers=[0.6, 0.4])
    >>> model.sample(2, seed=0)[0].horizon
    3
    """

    horizon: int
    reward: Floats
    penalty: Floats
    lifetime: Ints
    utility: Floats
    mu: Floats
    workers: Floats
    arrivals: npt.ArrayLike | None = None
    joint_arrivals: Sequence[tuple[npt.ArrayLike, float]] | None = None
    outside_utility: float | Floats = 0.0
    share: Floats | None = None
    queue: int = 0
    features: Floats | None = None
    streams: tuple[Stream, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("horizon", whole_number("horizon", self.horizon, least=1))
        put("queue", whole_number("queue", self.queue, least=0))
        K = max(floats("reward", self.reward, (None,)).size, 1)
        D = max(floats("mu", self.mu, (None,)).size, 1)
        shapes = {"reward": (K,), "penalty": (K,), "lifetime": (K,), "mu": (D,), "utility": (D, K)}
        for name, shape in shapes.items():
            put(name, floats(name, getattr(self, name), shape))
        outside = real("outside_utility", self.outside_utility)
        put("outside_utility", floats("outside_utility", outside, (D,) if outside.ndim else ()))
        put("features", floats("features", np.eye(K) if self.features is None else self.features, (K, None)))
        for broken, name, why in (
            (self.penalty > 0, "penalty", "is positive; write a cost of expiry as a number <= 0"),
            (self.lifetime < 0, "lifetime", "is negative; 0 means one step only"),
            (self.lifetime != np.floor(self.lifetime), "lifetime", "is no whole number of steps"),
            (self.mu <= 0, "mu", "is not positive; it is the scale of the worker's noise, in money"),
        ):
            if np.any(broken):
                i = int(np.argmax(broken))
                place = f"[{i}]" if np.ndim(broken) else ""
                raise InputError(f"{name}{place} = {np.ravel(getattr(self, name))[i]:g} {why}")
        put("lifetime", read_only(self.lifetime.astype(np.int64)))
        put("workers", _distribution("workers", floats("workers", self.workers, (None,))))
        share = np.full(D, 1.0 / D) if self.share is None else floats("share", self.share, (D,))
        put("share", _distribution("share", share))
        put("streams", self._streams(K))

    def _streams(self, K: int) -> tuple[Stream, ...]:
        if (self.arrivals is None) == (self.joint_arrivals is None):
            raise InputError("give either arrivals, for independent types, or joint_arrivals, and not both")
        if self.joint_arrivals is not None:
            try:
                pairs = [(count, probability) for count, probability in self.joint_arrivals]
            except (TypeError, ValueError):
                raise InputError("joint_arrivals is no list of pairs (numbers of requests, probability)") from None
            count = np.array([floats(f"joint_arrivals[{s}]", c, (K,)) for s, (c, _) in enumerate(pairs)])
            if (count < 0).any() or (count != np.floor(count)).any():
                s = int(((count < 0) | (count != np.floor(count))).any(axis=1).argmax())
                raise InputError(f"joint_arrivals[{s}] = {count[s].tolist()} are not whole numbers >= 0 of requests")
            p = floats("probabilities in joint_arrivals", [p for _, p in pairs], (None,))
            p = _distribution("probabilities in joint_arrivals", p)
            different, same = np.unique(count[p > 0].astype(np.int64), axis=0, return_inverse=True)
            return (Stream(different, np.asarray(np.bincount(same.ravel(), p[p > 0]), float)),)  # NumPy 2.0: (n, 1)
        table = real("arrivals", self.arrivals)
        if table.ndim not in (1, 2) or len(table) != K:
            raise InputError(f"arrivals has shape {table.shape}; it needs ({K},) or ({K}, any), a row for each type")
        if table.ndim == 1:
            if (table < 0).any() or (table > 1).any():
                k = int(((table < 0) | (table > 1)).argmax())
                raise InputError(f"arrivals[{k}] = {table[k]:g} is no probability; give numbers from 0 to 1")
            table = np.column_stack([1.0 - table, table])
        streams = []
        for k, row in enumerate(table):
            p = _distribution(f"arrivals[{k}]", row)
            count = np.flatnonzero(p > 0)[:, None] * np.eye(K, dtype=np.int64)[k]
            if count.any():
                streams.append(Stream(count, p[p > 0]))
        return tuple(streams)

    @property
    def outside_by_group(self) -> Floats:
        """The outside utility u_0 of each group, (D,), in money."""
        return np.broadcast_to(self.outside_utility, self.mu.shape)

    def queue_transitions(self) -> tuple[Floats, Floats]:
        """Transitions of the queue of workers in one step, each (Q + 1, Q + 1), by its lengths before and after.

        Returns
        -------
        any, seen : (Q + 1, Q + 1) float
            The probability of each change of length, and that of the change happening while a worker is seen.

        Examples
        --------
        >>> model = SmallModel(horizon=1, reward=[30.0], penalty=[-5.0], lifetime=[1], utility=[[-10.0]], mu=[1.0],
        ...                    arrivals=[0.5], workers=[0.5, 0.25, 0.25], queue=1)
        >>> model.queue_transitions()[1].tolist()
        [[0.25, 0.25], [0.5, 0.5]]
        """
        Q = self.queue
        any_, seen = np.zeros((Q + 1, Q + 1)), np.zeros((Q + 1, Q + 1))
        for before in range(Q + 1):
            for joined, p in enumerate(self.workers):
                after = min(max(before + joined - 1, 0), Q)
                any_[before, after] += p
                seen[before, after] += p * (before + joined > 0)
        return any_, seen

    def draw(self, seed: int | np.random.Generator | np.random.SeedSequence) -> Draw:
        """Draw one instance, noise included, and the length of the queue after each step.

        The pick-up place of a request is its type.

        Examples
        --------
        >>> model = SmallModel(horizon=3, reward=[30.0], penalty=[-5.0], lifetime=[1], utility=[[-10.0]], mu=[1.0],
        ...                    arrivals=[1.0], workers=[0.0, 0.0, 1.0], queue=2)
        >>> draw = model.draw(seed=0)
        >>> draw.instance.worker_step, draw.queue
        (array([0, 1, 2]), array([1, 2, 2]))
        """
        rng = np.random.default_rng(seed)
        T, K = self.horizon, self.reward.size
        requests = np.zeros((T, K), dtype=np.int64)
        for stream in self.streams:
            requests += stream.count[_cases(rng, stream.probability, T)]
        joined = _cases(rng, self.workers, T).tolist()  # numbers one by one are quicker in lists
        length, before = [0] * T, 0
        for step in range(T):
            joined[step] = min(joined[step], self.queue + 1 - before)
            before = length[step] = max(before + joined[step] - 1, 0)
        worker_step, _ = fifo_queue(np.repeat(np.arange(T), joined), T)
        arrival, kind = np.divmod(np.repeat(np.arange(T * K), requests.ravel()), K)
        features: Any = self.features
        share: Any = self.share
        instance = Instance(
            horizon=T,
            arrival=arrival,
            expiry=np.minimum(arrival + self.lifetime[kind], T - 1),
            reward=self.reward[kind],
            penalty=self.penalty[kind],
            features=features[kind],
            pickup=kind,
            dropoff=np.zeros(kind.size, dtype=np.int64),
            worker_step=worker_step,
            worker_group=_cases(rng, share, worker_step.size),
            utility=self.utility[:, kind],
            mu=self.mu,
            outside_utility=self.outside_utility,
        )
        return Draw(instance.with_noise(rng), np.array(length, dtype=np.int64))

    def sample(self, count: int, seed: int | np.random.SeedSequence) -> list[Instance]:
        """Draw ``count`` independent instances, each from a seed of its own, spawned from ``seed``.

        Raises
        ------
        InputError
            If ``count`` or ``seed`` is negative or no whole number, or so many would not fit in memory.
        """
        check_count(count)
        T, K = float(self.horizon), self.reward.size
        requests = T * sum(float(stream.probability @ stream.count.sum(axis=1)) for stream in self.streams)
        workers = T * (1.0 - float(self.workers[0]))
        pairs = workers * requests
        if pairs > DENSE_NOISE_LIMIT:  # only pairs that can meet
            pairs *= min(1.0, (float(self.lifetime.min()) + 1.0) / T)
        numbers = requests * (10.0 + self.features.shape[1] + self.mu.size) + 4.0 * workers + pairs  # type: ignore[union-attr]
        needed = count * (8.0 * numbers + OVERHEAD) + (8.0 * T * (2 * K + 4) if count else 0.0)
        check_memory(f"{count:,} instances of this model", needed, "take fewer, or a shorter horizon")
        return [self.draw(child).instance for child in seed_sequence(seed).spawn(count)]


def _cases(rng: np.random.Generator, probability: Floats, count: int) -> Ints:
    """Draw cases 0, 1, ... of a distribution: those of NumPy's ``choice``, which checks it anew each time."""
    up_to = probability.cumsum()
    drawn: Ints = np.searchsorted(up_to / up_to[-1], rng.random(count), side="right")
    return drawn


def _distribution(name: str, p: Floats) -> Floats:
    """Return probabilities scaled to add up to 1 to the last digit, or raise an InputError."""
    if (p < 0).any():
        i = int((p < 0).argmax())
        raise InputError(f"{name}[{i}] = {p[i]:g} is a negative probability")
    if not abs(p.sum() - 1.0) <= _ROUNDING:
        raise InputError(f"{name} adds up to {p.sum():.12g}, not to 1: give the probability of every case")
    return read_only(p / p.sum())
