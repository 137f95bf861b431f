"""Conditional logit against its peers: the same choices, from arrays to estimates with standard errors.

    python benchmarks/estimation.py                       all sizes; a few minutes, most of them spent by the peers
    python benchmarks/estimation.py --quick               10,000 situations, without biogeme
    python benchmarks/estimation.py --sizes 10000 1000000

Ten features, 1 to 8 offers and an outside option. The peers know no outside option: they get it as one more row of
zeros, which is the same model, so that all log-likelihoods agree; "optkit, rows" is ours on those rows. Every peer that
is not installed is skipped and named (`pip install xlogit biogeme "tomlkit<0.14"`). Each run is a process of its own,
with one BLAS thread; the time leaves imports and the drawing of the data out, and keeps what a package makes of the
arrays in (biogeme compiles the model each time).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _machine import machine
from rich.console import Console
from rich.table import Table

RESULTS = Path(__file__).parent / "results" / "estimation.json"
SIZES = (10_000, 100_000, 1_000_000)
FEATURES, LARGEST = 10, 8
HARD_LIMIT = 900.0
"""Seconds after which a run is stopped from outside."""


class Choices(NamedTuple):
    """Rows of offers; ``choice`` is all 0 in a situation whose worker took none."""

    choice: np.ndarray
    x: np.ndarray
    groups: np.ndarray


def draw(situations: int, seed: int = 0) -> Choices:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, LARGEST + 1, situations)
    groups = np.repeat(np.arange(situations), sizes)
    x = rng.normal(size=(len(groups), FEATURES))
    utility = x @ rng.normal(scale=0.5, size=FEATURES) + rng.gumbel(size=len(groups))
    best = np.maximum.reduceat(utility, np.cumsum(sizes) - sizes)
    taken = (utility == best[groups]) & (best > rng.gumbel(size=situations))[groups]
    return Choices(taken.astype(float), x, groups)


def with_outside_row(data: Choices) -> Choices:
    """Write the outside option as a row of zeros at the head of its situation."""
    situations = int(data.groups[-1]) + 1
    idle = 1.0 - np.bincount(data.groups, data.choice, minlength=situations)
    groups = np.concatenate([np.arange(situations), data.groups])
    order = np.argsort(groups, kind="stable")
    x = np.concatenate([np.zeros((situations, FEATURES)), data.x])
    return Choices(np.concatenate([idle, data.choice])[order], x[order], groups[order])


def alternatives(data: Choices) -> np.ndarray:
    """Number the rows of each situation from 0."""
    first = np.flatnonzero(np.diff(data.groups, prepend=-1))
    return np.arange(len(data.groups)) - first[data.groups]


Answer = tuple[float, np.ndarray, np.ndarray]
"""Log-likelihood, estimates, standard errors."""


def ours(data: Choices) -> Callable[[], Answer]:
    from optkit.models.estimation import ConditionalLogit

    def run() -> Answer:
        results = ConditionalLogit(data.choice, data.x, data.groups, outside_option=True).fit()
        return results.llf, results.params, results.bse

    return run


def ours_with_rows(data: Choices) -> Callable[[], Answer]:
    from optkit.models.estimation import ConditionalLogit

    rows = with_outside_row(data)

    def run() -> Answer:
        results = ConditionalLogit(rows.choice, rows.x, rows.groups).fit()
        return results.llf, results.params, results.bse

    return run


def statsmodels(data: Choices) -> Callable[[], Answer]:
    from statsmodels.discrete.conditional_models import ConditionalLogit

    rows = with_outside_row(data)

    def run() -> Answer:
        results = ConditionalLogit(rows.choice, rows.x, groups=rows.groups).fit()
        return results.llf, results.params, results.bse

    return run


def xlogit(data: Choices) -> Callable[[], Answer]:
    from xlogit import MultinomialLogit

    rows = with_outside_row(data)
    place = alternatives(rows)
    names = [f"x{i}" for i in range(FEATURES)]
    # It needs every set in full: the missing rows are zeros that are marked as not available.
    situations = int(rows.groups[-1]) + 1
    full = situations * (LARGEST + 1)
    at = rows.groups * (LARGEST + 1) + place
    x, choice, available = np.zeros((full, FEATURES)), np.zeros(full), np.zeros(full)
    x[at], choice[at], available[at] = rows.x, rows.choice, 1.0
    ids, alts = np.repeat(np.arange(situations), LARGEST + 1), np.tile(np.arange(LARGEST + 1), situations)

    def run() -> Answer:
        model = MultinomialLogit()
        model.fit(X=x, y=choice, varnames=names, ids=ids, alts=alts, avail=available, verbose=0)
        return model.loglikelihood, model.coeff_, model.stderr

    return run


def biogeme(data: Choices) -> Callable[[], Answer]:
    import biogeme.biogeme as bio
    import biogeme.database as db
    import pandas as pd
    from biogeme import models
    from biogeme.expressions import Beta, Variable
    from biogeme.results_processing import EstimateVarianceCovariance

    rows = with_outside_row(data)
    place, situations = alternatives(rows), int(rows.groups[-1]) + 1
    wide = {}
    for j in range(LARGEST + 1):
        here = place == j
        for k in range(FEATURES):
            column = np.zeros(situations)
            column[rows.groups[here]] = rows.x[here, k]
            wide[f"x{j}_{k}"] = column
        wide[f"open{j}"] = np.bincount(rows.groups[here], minlength=situations).astype(float)
    wide["choice"] = place[rows.choice == 1].astype(float)
    table = pd.DataFrame(wide)

    def run() -> Answer:
        betas = [Beta(f"b{k}", 0, None, None, 0) for k in range(FEATURES)]
        every = range(LARGEST + 1)
        utility = {j: sum(betas[k] * Variable(f"x{j}_{k}") for k in range(FEATURES)) for j in every}
        log_probability = models.loglogit(utility, {j: Variable(f"open{j}") for j in every}, Variable("choice"))
        model = bio.BIOGEME(
            db.Database("choices", table),
            log_probability,
            generate_html=False,
            generate_yaml=False,
            save_iterations=False,
            number_of_threads=1,
        )
        model.model_name = "benchmark"
        results = model.estimate()
        values = results.get_beta_values()
        classical = EstimateVarianceCovariance.RAO_CRAMER  # robust ones would be the default
        errors = [results.get_parameter_std_err(f"b{k}", classical) for k in range(FEATURES)]
        return results.final_log_likelihood, np.array([values[f"b{k}"] for k in range(FEATURES)]), np.array(errors)

    return run


class Peer(NamedTuple):
    """Who fits, what it needs, up to how many situations, and how often."""

    build: Callable[[Choices], Callable[[], Answer]]
    package: str
    largest: int
    repeats: int


PEERS = {
    "optkit": Peer(ours, "optkit", 10**9, 5),
    "optkit, rows": Peer(ours_with_rows, "optkit", 10**9, 5),
    "xlogit": Peer(xlogit, "xlogit", 100_000, 3),
    "statsmodels": Peer(statsmodels, "statsmodels", 100_000, 1),
    "biogeme": Peer(biogeme, "biogeme", 10_000, 1),
}


def _measure(name: str, situations: int, pipe: Any) -> None:
    import resource
    import tempfile
    import warnings

    warnings.simplefilter("ignore")
    os.chdir(tempfile.mkdtemp())  # biogeme leaves files where it runs
    try:
        peer, data = PEERS[name], draw(situations)
        run = peer.build(data)
        seconds = []
        for _ in range(peer.repeats):
            start = time.perf_counter()
            value, params, errors = run()
            seconds.append(time.perf_counter() - start)
        answer = {
            "seconds": statistics.median(seconds),
            "fastest": min(seconds),
            "runs": len(seconds),
            "loglikelihood": float(value),
            "params": np.asarray(params, dtype=float).tolist(),
            "errors": np.asarray(errors, dtype=float).tolist(),
            "rows": len(data.groups),
            # Of the whole process: the data and the libraries count.
            "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        }
    except Exception as error:  # a peer that fails is a line of the table, not the end of it
        answer = {"failed": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
    pipe.send(answer)


def measure(name: str, situations: int) -> dict[str, Any]:
    """Run one peer in a process of its own, so that peak memory is its own and a limit can stop it."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_measure, args=(name, situations, sender))
    process.start()
    sender.close()
    try:
        answer = receiver.recv() if receiver.poll(HARD_LIMIT) else {"failed": f"stopped after {HARD_LIMIT:g} s"}
    except EOFError:
        answer = {"failed": "the process died"}
    process.terminate()
    process.join()
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of situations")
    parser.add_argument("--peers", nargs="+", choices=list(PEERS), default=list(PEERS), help="whom to run")
    parser.add_argument("--quick", action="store_true", help="10,000 situations, without biogeme; seconds")
    parser.add_argument("--output", type=Path, default=RESULTS, help="where to write the figures")
    arguments = parser.parse_args()
    for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(threads, "1")  # the runs inherit it
    sizes, names = arguments.sizes, arguments.peers
    if arguments.quick:
        sizes, names = [10_000], [name for name in names if name != "biogeme"]
    console, found = Console(), []
    for name in names:
        if find_spec(PEERS[name].package) is None:
            console.print(f"{name} is skipped: {PEERS[name].package} is not installed")
    names = [name for name in names if find_spec(PEERS[name].package)]
    for situations in sizes:
        table = Table(
            title=f"{situations:,} situations, {FEATURES} features, 1 to {LARGEST} offers and the outside option"
        )
        for column in ("", "seconds", "ratio", "log-likelihood", "params off (s.e.)", "s.e. off", "peak GB"):
            table.add_column(column, justify="left" if not column else "right")
        base: dict[str, Any] | None = None
        for name in names:
            if situations > PEERS[name].largest:
                continue
            with console.status(f"{name}, {situations:,} situations"):
                answer = measure(name, situations)
            answer = {"peer": name, "situations": situations, **answer}
            found.append(answer)
            if "failed" in answer:
                table.add_row(name, answer["failed"])
                continue
            base = base or answer
            errors = np.array(base["errors"])
            answer["ratio"] = answer["seconds"] / base["seconds"]
            answer["loglikelihood_difference"] = answer["loglikelihood"] - base["loglikelihood"]
            answer["params_off"] = float(np.abs((np.array(answer["params"]) - base["params"]) / errors).max())
            answer["errors_off"] = float(np.abs(np.array(answer["errors"]) / errors - 1).max())
            table.add_row(
                name,
                f"{answer['seconds']:.3f}",
                f"{answer['ratio']:.1f}",
                f"{answer['loglikelihood_difference']:+.1e}" if answer is not base else f"{base['loglikelihood']:.1f}",
                f"{answer['params_off']:.1e}",
                f"{answer['errors_off']:.1e}",
                f"{answer['peak_gb']:.2f}",
            )
        console.print(table)
    packages = ("numpy", "scipy", "pandas", "statsmodels", "xlogit", "biogeme")
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    from optkit.basics.files import write_whole  # peers are measured without optkit

    write_whole(arguments.output, json.dumps({"machine": machine(*packages), "runs": found}, indent=1) + "\n")
    console.print(f"written to {arguments.output}")


if __name__ == "__main__":
    main()
