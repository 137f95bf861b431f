"""The gap report: how far policies are from optimal, with proof; its arithmetic is in :mod:`optkit.gap.tables`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Known, flag, number, whole_number
from optkit.basics.errors import InputError, SolverError
from optkit.basics.keeper import Form, KeptRows
from optkit.basics.memory import check_memory
from optkit.basics.parallel import check_jobs, in_parallel
from optkit.basics.plain_json import to_json
from optkit.basics.seeds import Stream, check_seed
from optkit.basics.version import __version__
from optkit.bounds.arrival.exact import check_limit
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.bounds.penalised.penalized import LIMIT
from optkit.gap.charge_tests import charge_test
from optkit.gap.charging import scenario_charging, scenario_linear_charges
from optkit.gap.policy_digest import policy_digest
from optkit.gap.process_tests import process_tests
from optkit.gap.rows import BOUND_KINDS, CHARGED, GapTask, Kind, gap_row
from optkit.gap.tables import gap_tables
from optkit.instances.digest import exact_digest, refuse_repeated
from optkit.instances.instance import Instance
from optkit.instances.scenario import Scenario
from optkit.instances.splits import held_out
from optkit.instances.world import OVERHEAD
from optkit.learning.beliefs import BelievedValue
from optkit.learning.worker_rates import WorkerRates
from optkit.models.value.request_sets import SetValue
from optkit.policies import PostDecisionPricing
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import Policy, named_policies, simulate

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

ROWS = Form("optkit rows", 1, "a checkpoint of optkit certify", "choose another checkpoint")

NOTES = {
    "money": "mean less the luck of the arrivals, as far as the best policy's charges tell it (a control variate); "
    "of gaps to the penalised bound, with what the policy was charged",
    "raw_money": "plain mean of the rows",
}
"""What the columns of money are, for who reads the plain data."""

POINTS = ("points", "half_width", "points_low", "points_high", "claim")
"""Columns that are NaN where nothing can be gained."""

SPREADS = (
    *("money_half_width", "raw_half_width", "half_width", "charge_half_width", "money_low", "money_high"),
    *("points_low", "points_high", "claim", "claim_money"),
)
"""Columns that are NaN for one instance."""

REDRAWS = 256
"""Draws of the noise where a policy must be simulated: their error is then small beside that of the instances."""


@dataclass(frozen=True)
class GapReport(Known):
    """How far policies are from optimal.

    All numbers are finite but for these, which are NaN: half-widths, ends of intervals and claims of one instance;
    points where nothing can be gained; ``smallest`` where no policy's value is exact.

    Attributes
    ----------
    bounds : DataFrame
        One row per bound, loosest first: ``kind``; its mean in ``money`` an instance and ``money_half_width``, without
        the luck of these arrivals as far as the best policy's charges tell it (a control variate; without a penalised
        bound there are no charges); ``raw_money`` and ``raw_half_width``, the plain mean of the rows; ``points`` of
        full information on these instances (100 is the full-information bound, 0 what is earned if all requests expire)
        and ``half_width``; mean ``seconds`` an instance; the largest ``certificate_gap`` and ``residual`` of all
        certificates (money); ``methods``.
    policies : DataFrame
        One row per policy, the same six figures; ``charge`` and ``charge_half_width``, whose mean must be zero within
        its error; on how many instances it is ``exact``.
    gaps : DataFrame
        One row per policy and bound: ``money``, ``points``, each with ``_low`` and ``_high``, and ``claim`` (points)
        with ``claim_money``: with the report's confidence, the policy is at most so far from optimal (one-sided);
        ``raw_money``, the plain mean of bound less reward, to which the penalised bound's ``money`` adds what the
        policy was charged; ``smallest``, the gap on the worst path where both are exact.
    rows : DataFrame
        One row per instance: what the plain means are made of.
    assumptions : tuple of str
        What the numbers rest on.
    failures : dict
        By instance, why a bound could not be proven; these are left out.
    confidence : float
        Of all intervals and claims.
    refused : tuple of str
        Why there is no penalised bound though it was asked for: what the instances contradict.
    """

    bounds: pd.DataFrame
    policies: pd.DataFrame
    gaps: pd.DataFrame
    rows: pd.DataFrame
    assumptions: tuple[str, ...]
    failures: dict[int, str]
    confidence: float
    refused: tuple[str, ...] = ()

    def columns_lacking(self, table: str) -> list[str]:
        """Columns of a table that may hold NaN, as said above."""
        points = [*POINTS] if self.gaps["points"].isna().all() else []
        return ["smallest", *points, *(SPREADS if len(self.rows) == 1 else [])]

    @property
    def best_bound(self) -> str:
        """Kind of the bound with the least mean gap to the best policy."""
        gaps = self.gaps[self.gaps["policy"] == self.best_policy]
        return str(gaps["bound"].iloc[int(gaps["money"].to_numpy().argmin())])

    @property
    def best_policy(self) -> str:
        """Name of the policy with the highest mean."""
        return str(self.policies["policy"].iloc[int(self.policies["money"].to_numpy().argmax())])

    def gap(self, policy: str | None = None, bound: str | None = None) -> dict[str, Any]:
        """One row of :attr:`gaps`, the best policy's to the best bound unless told otherwise.

        Raises
        ------
        InputError
            If there is no such policy or bound.
        """
        policy, bound = policy or self.best_policy, bound or self.best_bound
        found = self.gaps[(self.gaps["policy"] == policy) & (self.gaps["bound"] == bound)]
        if found.empty:
            raise InputError(f"no gap of policy {policy!r} to bound {bound!r} in this report")
        return {str(name): entry for name, entry in found.iloc[0].to_dict().items()}

    def claim(self, policy: str | None = None) -> str:
        """Say in a sentence how far a policy is from optimal, the best by default."""
        row = self.gap(policy)
        if len(self.rows) < 2:
            return f"{row['policy']}: one instance allows no claim"
        money = f"{row['claim_money']:.2f} money an instance"
        far = f"{row['claim']:.2f} points ({money})" if isfinite(row["claim"]) else money
        return f"with {100 * self.confidence:g} % confidence, {row['policy']} is at most {far} from optimal"

    def __repr__(self) -> str:
        return f"GapReport({len(self.rows)} instances, bounds {', '.join(self.bounds['kind'])}: {self.claim()})"

    def _repr_html_(self) -> str:
        from html import escape

        tables = (one.to_html(max_rows=20, index=False) for one in (self.bounds, self.policies))
        return f"<p>{escape(self.claim())}</p>" + "".join(tables)

    def summary(self) -> str:
        """Return the report as text."""
        from optkit.gap.summary import report_text

        return report_text(self)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the per-instance rows, as plain data."""
        tables = {name: getattr(self, name).to_dict(orient="records") for name in ("bounds", "policies", "gaps")}
        return {
            **tables,
            "best": {"bound": self.best_bound, "policy": self.best_policy, "claim": self.claim()},
            "instances": len(self.rows),
            "notes": NOTES,
            "assumptions": list(self.assumptions),
            "refused": list(self.refused),
            "failures": self.failures,
            "confidence": self.confidence,
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw bounds and policies as a ladder (:func:`optkit.plotting.ladder.ladder_plot`)."""
        from optkit.plotting.ladder import ladder_plot

        return ladder_plot(self, ax=ax)


def gap_report(
    source: Scenario | Sequence[Instance],
    policies: Mapping[str, Policy],
    *,
    value: SetValue | None = None,
    foresight: Foresight | None = None,
    charges: LinearCharges | None = None,
    kinds: Sequence[str] | None = None,
    limit: int = LIMIT,
    redraws: int = REDRAWS,
    confidence: float = 0.95,
    assumptions: Sequence[str] = (),
    known_process: bool = False,
    learned: WorkerRates | None = None,
    others: Sequence[Instance] = (),
    seed: int = 0,
    n_jobs: int | None = 1,
    progress: Callable[[int, int], object] | None = None,
    checkpoint: str | Path | None = None,
) -> GapReport:
    """Measure how far policies are from optimal, against upper bounds whose certificates are checked.

    A penalised bound holds for one process, that of ``value`` and ``foresight``. Whether the instances come from it is
    tested on them (:mod:`optkit.gap.process_tests`); where they contradict it there is no penalised bound, and
    :attr:`GapReport.refused` says why.

    Parameters
    ----------
    source : Scenario or sequence of Instance
        A scenario stands for its test instances, and brings value and foresight
        (:func:`optkit.gap.charging.scenario_charging`). Instances should be independent draws; their noise is drawn
        here if it is not realised.
    policies : mapping from name to policy
        Anything that :func:`optkit.simulate` takes, if its offers depend on the state alone.
    value, foresight : SetValue, Foresight, optional
        For the penalised bound: any post-decision value function, and the distribution of the instances. Neither may
        have been made from these instances.
    charges : LinearCharges, optional
        For the penalised Lagrangian, which is for days on which dozens of requests wait at once: of
        :func:`optkit.bounds.penalised.charge_fit.fit_linear_charges`, fitted to other instances.
    kinds : sequence of {"full", "lagrangian", "penalised-lagrangian", "arrival", "penalised"}, optional
        Bounds to compute, see :data:`optkit.gap.rows.BOUND_KINDS`. Full information is always there; by default all
        but the penalised ones that need what is not given, and of a scenario's the penalised Lagrangian.
    limit : int
        Requests that the penalised bound tells apart, and up to which a policy is evaluated by enumeration. Time and
        memory double with each.
    redraws : int
        Draws of the noise where a policy must be simulated; those of one instance are in memory together.
    confidence : float
        Of intervals and claims.
    assumptions : sequence of str
        What you take for granted of the instances, to stand in the report.
    known_process : bool
        Whether the instances are known to be drawn from the process of the foresight: then it is not tested before,
        only by what policies are charged. A scenario's own instances are.
    learned : WorkerRates, optional
        What the foresight's workers were learned as: the tests then allow for what could not be learned.
    others : sequence of Instance
        Other days that the process is tested on too, as in :func:`optkit.gap.process_tests.process_tests`.
    seed : int
        Of the arrivals that might have come, of the noise, and of the tests.
    n_jobs : int or None
        Processes, 0 for one per core, None for as many as are worth it; the numbers do not depend on it.
    progress : callable, optional
        Called with the number of instances done, and their number.
    checkpoint : path, optional
        File in which each instance's row is kept as soon as it is there; a report that was interrupted goes on from it.
        Another report, by other instances, policies or settings, keeps its rows in a file of its own beside it.

    Returns
    -------
    GapReport
        Tables of bounds, policies and gaps, the claim, and what they rest on.

    Raises
    ------
    InputError
        If there are no instances or policies, an argument is out of range, or the penalised bound is asked for without
        value and foresight.
    PolicyError
        If a policy's offer is not feasible.
    SolverError
        If no instance could be bounded, or a policy earns more than a bound.

    Examples
    --------
    >>> from optkit import scenario
    >>> days = scenario("I.2", seed=0).sample(4, seed=1)
    >>> report = gap_report(days, {"myopic": PostDecisionPricing(), "half": lambda state: 0.5 * state.reward})
    >>> report.best_policy, report.best_bound, bool((report.gaps["money"] > 0).all())
    ('myopic', 'arrival', True)
    """
    flag("known_process", known_process)
    told = list(assumptions)
    if isinstance(source, Scenario):
        instances = held_out(source)
        told.insert(0, f"instances: the {len(instances)} of the test split of {source.name}, world {source.seed}")
        if value is None and foresight is None and (kinds is None or "penalised" in chosen_kinds(kinds)):
            charging = scenario_charging(source)
            value, foresight, known_process = charging.value, charging.foresight, True
            told += charging.assumptions
        if charges is None and kinds is not None and "penalised-lagrangian" in chosen_kinds(kinds):
            charges, known_process = scenario_linear_charges(source), True
            told.append("linear charges: fitted to the training split")
    else:
        instances = list(source)
    chosen = _checked(instances, policies, value, foresight, charges, kinds, limit, redraws, confidence, seed)
    jobs = None if n_jobs is None else check_jobs(n_jobs)
    refused: list[str] = []
    charge_for = [kind for kind in chosen if kind in CHARGED]
    assumed = foresight if "penalised" in chosen else charges.foresight if charges is not None else None
    if charge_for and assumed is not None and not known_process:
        refused, tested = process_tests(instances, assumed, learned=learned, others=others, seed=seed)
        told += tested
        if refused:
            chosen, value, foresight, charges = _free(chosen), None, None, None
    shared = {"policies": dict(policies), "kinds": chosen, "value": value, "charges": charges}
    sizes = {"limit": limit, "redraws": redraws, "seed": seed}
    hands = [None] * len(instances) if foresight is None else foresight.dealt(len(instances))
    tasks = [
        GapTask(number=i, instance=one, foresight=hand, **shared, **sizes)  # type: ignore[arg-type]
        for i, (one, hand) in enumerate(zip(instances, hands, strict=True))
    ]
    key = "" if checkpoint is None else _key(tasks, foresight)
    log = _kept(checkpoint, key)
    missing = log.missing(range(len(tasks)))
    if progress is not None:
        progress(len(tasks) - len(missing), len(tasks))
    for position, row in in_parallel(gap_row, [tasks[i] for i in missing], jobs):
        log.add(missing[position], row)
        if progress is not None:
            progress(len(log.rows), len(tasks))
    rows = {i: log.rows[i] for i in range(len(tasks))}
    failures = {i: str(row["error"]) for i, row in rows.items() if "error" in row}
    kept = {i: row for i, row in rows.items() if "error" not in row}
    if not kept:
        raise SolverError(f"none of {len(rows)} instances could be bounded; the first: {failures[0]}")
    charge_for = [kind for kind in chosen if kind in CHARGED]
    if charge_for:
        tested_charges = charge_test(
            kept, list(policies), charge_for, learned_from=None if learned is None else learned.days
        )
        if tested_charges.contradicted:
            refused.append(f"{tested_charges.told}, beyond its error: the process is not the one that was assumed")
            chosen = _free(chosen)
    told += _said(instances, kept, chosen, redraws, failures)
    if log.found:
        told.append(f"rows: {len(log.found)} of {len(rows)} are of {log.path}, proven when they were made, not again")
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused when the report is made
        tables = gap_tables(kept, list(policies), chosen, confidence)
    return GapReport(*tables, tuple(told), failures, confidence, tuple(refused))


def chosen_kinds(kinds: Sequence[str]) -> tuple[Kind, ...]:
    """Return bounds by name in order, loosest first, full information among them.

    Raises
    ------
    InputError
        If one is unknown.

    Examples
    --------
    >>> chosen_kinds(["arrival"])
    ('full', 'arrival')
    """
    wanted = {"penalised" if kind == "penalized" else kind for kind in ([kinds] if isinstance(kinds, str) else kinds)}
    for kind in wanted - set(BOUND_KINDS):
        raise InputError(f"no bound {kind!r}; there are {', '.join(BOUND_KINDS)}")
    return tuple(kind for kind in BOUND_KINDS if kind in wanted or kind == "full")


def _free(kinds: Sequence[Kind]) -> tuple[Kind, ...]:
    """Those that charge for nothing, and so rest on no process."""
    return tuple(kind for kind in kinds if kind not in CHARGED)


def _checked(
    instances: Sequence[Instance],
    policies: Mapping[str, Policy],
    value: SetValue | None,
    foresight: Foresight | None,
    charges: LinearCharges | None,
    kinds: Sequence[str] | None,
    limit: int,
    redraws: int,
    confidence: float,
    seed: int,
) -> tuple[Kind, ...]:
    """Check the arguments of a report; return the bounds to compute."""
    if not 0 < number("confidence", confidence) < 1:
        raise InputError(f"confidence = {confidence} is not between 0 and 1")
    named_policies(policies)
    if not instances or not policies:
        raise InputError("a gap report needs at least one instance and one policy")
    for b, one in enumerate(instances):
        if not isinstance(one, Instance):
            raise InputError(f"element {b} is a {type(one).__name__}, not an Instance")
    refuse_repeated(instances)
    check_limit(limit)
    check_seed(seed)
    whole_number("redraws", redraws, least=1)
    meet = [
        np.searchsorted(one.worker_step, one.expiry, "right") - np.searchsorted(one.worker_step, one.arrival)
        for one in instances
    ]
    most = max(int(pairs.sum()) for pairs in meet)
    # All draws of one instance are simulated at once.
    check_memory(f"{redraws:,} draws of the noise", redraws * (OVERHEAD + 8.0 * most), "take fewer redraws")
    able = value is not None and foresight is not None
    if kinds is None:
        if (value is None) != (foresight is None):
            raise InputError("a penalised bound needs both value and foresight: give both or neither")
        return tuple(k for k in BOUND_KINDS if able or k != "penalised" if charges or k != "penalised-lagrangian")
    chosen = chosen_kinds(kinds)
    if "penalised-lagrangian" in chosen and charges is None:
        raise InputError(
            "the penalised Lagrangian needs charges: pass a scenario, or fit them "
            "(optkit.bounds.penalised.charge_fit.fit_linear_charges)"
        )
    if "penalised" in chosen and not able:
        raise InputError(
            "the penalised bound needs value and foresight: pass a scenario, or make them with optkit.gap.charging"
        )
    return chosen


def _kept(checkpoint: str | Path | None, key: str) -> KeptRows:
    """Open the rows of a report; where the file holds another's, in a file beside it that the key names."""
    path = None if checkpoint is None else Path(checkpoint)
    try:
        return KeptRows(path, ROWS, key)
    except InputError:
        if path is None or not path.is_file():
            raise
        return KeptRows(path.with_name(f"{path.stem}-{key[:16]}{path.suffix}"), ROWS, key)


def _key(tasks: Sequence[GapTask], foresight: Foresight | None) -> str:
    """Return a digest of all that a report's rows consist of; policies and value function by what they are and do."""
    first = tasks[0]
    days = [
        one.instance if one.instance.noise is not None else one.instance.with_noise(one.stream(Stream.REPORT_OWN_NOISE))
        for one in tasks
    ]
    batch = Batch.of(days)
    acts: dict[str, Policy] = dict(first.policies)
    plain: list[Any] = [__version__, list(acts), first.kinds, first.limit, first.redraws, first.seed]
    seals = [exact_digest(days)]
    if (linear := first.charges) is not None:
        of = linear.foresight
        plain += [linear.theta.tolist(), linear.surplus_knots.tolist(), linear.time_knots.tolist()]
        plain += [linear.request_rate, of.presence.tolist(), of.share.tolist()]
    if first.value is not None and foresight is not None:
        acts["value of the charges"] = PostDecisionPricing(value_function=BelievedValue(first.value))
        f = foresight
        weight = None if f.weight is None else f.weight.tolist()
        plain += [f.presence.tolist(), f.share.tolist(), f.nothing, f.draws, weight]
        seals.append(exact_digest(f.arrivals))
    plain += [policy_digest(name, act) for name, act in acts.items()]
    # What they do tells of files and of compiled code that they use. Ten digits: another processor may round otherwise.
    plain += [[f"{reward:.10g}" for reward in simulate(batch, act).reward] for act in acts.values()]
    return hashlib.sha256(to_json(plain).encode() + b"".join(seals)).hexdigest()


def _said(
    instances: Sequence[Instance],
    kept: Mapping[int, dict[str, Any]],
    kinds: Sequence[str],
    redraws: int,
    failures: Mapping[int, str],
) -> list[str]:
    """What the report must say of how its numbers came about."""
    told = []
    exact = sum(all(one["exact"] for one in row["policies"].values()) for row in kept.values())
    ways = f"by enumeration on {exact} of {len(kept)} instances"
    if exact < len(kept):
        ways += f", with {redraws} draws of the noise on the others"
    told.append(f"policies: they look at the state alone; evaluated {ways}")
    drawn = sum(one.noise is None for one in instances)
    if drawn:
        told.append(f"noise: drawn here for {drawn} instances, for the full-information bound")
    if any(kind in CHARGED for kind in kinds):
        told.append(
            "money: without the luck of the arrivals, as far as the best policy's charges tell it, a control variate; "
            "raw: the plain mean of the rows; points: with the luck; gaps to a penalised bound: with the policy's own "
            "charges"
        )
    if failures:
        told.append(f"WARNING: {len(failures)} instances without a proven bound are left out, which may bias the means")
    told.append("intervals: instances are taken to be independent draws; Student's, by the delta method for points")
    return told
