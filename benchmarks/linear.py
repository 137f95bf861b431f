"""What charges linear in openness take off the bounds that know all arrivals, and what the fluid bound and prices do.

    python benchmarks/linear.py                I.1, I.2, I.3, II in worlds 0 to 2
    python benchmarks/linear.py --busy         I.1 where hundreds of requests come, and dozens wait

Charges are fitted to the split's training instances and evaluated on its test instances. Points are per cent of full
information, ratios of means; differences are paired by instance, and the luck with arrivals is taken out by regression
on the part of the charges that no action changes, whose mean is zero. The fluid bound is one of the scenario, and bid
prices are its shadow prices, as a policy. Prints a row per scenario and world, and keeps them.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from _machine import machine

from optkit import scenario, simulate
from optkit.basics.files import write_whole
from optkit.basics.plain_json import to_json
from optkit.bounds import Foresight, full_information
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.penalised.charge_fit import fit_linear_charges
from optkit.bounds.penalised.foresight import fifo_presence
from optkit.bounds.penalised.penalized_dual import penalized_dual
from optkit.gap.charging import scenario_linear_charges
from optkit.gap.fluid_scenario import bid_prices
from optkit.gap.tables import ratio_of_means
from optkit.policies import PostDecisionPricing
from optkit.simulation.metrics import mean_interval

RESULTS = Path(__file__).parent / "results" / "linear.json"

BUSY: dict[str, tuple[dict[str, Any], int, int]] = {
    "two requests a step, half a worker": ({"horizon": 250, "request_rate": 2.0}, 20, 20),
    "four requests a step, half a worker": ({"horizon": 250, "request_rate": 4.0}, 20, 20),
    "as many requests as workers, for 40 steps": ({"horizon": 1000, "mean_lifetime": 40.0}, 10, 10),
}
"""Settings, days to fit the charges to, and fresh days to bound."""


def measure(name: str, seed: int) -> dict[str, Any]:
    """Measure one scenario in one world."""
    source = scenario(name, seed=seed)
    split, settings = source.split(), source.settings
    started = time.perf_counter()
    foresight = Foresight(fifo_presence(settings.worker_rate), np.full(settings.groups, 1 / settings.groups))
    charges = fit_linear_charges(split.train, foresight, settings.request_rate)
    fitted = time.perf_counter()
    least = np.array([day.penalty.sum() for day in split.test])
    full = np.array([full_information(day).value for day in split.test])
    charged = [penalized_dual(day, charges) for day in split.test]
    luck = np.array([bound.solver.details["paid"] for bound in charged])
    value = {
        "arrival dual": np.array([arrival_dual(day).value for day in split.test]),
        "arrival dual, charged": np.array([bound.value for bound in charged]),
    }
    bound, prices = bid_prices(source, 1e-4)
    value["bid prices"] = simulate(split.test, PostDecisionPricing(value_function=prices)).reward
    value["myopic"] = simulate(split.test, PostDecisionPricing()).reward
    row: dict[str, Any] = {"scenario": name, "world": seed, "fit_seconds": fitted - started}
    row["fluid"] = 100 * float((bound.value - least.mean()) / (full - least).mean())
    for kind, found in value.items():
        points = ratio_of_means(found - least, full - least)
        row[kind] = {"points": 100 * points.mean, "low": 100 * points.low, "high": 100 * points.high}
    for kind, base in {"arrival dual, charged": "arrival dual", "bid prices": "myopic"}.items():
        less = value[kind] - value[base]
        if kind != "bid prices":
            less = less - luck * float(np.cov(less, luck)[0, 1] / luck.var(ddof=1))
        gain = ratio_of_means(less, full - least)
        row[kind]["difference"] = [100 * gain.mean, 100 * gain.low, 100 * gain.high]
    return row


def measure_busy(name: str) -> dict[str, Any]:
    """Measure charges on days on which dozens of requests wait: what they take off the multiplier bound, money."""
    settings, trained, bounded = BUSY[name]
    source = scenario("I.1", seed=1, **settings)
    days = source.sample(trained + bounded, seed=77)  # the fit was developed on other days, of world 0
    started = time.perf_counter()
    charges = scenario_linear_charges(source, days[:trained])
    fitted, fresh = time.perf_counter(), days[trained:]
    free = np.array([arrival_dual(day).value for day in fresh])
    begun = time.perf_counter()
    found = [penalized_dual(day, charges) for day in fresh]
    ended = time.perf_counter()
    luck = np.array([bound.solver.details["paid"] for bound in found])
    less = np.array([bound.value for bound in found]) - free
    less = less - luck * float(np.cov(less, luck)[0, 1] / luck.var(ddof=1))
    gain = mean_interval(less)
    return {
        "days": name,
        "requests": float(np.mean([day.n_requests for day in fresh])),
        "free": float(free.mean()),
        "difference": [gain.mean, gain.low, gain.high],
        "fit_seconds": fitted - started,
        "bound_seconds": (ended - begun) / len(fresh),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Linear charges, the fluid bound, and bid prices.")
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.2", "I.3", "II"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="world seeds")
    parser.add_argument("--output", type=Path, default=RESULTS, help="results file (JSON)")
    parser.add_argument("--busy", action="store_true", help="days on which dozens of requests wait, instead")
    options = parser.parse_args()
    kept = json.loads(options.output.read_text()) if options.output.is_file() else {}
    if options.busy:
        busy = []
        for name in BUSY:
            busy.append(measure_busy(name))
            print(", ".join(f"{key} {told}" for key, told in busy[-1].items()), flush=True)
            told_machine = {**kept, "busy": busy, "machine of busy": machine("optkit", "numpy", "scipy")}
            write_whole(options.output, to_json(told_machine) + "\n")
        return
    rows = []
    for name in options.scenarios:
        for seed in options.seeds:
            rows.append(measure(name, seed))
            told = {k: v["difference"] for k, v in rows[-1].items() if isinstance(v, dict) and "difference" in v}
            shown = ", ".join(f"{k} {a:+.2f} [{b:+.2f}, {c:+.2f}]" for k, (a, b, c) in told.items())
            print(f"{name}, world {seed}: fluid {rows[-1]['fluid']:.1f}; {shown}", flush=True)
            told_machine = {**kept, "machine": machine("optkit", "numpy", "scipy"), "results": rows}
            write_whole(options.output, to_json(told_machine) + "\n")


if __name__ == "__main__":
    main()
