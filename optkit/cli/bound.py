"""``optkit bound``: upper bounds for a folder of instances."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.cli.console import PARTS, print_table, progress_bar
from optkit.cli.options import Json, Quiet
from optkit.errors import InputError, OptkitError

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
    import pandas as pd
    from joblib import Parallel, delayed

    from optkit.storage import load_instances

    if jobs < 0:
        raise InputError(f"--jobs {jobs} is negative; 0 means one process per core")
    if out is not None and out.suffix not in (".csv", ".parquet"):
        raise InputError(f"--out {out} must end in .csv or .parquet")
    parts = [part for part in PARTS if (folder / part).is_dir()]
    if parts and not (folder / "scenario.json").exists():
        raise InputError(
            f"{folder} holds the sets {', '.join(parts)}: name one of them, for example {folder / parts[-1]}"
        )
    instances = load_instances(folder)
    pool = Parallel(n_jobs=jobs or os.cpu_count() or 1, return_as="generator")
    rows: list[dict[str, Any]] = []
    with progress_bar(quiet or as_json) as tell:
        for row in pool(delayed(_bound_one)(one, method, time_limit) for one in instances):
            rows.append({"instance": len(rows), **row})
            tell("bounding", len(rows), len(instances))
    if out is not None:
        _write(pd.DataFrame(rows), out)
    failed = [row for row in rows if row["bound"] is None]
    if as_json:
        typer.echo(json.dumps({"folder": str(folder), "bounds": rows}, indent=1))
    else:
        _print(folder, rows, failed)
    if failed:
        raise typer.Exit(1)


def _bound_one(instance: Instance, method: str | None, time_limit: float | None) -> dict[str, Any]:
    from optkit.bounds import full_information
    from optkit.errors import SolverError

    base = {"requests": instance.n_requests, "workers": instance.n_workers, "penalty": float(instance.penalty.sum())}
    try:
        found = full_information(instance, method, time_limit=time_limit)  # type: ignore[arg-type]
    except SolverError as error:
        return {**base, "bound": None, "gap": None, "method": method, "seconds": None, "error": str(error)}
    verdict = found.certificate.check(instance)
    solver = found.solver
    checked = {"bound": verdict.bound, "gap": verdict.gap, "method": solver.method, "seconds": solver.seconds}
    return {**base, **checked, "error": None}


def _write(frame: Any, out: Path) -> None:
    try:
        frame.to_csv(out, index=False) if out.suffix == ".csv" else frame.to_parquet(out, index=False)
    except OSError as error:
        raise OptkitError(f"{out} cannot be written ({error.strerror or error})") from error


def _print(folder: Path, rows: list[dict[str, Any]], failed: list[dict[str, Any]]) -> None:
    good = [row for row in rows if row["bound"] is not None]
    shown = [
        [str(row["instance"]), str(row["requests"]), str(row["workers"]), f"{row['bound']:.4f}", f"{row['gap']:.1e}"]
        for row in good[:20]
    ]
    if len(good) > 20:
        shown.append([f"and {len(good) - 20} more", "", "", "", ""])
    print_table(f"full information: {folder}", ["instance", "requests", "workers", "bound", "certified gap"], shown)
    if good:
        mean = sum(row["bound"] for row in good) / len(good)
        worst = max(row["gap"] for row in good)
        typer.echo(f"mean bound {mean:.4f} over {len(good)} instances; certificates checked, largest gap {worst:.1e}")
    for row in failed:
        typer.echo(f"instance {row['instance']}: no bound: {row['error']}")
