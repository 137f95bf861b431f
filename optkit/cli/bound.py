"""``optkit bound``: upper bounds for a folder of instances."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.cli.console import print_table, progress_bar
from optkit.cli.options import Json, Quiet
from optkit.errors import InputError, InstanceError, OptkitError, SolverError

if TYPE_CHECKING:
    from optkit.instance import Instance


def bound(
    folder: Annotated[Path, typer.Argument(help="Folder of an instance set, written by optkit generate.")],
    method: Annotated[str | None, typer.Option(help="lp, milp or assignment; the fastest by default.")] = None,
    time_limit: Annotated[float | None, typer.Option(help="Seconds per instance.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; 0 means one per core.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Also write the rows to this .csv or .parquet file.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Bound every instance of a set with full information, and check every certificate.

    An instance whose solver gave up is reported with the reason and without a bound; the exit status is then 1.
    """
    from optkit.plain import to_json
    from optkit.publish import writable_parent
    from optkit.splits import PARTS, has_parts
    from optkit.storage import load_instances

    if jobs < 0:
        raise InputError(f"--jobs {jobs} is negative; 0 means one process per core")
    if out is not None and (out.suffix not in (".csv", ".parquet") or out.is_dir()):
        raise InputError(f"--out {out} must be a file that ends in .csv or .parquet")
    if out is not None and not (out.resolve().parent.is_dir() and writable_parent(out)):
        raise InputError(f"--out {out} cannot be written: its folder does not exist, or may not be written to")
    if folder.is_dir() and has_parts(folder):
        parts = [part for part in PARTS if (folder / part).is_dir()]
        raise InputError(
            f"{folder} holds the sets {', '.join(parts)}: name one of them, for example {folder / parts[-1]}"
        )
    instances = load_instances(folder)
    rows: list[dict[str, Any]] = []
    with progress_bar(quiet or as_json) as tell:
        for row in _bound_all(instances, method, time_limit, jobs or os.cpu_count() or 1):
            rows.append({"instance": len(rows), **row})
            tell("bounding", len(rows), len(instances))
    failed = [row for row in rows if row["bound"] is None]
    if as_json:
        typer.echo(to_json({"folder": str(folder), "bounds": rows}))
    else:
        _print(folder, rows, failed)
    if out is not None:
        _write(rows, out)
    if failed:
        raise typer.Exit(1)


def _bound_all(
    instances: list[Instance], method: str | None, time_limit: float | None, jobs: int
) -> Iterator[dict[str, Any]]:
    """Yield a row per instance, in order; a worker process that is killed is an error of ours."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    pool = Parallel(n_jobs=max(1, min(jobs, len(instances))), return_as="generator")
    try:
        yield from pool(delayed(_bound_one)(one, method, time_limit) for one in instances)
    except TerminatedWorkerError as error:
        raise SolverError("a worker process was killed, perhaps for want of memory: take fewer --jobs") from error


def _bound_one(instance: Instance, method: str | None, time_limit: float | None) -> dict[str, Any]:
    from optkit.bounds import full_information
    from optkit.bounds.bound import prove

    base = {"requests": instance.n_requests, "workers": instance.n_workers, "penalty": float(instance.penalty.sum())}
    nothing = {"bound": None, "gap": None, "method": method, "seconds": None}
    try:
        found = full_information(instance, method, time_limit=time_limit)  # type: ignore[arg-type]
        verdict = prove(found, instance)
    except (SolverError, InstanceError) as error:
        return {**base, **nothing, "error": str(error)}
    solver = found.solver
    checked = {"bound": found.value, "gap": verdict.gap, "method": solver.method, "seconds": solver.seconds}
    return {**base, **checked, "error": None}


def _write(rows: list[dict[str, Any]], out: Path) -> None:
    import pandas as pd

    frame = pd.DataFrame(rows)
    staging = out.with_name(f".{out.name}.tmp")
    try:
        frame.to_csv(staging, index=False) if out.suffix == ".csv" else frame.to_parquet(staging, index=False)
        os.replace(staging, out)
    except OSError as error:
        staging.unlink(missing_ok=True)
        raise OptkitError(f"{out} cannot be written ({error.strerror or error})") from error


def _print(folder: Path, rows: list[dict[str, Any]], failed: list[dict[str, Any]]) -> None:
    good = [row for row in rows if row["bound"] is not None]
    shown = [
        [str(row["instance"]), str(row["requests"]), str(row["workers"]), f"{row['bound']:.4f}", f"{row['gap']:.1e}"]
        for row in good[:20]
    ]
    if len(good) > 20:
        shown.append([f"and {len(good) - 20} more", "", "", "", ""])
    if not rows:
        typer.echo(f"{folder} holds no instances: there is nothing to bound")
        return
    print_table(f"full information: {folder}", ["instance", "requests", "workers", "bound", "certified gap"], shown)
    if good:
        mean = sum(row["bound"] for row in good) / len(good)
        worst = max(row["gap"] for row in good)
        typer.echo(f"mean bound {mean:.4f} over {len(good)} instances; certificates checked, largest gap {worst:.1e}")
    for row in failed:
        typer.echo(f"instance {row['instance']}: no bound: {row['error']}")
