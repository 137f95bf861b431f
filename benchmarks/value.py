"""What waiting is worth: light value functions against the attention network, the myopic policy, PP and FP.

For every scenario, world seed and choice model (true, or learned by re-estimation): performance ratio and per cent of
the arrival-information bound on the test instances, paired differences to the better network, and the processor seconds
of each training. The network is trained as printed (one seed) and tuned (best of three seeds by validation), the light
functions once. Cells are kept as they end, so that a run that was stopped goes on. Prints a table and keeps it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import time
from itertools import product
from pathlib import Path

import joblib
import numpy as np
from _machine import machine
from rich.console import Console
from rich.table import Table

from optkit import performance_ratio, scenario, simulate
from optkit.bounds import arrival_information, full_information
from optkit.errors import OptkitError
from optkit.learning import learn_preferences
from optkit.metrics import mean_interval
from optkit.models.ranked_term import RankedTerm
from optkit.models.value import LinearValue
from optkit.models.value_features import HatFeatures
from optkit.policies import PostDecisionPricing
from optkit.training import train
from optkit.tuning import tune_formula, tune_reward_percentage

GROUPS = ("light", "networks")
NETWORKS = {"attention, printed": ("attention-printed", 1), "attention, tuned": ("attention", 3)}


def ranked(split, preferences):
    """Return the prototype: one term, ranked by mean surplus."""
    utilities = []
    for day in split.train:
        if preferences is None:
            own = day.utility - day.outside_by_group[:, None]
        else:
            groups = np.arange(day.n_groups)[:, None]
            own = preferences.utility_of(day.features, day.pickup, day.dropoff, groups)
        utilities.append((day.reward - day.penalty + own).mean(axis=0))
    low, high = np.quantile(np.concatenate(utilities), [0.03, 0.97])
    hats = HatFeatures(None, np.array([low, high]), np.array([1.0, 3.0, 10.0]))
    return LinearValue(terms=[RankedTerm(hats, "surplus", np.array([0.0, 1.0, 4.0]))])


def measure(name: str, seed: int, choice: str, group: str, trips: str | None) -> dict:
    """Train and test the light functions and benchmarks of a cell, or its networks."""
    split = scenario(name, seed=seed, trips=trips).split()
    full = np.array([full_information(day).value for day in split.test])
    arrival = np.array([arrival_information(day).value for day in split.test])
    least = np.array([day.penalty.sum() for day in split.test])
    preferences = None if choice == "true" else learn_preferences(split.train, seed=seed).preferences
    model = "true" if preferences is None else preferences
    beliefs = {} if preferences is None else {"choice": preferences}
    cell = {"scenario": name, "seed": seed, "choice": choice, "ratio": {}, "seconds": {}, "failed": {}}
    cell["of arrival"] = {}

    def test(label, policy):
        reward = simulate(split.test, policy).reward
        cell["ratio"][label] = performance_ratio(reward, full, least).tolist()
        cell["of arrival"][label] = performance_ratio(reward, arrival, least).tolist()

    if group == "light":
        test("myopic", PostDecisionPricing(**beliefs))
        if choice == "true":
            test("PP", tune_reward_percentage(split.train).policy)
            test("FP", tune_formula(split.train).policy)
    light = {"ranked": (ranked(split, preferences), 1), "linear": ("linear", 1), "kernel": ("kernel", 1)}
    forms = light if group == "light" else NETWORKS
    for label, (form, seeds) in forms.items():
        started = time.process_time()
        try:
            trained = train(split, form, choice=model, seeds=seeds, seed=seed)
        except OptkitError as error:
            cell["failed"][label] = str(error)
            continue
        cell["seconds"][label] = time.process_time() - started
        test(label, trained.policy)
    return cell


def kept(folder: Path, name: str, seed: int, choice: str, group: str, trips: str | None) -> dict:
    """Measure one half of a cell, or read what an earlier run kept."""
    file = folder / f"{name}-{seed}-{choice}-{group}.json"
    if file.exists():
        return json.loads(file.read_text())
    cell = measure(name, seed, choice, group, trips)
    staging = file.with_suffix(".tmp")
    staging.write_text(json.dumps(cell))
    os.replace(staging, file)
    return cell


def joined(halves: list[dict]) -> list[dict]:
    """Put the halves of each cell together."""
    cells: dict[tuple, dict] = {}
    for half in halves:
        cell = cells.setdefault((half["scenario"], half["seed"], half["choice"]), {**half})
        for part in ("ratio", "of arrival", "seconds", "failed"):
            cell[part] = cell[part] | half[part]
    return list(cells.values())


def summary(cells: list[dict]) -> list[dict]:
    """One row per scenario, choice model and policy: means over all worlds' test instances, paired with the network."""
    rows = []
    for key in dict.fromkeys((c["scenario"], c["choice"]) for c in cells):
        own = [c for c in cells if (c["scenario"], c["choice"]) == key]
        joined = {
            p: np.concatenate([c["ratio"][p] for c in own])
            for p in own[0]["ratio"]
            if all(p in c["ratio"] for c in own)
        }
        networks = [p for p in NETWORKS if p in joined]
        best = max(networks, key=lambda p: joined[p].mean()) if networks else None
        for policy, ratio in joined.items():
            of = np.concatenate([c["of arrival"][policy] for c in own])
            row = {"scenario": key[0], "choice": key[1], "policy": policy, "instances": ratio.size}
            row |= {
                "ratio": ratio.mean(),
                "of arrival": of.mean(),
                "worlds": [np.mean(c["ratio"][policy]) for c in own],
            }
            if best is not None:
                gain = mean_interval(ratio, joined[best])
                row |= {"against": best, "gain": gain.mean, "low": gain.low, "high": gain.high}
            seconds = [c["seconds"][policy] for c in own if policy in c["seconds"]]
            rows.append(row | {"seconds": float(np.mean(seconds)) if seconds else None})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.2", "I.3", "II"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--choices", nargs="+", default=["true", "learned"])
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--trips", help="TLC trip records, for nyc-weak and nyc-strong")
    parser.add_argument("--jobs", type=int, default=1, help="cells at once")
    parser.add_argument("--cells", type=Path, default=Path(".value-cells"), help="where finished cells are kept")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "value.json")
    chosen = parser.parse_args()
    chosen.cells.mkdir(parents=True, exist_ok=True)
    every = product(chosen.groups, chosen.choices, chosen.seeds, chosen.scenarios)
    plan = [(n, s, c, g) for g, c, s, n in every]
    trips = {n: chosen.trips if n.startswith("nyc") else None for n in chosen.scenarios}
    run = joblib.Parallel(chosen.jobs)
    halves = run(joblib.delayed(kept)(chosen.cells, n, s, c, g, trips[n]) for n, s, c, g in plan)
    cells = joined(halves)
    rows = summary(cells)
    table = Table(title="value functions")
    for column in (
        "scenario",
        "choice",
        "policy",
        "ratio %",
        "of arrival %",
        "against the better network",
        "CPU seconds",
    ):
        table.add_column(column)
    for row in rows:
        paired = f"{row['gain']:+.2f} [{row['low']:+.2f}, {row['high']:+.2f}]" if "gain" in row else ""
        numbers = (f"{row['ratio']:.2f}", f"{row['of arrival']:.2f}", paired)
        spent = "" if row["seconds"] is None else f"{row['seconds']:.1f}"
        table.add_row(row["scenario"], row["choice"], row["policy"], *numbers, spent)
    Console().print(table)
    failed = [{k: c[k] for k in ("scenario", "seed", "choice", "failed")} for c in cells if c["failed"]]
    result = {"machine": machine("numpy", "scipy", "torch"), "jobs": chosen.jobs, "rows": rows, "failed": failed}
    chosen.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
