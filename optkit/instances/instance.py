"""One instance of the problem: the requests, the workers, their preferences and, if drawn, their noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from optkit.basics import arrays
from optkit.basics.arrays import Floats, Ints, ReadOnlyArrays, locked, text_names
from optkit.basics.errors import InstanceError
from optkit.instances.clock import Clock
from optkit.instances.labels import Identifiers, identifiers
from optkit.instances.queue import fifo_queue

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["DENSE_NOISE_LIMIT", "Floats", "Instance", "Ints", "fifo_queue"]

DENSE_NOISE_LIMIT = 4_000_000
"""Worker-request pairs above which :meth:`Instance.with_noise` draws sparse noise (32 MB if dense)."""

_whole_number = partial(arrays.whole_number, error=InstanceError)
_count = partial(arrays.count, error=InstanceError)
_ints = partial(arrays.ints, error=InstanceError)
_real = partial(arrays.real, error=InstanceError)
_floats = partial(arrays.floats, error=InstanceError)


LATEST_START = 1_000_000
"""Step at which the first request or worker must have come: who counts from 1970 comes later."""

LONGEST = 10_000_000
"""Steps that can be gone through one by one, see :attr:`Instance.steps`."""


@dataclass(frozen=True, eq=False)
class Instance(ReadOnlyArrays):
    """A day of one platform: everything exogenous, and nothing that a policy decides.

    Arrays are copied, checked and made read-only; n requests, J workers, D worker groups, k features.

    Parameters
    ----------
    horizon : int
        Number of decision steps T; steps are 0..T-1 (the paper's t is step + 1).
    arrival, expiry : (n,) int
        First and last step at which a request can be served, both inclusive; ``arrival <= expiry < horizon``.
    reward : (n,) float
        Money earned for serving a request, before the compensation is paid.
    penalty : (n,) float
        Money, at most 0, received when a request expires unserved.
    features : (n, k) float
        Characteristics x_i of the request. The scenarios of optkit put the travel time last, and
        :class:`optkit.policies.Formula` reads it from there.
    pickup, dropoff : (n,) int
        Location indices, at least 0.
    worker_step : (J,) int
        The step at which each worker is seen, strictly increasing: a step sees at most one worker.
        :func:`fifo_queue` turns arrivals into such steps.
    worker_group : (J,) int
        The group of each worker, in 0..D-1.
    utility : (D, n) float
        Mean utility u of request i to group d, in money; the compensation adds to it with weight 1.
    mu : (D,) float
        Scale of the Gumbel noise of each group, in money, positive.
    outside_utility : float or (D,) float
        Utility u_0 of rejecting everything, in money.
    noise : (J, n) float or SciPy sparse array, optional
        Realised zero-mean Gumbel noise per worker and request. A sparse array needs an entry for every pair
        whose worker comes while the request is open; other entries are dropped.
    outside_noise : (J,) float, optional
        Realised noise of the outside option. Given with ``noise`` or not at all.
    request_id, worker_id : (n,) and (J,) text or int, optional
        What they are called elsewhere: all text, or all whole numbers, no two alike. Simulations and files keep them.
    worker_joined : (J,) int, optional
        Step at which each worker joined the queue, at most ``worker_step``, non-decreasing.
    group_names, feature_names : sequence of str, optional
        What the groups and the features are called.
    clock : Clock, optional
        When step 0 begins and how long a step is.

    Raises
    ------
    InstanceError
        If a rule above is broken; the message names the field, the first offending index and the remedy.

    Notes
    -----
    Paper section 2; ``docs/explanation/index.md``.

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[0.2], [0.7]], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[1.0])
    >>> day
    Instance(horizon=4, requests=2, workers=2, groups=1, noise=not realised)
    >>> day.with_noise(seed=0).noise.shape
    (2, 2)
    """

    horizon: int
    arrival: Ints
    expiry: Ints
    reward: Floats
    penalty: Floats
    features: Floats
    pickup: Ints
    dropoff: Ints
    worker_step: Ints
    worker_group: Ints
    utility: Floats
    mu: Floats
    outside_utility: float | Floats = 0.0
    noise: Floats | sparse.csr_array | None = None
    outside_noise: Floats | None = None
    request_id: Identifiers | None = None
    worker_id: Identifiers | None = None
    worker_joined: Ints | None = None
    group_names: tuple[str, ...] | None = None
    feature_names: tuple[str, ...] | None = None
    clock: Clock | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("horizon", _whole_number("horizon", self.horizon))
        if self.horizon < 1:
            raise InstanceError(f"horizon is {self.horizon}: it needs at least one step")
        n, J = _count("arrival", self.arrival), _count("worker_step", self.worker_step)
        for name in ("arrival", "expiry", "pickup", "dropoff"):
            put(name, _ints(name, getattr(self, name), (n,)))
        for name in ("reward", "penalty"):
            put(name, _floats(name, getattr(self, name), (n,)))
        for name in ("worker_step", "worker_group"):
            put(name, _ints(name, getattr(self, name), (J,)))
        put("features", _floats("features", self.features, (n, None), flags=True))
        put("mu", _floats("mu", np.atleast_1d(_real("mu", self.mu)), (None,)))
        put("utility", _floats("utility", self.utility, (self.mu.size, n)))
        outside = _real("outside_utility", self.outside_utility)
        put("outside_utility", _floats("outside_utility", outside, (self.mu.size,)) if outside.ndim else float(outside))
        self._check_rules()
        self._check_labels()
        self._check_noise()

    def _check_labels(self) -> None:
        sizes = {"request_id": self.n_requests, "worker_id": self.n_workers}
        for name, size in sizes.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, identifiers(name, getattr(self, name), size))
        counts = {"group_names": self.n_groups, "feature_names": self.features.shape[1]}
        for name, size in counts.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, text_names(name, getattr(self, name), size, error=InstanceError))
        if self.clock is not None and not isinstance(self.clock, Clock):
            raise InstanceError(f"clock is a {type(self.clock).__name__}, not a Clock")
        if self.worker_joined is not None:
            joined = _ints("worker_joined", self.worker_joined, (self.n_workers,))
            object.__setattr__(self, "worker_joined", joined)
            early = (joined > self.worker_step) | (np.diff(joined, prepend=joined[:1]) < 0)
            if early.any():
                j = int(early.argmax())
                raise InstanceError(
                    f"worker_joined[{j}] = {joined[j]} comes before those in front of him joined, or after he is seen "
                    f"at step {self.worker_step[j]}"
                )

    def _check_rules(self) -> None:
        at_request = (
            (self.arrival < 0, "arrival", "is negative; steps count from 0"),
            (self.expiry < self.arrival, "expiry", "comes before its arrival; the last step to serve it is inclusive"),
            (self.expiry >= self.horizon, "expiry", f"lies beyond the last step {self.horizon - 1}; cut it there"),
            (self.penalty > 0, "penalty", "is positive; write a cost of expiry as a number <= 0"),
            (self.pickup < 0, "pickup", "is negative; locations count from 0"),
            (self.dropoff < 0, "dropoff", "is negative; locations count from 0"),
        )
        for broken, name, why in at_request:
            if broken.any():
                i = int(broken.argmax())
                raise InstanceError(f"{name}[{i}] = {getattr(self, name)[i]} {why}")
        if self.mu.size == 0:
            raise InstanceError("mu is empty: give the noise scale of at least one worker group")
        if (self.mu <= 0).any():
            d = int((self.mu <= 0).argmax())
            raise InstanceError(
                f"mu[{d}] = {self.mu[d]} is not positive; it is the scale of the worker's noise, in money"
            )
        outside = (self.worker_step < 0) | (self.worker_step >= self.horizon)
        if outside.any():
            j = int(outside.argmax())
            raise InstanceError(f"worker_step[{j}] = {self.worker_step[j]} is outside the steps 0..{self.horizon - 1}")
        late = np.diff(self.worker_step) <= 0
        if late.any():
            j = int(late.argmax())
            raise InstanceError(
                f"worker_step[{j + 1}] = {self.worker_step[j + 1]} does not come after worker_step[{j}] = "
                f"{self.worker_step[j]}: a step sees one worker; optkit.instances.instance.fifo_queue lines arrivals up"
            )
        came = [at.min() for at in (self.arrival, self.worker_step) if at.size]
        if came and min(came) >= LATEST_START:
            raise InstanceError(
                f"nobody comes before step {min(came):,}: steps count from 0 (are these seconds since 1970?); subtract "
                "the first from arrival, expiry and worker_step"
            )
        D = self.mu.size
        alien = (self.worker_group < 0) | (self.worker_group >= D)
        if alien.any():
            j = int(alien.argmax())
            raise InstanceError(
                f"worker_group[{j}] = {self.worker_group[j]} is not in 0..{D - 1}, the groups that mu has"
            )

    def _check_noise(self) -> None:
        if (self.noise is None) != (self.outside_noise is None):
            given, missing = ("outside_noise", "noise") if self.noise is None else ("noise", "outside_noise")
            raise InstanceError(f"{given} is given without {missing}: give both, or neither and call with_noise(seed)")
        if self.noise is None:
            return
        shape = (self.worker_step.size, self.arrival.size)
        object.__setattr__(self, "outside_noise", _floats("outside_noise", self.outside_noise, shape[:1]))
        if sparse.issparse(self.noise):
            object.__setattr__(self, "noise", self._compatible_noise(sparse.csr_array(self.noise, copy=True), shape))
        else:
            object.__setattr__(self, "noise", _floats("noise", self.noise, shape))

    def _compatible_noise(self, noise: sparse.csr_array, shape: tuple[int, int]) -> sparse.csr_array:
        if noise.shape != shape:
            raise InstanceError(f"noise has shape {noise.shape}; it needs (workers, requests) = {shape}")
        if noise.dtype.kind == "c":
            raise InstanceError("noise holds complex numbers (dtype complex), not real numbers")
        noise.sum_duplicates()
        worker, request = self.pairs()
        if noise.nnz:
            rows = np.repeat(np.arange(shape[0]), np.diff(noise.indptr))
            stored, wanted = rows * shape[1] + noise.indices, worker * shape[1] + request
            at = np.minimum(np.searchsorted(stored, wanted), stored.size - 1)
            absent = stored[at] != wanted
        else:
            at, absent = np.zeros(worker.size, int), np.ones(worker.size, bool)
        if absent.any():
            p = int(absent.argmax())
            raise InstanceError(
                f"noise has no entry for worker {worker[p]} and request {request[p]}, who meet at step "
                f"{self.worker_step[worker[p]]}; store every compatible pair (Instance.pairs lists them)"
            )
        data = noise.data[at] if worker.size else np.zeros(0)
        if not np.isfinite(data).all():
            p = int((~np.isfinite(data)).argmax())
            raise InstanceError(f"noise[{worker[p]}, {request[p]}] is {data[p]}: draw it again; optkit never guesses")
        starts = np.searchsorted(worker, np.arange(shape[0] + 1))
        made = sparse.csr_array((data, request, starts), shape=shape)
        made.data, made.indices, made.indptr = locked((made.data, made.indices, made.indptr))
        return made

    @property
    def steps(self) -> int:
        """The horizon, for what goes through all steps one by one.

        Raises
        ------
        InstanceError
            If there are more than :data:`LONGEST`.
        """
        if self.horizon > LONGEST:
            raise InstanceError(
                f"horizon is {self.horizon:,}: more than {LONGEST:,} steps cannot be gone through one by one; take "
                "longer steps, or look for seconds since 1970 among arrival, expiry and worker_step"
            )
        return self.horizon

    @property
    def n_requests(self) -> int:
        """Number of requests n."""
        return self.arrival.size

    @property
    def n_workers(self) -> int:
        """Number of workers J."""
        return self.worker_step.size

    @property
    def n_groups(self) -> int:
        """Number of worker groups D."""
        return self.mu.size

    @property
    def outside_by_group(self) -> Floats:
        """The outside utility u_0 of each group, (D,), in money."""
        given = self.outside_utility
        return given if isinstance(given, np.ndarray) else np.full(self.mu.size, given)

    @property
    def relative_utility(self) -> Floats:
        """How much more each group likes each request than rejecting, u - u_0, (D, n), in money."""
        return np.asarray(self.utility - self.outside_by_group[:, None])

    @property
    def surplus(self) -> Floats:
        """What serving a request is worth to platform and worker together, r - beta + u - u_0, (D, n), in money."""
        return np.asarray(self.reward - self.penalty + self.relative_utility)

    def pairs(self) -> tuple[Ints, Ints]:
        """Compatible pairs: every worker with every request that is open at the worker's step.

        Returns
        -------
        worker, request : (p,) int
            Sorted by worker, then by request.
        """
        first = np.searchsorted(self.worker_step, self.arrival, side="left")
        count = np.searchsorted(self.worker_step, self.expiry, side="right") - first
        request = np.repeat(np.arange(self.n_requests), count)
        worker = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
        order = np.argsort(worker, kind="stable")
        return worker[order], request[order]

    def pair_noise(self) -> Floats:
        """Realised noise of the compatible pairs, (p,), in the order of :meth:`pairs`.

        Raises
        ------
        InstanceError
            If the noise is not realised.
        """
        if self.noise is None:
            raise InstanceError("the noise of this instance is not realised: call instance.with_noise(seed) first")
        if sparse.issparse(self.noise):
            return np.asarray(self.noise.data)
        return np.asarray(self.noise[self.pairs()])

    def with_noise(self, seed: int | np.random.Generator | np.random.SeedSequence | None) -> Instance:
        """Return this instance with its noise drawn anew: Gumbel of mean 0 and the scale of the worker's group.

        Parameters
        ----------
        seed : int, Generator or SeedSequence
            Source of the randomness; the same seed gives the same noise.

        Returns
        -------
        Instance
            Another one; this one stays as it is.
        """
        rng = np.random.default_rng(seed)
        scale = self.mu[self.worker_group]
        outside = rng.gumbel(-np.euler_gamma * scale, scale)
        if self.n_workers * self.n_requests <= DENSE_NOISE_LIMIT:
            # One scale for all gives the same numbers as a scale for each, sooner.
            by_worker = scale[:, None] if (self.mu != self.mu[0]).any() else self.mu[0]
            noise: Any = rng.gumbel(-np.euler_gamma * by_worker, by_worker, (self.n_workers, self.n_requests))
        else:
            worker, request = self.pairs()
            drawn = rng.gumbel(-np.euler_gamma * scale[worker], scale[worker])
            noise = sparse.csr_array((drawn, (worker, request)), shape=(self.n_workers, self.n_requests))
        # All but the noise is checked already, and nobody can have changed it since.
        other = object.__new__(type(self))
        vars(other).update(self.__getstate__(), noise=noise, outside_noise=outside)
        other._check_noise()
        return other

    @classmethod
    def from_frames(
        cls,
        requests: Any,
        workers: Any,
        *,
        mu: npt.ArrayLike | Mapping[str, float] = 1.0,
        outside_utility: float | npt.ArrayLike | Mapping[str, float] = 0.0,
        horizon: int | None = None,
        start: Any = None,
        step: Any = None,
        features: Sequence[str] = (),
        queue: bool = False,
    ) -> Instance:
        """Build an instance from two tables: the way to bring one's own data.

        Parameters
        ----------
        requests : DataFrame, or table of polars or pyarrow
            Columns ``arrival``, ``expiry``, ``reward``, ``penalty``, ``pickup``, ``dropoff``, ``request_id``, and
            ``utility`` for one worker group or for all, or one for each: ``utility_bike``, ``utility_car``, or
            ``utility_0``, ``utility_1``. ``penalty``, ``pickup`` and ``dropoff`` may be left out and are then 0.
        workers : DataFrame, or table of polars or pyarrow
            ``joined``, when each joined the queue, which makes the step at which he is seen; or ``step``, when he was
            seen; or both. ``group``, by name or number, and ``worker_id`` may be left out. Any order.
        mu, outside_utility : float, (D,) float, or dict or Series of group to float
            Noise scale and utility of rejecting, in money: per group, or one number for all.
        horizon : int, optional
            Number of steps; one more than the last step that the tables name, unless given.
        start : str or Timestamp, optional
            Where times are timestamps: when step 0 begins. A time of day is one of the date of the first row. Without
            it, the first time in the tables, down to a multiple of a step.
        step : str, Timedelta or float
            Where times are timestamps: how long a step is, as ``"15s"`` or in seconds. ``arrival`` and ``joined`` fall
            into a step; a deadline at the very beginning of a step belongs to the one before.
        features : sequence of str
            The columns of ``requests`` that make up the feature matrix, travel time last.
        queue : bool
            Treat ``step`` as ``joined``.

        Returns
        -------
        Instance
            Its noise is not realised; see :meth:`with_noise`.

        Raises
        ------
        InstanceError
            If a column is missing or nearly has the name of one that may be left out, a row has no group, time or
            number where it needs one, or the instance breaks a rule.

        Warns
        -----
        LeftOutWarning
            If a row has no part in the instance: workers whose turn does not come before the day ends, and, where times
            are timestamps, whatever comes before the start or after the end. Also of columns that play no part.

        Examples
        --------
        >>> import pandas as pd
        >>> requests = pd.DataFrame({"reward": [30.0, 40.0], "utility_bike": [-9.0, -8.0],
        ...                          "arrival": ["2026-03-02T08:00:05", "2026-03-02T08:00:20"],
        ...                          "expiry": ["2026-03-02T08:01:00", "2026-03-02T08:02:00"]})
        >>> workers = pd.DataFrame({"joined": ["2026-03-02T08:00:16", "2026-03-02T08:00:17"], "group": "bike"})
        >>> day = Instance.from_frames(requests, workers, start="08:00", step="15s")
        >>> day.arrival, day.expiry, day.worker_step, day.group_names
        (array([0, 1]), array([3, 7]), array([1, 2]), ('bike',))
        """
        from optkit.instances.frames import fields_of, understood

        tables = understood(requests, workers, features, queue)
        made = cls(**fields_of(tables, mu=mu, outside_utility=outside_utility, horizon=horizon, start=start, step=step))
        tables.account.warn(stacklevel=2)
        return made

    def to_frames(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Return the requests and the workers as two tables, which :meth:`from_frames` takes.

        What no column holds is to be given again: mu, the outside utility, the horizon, the clock, and ``features=``.
        The noise is in neither.

        Examples
        --------
        >>> from optkit import scenario
        >>> requests, workers = scenario("I.2", seed=0).sample(1, seed=1)[0].to_frames()
        >>> workers.columns.tolist()
        ['step']
        """
        from optkit.instances.frames import tables_of

        return tables_of(self)

    def __repr__(self) -> str:
        kind = "not realised" if self.noise is None else "sparse" if sparse.issparse(self.noise) else "dense"
        return (
            f"Instance(horizon={self.horizon}, requests={self.n_requests}, workers={self.n_workers}, "
            f"groups={self.n_groups}, noise={kind})"
        )

    def _repr_html_(self) -> str:
        from html import escape

        tables = (one.to_html(max_rows=8, index=False) for one in self.to_frames())
        return f"<p>{escape(repr(self))}</p>" + "".join(tables)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Instance):
            return NotImplemented
        return all(_same(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))

    __hash__ = None  # type: ignore[assignment]


def _same(a: Any, b: Any) -> bool:
    if sparse.issparse(a) and sparse.issparse(b):
        return bool(
            all(np.array_equal(getattr(a, part), getattr(b, part)) for part in ("shape", "indptr", "indices", "data"))
        )
    if sparse.issparse(a) or sparse.issparse(b) or (a is None) != (b is None):
        return False
    if isinstance(a, Clock):
        return bool(a == b)
    return bool(np.array_equal(a, b))
