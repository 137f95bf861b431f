"""The main job: instances, tuned benchmarks, policies, bounds and verified prices, in one results folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from optkit.basics.errors import InputError, OptkitError
from optkit.basics.version import versions
from optkit.evaluation.comparison import Comparison, compare
from optkit.evaluation.proven import Progress, proven_bounds
from optkit.evaluation.verification import Verification, verify_pricing
from optkit.instances.instance import Instance
from optkit.instances.scenario import Split
from optkit.learning.rounds import Learned, learn_once, learn_preferences
from optkit.learning.trained import Trained
from optkit.learning.training import Choice, TrainingSettings, train
from optkit.models.preferences.preferences import Preferences
from optkit.policies import PostDecisionPricing
from optkit.policies.tuning import tune_formula, tune_reward_percentage
from optkit.simulation.simulator import Policy, simulate

TRAININGS: dict[str, tuple[str, Choice]] = {
    "Linear, true MNL": ("linear", "true"),
    "Kernel, true MNL": ("kernel", "true"),
    "Linear, learned MNL": ("linear", "learned"),
}
"""Value function and choice model of each trained policy, as in :func:`optkit.learning.training.train`."""

NO_DISTANCE = "it weighs the travel distance, the last feature, and these instances have no features"
"""Why there is no FP."""

ONCE, REESTIMATED, GIVEN = "Learned MNL, paper's data", "Learned MNL, re-estimated", "Given MNL"


@dataclass(frozen=True)
class RunResult:
    """What the main job found.

    Attributes
    ----------
    comparison : Comparison
        Policies on the test instances against the full-information bound.
    verification : Verification
        Checks of all decisions of the policies that price optimally by their beliefs, on the test instances.
    worst_bound_gap : float
        Largest gap between bound and matching that the bounds' certificates show when checked, in money.
    bound_failures : dict
        Test instances whose bound could not be computed, with the reason; they are left out of the comparison.
    record : dict
        Version, settings, seeds, tuned policies, sizes and seconds per stage, as plain data.
    """

    comparison: Comparison
    verification: Verification
    worst_bound_gap: float
    bound_failures: dict[int, str]
    record: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Everything but the per-instance rows, as plain data."""
        return {
            "policies": self.comparison.table.to_dict(orient="records"),
            "verification": self.verification.to_dict(),
            "worst_bound_gap": self.worst_bound_gap,
            "bound_failures": self.bound_failures,
            "record": self.record,
        }


def run_main_job(
    split: Split,
    origin: dict[str, Any],
    *,
    verify: int = 60,
    seed: int = 0,
    preferences: Preferences | None = None,
    progress: Progress | None = None,
) -> RunResult:
    """Tune, learn and train on training instances, then run, bound and verify on the test instances.

    Parameters
    ----------
    split : Split
        Training instances for the grid searches of PP and FP, for preferences and for value functions; validation
        instances to choose between rounds of training; test instances for everything that is reported.
    origin : dict
        Where the instances come from, as plain data; kept in the record.
    verify : int
        Number of pricing decisions to solve again with CVXPY.
    seed : int
        Of learning, of training, and of the choice of these decisions.
    preferences : Preferences, optional
        Somebody's own, which two more policies believe: :data:`GIVEN`, myopic, and ``Linear, given MNL``.
    progress : callable, optional
        Called with stage, done and total.

    Raises
    ------
    InputError
        If there are no training or no test instances, ``verify`` is negative, or the preferences do not fit these
        instances.
    SolverError
        If no test instance could be bounded.
    """
    if not split.train or not split.test:
        raise InputError(f"{len(split.train)} training and {len(split.test)} test instances; both are needed")
    given = {} if preferences is None else {GIVEN: PostDecisionPricing(choice=preferences)}
    for policy in given.values():
        simulate([*split.train, *split.validation, *split.test], policy)  # does it know their groups and places?
    tell: Progress = progress if progress is not None else lambda *_: None
    seconds: dict[str, float] = {}

    def timed(stage: str, started: float) -> float:
        now = time.perf_counter()
        seconds[stage] = round(now - started, 3)
        return now

    clock = time.perf_counter()
    pp = tune_reward_percentage(split.train, progress=lambda k, n: tell("tuning PP", k, n))
    clock = timed("tune PP", clock)
    bare = any(one.features.shape[1] == 0 for one in (*split.train, *split.test))
    fp = None if bare else tune_formula(split.train, progress=lambda k, n: tell("tuning FP", k, n))
    clock = timed("tune FP", clock)
    kept, bounds, failures, worst = proven_bounds(split.test, tell)
    tests = [split.test[i] for i in kept]
    clock = timed("bounds", clock)
    learned, unlearned = _learn(split.train, tests, seed, tell)
    clock = timed("learn", clock)
    trained, untrained = _train(split, tests, learned.get(REESTIMATED), preferences, seed, tell)
    clock = timed("train", clock)
    pricing = {"Myopic, true MNL": PostDecisionPricing()}
    pricing |= {name: PostDecisionPricing(choice=found.preferences) for name, found in learned.items()}
    pricing |= given
    pricing |= {name: found.policy for name, found in trained.items()}
    tuned: dict[str, Policy] = {"PP": pp.policy} if fp is None else {"FP": fp.policy, "PP": pp.policy}
    policies: dict[str, Policy] = {**pricing, **tuned}
    comparison = compare(tests, policies, bounds, labels=kept)
    clock = timed("simulate", clock)
    verification = verify_pricing(
        tests, list(pricing.values()), sample=verify, seed=seed, progress=lambda k, n: tell("verifying", k, n)
    )
    timed("verify", clock)
    record = {
        "origin": origin,
        "tuned": {name: vars(policy) for name, policy in sorted(tuned.items(), reverse=True)},
        "not tuned": {"FP": NO_DISTANCE} if bare else {},
        "instances": {part: len(getattr(split, part)) for part in Split._fields},
        "learned": {name: _rounds(found) for name, found in learned.items()},
        "not learned": unlearned,
        "trained": {name: {"settings": found.settings, "rounds": found.record} for name, found in trained.items()},
        "not trained": untrained,
        "verify": {"sample": verify, "seed": seed, "policies": list(pricing)},
        "seconds": seconds,
        "versions": versions(),
    }
    return RunResult(comparison, verification, worst, failures, record)


def _learn(
    train: Sequence[Instance], tests: Sequence[Instance], seed: int, tell: Progress
) -> tuple[dict[str, Learned], dict[str, str]]:
    """Learn from the paper's data and by re-estimation; with several groups also one model for all.

    What cannot be learned from these instances, or does not know the places of the tests, comes second, with the
    reason: the other policies go on.
    """
    learned: dict[str, Learned] = {}
    failures: dict[str, str] = {}
    ways: dict[str, Callable[[], Learned]] = {
        ONCE: lambda: learn_once(train, seed=seed),
        REESTIMATED: lambda: learn_preferences(
            train, seed=seed, begun=learned.get(ONCE), progress=lambda k, n: tell("learning", k, n)
        ),
    }
    if max(one.n_groups for one in train) > 1:
        ways["Single MNL, re-estimated"] = lambda: learn_preferences(train, seed=seed, pooled=True)
    for name, learn in ways.items():
        try:
            found = learn()
            simulate(tests, PostDecisionPricing(choice=found.preferences))  # does it know the places of the tests?
        except OptkitError as error:
            failures[name] = str(error)
        else:
            learned[name] = found
    return learned, failures


def _train(
    split: Split,
    tests: Sequence[Instance],
    learned: Learned | None,
    preferences: Preferences | None,
    seed: int,
    tell: Progress,
) -> tuple[dict[str, Trained], dict[str, str]]:
    """Train value functions; one that comes to nothing, or does not know the tests, comes second with the reason."""
    trained, failures = {}, {}
    rounds = len(TrainingSettings().deviations)
    trainings = TRAININGS if preferences is None else {**TRAININGS, "Linear, given MNL": ("linear", preferences)}
    for number, (name, (value, choice)) in enumerate(trainings.items()):

        def tell_round(done: int, _: int, before: int = number * rounds) -> None:
            tell("training", before + done, len(trainings) * rounds)

        try:
            known = learned if choice == "learned" else None
            found = train(split, value, choice=choice, learned=known, seed=seed, progress=tell_round)
            simulate(tests, found.policy)  # does it know the steps and places of the tests?
        except OptkitError as error:
            failures[name] = str(error)
            tell_round(rounds, rounds)
        else:
            trained[name] = found
    return trained, failures


def _rounds(learned: Learned) -> dict[str, Any]:
    rows = [{str(name): value for name, value in row.items()} for row in learned.rounds.to_dict(orient="records")]
    rows = [{"fit_converged" if name == "converged" else name: x for name, x in row.items()} for row in rows]
    return {"within_tolerance": learned.converged, "tolerance": learned.tolerance, "rounds": rows}
