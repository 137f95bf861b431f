"""``optkit run``: the main job."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.cli.console import open_source, print_table, progress_bar, read_split
from optkit.cli.options import Fraction, Json, Mode, Quiet, Seed, Setting, Trips

if TYPE_CHECKING:
    from optkit.main_job import RunResult


def run(
    source: Annotated[str, typer.Argument(help="A scenario (I.1, I.2, I.3, II, nyc-weak, nyc-strong) or a folder.")],
    seed: Seed = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    verify: Annotated[int, typer.Option(help="Pricing decisions to solve again with CVXPY.")] = 60,
    out: Annotated[Path | None, typer.Option(help="Results folder; results/<source>-<seed> by default.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Tune, simulate, bound and verify: how policies perform against a certified upper bound.

    Tunes the benchmark policies PP and FP on training instances, runs them and optimal pricing on the test instances,
    bounds each test instance with full information, checks the prices by certificate and with a convex solver, and
    writes a folder: summary.json, table.csv, per_instance.parquet and a box plot.
    """
    from optkit.main_job import check_target, run_main_job, write_results

    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    if isinstance(opened, Path):
        name, split, origin = opened.resolve().name, read_split(opened), {"folder": opened.resolve().name}
        folder = out or Path("results") / name
    else:
        name, split, origin = opened.name, opened.split(), opened.describe()
        folder = out or Path("results") / f"{name}-{seed}"
    check_target(folder)
    with progress_bar(quiet or as_json) as tell:
        result = run_main_job(split, origin, verify=verify, seed=seed, progress=tell)
    write_results(folder, result, f"{name}: {len(split.test)} test instances")
    if as_json:
        typer.echo(json.dumps({"folder": str(folder), **result.to_dict()}, indent=1))
    else:
        _print(name, result, folder)
    if not result.verification.holds or result.bound_failures:
        raise typer.Exit(1)


def _print(name: str, result: RunResult, folder: Path) -> None:
    record = result.record
    rows = [_row(row) for row in result.comparison.table.to_dict(orient="records")]
    sizes = record["instances"]
    title = f"{name}: {sizes['test']} test instances; PP and FP tuned on {sizes['train']} others"
    header = ["policy", "ratio %", "std", "95 % interval", "difference", "served %"]
    print_table(title, header, rows)
    trips = record["origin"].get("trips")
    if trips:
        left = ", ".join(f"{count:,} {reason}" for reason, count in trips["dropped"].items() if count) or "none"
        typer.echo(f"trips: {trips['rows']:,} rows read from {', '.join(trips['files'])}; left out: {left}")
    pp, fp = record["tuned"]["PP"], record["tuned"]["FP"]
    weights = ", ".join(f"{weight} {value:g}" for weight, value in fp.items())
    typer.echo("ratio: performance ratio against full information; difference: to the first policy, paired")
    typer.echo(f"tuned: PP pays {100 * pp['share']:g} % of the reward; FP weighs {weights}")
    for name, rows in record["learned"].items():
        for row in rows:
            label = f"{name}, group {row['group']}" if len(rows) > 1 else name
            error = f"RMSE {row['rmse']:.3f}, bias {row['mbe']:+.3f}, standard error {row['standard_error']:.3f}"
            data = f"{row['round']} round(s), {row['rejections']} rejections, {row['verdict']}"
            typer.echo(f"utility: {label}: {error}; {data}")
    typer.echo(f"bounds: every certificate checked, largest gap {result.worst_bound_gap:.1e} (money)")
    for i, why in result.bound_failures.items():
        typer.echo(f"bounds: instance {i} is left out: {why}")
    typer.echo(f"prices: {result.verification.summary()}".replace("\n", "\n        "))
    for why in result.verification.failures:
        typer.echo(f"prices: {why}")
    seconds = record["seconds"]
    typer.echo(f"time: {sum(seconds.values()):.1f} s ({', '.join(f'{k} {v:.1f}' for k, v in seconds.items())})")
    typer.echo(f"results: {folder}")


def _row(row: Mapping[Any, Any]) -> list[str]:
    first = row["difference"] == 0 and row["difference_low"] == row["difference_high"]
    paired = "" if first else f"{row['difference']:+.2f} [{row['difference_low']:+.2f}, {row['difference_high']:+.2f}]"
    return [
        row["policy"],
        f"{row['ratio']:.2f}",
        f"{row['std']:.2f}",
        f"[{row['low']:.2f}, {row['high']:.2f}]",
        paired,
        f"{100 * row['served']:.1f}",
    ]
