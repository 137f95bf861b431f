"""Two tables, of requests and of workers, as the fields of an instance."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, floats, ints, real
from optkit.basics.errors import InstanceError
from optkit.instances.queue import fifo_queue

if TYPE_CHECKING:
    import pandas as pd

REQUESTS = ("arrival", "expiry", "reward", "penalty", "pickup", "dropoff")
"""Columns of a table of requests, beside utilities and features."""

WORKERS = ("step", "group")
"""Columns of a table of workers."""


class LeftOutWarning(UserWarning):
    """Rows of a table have no part in the instance that was made of it; how many, and why."""


def fields_from_frames(
    requests: pd.DataFrame,
    workers: pd.DataFrame,
    mu: npt.ArrayLike,
    outside_utility: npt.ArrayLike,
    horizon: int | None,
    features: Sequence[str],
    queue: bool,
) -> dict[str, Any]:
    """Return the fields of an Instance; see :meth:`optkit.Instance.from_frames` for arguments and errors."""
    _need("requests", requests, ["arrival", "expiry", "reward", *features])
    _need("workers", workers, ["step"])
    mu = floats("mu", np.atleast_1d(real("mu", mu, error=InstanceError)), (None,), error=InstanceError)
    numbered = [c for c in requests.columns if isinstance(c, str) and re.fullmatch(r"utility_\d+", c)]
    columns = [f"utility_{d}" for d in range(len(numbered))] or ["utility"]
    _need("requests", requests, columns)
    _no_misspelling("requests", requests, [*REQUESTS, *columns], features)
    _no_misspelling("workers", workers, WORKERS)
    if mu.size == 1:
        mu = np.full(len(columns), mu[0])
    n = len(requests)
    step = ints("step", workers["step"], (len(workers),), error=InstanceError)
    order = np.argsort(step, kind="stable")
    step = step[order]
    group = workers["group"].to_numpy()[order] if "group" in workers else np.zeros(len(step), int)
    expiry = ints("expiry", requests["expiry"], (n,), error=InstanceError)
    if horizon is None:
        horizon = int(max(expiry.max(initial=0), step.max(initial=0))) + 1
    if queue:
        joined = step
        step, served = fifo_queue(joined, horizon)
        group = group[served]
        _tell_left_out(joined, served, horizon)
    return dict(
        horizon=horizon,
        **{name: requests[name].to_numpy() for name in ("arrival", "expiry", "reward")},
        **{
            name: requests[name].to_numpy() if name in requests else np.zeros(n, kind)
            for name, kind in (("penalty", float), ("pickup", int), ("dropoff", int))
        },
        features=_columns("features", requests, list(features), flags=True),
        worker_step=step,
        worker_group=group,
        utility=_columns("utility", requests, columns).T,
        mu=mu,
        outside_utility=outside_utility,
    )


def _no_misspelling(table: str, frame: pd.DataFrame, known: Sequence[str], taken: Sequence[str] = ()) -> None:
    """Refuse a column that nearly has the name of one that is not there: it would count as 0 in silence."""
    absent = [name for name in known if name not in frame]
    for column in frame.columns:
        if not isinstance(column, str) or column in known or column in taken:
            continue
        near = get_close_matches(column.strip().lower(), absent, n=1, cutoff=0.75)
        if near:
            raise InstanceError(
                f"the {table} table has a column {column!r} and none {near[0]!r}: rename it, or drop it if that is "
                "something else"
            )


def _tell_left_out(joined: Ints, served: Ints, horizon: int) -> None:
    """Warn of workers whom nobody sees, with their number."""
    late = int((joined >= horizon).sum())
    waiting = joined.size - served.size - late
    told = [f"{late} join at step {horizon} or later"] if late else []
    told += [f"{waiting} still wait in the queue when the day ends"] if waiting else []
    if told:
        warnings.warn(
            f"{late + waiting} of {joined.size} workers are left out of the {horizon} steps: {' and '.join(told)}",
            LeftOutWarning,
            stacklevel=4,
        )


def _need(table: str, frame: pd.DataFrame, columns: Sequence[str]) -> None:
    missing = [c for c in columns if c not in frame]
    if missing:
        have = ", ".join(map(str, frame.columns))
        raise InstanceError(f"the {table} table has no column {', '.join(map(repr, missing))}; it has: {have}")
    double = next((c for c in columns if list(frame.columns).count(c) > 1), None)
    if double is not None:
        raise InstanceError(f"the {table} table has the column {double!r} twice; leave one")


def _columns(name: str, frame: pd.DataFrame, columns: list[str], flags: bool = False) -> Floats:
    """Return columns of a table as a matrix, (rows, columns); an error names the column."""
    matrix = np.empty((len(frame), len(columns)))
    for c, column in enumerate(columns):
        label = column if column.startswith(name) else f"{name} {column!r}"
        matrix[:, c] = floats(label, frame[column], (len(frame),), flags=flags, error=InstanceError)
    return matrix
