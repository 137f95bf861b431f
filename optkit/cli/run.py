"""``optkit run``: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.basics.arrays import whole_number
from optkit.basics.paths import resolved
from optkit.cli.console import open_source, progress_bar, say, say_json, trips_line
from optkit.cli.options import Believed, Fraction, Json, Mode, Quiet, Seed, Setting, Trips
from optkit.cli.output import FEW, print_comparison

if TYPE_CHECKING:
    from optkit.evaluation.main_job import RunResult

MOST_VERIFIED = 100_000
"""Decisions that are solved again: hours of work."""


def run(
    source: Annotated[str, typer.Argument(help="A scenario (I.1, I.2, I.3, II, nyc-weak, nyc-strong) or a folder.")],
    seed: Seed = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    preferences: Believed = None,
    verify: Annotated[int, typer.Option(min=0, help="Pricing decisions to solve again with CVXPY.")] = 60,
    out: Annotated[Path | None, typer.Option(help="Results folder; results/SOURCE-SEED by default.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Tune, learn, train, simulate, bound and verify: how policies perform against a certified upper bound.

    Tunes the benchmark policies PP and FP, learns preferences and trains value functions on training instances, runs
    all policies on the test instances, bounds each test instance with full information, checks the optimal prices by
    certificate and with a convex solver, and writes a folder: summary.json, table.csv, per_instance.parquet and a box
    plot.
    """
    from optkit.evaluation.main_job import run_main_job
    from optkit.evaluation.results_folder import check_target, write_results
    from optkit.instances.splits import read_split
    from optkit.models.preferences.preferences import Preferences

    verify = whole_number("--verify", verify, least=0, most=MOST_VERIFIED)
    believed = None if preferences is None else Preferences.load(preferences)
    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    if isinstance(opened, Path):
        split, origin = read_split(opened)
        name = resolved(opened).name
        folder = out or Path("results") / name
    else:
        name, split, origin = opened.name, opened.split(), opened.describe()
        folder = out or Path("results") / f"{name}-{seed}"
    check_target(folder, origin)
    with progress_bar(quiet or as_json) as tell:
        result = run_main_job(split, origin, verify=verify, seed=seed, preferences=believed, progress=tell)
    if as_json:
        say_json({"folder": str(folder), **result.to_dict()})
    else:
        _print(name, result)
    drawn = len(split.test) - len(result.bound_failures)
    write_results(folder, result, f"{name}: {drawn} test instances")
    if not as_json:
        say(f"results: {folder}")
    if not result.verification.holds or result.bound_failures:
        raise typer.Exit(1)


def _print(name: str, result: RunResult) -> None:
    record = result.record
    sizes = record["instances"]
    title = f"{name}: {sizes['test']} test instances; tuned, learned and trained on {sizes['train']} others"
    print_comparison(title, result.comparison)
    trips = trips_line(record["origin"])
    if trips is not None:
        say(trips)
    pp, fp = record["tuned"]["PP"], record["tuned"].get("FP", {})
    weights = ", ".join(f"{weight} {value:g}" for weight, value in fp.items())
    told = f"; FP (formula) weighs {weights}" if fp else ""
    say(f"tuned: PP (percentage of the reward) pays {100 * pp['share']:g} %{told}")
    for name, why in record["not tuned"].items():
        say(f"tuned: {name} is left out: {why}")
    if record["not tuned"]:
        say(f"learned: {FEW}")
    say("learned: by one round of random offers (paper's data), or by rounds of offers near its prices (re-estimated)")
    for name, learned in record["learned"].items():
        last = learned["rounds"][-1]["round"]
        ends = [end for end in learned["rounds"] if end["round"] == last]
        for end in ends:
            label = f"{name}, group {end['group']}" if len(ends) > 1 else name
            error = f"RMSE {end['rmse']:.3f}, bias {end['mbe']:+.3f}, standard error {end['standard_error']:.3f}"
            data = f"{end['round']} round(s), {end['rejections']} rejections, {end['verdict']}"
            if end["standard_error"] > learned["tolerance"] and last > 1:
                data += f", round limit reached before {learned['tolerance']:g}"
            say(f"utility: {label}: {error}; {data}")
    for name, why in record["not learned"].items():
        say(f"utility: {name} is left out: {why}")
    for name, trained in record["trained"].items():
        say(f"trained: {name}: {_course(trained['rounds'])}")
    for name, why in record["not trained"].items():
        say(f"trained: {name} is left out: {why}")
    say(f"bounds: every certificate checked, largest gap {result.worst_bound_gap:.1e} (money)")
    for i, why in result.bound_failures.items():
        say(f"bounds: instance {i} is left out: {why}")
    first, *more = result.verification.summary().split("\n")
    say(f"prices: {first}", *(f"        {line}" for line in more))
    for why in result.verification.failures:
        say(f"prices: {why}")
    seconds = record["seconds"]
    say(f"time: {sum(seconds.values()):.1f} s ({', '.join(f'{k} {v:.1f}' for k, v in seconds.items())})")


def _course(rounds: list[dict[str, Any]]) -> str:
    """Tell how the round was chosen, and how long training took."""
    scores = ", ".join(f"{row['score']:.2f}" for row in rounds if row["score"] is not None)
    by = f"best of {len(rounds)} round(s) by mean validation reward: {scores}" if scores else f"round {len(rounds)}"
    told = f"{by}; {sum(row.get('seconds', 0.0) for row in rounds):.1f} s"
    return "; ".join([told, *(f"round {row['round']}: {row['error']}" for row in rounds if row["error"])])
