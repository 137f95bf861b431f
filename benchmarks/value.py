"""What waiting is worth: light value functions against three attention networks, the myopic policy, PP and FP.

For every scenario, world seed and choice model (true, or learned by re-estimation): performance ratio and per cent of
the arrival-information bound on held-out instances, paired differences to the networks, and the processor seconds of
each training. The paper's network is trained as printed (one seed), and on Algorithm 1's levels with better settings
(best of three seeds by validation); ours is the same network on the light functions' differences (best of three). The
light functions are trained once, the mean of three on 75,000 requests drawn anew, in at most 5,000 instances. Cells are
kept as they end, so that a run that was stopped goes on. Prints a table and keeps it.
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
from optkit.charging import MOST, TRAINING, held_out
from optkit.errors import OptkitError
from optkit.learning import learn_preferences
from optkit.metrics import mean_interval
from optkit.models.ranked_term import RankedTerm
from optkit.models.value import LinearValue
from optkit.models.value_features import HatFeatures
from optkit.nyc import TripScenario
from optkit.policies import PostDecisionPricing
from optkit.training import train
from optkit.tuning import tune_formula, tune_reward_percentage

GROUPS = ("light", "networks")
PAPER = {"attention, printed": ("attention-printed", 1), "attention, levels": ("attention-levels", 3)}
OURS = "attention, differences"
NETWORKS = PAPER | {OURS: ("attention", 3)}


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


def tested(source, split, count: int) -> list:
    """Held-out instances; of trips, the split's test half-hours, each realised several times."""
    if not isinstance(source, TripScenario):
        return held_out(source, count)
    first = len(split.train)
    order = source.order(sum(map(len, split)), np.random.SeedSequence(source.seed, spawn_key=(1,)))
    own = order[first : first + len(split.test)]
    seeds = np.random.SeedSequence(source.seed, spawn_key=(9,)).spawn(count)
    return [source.instance(one, own[i % len(own)]) for i, one in enumerate(seeds)]


def measure(name: str, seed: int, choice: str, group: str, trips: str | None, count: int) -> dict:
    """Train and test the light functions and benchmarks of a cell, or its networks."""
    source = scenario(name, seed=seed, trips=trips)
    split = source.split()
    test_days = tested(source, split, count)
    full = np.array([full_information(day).value for day in test_days])
    arrival = np.array([arrival_information(day).value for day in test_days])
    least = np.array([day.penalty.sum() for day in test_days])
    preferences = None if choice == "true" else learn_preferences(split.train, seed=seed).preferences
    model = "true" if preferences is None else preferences
    beliefs = {} if preferences is None else {"choice": preferences}
    cell = {"scenario": name, "seed": seed, "choice": choice, "ratio": {}, "seconds": {}, "failed": {}}
    cell["of arrival"] = {}

    def test(label, policy):
        reward = simulate(test_days, policy).reward
        cell["ratio"][label] = performance_ratio(reward, full, least).tolist()
        cell["of arrival"][label] = performance_ratio(reward, arrival, least).tolist()

    if group == "light":
        test("myopic", PostDecisionPricing(**beliefs))
        if choice == "true":
            test("PP", tune_reward_percentage(split.train).policy)
            test("FP", tune_formula(split.train).policy)
    settings = source.settings
    many = min(MOST, round(TRAINING / (settings.request_rate * settings.horizon)))
    light = {"ranked": (ranked(split, preferences), 1), "linear": ("linear", 1), "kernel": ("kernel", 1)}
    forms = light | {"mean": ("mean", 1)} if group == "light" else NETWORKS
    for label, (form, seeds) in forms.items():
        started = time.process_time()
        try:
            more = many if form == "mean" else None
            trained = train(source, form, choice=model, instances=more, seeds=seeds, seed=seed)
        except OptkitError as error:
            cell["failed"][label] = str(error)
            continue
        cell["seconds"][label] = time.process_time() - started
        test(label, trained.policy)
    return cell


def kept(folder: Path, name: str, seed: int, choice: str, group: str, trips: str | None, count: int) -> dict:
    """Measure one half of a cell, or read what an earlier run kept."""
    file = folder / f"{name}-{seed}-{choice}-{group}-{count}.json"
    if file.exists():
        return json.loads(file.read_text())
    cell = measure(name, seed, choice, group, trips, count)
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
    """One row per scenario, choice model and policy: means over all worlds' instances, paired with the networks."""
    rows = []
    for key in dict.fromkeys((c["scenario"], c["choice"]) for c in cells):
        own = [c for c in cells if (c["scenario"], c["choice"]) == key]
        ratios = {p: np.concatenate([c["ratio"][p] for c in own]) for p in everywhere(own)}
        papers = [p for p in PAPER if p in ratios]
        against = {"paper": max(papers, key=lambda p: ratios[p].mean()) if papers else None}
        against["ours"] = OURS if OURS in ratios else None
        for policy, ratio in ratios.items():
            of = np.concatenate([c["of arrival"][policy] for c in own])
            row = {"scenario": key[0], "choice": key[1], "policy": policy, "instances": ratio.size}
            row |= {"ratio": ratio.mean(), "of arrival": of.mean()}
            row["worlds"] = [np.mean(c["ratio"][policy]) for c in own]
            for whose, network in against.items():
                if network is not None:
                    gain = mean_interval(ratio, ratios[network])
                    row[whose] = {"network": network, "gain": gain.mean, "low": gain.low, "high": gain.high}
            seconds = [c["seconds"][policy] for c in own if policy in c["seconds"]]
            rows.append(row | {"seconds": float(np.mean(seconds)) if seconds else None})
    return rows


def everywhere(cells: list[dict]) -> list[str]:
    """Policies that no cell lacks."""
    return [policy for policy in cells[0]["ratio"] if all(policy in cell["ratio"] for cell in cells)]


def interval(row: dict, whose: str) -> str:
    """A paired difference, or nothing."""
    found = row.get(whose)
    return "" if found is None else f"{found['gain']:+.2f} [{found['low']:+.2f}, {found['high']:+.2f}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=["I.1", "I.2", "I.3", "II"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--choices", nargs="+", default=["true", "learned"])
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--trips", help="TLC trip records, for nyc-weak and nyc-strong")
    parser.add_argument("--tests", type=int, default=2000, help="held-out instances of each world")
    parser.add_argument("--jobs", type=int, default=1, help="cells at once")
    parser.add_argument("--cells", type=Path, default=Path(".value-cells"), help="where finished cells are kept")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "value.json")
    chosen = parser.parse_args()
    chosen.cells.mkdir(parents=True, exist_ok=True)
    every = product(chosen.groups, chosen.choices, chosen.seeds, chosen.scenarios)
    plan = [(n, s, c, g) for g, c, s, n in every]
    trips = {n: chosen.trips if n.startswith("nyc") else None for n in chosen.scenarios}
    run = joblib.Parallel(chosen.jobs)
    halves = run(joblib.delayed(kept)(chosen.cells, n, s, c, g, trips[n], chosen.tests) for n, s, c, g in plan)
    cells = joined(halves)
    rows = summary(cells)
    table = Table(title="value functions")
    headings = (
        "scenario",
        "choice",
        "policy",
        "ratio %",
        "of arrival %",
        "less the paper's",
        "less ours",
        "CPU seconds",
    )
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        numbers = (f"{row['ratio']:.2f}", f"{row['of arrival']:.2f}", interval(row, "paper"), interval(row, "ours"))
        spent = "" if row["seconds"] is None else f"{row['seconds']:.1f}"
        table.add_row(row["scenario"], row["choice"], row["policy"], *numbers, spent)
    Console().print(table)
    failed = [{k: c[k] for k in ("scenario", "seed", "choice", "failed")} for c in cells if c["failed"]]
    result = {"machine": machine("numpy", "scipy", "torch"), "jobs": chosen.jobs, "rows": rows, "failed": failed}
    chosen.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
