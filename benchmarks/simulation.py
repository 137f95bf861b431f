"""The lockstep simulator against a plain Python loop over instances and steps, and FP's whole grid search.

    python benchmarks/simulation.py             480 instances of I.1, about 20 seconds
    python benchmarks/simulation.py --quick     60 instances, seconds

Everything runs on one thread. Both simulators meet the same noise, and their rewards are compared before any ratio is
printed. They take turns, and the best time of each counts, which forgives what else the machine is doing. "Of a Batch"
leaves out laying the instances end to end, which many simulations can share. The loop is what one writes first: lists
of open requests and one decision at a time. Its two variants differ in the price of a decision only: a share of the
reward (PP), or the optimal prices of the one state (myopic).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from _machine import machine
from rich.console import Console
from rich.table import Table

from optkit import Instance, scenario, simulate
from optkit.basics.files import write_whole
from optkit.models.pricing import optimal_prices
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.policies.tuning import tune_formula, tune_reward_percentage
from optkit.simulation.batch import Batch

RESULTS = Path(__file__).parent / "results" / "simulation.json"
GOAL = 20.0

Price = Callable[[Instance, int, int, list[int]], Any]


def share(instance: Instance, step: int, group: int, active: list[int]) -> Any:
    return 0.6 * instance.reward[active]


def myopic(instance: Instance, step: int, group: int, active: list[int]) -> Any:
    expiring = instance.expiry[active] == step
    value = instance.reward[active] - np.where(expiring, instance.penalty[active], 0.0)
    return optimal_prices(value, instance.utility[group, active], instance.mu[group]).compensation


def loop(instances: list[Instance], price: Price) -> np.ndarray:
    """Simulate one instance after the other, step by step; return the rewards."""
    rewards = []
    for instance in instances:
        workers = dict(zip(instance.worker_step.tolist(), range(instance.n_workers), strict=True))
        arriving: dict[int, list[int]] = {}
        for i, step in enumerate(instance.arrival.tolist()):
            arriving.setdefault(step, []).append(i)
        reward, penalty = instance.reward.tolist(), instance.penalty.tolist()
        expiry, group = instance.expiry.tolist(), instance.worker_group.tolist()
        total, active = 0.0, []
        for step in range(instance.horizon):
            active += arriving.get(step, [])
            if active and step in workers:
                j = workers[step]
                pay = price(instance, step, group[j], active)
                gained = instance.utility[group[j], active] + pay + instance.noise[j, active]
                best = int(gained.argmax())
                if gained[best] >= instance.outside_by_group[group[j]] + instance.outside_noise[j]:
                    total += reward[active.pop(best)] - float(pay[best])
            total += sum(penalty[i] for i in active if expiry[i] == step)
            active = [i for i in active if expiry[i] != step]
        rewards.append(total)
    return np.array(rewards)


def best_times(tasks: list[Callable[[], Any]], rounds: int) -> tuple[list[float], list[Any]]:
    """Run tasks in turn; return the best wall time of each, in seconds, and what each returned last."""
    best, answers = [float("inf")] * len(tasks), [None] * len(tasks)
    for _ in range(rounds):
        for k, task in enumerate(tasks):
            begin = time.perf_counter()
            answers[k] = task()
            best[k] = min(best[k], time.perf_counter() - begin)
    return best, answers


def compare(instances: list[Instance], name: str, policy: Any, price: Price, rounds: int) -> dict[str, Any]:
    """Time one policy in both simulators, after checking that they earn the same."""
    batch = Batch.of(instances)
    simulate(batch, policy)  # imports and caches
    tasks = [lambda: loop(instances, price), lambda: simulate(instances, policy), lambda: simulate(batch, policy)]
    (slow, fast, warm), (rewards, *results) = best_times(tasks, rounds)
    for result in results:
        np.testing.assert_allclose(result.reward, rewards, rtol=1e-9, atol=1e-9)
    times = {"loop_s": slow, "lockstep_s": fast, "lockstep_of_batch_s": warm}
    return {"policy": name, **times, "ratio": slow / fast, "ratio_of_batch": slow / warm}


def measure(count: int, rounds: int) -> dict[str, Any]:
    instances = scenario("I.1", seed=0).sample(count, seed=1)
    tuners = (("FP", lambda: tune_formula(instances)), ("PP", lambda: tune_reward_percentage(instances)))
    tuning = []
    for name, tune in tuners:
        (took,), (tuned,) = best_times([tune], 1)
        tuning.append({"policy": name, "settings": len(tuned.table), "seconds": took, "best": repr(tuned.policy)})
    return {
        "instances": count,
        "runs": [
            compare(instances, "myopic", PostDecisionPricing(), myopic, rounds),
            compare(instances, "PP", RewardPercentage(0.6), share, rounds),
        ],
        "tuning": tuning,
        "goal": GOAL,
        "machine": machine("optkit", "numpy", "scipy", "pandas"),
    }


def show(found: dict[str, Any]) -> None:
    console = Console()
    table = Table(title=f"{found['instances']} instances of I.1, one thread (goal: myopic at least {GOAL:g} times)")
    for column in ("policy", "plain loop (s)", "lockstep (s)", "ratio", "of a Batch (s)", "ratio"):
        table.add_column(column, justify="left" if column == "policy" else "right")
    for run in found["runs"]:
        cells = [f"{run['loop_s']:.3f}", f"{run['lockstep_s']:.4f}", f"{run['ratio']:.1f}"]
        table.add_row(run["policy"], *cells, f"{run['lockstep_of_batch_s']:.4f}", f"{run['ratio_of_batch']:.1f}")
    console.print(table)
    table = Table(title=f"Grid search on {found['instances']} instances")
    for column in ("policy", "settings", "seconds", "ms a setting", "best"):
        table.add_column(column, justify="left" if column in ("policy", "best") else "right")
    for one in found["tuning"]:
        each = f"{1000 * one['seconds'] / one['settings']:.1f}"
        table.add_row(one["policy"], f"{one['settings']:,}", f"{one['seconds']:.2f}", each, one["best"])
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="60 instances instead of 480")
    options = parser.parse_args()
    found = measure(60 if options.quick else 480, rounds=7)
    show(found)
    if not options.quick:
        RESULTS.parent.mkdir(exist_ok=True)
        write_whole(RESULTS, json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
