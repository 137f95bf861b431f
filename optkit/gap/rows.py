"""One instance of a gap report: its bounds, each proven, and what the policies earn in the mean over the noise.

Given the arrivals, a policy's mean reward is exact where the subsets of open requests can be enumerated
(:func:`optkit.bounds.arrival.policy_value.policy_value`), and simulated with fresh noise where they are too many. Its
*charge* is what the penalised bound would have charged it: zero in the mean over instances, and so a control variate.
With all requests told apart, no policy's reward less its charge exceeds the penalised bound of the same path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.basics.errors import PolicyError, SolverError
from optkit.basics.seeds import Stream, stream
from optkit.bounds import Bound, arrival_information, full_information
from optkit.bounds.arrival.lattice import lattice_bits, stages
from optkit.bounds.arrival.policy_value import Offer, policy_value
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import prove
from optkit.bounds.penalised.charges import KeptCharges
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.bounds.penalised.penalized import (
    PenalizedCertificate,
    idle_steps,
    penalized,
    penalized_program,
    tracked_requests,
)
from optkit.bounds.penalised.penalized_dual import penalized_dual
from optkit.gap.policy_offers import lattice_offers
from optkit.instances.instance import Instance
from optkit.models.value.request_sets import SetValue
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import Policy, simulate

Kind = Literal["full", "lagrangian", "penalised-lagrangian", "arrival", "penalised"]

BOUND_KINDS: tuple[Kind, ...] = ("full", "lagrangian", "penalised-lagrangian", "arrival", "penalised")
"""Bounds, loosest first as a rule: full information; arrival information with each request served at most once in
expectation, or exactly (as exactly as its size allows); and each of these two with foresight charged for."""

CHARGED: dict[Kind, str] = {"penalised": "charge", "penalised-lagrangian": "linear_charge"}
"""Those that charge, and how what a policy is charged is called in a row."""

ROUNDING = 1e-7
"""Of the money in play: what a bound may lie below a policy on one path before something must be wrong."""


@dataclass(frozen=True, eq=False)
class GapTask:
    """What is to be worked out for one instance.

    Attributes
    ----------
    number : int
        Of the instance.
    instance : Instance
    policies : mapping from name to policy
    kinds : tuple of str
        Among :data:`BOUND_KINDS`; full information is always there, because everything is measured by it.
    value, foresight : SetValue, Foresight or None
        For the penalised bound.
    charges : LinearCharges or None
        For the penalised Lagrangian.
    limit : int
        Requests told apart by the penalised bound, and by the enumeration of a policy.
    redraws : int
        Draws of the noise where a policy must be simulated.
    seed : int
        Of the report.
    """

    number: int
    instance: Instance
    policies: Mapping[str, Policy]
    kinds: tuple[Kind, ...]
    value: SetValue | None
    foresight: Foresight | None
    charges: LinearCharges | None
    limit: int
    redraws: int
    seed: int

    def stream(self, name: Stream) -> np.random.SeedSequence:
        """Randomness of one kind, apart from that of other instances."""
        return stream(self.seed, name, self.number)


def gap_row(task: GapTask) -> dict[str, Any]:
    """Bound one instance and evaluate the policies on it.

    Returns
    -------
    dict
        Plain data: ``requests``, ``workers``, ``penalty`` (sum, money); ``bounds`` by kind: ``value``, ``gap`` of its
        certificate, ``residual``, ``seconds``, ``method``; ``policies`` by name: ``reward``, ``charge`` and, where it
        is charged, ``linear_charge`` (money), ``exact``. Or ``error``, the reason why a solver's bound could not be
        proven.

    Raises
    ------
    PolicyError
        If a policy's offer is not feasible, or what it pays adds up to more than a number can hold.
    SolverError
        If a policy earns more than a bound that holds on each path.

    Examples
    --------
    >>> from optkit import scenario
    >>> day = scenario("I.2", seed=0).sample(1, seed=1)[0]
    >>> half = {"half": lambda state: 0.5 * state.reward}
    >>> row = gap_row(GapTask(0, day, half, ("full", "arrival"), None, None, None, 12, 64, 0))
    >>> row["policies"]["half"]["reward"] < row["bounds"]["arrival"]["value"]
    True
    """
    given = task.instance
    instance = given if given.noise is not None else given.with_noise(task.stream(Stream.REPORT_OWN_NOISE))
    row: dict[str, Any] = {
        "requests": instance.n_requests,
        "workers": instance.n_workers,
        "penalty": float(instance.penalty.sum()),
    }
    charged: dict[Kind, _Charged] = {}
    bounds: dict[Kind, dict[str, Any]] = {}
    order: tuple[Kind, ...] = ("full", *(k for k in task.kinds if k != "full"))
    try:
        for kind in order:
            if kind in CHARGED:
                charged[kind] = (_Charged.of if kind == "penalised" else _Charged.linear)(task, instance)
                bound = charged[kind].bound
            else:
                bound = _bound(kind, instance)
            verdict = prove(bound, instance)
            solver = bound.solver
            bounds[kind] = {
                "value": bound.value,
                "gap": verdict.gap,
                "residual": verdict.residual,
                "seconds": solver.seconds,
                "method": solver.method,
            }
    except SolverError as error:
        return {**row, "error": str(error)}
    policies, runs = {}, _Runs(task, instance)
    for name, policy in task.policies.items():
        with np.errstate(over="ignore", invalid="ignore"):
            policies[name] = _evaluate(task, instance, policy, charged, runs)
        _must_hold(task.number, name, policies[name], bounds)
    return {**row, "bounds": bounds, "policies": policies}


def _bound(kind: str, instance: Instance) -> Bound:
    if kind == "full":
        return full_information(instance)
    return arrival_information(instance, "lagrangian" if kind == "lagrangian" else None)


class _DayCharges(Protocol):
    """What is charged on one instance."""

    def __call__(self, step: int, requests: Ints) -> Floats: ...

    def idle(self, steps: Ints) -> float: ...


@dataclass(frozen=True, eq=False)
class _Charged:
    """A bound that charges; ``along`` is the charge of M runs, from the last steps after which requests waited."""

    bound: Bound
    charges: _DayCharges
    along: Callable[[Ints], Floats]

    @classmethod
    def of(cls, task: GapTask, instance: Instance) -> _Charged:
        """By a value function; proving it works its charges out once more, for the policies too."""
        assert task.value is not None
        assert task.foresight is not None
        bound = penalized(instance, task.value, task.foresight, seed=task.stream(Stream.CHARGES), limit=task.limit)
        proof = bound.certificate
        assert isinstance(proof, PenalizedCertificate)
        seen = KeptCharges.of(proof.charges)
        proven = replace(bound, certificate=replace(proof, charges=seen))
        return cls(proven, seen, lambda last: seen.along(last, proof.tracked))

    @classmethod
    def linear(cls, task: GapTask, instance: Instance) -> _Charged:
        """By what is linear in who waits, at any number of requests."""
        assert task.charges is not None
        charges = task.charges.on(instance)
        return cls(penalized_dual(instance, task.charges), charges, charges.along)


@dataclass(frozen=True, eq=False)
class _Runs:
    """What all policies are evaluated on: the induction over subsets, or the noise drawn anew, several times."""

    task: GapTask
    instance: Instance

    @cached_property
    def program(self) -> SubsetProgram:
        n = self.instance.n_requests
        return penalized_program(self.instance, np.ones(n, bool), np.zeros(n))

    @cached_property
    def batch(self) -> Batch:
        return Batch.of(
            [self.instance.with_noise(d) for d in self.task.stream(Stream.REPORT_NOISE).spawn(self.task.redraws)]
        )


def _evaluate(
    task: GapTask, instance: Instance, policy: Policy, charged: Mapping[Kind, _Charged], runs: _Runs
) -> dict[str, Any]:
    """Mean reward of a policy over the noise, and its charges, money; and whether they are exact."""
    paid = {"charge": 0.0}
    if charged and tracked_requests(instance, task.limit).all():
        offer, again = _asked_once(lattice_offers(instance, policy))
        reward = policy_value(runs.program, offer)
        for kind, one in charged.items():
            left = policy_value(runs.program, again(), one.charges) - one.charges.idle(idle_steps(runs.program))
            paid[CHARGED[kind]] = reward - left
        return {"reward": reward, **paid, "exact": True}
    if not charged and lattice_bits(instance).max(initial=0) <= task.limit:
        nothing, everything = np.zeros(instance.n_requests), np.ones(instance.n_requests, bool)
        program = SubsetProgram(instance, stages(instance), nothing, everything)
        return {"reward": policy_value(program, lattice_offers(instance, policy)), **paid, "exact": True}
    outcome = simulate(runs.batch, policy)
    # Last step after which each request waited.
    last = np.tile(instance.expiry - 1, (task.redraws, 1))
    run, worker = np.nonzero(outcome.accepted >= 0)
    last[run, outcome.accepted[run, worker]] = instance.worker_step[worker] - 1
    paid |= {CHARGED[kind]: float(one.along(last).mean()) for kind, one in charged.items()}
    return {"reward": float(outcome.reward.mean()), **paid, "exact": False}


def _asked_once(offer: Offer) -> tuple[Offer, Callable[[], Offer]]:
    """Return offers for an induction, and for each further one over the same program what the first was told."""
    told: list[Floats] = []

    def first(step: int, worker: int, requests: Ints, open_: Bools) -> Floats:
        told.append(offer(step, worker, requests, open_))
        return told[-1]

    def again() -> Offer:
        next_one = iter(told)
        return lambda step, worker, requests, open_: next(next_one)

    return first, again


def _must_hold(number: int, name: str, policy: Mapping[str, Any], bounds: Mapping[Kind, Any]) -> None:
    """Raise a PolicyError if a value is no number, a SolverError if an exact one exceeds a bound of every path."""
    if not np.isfinite(list(policy.values())).all():
        raise PolicyError(
            f"instance {number}: what {name} pays adds up to more than a number can hold; "
            "a compensation is an amount of moderate size"
        )
    if not policy["exact"]:
        return
    for kind, bound in bounds.items():
        earned = policy["reward"] - (policy[CHARGED[kind]] if kind in CHARGED else 0.0)
        if kind != "full" and earned > bound["value"] + ROUNDING * max(abs(earned), abs(bound["value"])):
            raise SolverError(
                f"instance {number}: {name} earns {earned:.9g} in the mean over the noise, more than the bound "
                f"{bound['value']:.9g} ({kind}), which cannot be: one of them is wrong"
            )
