"""Optimal prices in closed form against the same convex program solved again for every state.

    python benchmarks/pricing.py            about a minute
    python benchmarks/pricing.py --quick    seconds

One thread. States: 8 requests of value U(20, 120) and utility -U(5, 60), mu = 1; and, apart, those of the same
distribution in which Lemma 3 prices nothing below 0, so that the exact form has nothing to hold at 0. CVXPY's problems
are DPP: compiled before the clock starts, then only their parameters are set. The goals are held against the faster of

- "PricingProgram": ours, scaled, checked against its dual value, requests that cannot matter left out;
- "plain CVXPY": sum(P) + P_0 = 1 and -mu sum(rel_entr(P, P_0)) as in the literature, unscaled and unchecked.
"""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse  # noqa: E402
import json  # noqa: E402
import statistics  # noqa: E402
import time  # noqa: E402
from collections.abc import Callable  # noqa: E402
from contextlib import suppress  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import cvxpy as cp  # noqa: E402
import numpy as np  # noqa: E402
from _machine import machine  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from optkit.basics.errors import SolverError  # noqa: E402
from optkit.basics.files import write_whole  # noqa: E402
from optkit.models.pricing import certify, optimal_prices  # noqa: E402
from optkit.models.pricing_program import PricingProgram  # noqa: E402

RESULTS = Path(__file__).parent / "results" / "pricing.json"
REQUESTS, MU = 8, 1.0
FORMS: dict[str, Any] = {"paper's form": False, "exact, c >= 0": True, "paper's, clipped": "clip"}
GOALS = {"paper's form": 2_000.0, "exact, c >= 0": 600.0}
"""How many times faster than the faster of the two re-solved problems, at least."""

PEERS = ("PricingProgram", "plain CVXPY")

States = tuple[np.ndarray, np.ndarray]


def all_states(count: int, seed: int = 0) -> States:
    rng = np.random.default_rng(seed)
    return rng.uniform(20, 120, (count, REQUESTS)), -rng.uniform(5, 60, (count, REQUESTS))


def states_with_nothing_held(count: int, seed: int = 1) -> States:
    """Keep the states in which no request is held at compensation 0: about one in 280."""
    kept: list[States] = []
    while sum(len(value) for value, _ in kept) < count:
        value, utility = all_states(500_000, seed)
        free = optimal_prices(value, utility, MU, nonnegative=False).compensation.min(axis=1) >= 0
        kept.append((value[free], utility[free]))
        seed += 1
    value, utility = (np.concatenate(parts)[:count] for parts in zip(*kept, strict=True))
    return value, utility


def seconds(run: Callable[[], object], repeats: int) -> float:
    """Median time of a run; the first is not counted."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def closed_form(states: States, form: Any, repeats: int) -> dict[str, Any]:
    """Price all states at once, then the first thousand one by one."""
    value, utility = states
    each = seconds(lambda: optimal_prices(value, utility, MU, nonnegative=form), repeats) / len(value)
    few = range(min(1_000, len(value)))
    alone = seconds(lambda: [optimal_prices(value[i], utility[i], MU, nonnegative=form) for i in few], 3) / len(few)
    return {"states": len(value), "us": 1e6 * each, "alone_us": 1e6 * alone}


def plain_problem(nonnegative: bool) -> Callable[[np.ndarray, np.ndarray], float]:
    """Write the pricing problem as the literature does; return the function that sets, solves and reads it."""
    # nonneg: else CVXPY evaluates the entropy at P = -1e-12, as the solver returns it, and reports an infinite value.
    P, outside = cp.Variable(REQUESTS, nonneg=True), cp.Variable(nonneg=True)
    a, floor = cp.Parameter(REQUESTS), cp.Parameter(REQUESTS, nonneg=True)
    constraints = [cp.sum(P) + outside == 1] + ([floor * outside <= P] if nonnegative else [])
    problem = cp.Problem(cp.Maximize(a @ P - MU * cp.sum(cp.rel_entr(P, outside))), constraints)
    if not problem.is_dcp(dpp=True):
        raise RuntimeError("the plain problem is not DPP: it would be compiled again for every state")

    def solve(value: np.ndarray, utility: np.ndarray) -> float:
        a.value, floor.value = value + utility, np.exp(utility / MU)
        problem.solve(solver=cp.CLARABEL)
        if problem.status != cp.OPTIMAL:
            raise SolverError(f"ended with status {problem.status}")
        return float(problem.value)

    return solve


def solved(states: States, profit: np.ndarray, solve: Callable[[np.ndarray, np.ndarray], float]) -> dict[str, Any]:
    """Solve the problem for each state; a state that the solver gives up is timed all the same, and counted."""
    for value, utility in zip(*states, strict=True):  # compiles every size of the problem that will occur
        with suppress(SolverError, cp.error.SolverError):
            solve(value, utility)
    times, worst, failed = [], 0.0, 0
    for value, utility, best in zip(*states, profit, strict=True):
        start = time.perf_counter()
        try:
            found = solve(value, utility)
        except (SolverError, cp.error.SolverError):
            failed += 1
        else:
            error = abs(found - best) / (MU + abs(best))
            if np.isfinite(error):
                worst = max(worst, error)
            else:
                failed += 1
        times.append(time.perf_counter() - start)
    return {
        "states": len(times),
        "us": 1e6 * statistics.fmean(times),
        "median_us": 1e6 * statistics.median(times),
        "solver_us": None,
        "error": worst,
        "failed": failed,
    }


def measure(states: States, solves: int, repeats: int) -> dict[str, Any]:
    """Run everything on one set of states."""
    few = states[0][:solves], states[1][:solves]
    exact = optimal_prices(*states, MU)
    proof = certify(exact.compensation, *states, MU)
    ours = {name: closed_form(states, form, repeats) for name, form in FORMS.items()}
    peers = {}
    for label, nonnegative in (("free", False), ("c >= 0", True)):
        profit = optimal_prices(*few, MU, nonnegative=nonnegative).profit
        program, inside = PricingProgram(REQUESTS, nonnegative), []

        def priced(
            value: np.ndarray, utility: np.ndarray, program: PricingProgram = program, inside: list[float] = inside
        ) -> float:
            solution = program.solve(value, utility, MU)
            inside.append(solution.seconds)
            return solution.profit

        peers[f"PricingProgram, {label}"] = solved(few, profit, priced)
        peers[f"PricingProgram, {label}"]["solver_us"] = 1e6 * statistics.fmean(inside)
        peers[f"plain CVXPY, {label}"] = solved(few, profit, plain_problem(nonnegative))
    for name, row in ours.items():
        label = "c >= 0" if FORMS[name] is True else "free"
        for peer in PEERS:
            row[f"times faster than {peer}"] = peers[f"{peer}, {label}"]["us"] / row["us"]
    return {
        "closed_form": ours,
        "solver": peers,
        "states_with_a_request_held_at_0": float((exact.compensation == 0).any(axis=1).mean()),
        "certified_optimal": float(np.mean(proof.optimal)),
        "largest_gap": float(np.max(proof.gap)),
    }


def show(title: str, result: dict[str, Any]) -> Table:
    """Make the table of one set of states."""
    held, proven = result["states_with_a_request_held_at_0"], result["certified_optimal"]
    table = Table(
        title=title,
        caption=f"{held:.1%} of the states hold a request at 0; {proven:.1%} certified optimal, "
        f"largest gap {result['largest_gap']:.0e}",
    )
    for heading in ("method", "states/s", "us", "us alone", "x ours", "x plain", "error", "failed"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for name, row in result["closed_form"].items():
        ratios = [row[f"times faster than {peer}"] for peer in PEERS]
        table.add_row(name, f"{1e6 / row['us']:,.0f}", f"{row['us']:.3f}", f"{row['alone_us']:.1f}",
                      *(f"{ratio:,.0f}" for ratio in ratios))  # fmt: skip
    for name, row in result["solver"].items():
        table.add_row(name, f"{1e6 / row['us']:,.0f}", f"{row['us']:,.0f}", "", "", "", f"{row['error']:.0e}",
                      f"{row['failed']} of {row['states']}")  # fmt: skip
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description="Optimal prices in closed form against CVXPY.")
    parser.add_argument("--states", type=int, default=100_000, help="states priced in closed form")
    parser.add_argument("--solves", type=int, default=200, help="states solved by CVXPY")
    parser.add_argument("--quick", action="store_true", help="10,000 states, 50 of them solved")
    parser.add_argument("--output", type=Path, default=RESULTS, help="results file (JSON)")
    options = parser.parse_args()
    count, solves = (10_000, 50) if options.quick else (options.states, options.solves)
    console = Console()
    if not console.is_terminal:
        console.width = 110
    record: dict[str, Any] = {
        "machine": machine("optkit", "numpy", "scipy", "cvxpy", "clarabel"),
        "threads": 1,
        "requests": REQUESTS,
        "mu": MU,
        "goals": GOALS,
    }
    console.print(", ".join(f"{key} {value}" for key, value in record["machine"].items() if key != "versions"))
    for title, draw in (("all states", all_states), ("nothing held at 0", states_with_nothing_held)):
        record[title] = measure(draw(count), solves, 3 if options.quick else 7)
        console.print(show(f"{count:,} states of {REQUESTS} requests, {title}", record[title]))
        for name, goal in GOALS.items():
            row = record[title]["closed_form"][name]
            ratio = min(row[f"times faster than {peer}"] for peer in PEERS)
            console.print(
                f"{name}: {ratio:,.0f} times faster, goal {goal:,.0f}: {'met' if ratio >= goal else 'MISSED'}"
            )
    options.output.parent.mkdir(parents=True, exist_ok=True)
    write_whole(options.output, json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
