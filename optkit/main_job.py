"""The main job: instances, tuned benchmarks, policies, bounds and verified prices, in one results folder."""

from __future__ import annotations

import io
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from optkit import __version__
from optkit.bounds import full_information
from optkit.bounds.bound import prove
from optkit.collection import collect
from optkit.comparison import Comparison, compare
from optkit.errors import InputError, OptkitError, SolverError
from optkit.instance import Instance
from optkit.learning import Learned, learn_once, learn_preferences
from optkit.plain import to_json
from optkit.plots import box_plot, figure_bytes
from optkit.policies import PostDecisionPricing
from optkit.publish import foreign_entry, publish, set_aside, writable_parent
from optkit.scenarios import Split
from optkit.simulator import Policy
from optkit.tuning import tune_formula, tune_reward_percentage
from optkit.verification import Verification, verify_pricing

FORMAT = "optkit-run"
Progress = Callable[[str, int, int], object]
"""Called with the name of the stage, the number of things done in it and their total."""


@dataclass(frozen=True)
class RunResult:
    """What the main job found.

    Attributes
    ----------
    comparison : Comparison
        Policies on the test instances against the full-information bound.
    verification : Verification
        Checks of the pricing policy's decisions on the test instances.
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
    split: Split, origin: dict[str, Any], *, verify: int = 60, seed: int = 0, progress: Progress | None = None
) -> RunResult:
    """Tune the benchmarks on training instances, then run, bound and verify on the test instances.

    Parameters
    ----------
    split : Split
        Training instances for the grid searches of PP and FP; test instances for everything that is reported.
    origin : dict
        Where the instances come from, as plain data; kept in the record.
    verify : int
        Number of pricing decisions to solve again with CVXPY.
    seed : int
        Chooses these decisions.
    progress : callable, optional
        Called with stage, done and total.

    Raises
    ------
    InputError
        If there are no training or no test instances, or ``verify`` is negative.
    SolverError
        If no test instance could be bounded.
    """
    if not split.train or not split.test:
        raise InputError(f"{len(split.train)} training and {len(split.test)} test instances; both are needed")
    tell: Progress = progress if progress is not None else lambda *_: None
    seconds: dict[str, float] = {}

    def timed(stage: str, started: float) -> float:
        now = time.perf_counter()
        seconds[stage] = round(now - started, 3)
        return now

    clock = time.perf_counter()
    pp = tune_reward_percentage(split.train, progress=lambda k, n: tell("tuning PP", k, n))
    clock = timed("tune PP", clock)
    fp = tune_formula(split.train, progress=lambda k, n: tell("tuning FP", k, n))
    clock = timed("tune FP", clock)
    kept, bounds, failures, worst = [], [], {}, 0.0
    for i, one in enumerate(split.test):
        try:
            bound = full_information(one)
            worst = max(worst, prove(bound, one).gap)
        except SolverError as error:
            failures[i] = str(error)
        else:
            kept.append(i)
            bounds.append(bound)
        tell("bounding", i + 1, len(split.test))
    if not bounds:
        raise SolverError(f"none of {len(split.test)} test instances could be bounded; the first: {failures[0]}")
    tests = [split.test[i] for i in kept]
    clock = timed("bounds", clock)
    learned, unlearned = _learn(split.train, tests, seed, tell)
    clock = timed("learn", clock)
    beliefs = {name: PostDecisionPricing(choice=found.preferences) for name, found in learned.items()}
    policies: dict[str, Policy] = {"Myopic, true MNL": PostDecisionPricing(), **beliefs}
    comparison = compare(tests, policies | {"FP": fp.policy, "PP": pp.policy}, bounds, labels=kept)
    clock = timed("simulate", clock)
    verification = verify_pricing(tests, sample=verify, seed=seed, progress=lambda k, n: tell("verifying", k, n))
    timed("verify", clock)
    record = {
        "origin": origin,
        "tuned": {"PP": vars(pp.policy), "FP": vars(fp.policy)},
        "instances": {part: len(getattr(split, part)) for part in Split._fields},
        "learned": {name: _last_round(found) for name, found in learned.items()},
        "not learned": unlearned,
        "verify": {"sample": verify, "seed": seed},
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
    ways: dict[str, Callable[[], Learned]] = {
        "Learned MNL, paper's data": lambda: learn_once(train, seed=seed),
        "Learned MNL, re-estimated": lambda: learn_preferences(
            train, seed=seed, progress=lambda k, n: tell("learning", k, n)
        ),
    }
    if max(one.n_groups for one in train) > 1:
        ways["Single MNL, re-estimated"] = lambda: learn_preferences(train, seed=seed, pooled=True)
    learned, failures = {}, {}
    for name, learn in ways.items():
        try:
            found = learn()
            collect(tests, PostDecisionPricing(choice=found.preferences))  # does it know the places of the tests?
        except OptkitError as error:
            failures[name] = str(error)
        else:
            learned[name] = found
    return learned, failures


def _last_round(learned: Learned) -> list[dict[str, Any]]:
    rounds = learned.rounds
    rows = rounds[rounds["round"] == rounds["round"].max()].to_dict(orient="records")
    return [{str(name): value for name, value in row.items()} for row in rows]


def versions() -> dict[str, str]:
    """Versions of optkit, Python and the packages that the numbers depend on."""
    packages = ("numpy", "scipy", "cvxpy", "clarabel", "highspy")
    return {"optkit": __version__, "python": platform.python_version()} | {p: metadata.version(p) for p in packages}


FILES = ("summary.json", "table.csv", "per_instance.parquet", "performance_ratio.png", "performance_ratio.pdf")
"""What a results folder holds."""


def check_target(folder: str | os.PathLike[str], origin: dict[str, Any] | None = None) -> bool:
    """Return whether results are there that may be replaced; call it before the work, not after.

    Parameters
    ----------
    folder : path
        The results folder.
    origin : dict, optional
        Where the instances come from; results of another origin are not replaced.

    Raises
    ------
    InputError
        If the folder holds anything but results of an earlier run of the same origin, or cannot be made.
    """
    target, remedy = Path(folder), "choose another folder with --out"
    aside = set_aside(target)
    if aside is not None:
        raise InputError(f"{folder} is missing: writing was interrupted; the old results are {aside}: move them back")
    if not target.exists():
        if not writable_parent(target):
            raise InputError(f"{folder} cannot be written: {remedy}")
        return False
    found = _summary(target)
    if found is None:
        raise InputError(f"{folder} exists and holds no results of optkit run: {remedy}")
    foreign = foreign_entry(target, FILES)
    if foreign is not None:
        raise InputError(f"{folder} also holds {foreign!r}: move that away, or {remedy}")
    if origin is not None and found.get("record", {}).get("origin") != json.loads(to_json(origin)):
        raise InputError(f"{folder} holds results of other instances or settings: {remedy}")
    return True


def write_results(folder: str | os.PathLike[str], result: RunResult, title: str) -> Path:
    """Write a results folder, whole or not at all; an earlier run's results in that place are replaced.

    ``summary.json`` (everything but the rows), ``table.csv``, ``per_instance.parquet``, and the box plot of performance
    ratios as ``performance_ratio.png`` and ``.pdf``.

    Raises
    ------
    InputError
        If the folder exists and does not hold results of an earlier run.
    OptkitError
        If the disk refuses.
    """
    replacing = check_target(folder)
    rows = io.BytesIO()
    result.comparison.per_instance.to_parquet(rows, index=False)
    axes = box_plot(result.comparison.ratios(), title=title)
    contents = {
        "summary.json": (to_json({"format": FORMAT, **result.to_dict()}) + "\n").encode(),
        "table.csv": result.comparison.table.to_csv(index=False).encode(),
        "per_instance.parquet": rows.getvalue(),
        "performance_ratio.png": figure_bytes(axes, "png"),
        "performance_ratio.pdf": figure_bytes(axes, "pdf"),
    }
    try:
        publish(Path(folder).resolve(), contents, replacing)
    except OSError as error:
        why = error.strerror or str(error)
        raise OptkitError(f"{folder} cannot be written ({why}); choose another with --out") from error
    return Path(folder)


def _summary(folder: Path) -> dict[str, Any] | None:
    """Return the summary of an earlier run, or None if there is none."""
    try:
        found = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("format") == FORMAT else None
