"""What waiting is worth: light value functions against three attention networks, the myopic policy, PP and FP.

For every scenario, world seed and choice model (true, or learned by re-estimation): performance ratio and per cent of
the arrival-information bound on held-out instances, paired differences to the networks, and the processor seconds of
each training. The paper's network is trained as printed (one seed), and on Algorithm 1's levels with better settings
(best of three seeds by validation); ours is the same network on the light functions' differences (best of three). The
light functions are trained once, their mean on 75,000 requests drawn anew, in at most 5,000 instances. Cells are
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
from optkit.basics.errors import OptkitError
from optkit.basics.files import write_whole
from optkit.bounds import arrival_information, full_information
from optkit.gap.charging import MOST, TRAINING
from optkit.instances.new_york.trip_scenario import TripScenario
from optkit.instances.settings import TABLE_1
from optkit.instances.splits import held_out
from optkit.learning.rounds import learn_preferences
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.models.value.features import HatFeatures
from optkit.models.value.ranked_term import RankedTerm
from optkit.policies import PostDecisionPricing
from optkit.policies.tuning import tune_formula, tune_reward_percentage
from optkit.simulation.metrics import mean_interval

GROUPS = ("light", "mean", "networks")
NETWORKS = {
    "attention, printed": ("attention-printed", 1),
    "attention, levels": ("attention-levels", 3),
    "attention, differences": ("attention", 3),
}


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


def tested(source, count: int) -> list:
    """Held-out instances; of trips, the split's test half-hours, each realised several times."""
    return source.further("test", count) if isinstance(source, TripScenario) else held_out(source, count)


def measure(name: str, seed: int, choice: str, group: str, trips: str | None, count: int) -> dict:
    """Train and test a group of policies in a cell."""
    source = scenario(name, seed=seed, trips=trips)
    split = source.split()
    test_days = tested(source, count)
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
        cell["of arrival"][label] = performance_ratio(reward, arrival, least, in_the_mean=True).tolist()

    if group == "light":
        test("myopic", PostDecisionPricing(**beliefs))
        if choice == "true":
            test("PP", tune_reward_percentage(split.train).policy)
            test("FP", tune_formula(split.train).policy)
    settings = source.settings
    many = min(MOST, round(TRAINING / (settings.request_rate * settings.horizon)))
    light = {"ranked": (ranked(split, preferences), 1), "linear": ("linear", 1), "kernel": ("kernel", 1)}
    forms = {"light": light, "mean": {"mean": ("mean", 1)}, "networks": NETWORKS}[group]
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
    """Measure one group in a cell, or read what an earlier run kept."""
    file = folder / f"{name}-{seed}-{choice}-{group}-{count}.json"
    if file.exists():
        return json.loads(file.read_text())
    cell = measure(name, seed, choice, group, trips, count)
    staging = file.with_suffix(".tmp")
    staging.write_text(json.dumps(cell))
    os.replace(staging, file)
    return cell


def joined(measured: list[dict]) -> list[dict]:
    """Put the groups of each cell together; whose training led nowhere prices myopically in that world."""
    cells: dict[tuple, dict] = {}
    for group in measured:
        cell = cells.setdefault((group["scenario"], group["seed"], group["choice"]), {**group})
        for part in ("ratio", "of arrival", "seconds", "failed"):
            cell[part] = cell[part] | group[part]
    for cell in cells.values():
        for label in cell["failed"]:
            for part in ("ratio", "of arrival"):
                cell[part][label] = cell[part]["myopic"]
    return list(cells.values())


def summary(cells: list[dict]) -> list[dict]:
    """One row per scenario, choice model and policy: means over all worlds' instances, and paired differences.

    Two intervals, both of 95 per cent: over instances, for these policies in these worlds (with trips, over half-hours:
    realisations of one are alike); and over worlds, for other worlds and trainings.
    """
    rows = []
    for key in dict.fromkeys((c["scenario"], c["choice"]) for c in cells):
        own = [c for c in cells if (c["scenario"], c["choice"]) == key]
        for policy in own[0]["ratio"]:
            row = {"scenario": key[0], "choice": key[1], "policy": policy}
            row |= {"instances": sum(len(c["ratio"][policy]) for c in own)}
            row |= {"ratio": np.mean([c["ratio"][policy] for c in own])}
            row |= {"of arrival": np.mean([c["of arrival"][policy] for c in own])}
            row["worlds"] = [np.mean(c["ratio"][policy]) for c in own]
            row["less"] = {}
            for other in (network for network in NETWORKS if network in own[0]["ratio"] and network != policy):
                gains = [units(c, policy) - units(c, other) for c in own]
                over = mean_interval(np.concatenate(gains))
                row["less"][other] = {"gain": over.mean, "low": over.low, "high": over.high}
                if len(own) > 1:
                    worlds = mean_interval(np.array([gain.mean() for gain in gains]))
                    row["less"][other] |= {"low over worlds": worlds.low, "high over worlds": worlds.high}
            seconds = [c["seconds"][policy] for c in own if policy in c["seconds"]]
            rows.append(row | {"seconds": float(np.mean(seconds)) if seconds else None})
    return rows


def units(cell: dict, policy: str) -> np.ndarray:
    """What is independent within a world: the ratio of each instance; of each half-hour's mean, where trips are."""
    ratio, name = np.array(cell["ratio"][policy]), cell["scenario"]
    return ratio.reshape(-1, TABLE_1[name].split[1]).mean(axis=0) if name.startswith("nyc") else ratio


def shown(row: dict, other: str) -> str:
    """A paired difference with both intervals, or nothing."""
    found = row["less"].get(other)
    if found is None:
        return ""
    told = f"{found['gain']:+.2f} [{found['low']:+.2f}, {found['high']:+.2f}]"
    if "low over worlds" in found:
        told += f" [{found['low over worlds']:+.2f}, {found['high over worlds']:+.2f}]"
    return told


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
    measured = run(joblib.delayed(kept)(chosen.cells, n, s, c, g, trips[n], chosen.tests) for n, s, c, g in plan)
    cells = joined(measured)
    rows = summary(cells)
    table = Table(title="value functions: paired differences over instances, and over worlds")
    headings = ("scenario", "choice", "policy", "ratio %", "of arrival %", *(f"less {n}" for n in NETWORKS), "CPU s")
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        numbers = (f"{row['ratio']:.2f}", f"{row['of arrival']:.2f}", *(shown(row, network) for network in NETWORKS))
        spent = "" if row["seconds"] is None else f"{row['seconds']:.1f}"
        table.add_row(row["scenario"], row["choice"], row["policy"], *numbers, spent)
    console = Console(width=200)
    console.print(table)
    failed = [{k: c[k] for k in ("scenario", "seed", "choice", "failed")} for c in cells if c["failed"]]
    for cell in failed:
        for label in cell["failed"]:
            console.print(f"{cell['scenario']}, world {cell['seed']}, {cell['choice']}: {label} led nowhere: myopic")
    result = {"machine": machine("numpy", "scipy", "torch"), "jobs": chosen.jobs, "rows": rows, "failed": failed}
    write_whole(chosen.out, json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
