"""What learning the workers' preferences costs: myopic pricing with learned against true preferences.

For every scenario and world seed: performance ratio on the 120 test instances with the true model, and the paired loss
with what was learned on the 480 training instances, by four ways of learning. Prints a table and keeps it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
import warnings
from pathlib import Path

import numpy as np
from _machine import machine
from rich.console import Console
from rich.table import Table

from optkit import performance_ratio, scenario, simulate
from optkit.basics.files import write_whole
from optkit.bounds import full_information
from optkit.learning.rounds import RIDGE, learn_once, learn_preferences
from optkit.models.estimation import EstimationWarning
from optkit.models.preferences.fit import fit_preferences, utility_errors
from optkit.policies import PostDecisionPricing

WAYS = ("paper's data", "re-estimated", "accept-reject", "single MNL")


def measure(name: str, seed: int) -> dict:
    """Measure one scenario at one world seed."""
    split = scenario(name, seed=seed).split()
    bounds = [full_information(day).value for day in split.test]
    least = [day.penalty.sum() for day in split.test]

    def ratio(**beliefs):
        return performance_ratio(simulate(split.test, PostDecisionPricing(**beliefs)).reward, bounds, least)

    true = ratio()
    row = {"scenario": name, "seed": seed, "true": true.mean()}
    started = time.perf_counter()
    once = learn_once(split.train, seed=seed)
    row["seconds once"] = time.perf_counter() - started
    started = time.perf_counter()
    active = learn_preferences(split.train, seed=seed)
    row["seconds active"] = time.perf_counter() - started
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EstimationWarning)
        by_row = fit_preferences(once.offers, method="accept-reject", ridge=RIDGE)
        single = fit_preferences(active.offers, pooled=True)
    requests = [np.concatenate([getattr(d, part) for d in split.train]) for part in ("features", "pickup", "dropoff")]
    truth = np.concatenate([day.utility for day in split.train], axis=1)
    found = dict(zip(WAYS, (once.preferences, active.preferences, by_row, single), strict=True))
    for way, preferences in found.items():
        row[f"loss {way}"] = float((true - ratio(choice=preferences)).mean())
        errors = utility_errors(preferences, *requests, truth)
        row[f"rmse {way}"], row[f"mbe {way}"] = errors["rmse"].max(), errors["mbe"].abs().max()
    first, last = once.rounds, active.rounds[active.rounds["round"] == active.rounds["round"].max()]
    row["rejections once"] = int(first["rejections"].min())
    row["verdict once"] = "/".join(sorted(set(first["verdict"])))
    row["standard error once"] = float(first["standard_error"].max())
    row["rounds"], row["verdict active"] = int(last["round"].max()), "/".join(sorted(set(last["verdict"])))
    return {key: float(value) if isinstance(value, np.floating) else value for key, value in row.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="world seeds 0 to this, not included")
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.2", "I.3", "II"])
    options = parser.parse_args()
    rows = [measure(name, seed) for name in options.scenarios for seed in range(options.seeds)]
    console = Console(width=140)
    title = f"loss of performance ratio in points, mean over {options.seeds} world seeds (largest); RMSE: largest group"
    table = Table(title=title)
    for column in (
        "scenario",
        "true %",
        *WAYS,
        "RMSE once",
        "SE once",
        "weak once",
        "RMSE re-est.",
        "s once / active",
    ):
        table.add_column(column, justify="right")
    for name in options.scenarios:
        own = [row for row in rows if row["scenario"] == name]
        loss = {way: [row[f"loss {way}"] for row in own] for way in WAYS}
        table.add_row(
            name,
            f"{np.mean([row['true'] for row in own]):.2f}",
            *(f"{np.mean(loss[way]):.3f} ({max(loss[way]):.3f})" for way in WAYS),
            f"{max(row['rmse ' + WAYS[0]] for row in own):.3f}",
            f"{max(row['standard error once'] for row in own):.3f}",
            f"{sum('weak' in row['verdict once'] for row in own)} of {len(own)}",
            f"{max(row['rmse ' + WAYS[1]] for row in own):.3f}",
            " / ".join(f"{np.mean([row[f'seconds {way}'] for row in own]):.2f}" for way in ("once", "active")),
        )
    console.print(table)
    place = Path(__file__).parent / "results" / "learning.json"
    write_whole(place, json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
