"""What charges linear in openness take off the bounds that know all arrivals, and what the fluid bound and prices do.

    python benchmarks/linear.py                I.1, I.2, I.3, II in worlds 0 to 2

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
from optkit.bounds.penalised.penalized_dual import penalized_assignment, penalized_dual
from optkit.gap.fluid_scenario import bid_prices
from optkit.gap.tables import ratio_of_means
from optkit.policies import PostDecisionPricing

RESULTS = Path(__file__).parent / "results" / "linear.json"


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
        "full information, charged": np.array([penalized_assignment(day, charges).value for day in split.test]),
    }
    bound, prices = bid_prices(source, 1e-4)
    value["bid prices"] = simulate(split.test, PostDecisionPricing(value_function=prices)).reward
    value["myopic"] = simulate(split.test, PostDecisionPricing()).reward
    row: dict[str, Any] = {"scenario": name, "world": seed, "fit_seconds": fitted - started}
    row["fluid"] = 100 * float((bound.value - least.mean()) / (full - least).mean())
    for kind, found in value.items():
        points = ratio_of_means(found - least, full - least)
        row[kind] = {"points": 100 * points.mean, "low": 100 * points.low, "high": 100 * points.high}
    pairs = {
        "arrival dual, charged": "arrival dual",
        "full information, charged": None,
        "bid prices": "myopic",
    }
    for kind, base in pairs.items():
        less = value[kind] - (full if base is None else value[base])
        if kind != "bid prices":
            less = less - luck * float(np.cov(less, luck)[0, 1] / luck.var(ddof=1))
        gain = ratio_of_means(less, full - least)
        row[kind]["difference"] = [100 * gain.mean, 100 * gain.low, 100 * gain.high]
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description="Linear charges, the fluid bound, and bid prices.")
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.2", "I.3", "II"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="world seeds")
    parser.add_argument("--output", type=Path, default=RESULTS, help="results file (JSON)")
    options = parser.parse_args()
    rows = []
    for name in options.scenarios:
        for seed in options.seeds:
            rows.append(measure(name, seed))
            told = {k: v["difference"] for k, v in rows[-1].items() if isinstance(v, dict) and "difference" in v}
            shown = ", ".join(f"{k} {a:+.2f} [{b:+.2f}, {c:+.2f}]" for k, (a, b, c) in told.items())
            print(f"{name}, world {seed}: fluid {rows[-1]['fluid']:.1f}; {shown}", flush=True)
            told_machine = {"machine": machine("optkit", "numpy", "scipy"), "results": rows}
            write_whole(options.output, to_json(told_machine) + "\n")


if __name__ == "__main__":
    main()
