"""The full-information bound against its peers, from the same instance to its value.

    python benchmarks/bound.py                     all sizes, a few minutes
    python benchmarks/bound.py --quick             sizes up to 1,000, seconds
    python benchmarks/bound.py --sizes 50 10000    these sizes

Every peer starts from the instance and builds the same graph with optkit; only ours also makes a certificate. All of
them use one thread. The gap is measured for everybody against the bound that our certificate proves.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from _machine import forget_peak, machine, status
from rich.console import Console
from rich.table import Table

from optkit.basics.errors import SolverError
from optkit.basics.files import write_whole
from optkit.bounds import full_information
from optkit.bounds.full.edges import edges
from optkit.bounds.full.matching import dense_matching, sparse_matching
from optkit.bounds.full.matching_program import solve_matching_program
from optkit.bounds.full.windows import value_of_pairs
from optkit.instances.instance import Instance

SIZES = (50, 120, 1_000, 10_000, 100_000)
MILP_LIMIT = 60.0
"""Seconds, as HiGHS is told: after presolve, its integer solver overlooks the clock for minutes."""

HARD_LIMIT = 120.0
"""Seconds after which a method is stopped from outside."""

MEMORY_LIMIT = 20.0
"""Seconds up to which one more run is spent on the peak of memory."""

RESULTS = Path(__file__).parent / "results" / "bound.json"


def instance_of(steps: int, seed: int = 0) -> Instance:
    """Draw an instance like I.3: a request a step, a worker every other step, about ten requests open."""
    rng = np.random.default_rng(seed)
    arrival = np.repeat(np.arange(steps), rng.poisson(1.0, steps))
    n = arrival.size
    worker_step = np.flatnonzero(rng.random(steps) < 0.5)
    return Instance(
        horizon=steps,
        arrival=arrival,
        expiry=np.minimum(arrival + np.ceil(rng.exponential(10, n)).astype(int), steps - 1),
        reward=20 + rng.uniform(0, 60, n),
        penalty=-rng.uniform(0, 10, n),
        features=np.zeros((n, 1)),
        pickup=np.zeros(n, int),
        dropoff=np.zeros(n, int),
        worker_step=worker_step,
        worker_group=np.zeros(worker_step.size, int),
        utility=-rng.uniform(0, 40, (1, n)),
        mu=[1.0],
    ).with_noise(rng)


def default(instance: Instance) -> float:
    return full_information(instance).value


def linear_program(instance: Instance) -> float:
    return full_information(instance, "lp").value


def integer_program(instance: Instance) -> float:
    return full_information(instance, "milp", time_limit=MILP_LIMIT).value


def integer_program_presolved(instance: Instance) -> float:
    """Solve the integer program with HiGHS's own settings, as one would write it down."""
    graph = edges(instance)
    solved = solve_matching_program(graph, integer=True, time_limit=MILP_LIMIT, presolve=True)
    return graph.constant + float(value_of_pairs(graph, solved.worker, solved.request).sum())


def scipy_dense(instance: Instance) -> float:
    graph = edges(instance)
    matrix = graph.dense()
    return graph.constant + float(matrix[dense_matching(matrix)].sum())


def scipy_sparse(instance: Instance) -> float:
    graph = edges(instance)
    pairs = sparse_matching(graph.worker, graph.request, graph.value, graph.n_workers, graph.n_requests)
    return graph.constant + float(value_of_pairs(graph, *pairs).sum())


def cvxpy_highs(instance: Instance) -> float:
    import cvxpy as cp
    from scipy import sparse

    graph = edges(instance)
    column = np.arange(graph.size)
    ends = np.concatenate([graph.worker, graph.n_workers + graph.request])
    shape = (graph.n_workers + graph.n_requests, graph.size)
    uses = sparse.csr_array((np.ones(2 * graph.size), (ends, np.tile(column, 2))), shape=shape)
    x = cp.Variable(graph.size, nonneg=True)
    problem = cp.Problem(cp.Maximize(graph.value @ x), [uses @ x <= 1])
    return graph.constant + float(problem.solve(solver=cp.HIGHS))


def ortools_flow(instance: Instance) -> float:
    """Min-cost flow with costs in millionths: each worker sends one unit through a request, or straight to the sink."""
    from ortools.graph.python.min_cost_flow import SimpleMinCostFlow

    graph = edges(instance)
    J, n = graph.n_workers, graph.n_requests
    sink = J + n
    tail = np.concatenate([graph.worker, J + np.arange(n), np.arange(J)])
    head = np.concatenate([J + graph.request, np.full(n + J, sink)])
    cost = np.concatenate([-np.round(1e6 * graph.value), np.zeros(n + J)]).astype(np.int64)
    flow = SimpleMinCostFlow()
    arcs = flow.add_arcs_with_capacity_and_unit_cost(tail, head, np.ones(tail.size, np.int64), cost)
    supply = np.concatenate([np.ones(J, np.int64), np.zeros(n, np.int64), [-J]])
    flow.set_nodes_supplies(np.arange(sink + 1), supply)
    if flow.solve() != flow.OPTIMAL:
        raise SolverError("OR-Tools found no optimal flow")
    return graph.constant + float(graph.value[flow.flows(arcs)[: graph.size] > 0].sum())


METHODS: dict[str, Callable[[Instance], float]] = {
    "default": default,
    "SciPy dense": scipy_dense,
    "SciPy sparse": scipy_sparse,
    "HiGHS LP": linear_program,
    "HiGHS MILP": integer_program,
    "... presolved": integer_program_presolved,
    "CVXPY + HiGHS": cvxpy_highs,
    "OR-Tools flow": ortools_flow,
}
LARGEST = {"SciPy dense": 10_000}
"""A dense matrix for 100,000 requests would take 40 GB."""


def run(name: str, steps: int, budget: float) -> dict[str, Any]:
    """Run one method in this process: value, median milliseconds of as many runs as fit, and peak megabytes."""
    instance, method = instance_of(steps), METHODS[name]
    method(instance_of(20))  # imports are not timed
    times: list[float] = []
    try:
        while not times or (sum(times) < budget and len(times) < 1_000):
            start = time.perf_counter()
            value = method(instance)
            times.append(time.perf_counter() - start)
    except SolverError as error:
        return {"note": str(error)}
    peak = None
    if times[-1] < MEMORY_LIMIT and (before := forget_peak()) is not None:  # a run of its own: trimming slows it down
        method(instance)
        peak = (status("VmHWM") - before) / 1024
    return {"value": value, "ms": 1e3 * statistics.median(times), "runs": len(times), "peak_mb": peak}


def measure(steps: int, budget: float, console: Console) -> dict[str, Any]:
    """Measure every method at one size, each in a process of its own: OR-Tools cannot be loaded next to highspy."""
    instance = instance_of(steps)
    bound = full_information(instance)
    verdict = bound.certificate.check(instance)
    rows = []
    for name in METHODS:
        row: dict[str, Any] = {"method": name, "note": ""}
        if steps > LARGEST.get(name, steps):
            row["note"] = "too large for memory"
        elif name == "OR-Tools flow" and find_spec("ortools") is None:
            row["note"] = "not installed: optkit[flow]"
        else:
            with console.status(f"{steps:,} steps: {name}"), multiprocessing.get_context("spawn").Pool(1) as pool:
                try:
                    row |= pool.apply_async(run, (name, steps, budget)).get(HARD_LIMIT)
                except multiprocessing.TimeoutError:
                    row["note"] = f"stopped after {HARD_LIMIT:.0f} s without an answer"
        if "value" in row:
            row["gap"] = (verdict.bound - row.pop("value")) / abs(verdict.bound)
        rows.append(row)
    best = min(row["ms"] for row in rows if "ms" in row)
    for row in rows:
        if "ms" in row:
            row["ratio"] = row["ms"] / best
    return {
        "steps": steps,
        "requests": instance.n_requests,
        "workers": instance.n_workers,
        "edges": bound.solver.details["edges"],
        "certified_gap": verdict.gap / abs(verdict.bound),
        "algorithm": bound.solver.details,
        "rows": rows,
    }


def show(result: dict[str, Any]) -> Table:
    """Make the table of one size."""
    title = "{steps:,} steps: {requests:,} requests, {workers:,} workers, {edges:,} edges".format(**result)
    table = Table(title=title, caption=f"certified gap of the default {result['certified_gap']:.0e}")
    for heading in ("method", "ms", "x best", "runs", "gap", "peak MB"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for row in result["rows"]:
        if "ms" not in row:
            table.add_row(row["method"], "-")
            table.caption = f"{table.caption}\n{row['method']}: {row['note']}"
            continue
        memory = "" if row["peak_mb"] is None else f"{row['peak_mb']:,.1f}"
        table.add_row(
            row["method"], f"{row['ms']:,.3f}", f"{row['ratio']:.2f}", str(row["runs"]), f"{row['gap']:.0e}", memory
        )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="The full-information bound against its peers.")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of steps")
    parser.add_argument("--quick", action="store_true", help="sizes up to 1,000, fewer runs")
    parser.add_argument("--output", type=Path, default=RESULTS, help="results file (JSON)")
    options = parser.parse_args()
    sizes = [size for size in options.sizes if size <= 1_000 or not options.quick]
    console = Console()
    versions = machine("optkit", "numpy", "scipy", "highspy", "cvxpy", "ortools")
    console.print(", ".join(f"{key} {value}" for key, value in versions.items() if key != "versions"))
    results = []
    for steps in sizes:
        results.append(measure(steps, 0.2 if options.quick else 2.0, console))
        console.print(show(results[-1]))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    found = {"machine": versions, "milp_limit_s": MILP_LIMIT, "hard_limit_s": HARD_LIMIT, "sizes": results}
    write_whole(options.output, json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
