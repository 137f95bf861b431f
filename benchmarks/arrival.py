"""The arrival-information bound: its closed-form dual against a conic solver and a first-order method.

    python benchmarks/arrival.py                   everything, a few minutes
    python benchmarks/arrival.py --quick           fewer instances, sizes up to 10,000, seconds
    python benchmarks/arrival.py --sizes 1000      these sizes

Small: 120 instances of I.1, one after the other. Large: I.3 with a longer horizon, a request a step and a worker every
other, about eleven requests open. Every method starts from the instance and ends with multipliers, which are evaluated
by the same certificate: "excess" is how far the bound that they prove lies above the best one known, as a part of what
that adds to paying all penalties, "certified" the gap that the certificate itself shows. Times are those of the
processor, on one thread, so that neighbours on the machine hardly matter.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from _machine import machine
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize

from optkit import scenario
from optkit.basics.files import write_whole
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.arrival.market import OpenPairs
from optkit.bounds.arrival.program import arrival_program
from optkit.instances.instance import Floats, Instance

SIZES = (1_000, 10_000, 100_000)
HARD_LIMIT = 60.0
"""Seconds after which a method is stopped from outside."""

RUNS = 3
"""Runs of every method over the small instances, and over a large one that takes less than LONG."""

LONG = 10.0
"""Seconds of a run after which one is enough."""

RESULTS = Path(__file__).parent / "results" / "arrival.json"


def dual(instance: Instance) -> Floats:
    return arrival_dual(instance).certificate.multipliers


def rough_dual(instance: Instance) -> Floats:
    return arrival_dual(instance, tolerance=1e-3).certificate.multipliers


def program(instance: Instance) -> Floats:
    return arrival_program(instance).certificate.multipliers


def first_order(instance: Instance) -> Floats:
    """Minimise the same dual by L-BFGS-B, to the end of what its line search can see."""
    market = OpenPairs.of(instance)

    def value(prices: Floats) -> tuple[float, Floats]:
        ratio, acceptance = market.respond(prices)
        return market.gain(prices, ratio), market.count - market.served(acceptance)

    n = instance.n_requests
    options = {"maxiter": 10_000, "maxfun": 20_000, "ftol": 1e-13, "gtol": 1e-7, "maxcor": 20}
    return minimize(value, np.zeros(n), jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * n, options=options).x


METHODS: dict[str, Callable[[Instance], Floats]] = {
    "dual": dual,
    "dual, 0.1 %": rough_dual,
    "L-BFGS-B": first_order,
    "CVXPY + Clarabel": program,
}


def run(name: str, settings: dict[str, Any], count: int, runs: int) -> dict[str, Any]:
    """Run one method in this process over ``count`` instances: seconds for all, and what the multipliers prove."""
    method = METHODS[name]
    method(scenario("I.1", seed=0).sample(1, seed=1)[0])  # imports are not timed
    instances = scenario(**settings).sample(count, seed=11)
    times: list[float] = []
    while not times or (len(times) < runs and times[-1] < LONG):
        start = time.process_time()
        found = [method(one) for one in instances]
        times.append(time.process_time() - start)
    verdicts = [OpenPairs.of(one).verdict(prices) for one, prices in zip(instances, found, strict=True)]
    return {
        "seconds": statistics.median(times),
        "bounds": [verdict.bound for verdict in verdicts],
        "attained": [verdict.attained for verdict in verdicts],
        "penalties": [float(one.penalty.sum()) for one in instances],
        "requests": sum(one.n_requests for one in instances),
        "workers": sum(one.n_workers for one in instances),
        "pairs": sum(OpenPairs.of(one).size for one in instances),
    }


def measure(settings: dict[str, Any], count: int, runs: int, console: Console) -> dict[str, Any]:
    """Measure every method on the same instances, each in a process of its own that can be stopped."""
    found: dict[str, Any] = {}
    for name in METHODS:
        with console.status(f"{settings['name']}: {name}"), multiprocessing.get_context("spawn").Pool(1) as pool:
            try:
                found[name] = pool.apply_async(run, (name, settings, count, runs)).get(HARD_LIMIT)
            except multiprocessing.TimeoutError:
                found[name] = {"note": f"stopped after {HARD_LIMIT:.0f} s without an answer"}
    ended = [row for row in found.values() if "seconds" in row]
    best = np.min([row["bounds"] for row in ended], axis=0)
    gain = best - np.array(ended[0]["penalties"])
    size = {key: ended[0][key] for key in ("requests", "workers", "pairs")}
    fastest = min(row["seconds"] for row in ended)
    rows = []
    for name, row in found.items():
        if "seconds" not in row:
            rows.append({"method": name, **row})
            continue
        bounds = np.array(row["bounds"])
        rows.append(
            {
                "method": name,
                "seconds": row["seconds"],
                "ratio": row["seconds"] / fastest,
                "mean_excess": float(((bounds - best) / gain).mean()),
                "largest_excess": float(((bounds - best) / gain).max()),
                "largest_certified": float(((bounds - np.array(row["attained"])) / gain).max()),
            }
        )
    return {"settings": settings, "instances": count, **size, "rows": rows}


def show(result: dict[str, Any]) -> Table:
    """Make the table of one set of instances."""
    what = "{name}, {horizon:,} steps".format(**{"horizon": 50, **result["settings"]})
    title = f"{what}, {result['instances']} instances: " + ", ".join(
        f"{result[key]:,} {key}" for key in ("requests", "workers", "pairs")
    )
    table = Table(title=title)
    for heading in ("method", "s", "x best", "mean excess", "largest excess", "largest certified"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for row in result["rows"]:
        if "seconds" not in row:
            table.add_row(row["method"], "-")
            table.caption = f"{row['method']}: {row['note']}"
            continue
        shares = (f"{row[key]:.0e}" for key in ("mean_excess", "largest_excess", "largest_certified"))
        table.add_row(row["method"], f"{row['seconds']:,.3f}", f"{row['ratio']:.2f}", *shares)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="The arrival-information bound against its peers.")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of steps of the large instances")
    parser.add_argument("--quick", action="store_true", help="30 small instances, sizes up to 10,000, one run")
    parser.add_argument("--output", type=Path, default=RESULTS, help="results file (JSON)")
    options = parser.parse_args()
    for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
        os.environ.setdefault(threads, "1")  # the runs inherit it
    console = Console()
    versions = machine("optkit", "numpy", "scipy", "cvxpy", "clarabel")
    console.print(", ".join(f"{key} {value}" for key, value in versions.items() if key != "versions"))
    runs = 1 if options.quick else RUNS
    results = [measure({"name": "I.1", "seed": 0}, 30 if options.quick else 120, runs, console)]
    console.print(show(results[-1]))
    for steps in options.sizes:
        if steps <= 10_000 or not options.quick:
            results.append(measure({"name": "I.3", "seed": 0, "horizon": steps}, 1, runs, console))
            console.print(show(results[-1]))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    found = {"machine": versions, "hard_limit_s": HARD_LIMIT, "runs": runs, "results": results}
    write_whole(options.output, json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
