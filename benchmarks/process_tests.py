"""How often a true process is refused, and after how many days a rush hour is noticed.

    python benchmarks/process_tests.py             400 reports of each kind
    python benchmarks/process_tests.py --reports 40 --learned 10 --rush 10 --whole 10

Days of 50 steps. True: workers at 0.5 a step, known, on 20 days; requests of scenario I.2 against a pool of 400 on 20
days; a rush hour (0.1 a step in the morning, 0.9 in the evening) by rates that were learned from 40 other days, on 20;
whole reports with all their tests, those of what the policies are charged too, on 20 days of 20 steps of scenario I.1.
Noticed: the rush hour, where 0.5 a step is assumed, on 1 to 5 days. Prints and keeps shares of reports refused; what is
not measured this time (``--whole 0``) stays as it was kept.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
from pathlib import Path

import numpy as np
from _machine import machine

from optkit import Instance, scenario
from optkit.basics.files import write_whole
from optkit.basics.plain_json import to_json
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.gap.charging import scenario_charging
from optkit.gap.report import gap_report
from optkit.gap.request_tests import request_test
from optkit.gap.simulated_test import DRAWS, LEVEL
from optkit.gap.worker_tests import worker_test
from optkit.instances.queue import fifo_queue
from optkit.learning.worker_rates import learn_worker_rates
from optkit.policies.post_decision import PostDecisionPricing

RESULTS = Path(__file__).parent / "results" / "process_tests.json"
STEADY, RUSH = np.full(50, 0.5), np.where(np.arange(50) < 25, 0.1, 0.9)


def days(rate: np.ndarray, count: int, rng: np.random.Generator) -> list[Instance]:
    """Days of workers alone."""
    found = []
    for _ in range(count):
        step, _ = fifo_queue(np.repeat(np.arange(50), rng.poisson(rate)), 50)
        none = np.zeros(0)
        found.append(
            Instance(
                horizon=50, arrival=none, expiry=none, reward=none, penalty=none, features=np.zeros((0, 0)),
                pickup=none, dropoff=none, worker_step=step, worker_group=np.zeros(step.size, int),
                utility=np.zeros((1, 0)), mu=[1.0],
            )
        )  # fmt: skip
    return found


def whole_reports(count: int) -> list[bool]:
    """Make reports on true days; return which were refused."""
    source, refused = scenario("I.1", seed=0, horizon=20), []
    charging = scenario_charging(source, training=200, pool=200, draws=2)
    policies = {"myopic": PostDecisionPricing(), "trained": charging.policy}
    for number in range(count):
        report = gap_report(
            source.sample(20, seed=10_000 + number), policies, value=charging.value, foresight=charging.foresight,
            kinds=("full", "penalised"), redraws=64, seed=number,
        )  # fmt: skip
        refused.append(bool(report.refused))
    return refused


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reports", type=int, default=400)
    parser.add_argument("--learned", type=int, default=100, help="reports with rates that were learned")
    parser.add_argument("--rush", type=int, default=120, help="reports on rush hours")
    parser.add_argument("--whole", type=int, default=400, help="whole reports")
    options = parser.parse_args()
    steady = Foresight(fifo_presence(0.5), [1.0])
    pool = Foresight([0.5], [1.0], scenario("I.2", seed=0).sample(400, seed=1))
    refused: dict[str, list[bool]] = {
        name: [] for name in ("true, workers", "true, requests", "true, either", "true, learned")
    }
    for number in range(options.reports):
        rng = np.random.default_rng([1, number])
        found = worker_test(days(STEADY, 20, rng), steady, seed=number)
        refused["true, workers"].append(found.contradicted)
        same = scenario("I.2", seed=0).sample(20, seed=2 + number)
        asked = request_test(same, pool, seed=number)
        refused["true, requests"].append(asked is not None and asked.contradicted)
        refused["true, either"].append(refused["true, workers"][-1] or refused["true, requests"][-1])
        for count in range(1, 6) if number < options.rush else ():
            noticed = worker_test(days(RUSH, count, rng), steady, seed=number).contradicted
            refused.setdefault(f"rush hour, {count} day(s)", []).append(noticed)
    for number in range(options.learned):
        rng = np.random.default_rng([2, number])
        learned = learn_worker_rates(days(RUSH, 40, rng))
        foresight = Foresight(learned.presence, [1.0])
        tested = worker_test(days(RUSH, 20, rng), foresight, learned=learned, seed=number)
        refused["true, learned"].append(tested.contradicted)
    refused["true, whole report"] = whole_reports(options.whole)
    shares = json.loads(RESULTS.read_text())["shares"] if RESULTS.exists() else {}
    shares |= {name: {"reports": len(x), "refused": float(np.mean(x))} for name, x in refused.items() if x}
    for name, row in shares.items():
        print(f"{name:22} {row['reports']:5} reports, {100 * row['refused']:6.2f} % refused")
    told = {"machine": machine("numpy", "scipy"), "level": LEVEL, "draws": DRAWS, "shares": shares}
    write_whole(RESULTS, to_json(told) + "\n")


if __name__ == "__main__":
    main()
