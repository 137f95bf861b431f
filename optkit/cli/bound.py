"""``optkit bound``: upper bounds for a folder of instances."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.basics.errors import InputError, InstanceError, SolverError
from optkit.basics.seeds import Stream, stream
from optkit.cli.console import print_table, progress_bar, say, say_json
from optkit.cli.options import Jobs, Json, Quiet
from optkit.cli.output import ROWS, write_rows

if TYPE_CHECKING:
    from optkit.bounds.penalised.foresight import Foresight
    from optkit.gap.charging import Charging
    from optkit.instances.instance import Instance
    from optkit.instances.scenario import Scenario
    from optkit.models.value.request_sets import SetValue

METHODS: dict[str, tuple[str, ...]] = {
    "full": ("assignment", "lp", "milp"),
    "arrival": ("exact", "hybrid", "lagrangian", "program"),
    "penalised": (),
    "fluid": (),
}
"""Kinds of bounds, and the methods of each."""

FLUID_TOLERANCE = 1e-5
"""Relative gap at which the fluid bound's dual is left; it holds at any."""


def bound(
    folder: Annotated[Path, typer.Argument(help="Folder of an instance set, written by optkit generate.")],
    kind: Annotated[
        str,
        typer.Option(
            help="full (information), arrival (information), penalised or fluid: sets drawn from a scenario only."
        ),
    ] = "full",
    method: Annotated[
        str | None,
        typer.Option(
            help="full: assignment, lp or milp; arrival: exact, hybrid, lagrangian or program. "
            "The fastest, or the tightest that the size allows, by default."
        ),
    ] = None,
    time_limit: Annotated[float | None, typer.Option(help="Seconds per instance; with --kind full.")] = None,
    jobs: Jobs = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="Keep each bound in this folder; the same command goes on from there."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Also write the rows to this .csv or .parquet file.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Bound every instance of a set, and check every certificate.

    Full information bounds what can be earned on the instance as it is. Arrival information bounds the mean over the
    workers' noise, and is tighter. A penalised bound holds in the mean over instances only, and is the tightest; its
    charges are trained on further instances of the scenario that scenario.json names. The fluid bound is one number for
    that scenario, from expected numbers of requests and workers; its certificate is checked too.

    An instance whose solver gave up is reported with the reason and without a bound; the exit status is then 1.
    """
    from optkit.basics.keeper import Form, KeptRows, work_key
    from optkit.basics.parallel import check_jobs, in_parallel
    from optkit.instances.digest import exact_digest
    from optkit.instances.splits import PARTS, has_parts
    from optkit.instances.storage import load_instances, read_description

    jobs = None if jobs is None else check_jobs(jobs, "--jobs")
    kind = "penalised" if kind == "penalized" else kind
    _check_options(kind, method, time_limit)
    if out is not None:
        ROWS.check(out)
    if folder.is_dir() and has_parts(folder):
        parts = [part for part in PARTS if (folder / part).is_dir()]
        raise InputError(
            f"{folder} holds the sets {', '.join(parts)}: name one of them, for example {folder / parts[-1]}"
        )
    instances = load_instances(folder)
    source = read_description(folder)["scenario"]
    if kind == "fluid":
        if checkpoint is not None:
            raise InputError("--checkpoint goes with a bound for each instance; --kind fluid is one for all")
        rows = [_fluid_row(_drawn_again(folder, source, kind))]
        _tell(folder, kind, rows, out, as_json)
        return
    key = work_key(exact_digest(instances), kind, method, time_limit, source if kind == "penalised" else None)
    form = Form("optkit bounds", 1, "a file of optkit bound --checkpoint", "choose another folder with --checkpoint")
    log = KeptRows(None if checkpoint is None else checkpoint / f"bounds-{key[:16]}.jsonl", form, key)
    missing = log.missing(range(len(instances)))
    found = dict(log.rows)
    with progress_bar(quiet or as_json) as tell:
        charging = None
        if kind == "penalised" and missing:
            charging = _charging(folder, _drawn_again(folder, source, kind), instances)
        hands = None if charging is None else charging.foresight.dealt(len(instances))
        tasks = [(i, instances[i], None if hands is None else hands[i]) for i in missing]
        value = None if charging is None else charging.value
        solve = partial(_bound_one, kind=kind, method=method, time_limit=time_limit, value=value)
        for position, row in in_parallel(solve, tasks, jobs):
            if row["error"] is None:  # what failed is tried again
                log.add(missing[position], row)
            found[missing[position]] = row
            tell("bounding", len(found), len(instances))
    rows = [{"instance": i, **found[i], "checked": i not in log.found} for i in range(len(instances))]
    _tell(folder, kind, rows, out, as_json)
    if any(row["bound"] is None for row in rows):
        raise typer.Exit(1)


def _tell(folder: Path, kind: str, rows: list[dict[str, Any]], out: Path | None, as_json: bool) -> None:
    if as_json:
        say_json({"folder": str(folder), "kind": kind, "bounds": rows})
    elif kind == "fluid":
        _print_fluid(folder, rows[0])
    else:
        _print(folder, kind, rows)
    if out is not None:
        import pandas as pd

        write_rows(pd.DataFrame(rows), out)


def _check_options(kind: str, method: str | None, time_limit: float | None) -> None:
    if kind not in METHODS:
        raise InputError(f"--kind {kind} is unknown; there are {', '.join(METHODS)}")
    if method is not None and method not in METHODS[kind]:
        known = f"there are {', '.join(METHODS[kind])}" if METHODS[kind] else "there is but one"
        raise InputError(f"--method {method} is no method of --kind {kind}; {known}")
    if time_limit is not None and kind != "full":
        raise InputError(f"--time-limit goes with --kind full, not with {kind}")


def _drawn_again(folder: Path, description: dict[str, Any], kind: str) -> Scenario:
    """The scenario that a set says it was drawn from."""
    from optkit.instances.catalogue import scenario_of

    source = scenario_of(description)
    if source is None:
        other = "optkit certify with --worker-rate, or " if kind == "penalised" else ""
        raise InputError(
            f"--kind {kind}: scenario.json of {folder} names no scenario that can be drawn from again (scenarios "
            f"with trips need their trips): take {other}--kind arrival"
        )
    return source


def _charging(folder: Path, source: Scenario, instances: list[Instance]) -> Charging:
    """What to charge with, if the instances do not contradict that they are from the scenario."""
    from optkit.gap.charging import scenario_charging
    from optkit.gap.process_tests import process_tests

    charging = scenario_charging(source)
    for refused in process_tests(instances, charging.foresight)[0]:
        raise InputError(f"--kind penalised: {folder} is not from the scenario that it names: {refused}")
    return charging


def _fluid_row(source: Scenario) -> dict[str, Any]:
    """The fluid bound of a scenario, proven, with expected numbers in place of an instance's."""
    from optkit.bounds.bound import prove
    from optkit.bounds.fluid.bound import fluid_bound
    from optkit.gap.fluid_scenario import fluid_model

    model = fluid_model(source)
    found = fluid_bound(model, tolerance=FLUID_TOLERANCE)
    return {
        "instance": None,
        "requests": float(model.count.sum()),
        "workers": float(model.presence.sum()),
        "penalty": float(model.count @ model.penalty),
        "bound": found.value,
        "gap": prove(found, model).gap,
        "method": found.solver.method,
        "seconds": found.solver.seconds,
        "error": None,
        "checked": True,
    }


def _print_fluid(folder: Path, row: dict[str, Any]) -> None:
    headings = ["expected requests", "expected workers", "bound", "certified gap"]
    shown = [f"{row['requests']:.4f}", f"{row['workers']:.4f}", f"{row['bound']:.4f}", f"{row['gap']:.1e}"]
    print_table(f"fluid bound of the scenario: {folder}", headings, [shown])
    say("no policy earns more in the mean over instances of the scenario; certificate checked")


def _bound_one(
    task: tuple[int, Instance, Foresight | None],
    kind: str,
    method: str | None,
    time_limit: float | None,
    value: SetValue | None,
) -> dict[str, Any]:
    from optkit.bounds import arrival_information, full_information, penalized
    from optkit.bounds.bound import prove

    number, instance, foresight = task
    base = {"requests": instance.n_requests, "workers": instance.n_workers, "penalty": float(instance.penalty.sum())}
    nothing = {"bound": None, "gap": None, "method": method, "seconds": None}
    try:
        if value is not None and foresight is not None:
            seed = stream(0, Stream.CHARGES, number)
            found = penalized(instance, value, foresight, seed=seed)
        elif kind == "arrival":
            found = arrival_information(instance, method)  # type: ignore[arg-type]
        else:
            found = full_information(instance, method, time_limit=time_limit)  # type: ignore[arg-type]
        verdict = prove(found, instance)
    except (SolverError, InstanceError) as error:
        return {**base, **nothing, "error": str(error)}
    solver = found.solver
    checked = {"bound": found.value, "gap": verdict.gap, "method": solver.method, "seconds": solver.seconds}
    return {**base, **checked, "error": None}


def _print(folder: Path, kind: str, rows: list[dict[str, Any]]) -> None:
    from optkit.simulation.metrics import mean_interval

    failed = [row for row in rows if row["bound"] is None]
    good = [row for row in rows if row["bound"] is not None]
    shown = [
        [str(row["instance"]), str(row["requests"]), str(row["workers"]), f"{row['bound']:.4f}", f"{row['gap']:.1e}"]
        for row in good[:20]
    ]
    if len(good) > 20:
        shown.append([f"and {len(good) - 20} more", "", "", "", ""])
    if not rows:
        say(f"{folder} holds no instances: there is nothing to bound")
        return
    title = "penalised arrival" if kind == "penalised" else kind
    print_table(f"{title} information: {folder}", ["instance", "requests", "workers", "bound", "certified gap"], shown)
    if good:
        mean = mean_interval([row["bound"] for row in good])
        worst = max(row["gap"] for row in good)
        kept = sum(not row["checked"] for row in good)
        proofs = (
            f"{len(good) - kept} certificates checked, {kept} bounds kept from before"
            if kept
            else "certificates checked"
        )
        say(f"mean bound {mean.mean:.4f} over {len(good)} instances; {proofs}, largest gap {worst:.1e}")
        if kind == "penalised":
            spread = f" [{mean.low:.2f}, {mean.high:.2f}]" if len(good) > 1 else ""
            say(f"only the mean is a bound{spread}: single values may lie above or below what a policy earns")
    for row in failed:
        say(f"instance {row['instance']}: no bound: {row['error']}")
