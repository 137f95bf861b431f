"""How far the best policy is from optimal: every bound, with certificates, on test instances of every scenario.

    python benchmarks/gap.py                                        I.1, I.2, I.3, II in worlds 0 to 2
    python benchmarks/gap.py --trips trips.parquet --scenarios nyc-weak nyc-strong --seeds 0
    python benchmarks/gap.py --forms linear mean attention          also of the mean and of the network on differences
    python benchmarks/gap.py --quick                                8 instances each of world 0

Points are per cent of full information, ratios of means over the instances; gaps are to the best policy, and they know
the workers' true preferences: myopic, linear (trained on the split's training instances, networks too, as the best of
three seeds), and that of the value function that the penalised bound charges with (75,000 requests of other instances,
with trips of the same half-hours; the mean trains on as many).
Rows are kept as they come in --cells, so that a run that was stopped goes on. Prints a table and keeps it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import time
from pathlib import Path
from typing import Any

from _machine import machine
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from optkit import scenario
from optkit.basics.files import write_whole
from optkit.basics.plain_json import to_json
from optkit.bounds.penalised.penalized import LIMIT
from optkit.gap.charging import MOST, TRAINING, scenario_charging
from optkit.gap.report import gap_report
from optkit.gap.rows import BOUND_KINDS
from optkit.instances.splits import held_out
from optkit.learning.training import train
from optkit.policies import PostDecisionPricing

RESULTS = Path(__file__).parent / "results" / "gap.json"


def measure(name: str, seed: int, options: argparse.Namespace, console: Console) -> dict[str, Any]:
    """Measure one scenario in one world."""
    trips = {"trips": options.trips} if name.startswith("nyc") else {}
    source = scenario(name, seed=seed, **trips)
    started = time.perf_counter()
    charging = scenario_charging(source)
    charged = time.perf_counter()
    policies = {"myopic": PostDecisionPricing(), "charging": charging.policy}
    many = min(MOST, round(TRAINING / (source.settings.request_rate * source.settings.horizon)))
    for form in options.forms:
        more = {"mean": {"instances": many}, "attention": {"seeds": 3}, "attention-levels": {"seeds": 3}}
        policies[form] = train(source, form, choice="true", **more.get(form, {})).policy
    trained = time.perf_counter()
    cell = None if options.cells is None else options.cells / f"{name}-{seed}.jsonl"
    with Progress(console=console, transient=True) as bars:
        task = bars.add_task(f"{name}, world {seed}")
        report = gap_report(
            held_out(source, options.instances),
            policies,
            value=charging.value,
            foresight=charging.foresight,
            assumptions=charging.assumptions,
            limit=options.limit,
            n_jobs=options.jobs,
            checkpoint=cell,
            progress=lambda done, total: bars.update(task, completed=done, total=total),
        )
    seconds = {"charging": charged - started, "training": trained - charged, "report": time.perf_counter() - trained}
    return {"scenario": name, "world": seed, "seconds": seconds, **report.to_dict(), "best gap": report.gap()}


def show(rows: list[dict[str, Any]], jobs: int) -> Table:
    """Make the table: points of every bound and of the best policy, and the gap."""
    table = Table(title="points of full information, ± half-width of the 95 % interval; at most: one-sided 95 %")
    for heading in ("scenario", "world", *BOUND_KINDS[1:], "best policy", "", "gap", "at most", f"s, {jobs} job(s)"):
        table.add_column(heading, justify="left" if heading == "scenario" else "right")
    for row in rows:
        bounds = {one["kind"]: f"{one['points']:.2f} ± {one['half_width']:.2f}" for one in row["bounds"]}
        gap = row["best gap"]
        best = next(one for one in row["policies"] if one["policy"] == gap["policy"])
        table.add_row(
            row["scenario"],
            str(row["world"]),
            *(bounds[kind] for kind in BOUND_KINDS[1:]),
            f"{best['points']:.2f} ± {best['half_width']:.2f}",
            gap["policy"],
            f"{gap['points']:.2f} ± {(gap['points_high'] - gap['points_low']) / 2:.2f}",
            f"{gap['claim']:.2f}",
            f"{sum(row['seconds'].values()):.0f}",
        )
    return table


def show_policies(rows: list[dict[str, Any]]) -> Table:
    """Make the table of every policy's gap to the bound that the best one is measured by."""
    table = Table(title="gap of each policy, points, ± half-width of the 95 % interval")
    names = [one["policy"] for one in rows[0]["policies"]]
    for heading in ("scenario", "world", *names):
        table.add_column(heading, justify="left" if heading == "scenario" else "right")
    for row in rows:
        gaps = {one["policy"]: one for one in row["gaps"] if one["bound"] == row["best gap"]["bound"]}
        shown = (
            f"{g['points']:.2f} ± {(g['points_high'] - g['points_low']) / 2:.2f}" for g in map(gaps.get, names) if g
        )
        table.add_row(row["scenario"], str(row["world"]), *shown)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="How far the best policy is from optimal.")
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.2", "I.3", "II"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="world seeds")
    parser.add_argument("--instances", type=int, help="test instances; all 120 by default, and more if you ask")
    parser.add_argument("--trips", type=Path, help="trip records, for nyc-weak and nyc-strong")
    parser.add_argument("--forms", nargs="+", default=["linear"], help="value functions, as optkit train names them")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--limit", type=int, default=LIMIT, help="waiting requests that are told apart")
    parser.add_argument("--cells", type=Path, help="folder that keeps rows as they come")
    parser.add_argument("--quick", action="store_true", help="world 0, 8 instances")
    parser.add_argument("--output", type=Path, default=RESULTS, help="results file (JSON)")
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.instances = [0], 8
    console = Console(width=160)
    rows = []
    for name in options.scenarios:
        for seed in options.seeds:
            rows.append(measure(name, seed, options, console))
            console.print(show(rows[-1:], options.jobs))
    console.print(show(rows, options.jobs))
    console.print(show_policies(rows))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    versions = machine("optkit", "numpy", "scipy", "scikit-learn")
    told = {"machine": versions, "jobs": options.jobs, "limit": options.limit, "results": rows}
    write_whole(options.output, to_json(told) + "\n")


if __name__ == "__main__":
    main()
