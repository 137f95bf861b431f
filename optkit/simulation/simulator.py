"""The Markov decision process of paper section 2, stepped through many instances at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import MOST_MONEY, Bools, Floats, Ints, Known, flag, locked, real
from optkit.basics.errors import InputError, PolicyError
from optkit.basics.users_code import name_of, users_code
from optkit.instances.instance import Instance
from optkit.instances.labels import Identifiers
from optkit.simulation.batch import Batch
from optkit.simulation.offers_made import OffersMade
from optkit.simulation.same_world import same_world
from optkit.simulation.state import State

if TYPE_CHECKING:
    import pandas as pd

Policy = Callable[[State], npt.ArrayLike]
"""Any callable from a :class:`optkit.simulation.state.State` to compensations (b, w), in money, at least 0."""

Observer = Callable[[State, Floats, Ints], Any]
"""Called after each step's choices with the state, the compensations (b, w), and the column taken (b,), -1 for none."""


@dataclass(frozen=True)
class Simulation(Known):
    """What happened in B simulated runs.

    Attributes
    ----------
    reward : (B,) float
        Total reward: margins of accepted requests plus penalties of expired ones, in money.
    margin, penalty : (B,) float
        Its two parts.
    accepted : (B, J) int
        Request that each worker took, -1 for none; padded with -1 to the largest number of workers.
    compensation : (B, J) float
        What the worker was paid, in money; NaN for none.
    expired : (B, n) bool
        Which requests expired unserved; padded with False to the largest number of requests.
    request_id, worker_id : tuple of arrays or None
        What the requests and the workers of each run are called, if they are called anything.
    offers : DataFrame or None
        Every offer (:class:`optkit.simulation.offers_made.OffersMade`), if ``simulate`` was asked to keep them.
    """

    lacking = ("compensation",)

    reward: Floats
    margin: Floats
    penalty: Floats
    accepted: Ints
    compensation: Floats
    expired: Bools
    request_id: tuple[Identifiers | None, ...] | None = None
    worker_id: tuple[Identifiers | None, ...] | None = None
    offers: pd.DataFrame | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        runs, mean = len(self.reward), self.reward.mean() if len(self.reward) else 0.0
        return f"Simulation({runs:,} runs, mean reward {mean:.6g}, {self.served.sum():,} requests served)"

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self.to_frame().to_html(max_rows=10, index=False)}"

    @property
    def served(self) -> Ints:
        """Number of requests served in each run, (B,)."""
        return np.asarray((self.accepted >= 0).sum(axis=1))

    def to_frame(self, *, rejected: bool = False) -> pd.DataFrame:
        """One row per accepted request: ``run``, ``worker``, ``request``, ``compensation``.

        Where the instances say what things are called, also ``worker_id`` and ``request_id``, by which it is joined to
        the tables that the instances were made of.

        Parameters
        ----------
        rejected : bool
            One row per offer, those that were not accepted too, with ``step``, ``group``, ``reward`` and ``accepted``.

        Raises
        ------
        InputError
            If the offers were not kept.

        Examples
        --------
        >>> from dataclasses import replace
        >>> from optkit import scenario
        >>> day = scenario("I.1", seed=0, horizon=4).sample(1, seed=1)[0]
        >>> named = replace(day, request_id=[f"order {i}" for i in range(day.n_requests)])
        >>> simulate(named, lambda state: state.reward).to_frame()["request_id"].tolist()
        ['order 1', 'order 0', 'order 2']
        """
        import pandas as pd

        if flag("rejected", rejected):
            if self.offers is None:
                raise InputError("the offers were not kept: ask simulate(..., keep_offers=True) for them")
            columns: dict[str, Any] = {str(name): column.to_numpy() for name, column in self.offers.items()}
            run, paid = columns["run"], {}
        else:
            run, worker = np.nonzero(self.accepted >= 0)
            columns = {"run": run, "worker": worker, "request": self.accepted[run, worker]}
            paid = {"compensation": self.compensation[run, worker]}
        for name, ids in (("worker", self.worker_id), ("request", self.request_id)):
            if ids is not None:
                pairs = zip(run.tolist(), columns[name].tolist(), strict=True)
                columns[f"{name}_id"] = [None if (own := ids[r]) is None else own[at] for r, at in pairs]
        return pd.DataFrame({**columns, **paid})


def simulate(
    instances: Instance | Sequence[Instance] | Batch,
    policy: Policy,
    *,
    observe: Observer | None = None,
    keep_offers: bool = False,
) -> Simulation:
    """Run a policy through instances, all in lockstep.

    At each step the requests that arrive join the open ones; the worker, if there is one, sees a compensation for each
    and takes the request of highest utility plus compensation plus noise, or none if rejecting is better; then the
    requests whose last step this is expire. The noise is the instances' own, so every policy meets the same.

    Parameters
    ----------
    instances : sequence of Instance, or one
        Their noise must be realised.
    policy : callable
        Takes a :class:`optkit.simulation.state.State`, returns compensations (b, w); see ``CONTRIBUTING.md`` for a
        worked example.
    observe : callable, optional
        Called at every step in which somebody decides, with the state, the compensations and the choices.
    keep_offers : bool
        Keep every offer, for ``to_frame(rejected=True)``.

    Returns
    -------
    Simulation
        What was earned and who took what, instance by instance.

    Raises
    ------
    PolicyError
        If the policy fails, or returns the wrong shape, NaN, infinity or a negative compensation.
    InputError, InstanceError
        If the instances do not fit together or have no noise.

    Examples
    --------
    >>> from optkit import scenario
    >>> instances = scenario("I.1", seed=0).sample(2, seed=1)
    >>> half = simulate(instances, lambda state: 0.5 * state.reward)
    >>> bool(np.allclose(half.reward, half.margin + half.penalty))
    True
    """
    batch = Batch.of(instances)
    if not flag("keep_offers", keep_offers):
        return run(batch, policy, np.arange(len(batch)), observe=observe)
    made = OffersMade()

    def both(*seen: Any) -> None:
        made(*seen)
        if observe is not None:
            observe(*seen)

    return replace(run(batch, policy, np.arange(len(batch)), observe=both), offers=made.to_frame())


def run(batch: Batch, policy: Policy, instance: Ints, *, observe: Observer | None = None) -> Simulation:
    """Simulate R runs, where run r goes through instance ``instance[r]``; several runs may share an instance."""
    R = instance.size
    J = int(np.diff(batch.worker_start).max(initial=0))
    n = int(np.diff(batch.request_start).max(initial=0))
    margin, penalty = np.zeros(R), np.zeros(R)
    accepted = np.full((R, J), -1, dtype=np.int64)
    paid = np.full((R, J), np.nan)
    expired = np.zeros((R, n), dtype=bool)
    order, begin = batch.arrivals
    open_ = np.empty((R, 0), dtype=np.int64)  # open requests, packed to the left, -1 beyond
    with same_world(batch, policy):
        for step in range(batch.horizon):
            open_ = _arrive(open_, order, begin[step, instance], begin[step + 1, instance])
            if open_.shape[1] == 0:
                continue
            worker = batch.worker_at[step, instance]
            row = np.flatnonzero((worker >= 0) & (open_[:, 0] >= 0))
            if row.size:
                state = _state(batch, step, row, instance[row], worker[row], open_[row])
                offer = offers(policy, state)
                taken = locked(_choose(state, offer))
                if observe is not None:
                    observe(state, offer, taken)
                at = np.flatnonzero(taken >= 0)
                request, pay = state.request[at, taken[at]], offer[at, taken[at]]
                j = state.worker[at] - batch.worker_start[state.instance[at]]
                accepted[row[at], j] = request - batch.request_start[state.instance[at]]
                paid[row[at], j] = pay
                with np.errstate(over="ignore"):
                    margin[row[at]] += batch.reward[request] - pay
                open_[row[at], taken[at]] = -1
            over = (open_ >= 0) & (batch.expiry.take(open_, mode="wrap") == step)
            r, w = np.nonzero(over)
            if r.size:
                request = open_[r, w]
                penalty += np.bincount(r, batch.penalty[request], minlength=R)
                expired[r, request - batch.request_start[instance[r]]] = True
                open_[over] = -1
    if not np.isfinite(margin).all():
        lost = int((~np.isfinite(margin)).argmax())
        raise PolicyError(
            f"what the policy pays in instance {instance[lost]} adds up to more than a number can hold; "
            "a compensation is an amount of moderate size"
        )
    requests, workers = (_called(batch, instance, name) for name in ("request_id", "worker_id"))
    return Simulation(margin + penalty, margin, penalty, accepted, paid, expired, requests, workers)


def named_policies(policies: Any) -> None:
    """Refuse what is no mapping from names to policies.

    Raises
    ------
    InputError
        If it is none, or one of them cannot be called.
    """
    if not isinstance(policies, Mapping):
        raise InputError(f"policies is a {type(policies).__name__}: give a dict, such as {{'mine': policy}}")
    for name, policy in policies.items():
        if not callable(policy):
            raise InputError(f"policy {name!r} is a {type(policy).__name__}, which cannot be called")


def _called(batch: Batch, instance: Ints, name: str) -> tuple[Identifiers | None, ...] | None:
    """Return what the requests or the workers of each run are called; None if no instance says it."""
    if all(getattr(one, name) is None for one in batch.instances):
        return None
    return tuple(getattr(batch.instances[b], name) for b in instance.tolist())


def _arrive(open_: Ints, order: Ints, begin: Ints, end: Ints) -> Ints:
    """Add columns for the requests that arrive, then close the gaps that earlier steps left."""
    most = int((end - begin).max(initial=0))
    if most == 0:
        return _pack(open_)
    place = begin[:, None] + np.arange(most)
    new = np.where(place < end[:, None], order.take(place, mode="clip"), -1)
    return _pack(np.concatenate([open_, new], axis=1))


def _pack(open_: Ints) -> Ints:
    """Move the open requests of each row to the left, in order, and drop columns that are padding everywhere."""
    keep = open_ >= 0
    count = keep.sum(axis=1)
    packed = np.full((len(open_), int(count.max(initial=0))), -1, dtype=np.int64)
    packed[np.arange(packed.shape[1]) < count[:, None]] = open_[keep]
    return packed


def _state(batch: Batch, step: int, row: Ints, instance: Ints, worker: Ints, open_: Ints) -> State:
    open_ = open_[:, : int((open_ >= 0).sum(axis=1).max())]
    offered = open_ >= 0
    request = np.where(offered, open_, batch.request_start[-1])
    # A policy that wrote into what it sees would change the world.
    return State(batch, step, *locked((row, instance, worker, request, offered)))


def offers(policy: Policy, state: State) -> Floats:
    """Ask a policy: its compensations (b, w), in money, 0 where nothing is offered.

    Raises
    ------
    PolicyError
        If it fails, with its own exception as the cause, or its offers are not feasible; the first offence is named.

    Examples
    --------
    >>> from optkit import scenario
    >>> asked = []
    >>> done = simulate(scenario("I.1", seed=0).sample(2, seed=1), lambda state: asked.append(state) or state.reward)
    >>> bool((offers(lambda state: 0.5 * state.reward, asked[0]) <= asked[0].reward).all())
    True
    """
    name = name_of(policy)
    with users_code(f"the policy {name}, at step {state.step},"):
        what = f"what the policy {name} returned at step {state.step}"
        offer = real(what, policy(_seen(state)), accept="any", error=PolicyError)
    if offer.shape != state.offered.shape:
        shapes = f"shape {offer.shape} at step {state.step} for {state.offered.shape} decisions and requests"
        raise PolicyError(f"the policy {name} returned {shapes}; return a compensation for each")
    # NaN fails the comparison too.
    wrong = state.offered & ~((offer >= 0) & (offer <= MOST_MONEY))
    if wrong.any():
        b, w = np.argwhere(wrong)[0]
        request = state.request[b, w] - state.batch.request_start[state.instance[b]]
        raise PolicyError(
            f"the policy {name} offers {offer[b, w]} for request {request} of instance {state.instance[b]} "
            f"at step {state.step}; a compensation is a finite number >= 0, of moderate size"
        )
    return locked(np.where(state.offered, offer, 0.0))


def _seen(state: State) -> State:
    """The same state in an object of its own: whatever a policy does to it, workers choose by the other."""
    return State(state.batch, state.step, state.row, state.instance, state.worker, state.request, state.offered)


def _choose(state: State, offer: Floats) -> Ints:
    """Column of the request that each worker takes, (b,), -1 for none. A worker who is indifferent accepts."""
    noise = state.batch.noise(state.worker, state.request)
    total = np.where(state.offered, state.utility + offer + noise, -np.inf)
    best = total.argmax(axis=1)
    outside = state.outside_utility + state.batch.outside_noise[state.worker]
    return np.where(total[np.arange(best.size), best] >= outside, best, -1)
