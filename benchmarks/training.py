"""How long it takes to train a policy and to price with it, and how much memory: light value functions and networks.

    python benchmarks/training.py              I.1 and I.3, world 0

Each form is trained on the split's 480 instances (linear and kernel five times, of which the median is told), the
networks as the best of three seeds, "mean" on 75,000 requests. The peak of memory is that of one training in a new
process. Pricing is timed on states that the policy meets: one alone, and a thousand at once. Prints a table and keeps
it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import multiprocessing
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from _machine import forget_peak, machine, status
from rich.console import Console
from rich.table import Table

from optkit import scenario, simulate
from optkit.basics.files import write_whole
from optkit.basics.plain_json import to_json
from optkit.gap.charging import MOST, TRAINING
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.policies import PostDecisionPricing
from optkit.simulation.simulator import Policy
from optkit.simulation.state import State

RESULTS = Path(__file__).parent / "results" / "training.json"
NETWORKS: dict[str, tuple[Any, int]] = {
    "attention, differences": ("attention", 3),
    "attention, levels": ("attention-levels", 3),
}
FORMS: dict[str, tuple[Any, int]] = {
    "linear": ("linear", 1),
    "kernel": ("kernel", 1),
    "by group": (LinearValue(by_group=True, busy_knots=(0.0, 1.0, 3.0, 8.0)), 1),
    "mean": ("mean", 1),
    **NETWORKS,
}


def states(source: Any, policy: Policy, count: int) -> State:
    """Return so many decisions at the middle step of instances with a worker then."""
    found: list[State] = []

    def look(state: State, *_: Any) -> None:
        if state.step == source.settings.horizon // 2:
            found.append(state)

    simulate(source.sample(4 * max(count, 25), seed=1), policy, observe=look)
    (state,) = found
    few = slice(count)
    assert len(state.row[few]) == count
    width = int(state.offered[few].sum(axis=1).max())
    return replace(
        state,
        row=state.row[few],
        instance=state.instance[few],
        worker=state.worker[few],
        request=state.request[few, :width],
        offered=state.offered[few, :width],
    )


def seconds(task: Callable[[], Any], runs: int) -> float:
    """Return the median of so many runs."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        task()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure(name: str, label: str) -> dict[str, Any]:
    """Train one form in this process, and price with it."""
    source = scenario(name, seed=0)
    (form, seeds), split = FORMS[label], source.split()
    settings = source.settings
    many = None if label != "mean" else min(MOST, round(TRAINING / (settings.request_rate * settings.horizon)))
    trained = train(scenario("I.2", horizon=5, split=(20, 5, 5)), form, choice="true", seeds=1)  # imports are not timed
    data = split if many is None else split._replace(train=source.further("train", many))
    before = forget_peak()
    trained = train(data, form, choice="true", seeds=seeds)
    peak = None if before is None else (status("VmHWM") - before) / 1024
    once = seconds(lambda: train(data, form, choice="true", seeds=seeds), 5 if label in ("linear", "kernel") else 1)
    row: dict[str, Any] = {"scenario": name, "form": label, "instances": len(data.train), "training_s": once}
    row |= {"peak_mb": peak}
    for count, runs in ((1, 2_000), (1_000, 50)):
        state = states(source, trained.policy, count)
        row[f"pricing_{count}_ms"] = 1e3 * seconds(lambda state=state: trained.policy(replace(state)), runs)
        row[f"open_{count}"] = float(state.offered.sum(axis=1).mean())
    state = states(source, PostDecisionPricing(), 1_000)
    row["myopic_1000_ms"] = 1e3 * seconds(lambda: PostDecisionPricing()(replace(state)), 50)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.3"])
    parser.add_argument("--out", type=Path, default=RESULTS)
    chosen = parser.parse_args()
    rows = []
    for name in chosen.scenarios:
        for label in FORMS:
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                rows.append(pool.apply(measure, (name, label)))
        here = {row["form"]: row for row in rows if row["scenario"] == name}
        for row in here.values():
            row["networks_take"] = {label: here[label]["training_s"] / row["training_s"] for label in NETWORKS}
    table = Table(title="training and pricing")
    for heading in (
        "scenario",
        "form",
        "instances",
        "s",
        *(f"{label} takes" for label in NETWORKS),
        "peak MB",
        "one state, us",
        "1,000 states, ms",
    ):
        table.add_column(heading)
    for row in rows:
        peak = "" if row["peak_mb"] is None else f"{row['peak_mb']:.0f}"
        longer = (f"{row['networks_take'][label]:.1f} x" for label in NETWORKS)
        spent = (f"{row['training_s']:.2f}", *longer, peak)
        priced = (f"{1e3 * row['pricing_1_ms']:.0f}", f"{row['pricing_1000_ms']:.1f}")
        table.add_row(row["scenario"], row["form"], str(row["instances"]), *spent, *priced)
    Console().print(table)
    result = {"machine": machine("numpy", "scipy", "scikit-learn", "torch"), "rows": rows}
    write_whole(chosen.out, to_json(result) + "\n")


if __name__ == "__main__":
    main()
