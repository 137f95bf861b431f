"""Two tables, of requests and of workers, as instances, and instances as two tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Bools, Ints, flag, floats, real, text_names, whole_number
from optkit.basics.errors import InstanceError
from optkit.instances.account import Account
from optkit.instances.columns import (
    PREFIX,
    REQUESTS,
    WORKERS,
    frame,
    identifiers_of,
    matrix,
    need,
    no_misspelling,
    numbers_of,
    once,
    optional,
    whole_numbers_of,
)
from optkit.instances.queue import fifo_queue
from optkit.instances.steps import Steps, steps_of

if TYPE_CHECKING:
    import pandas as pd

MOST_STEPS = 10_000_000
"""Steps of a day that can be gone through one by one."""

LONGEST_DAY = 36 * 3600
"""Seconds that two tables may span if nobody said how many steps there are: a night shift, not a month."""


@dataclass(frozen=True)
class Tables:
    """Two tables that were understood: what their columns mean, before they are cut into days and steps.

    Attributes
    ----------
    requests, workers : DataFrame
    groups : tuple of str or None
        Names of the groups, if they have any.
    columns : list of str
        The column of utilities for each group.
    group : (J,) int
        Group of each worker.
    features : list of str
    queue : bool
        Whether the queue makes the steps at which workers are seen.
    account : Account
    """

    requests: pd.DataFrame
    workers: pd.DataFrame
    groups: tuple[str, ...] | None
    columns: list[str]
    group: Ints
    features: list[str]
    queue: bool
    account: Account


def understood(
    requests: Any, workers: Any, features: Sequence[str], queue: bool, more: Sequence[str] = (), remedy: str = "rename"
) -> Tables:
    """Check the columns of two tables and find the groups; ``more`` are columns of other use, such as that of days.

    ``remedy`` says what to do about a column that is called otherwise.

    Raises
    ------
    InstanceError
        If a column is missing, there twice, or nearly has the name of one that may be left out, or a group has no
        utilities.
    """
    queue = flag("queue", queue, error=InstanceError)
    requests, workers = frame("requests", requests), frame("workers", workers)
    features, more = list(map(str, features)), list(map(str, more))
    need("requests", requests, ["arrival", "expiry", "reward", *features, *more], remedy)
    need("workers", workers, ["joined|step", *more], remedy)
    named = [c for c in requests.columns if c.startswith(PREFIX) and len(c) > len(PREFIX)]
    if not named:
        need("requests", requests, ["utility"], remedy)
    once("requests", requests, named)
    once("workers", workers, ["group"])
    group, groups, columns = _groups(requests, workers, [c for c in named if c not in features])
    need("requests", requests, columns, remedy)
    for table, own, known in (
        ("requests", requests, [*REQUESTS, *columns, *features, *more]),
        ("workers", workers, [*WORKERS, *more]),
    ):
        once(table, own, [c for c in known if c in own])
        no_misspelling(table, own, known)
    account = Account({"requests": len(requests), "workers": len(workers)})
    used = {"requests": {*REQUESTS, *columns, *features, *more}, "workers": {*WORKERS, *more}}
    account.unused = {
        "requests": [c for c in requests.columns if c not in used["requests"]],
        "workers": [c for c in workers.columns if c not in used["workers"]],
    }
    queued = (queue and "step" in workers) or "joined" in workers
    return Tables(requests, workers, groups, columns, group, features, queued and not _both(workers, queue), account)


def _both(workers: pd.DataFrame, queue: bool) -> bool:
    """Whether workers joined and were seen at steps that are both known: then no queue makes these."""
    return "joined" in workers and "step" in workers and not queue


def _groups(
    requests: pd.DataFrame, workers: pd.DataFrame, named: list[str]
) -> tuple[Ints, tuple[str, ...] | None, list[str]]:
    """Return the workers' groups as numbers, the names of groups, and the column of utilities of each."""
    numbered = [c for c in named if c.removeprefix(PREFIX).isdecimal()]
    given = workers.get("group")
    text = given is not None and len(given) > 0 and any(isinstance(value, str) for value in given.tolist())
    if not text and (numbered or "utility" in requests or not named or given is not None):
        columns = [f"{PREFIX}{d}" for d in range(len(numbered))] or ["utility"]
        need("requests", requests, columns)
        if given is None:
            return np.zeros(len(workers), np.int64), None, columns
        return _numbered_groups(given, len(columns)), None, columns
    # A column such as utility_note is no group's, unless a worker is of that group.
    names = [c.removeprefix(PREFIX) for c in named]
    if given is None:
        if len(names) > 1:
            raise InstanceError(
                f"the requests table has utilities of the groups {', '.join(names)}, and the workers table no column "
                "'group' that says of which each worker is"
            )
        return np.zeros(len(workers), np.int64), text_names("group_names", names, error=InstanceError), named
    missing = next((i for i, value in enumerate(given.tolist()) if not isinstance(value, str)), None)
    if missing is not None:
        told = f"group in row {given.index[missing]} of the workers table is {given.iloc[missing]!r}"
        raise InstanceError(f"{told}, and no name")
    if "utility" in requests and not names:
        names = sorted(set(given))
        columns = ["utility"] * len(names)  # liked alike by all of them
    else:
        columns = named
        alien = next((i for i, value in enumerate(given) if value not in names), None)
        if alien is not None:
            near = get_close_matches(given.iloc[alien], names, n=1)
            raise InstanceError(
                f"group in row {given.index[alien]} of the workers table is {given.iloc[alien]!r}, and the requests "
                f"table has no column {PREFIX + given.iloc[alien]!r}; it has {', '.join(columns) or 'no utilities'}"
                + (f" (do you mean {near[0]!r}?)" if near else "")
            )
    place = {name: d for d, name in enumerate(names)}
    numbers = np.array([place[value] for value in given], dtype=np.int64)
    return numbers, text_names("group_names", names, error=InstanceError), columns


def _numbered_groups(given: pd.Series, count: int) -> Ints:
    group = whole_numbers_of("group", given)
    alien = (group < 0) | (group >= count)
    if alien.any():
        row = int(alien.argmax())
        raise InstanceError(
            f"group in row {given.index[row]} of the workers table is {group[row]}, and the requests table has "
            f"utilities for the groups 0..{count - 1}: add the column {PREFIX}{group[row]}, or mend the group"
        )
    return group


def fields_of(
    tables: Tables,
    *,
    mu: Any,
    outside_utility: Any,
    horizon: int | None,
    start: Any = None,
    step: Any = None,
) -> dict[str, Any]:
    """Return the fields of an Instance; see :meth:`optkit.Instance.from_frames` for arguments and errors."""
    steps = steps_of(tables.requests, tables.workers, tables.queue, start, step)
    if horizon is not None and whole_number("horizon", horizon, least=1, error=InstanceError) > MOST_STEPS:
        raise InstanceError(f"horizon = {horizon:,} steps: a day has at most {MOST_STEPS:,}; take longer steps")
    if horizon is None:
        latest = [x.max(initial=0) for x in (steps.expiry, steps.worker, *([] if steps.seen is None else [steps.seen]))]
        horizon = int(max(latest)) + 1
        if steps.clock is not None and horizon > MOST_STEPS:
            raise InstanceError(
                f"the tables span {horizon:,} steps of {steps.clock.step:g} s: take longer steps (step)"
            )
        if steps.clock is not None and horizon * steps.clock.step > LONGEST_DAY:
            raise InstanceError(
                f"the tables span {horizon * steps.clock.step / 86_400:.1f} days: name the column of days, or say how "
                "many steps there are (horizon)"
            )
    _refuse_impossible(tables.requests, steps, horizon)
    keep, expiry = np.ones(steps.arrival.size, bool), steps.expiry
    if steps.clock is not None:
        keep = _within(steps.arrival, horizon, tables.account.left_out["requests"], steps, "arrive")
        cut = keep & (expiry >= horizon)
        tables.account.cut += int(cut.sum())
        expiry = np.minimum(expiry, horizon - 1)
    requests = tables.requests
    # All rows are checked, those too that are left out: an error then names the row of the table.
    columns = {
        "arrival": steps.arrival,
        "expiry": expiry,
        "reward": numbers_of("reward", requests["reward"]),
        "penalty": optional(requests, "penalty"),
        "pickup": optional(requests, "pickup", whole=True),
        "dropoff": optional(requests, "dropoff", whole=True),
        "features": matrix("features", requests, tables.features, flags=True),
    }
    if "request_id" in requests:
        columns["request_id"] = identifiers_of("request_id", requests["request_id"])
    return dict(
        horizon=horizon,
        **{name: column[keep] for name, column in columns.items()},
        utility=matrix("utility", requests, tables.columns)[keep].T,
        mu=_by_group("mu", mu, tables),
        outside_utility=_by_group("outside_utility", outside_utility, tables, one=True),
        group_names=tables.groups,
        feature_names=tuple(tables.features) or None,
        clock=steps.clock,
        **_workers(tables, steps, horizon),
    )


def _refuse_impossible(requests: pd.DataFrame, steps: Steps, horizon: int) -> None:
    """Refuse steps that the instance would refuse, by the rows of the table."""
    by_step = steps.clock is None
    for wrong, name, why in (
        (steps.expiry < steps.arrival, "expiry", "comes before its arrival; the last step to serve it is inclusive"),
        (by_step & (steps.arrival < 0), "arrival", "is negative; steps count from 0"),
        (by_step & (steps.expiry >= horizon), "expiry", f"is beyond the last step {horizon - 1}: cut it there"),
    ):
        if wrong.any():
            i = int(wrong.argmax())
            raise InstanceError(f"{name} in row {requests.index[i]} = {getattr(steps, name)[i]} {why}")


def _workers(tables: Tables, steps: Steps, horizon: int) -> dict[str, Any]:
    """Return the fields of those workers who are seen."""
    out = tables.account.left_out["workers"]
    at = steps.worker if steps.seen is None else steps.seen
    order = np.argsort(at, kind="stable")
    order = order[at[order] >= 0] if steps.clock is not None else order
    if steps.clock is not None and (at < 0).any():
        out[f"come {steps.before}"] += int((at < 0).sum())
    joined, seen, kept = at[order], at[order], np.arange(order.size)
    late = joined >= horizon
    if tables.queue:
        seen, kept = fifo_queue(joined, horizon)
        if late.any():
            out[f"join {steps.after or f'at step {horizon} or later'}"] += int(late.sum())
        waiting = order.size - kept.size - int(late.sum())
        if waiting:
            out["still wait in the queue when the day ends"] += waiting
    elif steps.clock is not None:
        if late.any():
            out[f"come {steps.after}"] += int(late.sum())
        seen, kept = seen[~late], kept[~late]
    chosen = order[kept]
    earlier = steps.worker[chosen] if steps.seen is not None else joined[kept] if tables.queue else None
    workers = tables.workers
    named = None
    if "worker_id" in workers:
        named = identifiers_of("worker_id", workers["worker_id"])[chosen]
    return {
        "worker_step": seen,
        "worker_group": tables.group[chosen],
        "worker_id": named,
        "worker_joined": earlier if "joined" in workers or tables.queue else None,
    }


def _within(at: Ints, horizon: int, out: Counter[str], steps: Steps, verb: str) -> Bools:
    early, late = at < 0, at >= horizon
    for outside, where in ((early, steps.before), (late, steps.after)):
        if outside.any():
            out[f"{verb} {where}"] += int(outside.sum())
    return np.asarray(~(early | late))


def _by_group(name: str, value: Any, tables: Tables, one: bool = False) -> Any:
    """Return what was given for each group by its name, or for all alike; a Series goes by its labels, like a dict."""
    if hasattr(value, "iloc") and getattr(value, "ndim", 0) == 1:
        if not value.index.is_unique:
            raise InstanceError(f"{name} is given twice for {value.index[value.index.duplicated()][0]}")
        value = value.to_dict()
    if isinstance(value, Mapping):
        names = tables.groups or tuple(map(str, range(len(tables.columns))))
        given = {str(key): number for key, number in value.items()}
        strange = [key for key in given if key not in names]
        absent = [key for key in names if key not in given]
        if strange or absent:
            raise InstanceError(
                f"{name} is given for {', '.join(given) or 'nobody'}, and the groups are {', '.join(names)}"
            )
        value = [given[key] for key in names]
    if one:
        return value
    array = floats(name, np.atleast_1d(real(name, value, error=InstanceError)), (None,), error=InstanceError)
    return np.full(len(tables.columns), array[0]) if array.size == 1 else array


def tables_of(instance: Any) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return an instance as two tables; see :meth:`optkit.Instance.to_frames`."""
    import pandas as pd

    groups = instance.group_names or tuple(map(str, range(instance.n_groups)))
    several = instance.n_groups > 1 or instance.group_names is not None
    features = instance.feature_names or tuple(f"feature_{f}" for f in range(instance.features.shape[1]))
    requests: dict[str, Any] = {} if instance.request_id is None else {"request_id": instance.request_id}
    requests |= {name: getattr(instance, name) for name in REQUESTS[1:]}
    requests |= dict(zip(features, instance.features.T, strict=True))
    named = [f"{PREFIX}{group}" for group in groups] if several else ["utility"]
    requests |= dict(zip(named, instance.utility, strict=True))
    workers: dict[str, Any] = {} if instance.worker_id is None else {"worker_id": instance.worker_id}
    workers |= {} if instance.worker_joined is None else {"joined": instance.worker_joined}
    workers["step"] = instance.worker_step
    if several:
        by_name = instance.group_names is not None
        workers["group"] = np.array(groups, dtype=object)[instance.worker_group] if by_name else instance.worker_group
    return pd.DataFrame(requests), pd.DataFrame(workers)
