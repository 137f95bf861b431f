"""Two tables, of requests and of workers, as instances, and instances as two tables."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Ints, flag, floats, ints, real, whole_number
from optkit.basics.errors import InstanceError
from optkit.basics.printable import listed
from optkit.instances.clock import (
    SECOND,
    TIME_OF_DAY,
    Clock,
    Instants,
    at_time_of_day,
    instants,
    is_time,
    seconds_of,
    timestamp,
)
from optkit.instances.labels import identifiers, names_of
from optkit.instances.queue import fifo_queue

if TYPE_CHECKING:
    import pandas as pd

REQUESTS = ("request_id", "arrival", "expiry", "reward", "penalty", "pickup", "dropoff")
"""Columns of a table of requests, beside utilities and features."""

WORKERS = ("worker_id", "joined", "step", "group")
"""Columns of a table of workers."""

PREFIX = "utility_"

MOST_STEPS = 10_000_000
"""Steps of a day that can be gone through one by one."""

LONGEST_DAY = 36 * 3600
"""Seconds that two tables may span if nobody said how many steps there are: a night shift, not a month."""


class LeftOutWarning(UserWarning):
    """Rows or columns of a table have no part in the instance that was made of it; how many, and why."""


@dataclass
class Account:
    """What became of the rows and columns of two tables.

    Attributes
    ----------
    rows : dict of str to int
        Rows of each table.
    left_out : dict of str to Counter
        Rows of each table that are in no instance, by reason.
    cut : int
        Requests that are open when the day ends, and expire then.
    unused : dict of str to list of str
        Columns of each table that play no part.
    notes : list of str
        What else is to be told.
    """

    rows: dict[str, int]
    left_out: dict[str, Counter[str]] = field(default_factory=lambda: {"requests": Counter(), "workers": Counter()})
    cut: int = 0
    unused: dict[str, list[str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Return what was left out, a line each; none if nothing was."""
        told = []
        for table, reasons in self.left_out.items():
            if reasons.total():
                why = " and ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
                told.append(f"{reasons.total()} of {self.rows[table]} {table} are left out: {why}")
        if self.cut:
            told.append(f"{self.cut} of {self.rows['requests']} requests are open when the day ends, and expire there")
        for table, columns in self.unused.items():
            if columns:
                told.append(f"the {table} table has columns that play no part: {', '.join(columns)}")
        return [*told, *self.notes]

    def forget(self) -> None:
        """Begin to count anew."""
        self.cut, self.left_out = 0, {table: Counter() for table in self.left_out}

    def warn(self, stacklevel: int) -> None:
        """Warn of all that was left out."""
        if self.lines():
            warnings.warn("; ".join(self.lines()), LeftOutWarning, stacklevel=stacklevel + 1)


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


def frame(name: str, table: Any) -> pd.DataFrame:
    """Return a table of pandas, polars or pyarrow as a DataFrame whose columns are called by text.

    Raises
    ------
    InstanceError
        If it is no table.
    """
    import pandas as pd

    if not isinstance(table, pd.DataFrame) and hasattr(table, "to_pandas"):
        table = table.to_pandas()
    if isinstance(table, Mapping):
        table = pd.DataFrame(dict(table))
    if not isinstance(table, pd.DataFrame) or table.columns.nlevels > 1:
        raise InstanceError(f"{name} is a {type(table).__name__}: give a table of pandas, polars or pyarrow")
    return table.set_axis([str(column) for column in table.columns], axis=1)


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
    _need("requests", requests, ["arrival", "expiry", "reward", *features, *more], remedy)
    _need("workers", workers, ["joined|step", *more], remedy)
    named = [c for c in requests.columns if c.startswith(PREFIX) and len(c) > len(PREFIX)]
    if not named:
        _need("requests", requests, ["utility"], remedy)
    group, groups, columns = _groups(requests, workers, [c for c in named if c not in features])
    _need("requests", requests, columns, remedy)
    for table, own, known in (
        ("requests", requests, [*REQUESTS, *columns, *features, *more]),
        ("workers", workers, [*WORKERS, *more]),
    ):
        _once(table, own, [c for c in known if c in own])
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
        _need("requests", requests, columns)
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
        return np.zeros(len(workers), np.int64), names_of("group_names", names, len(names)), named
    missing = next((i for i, value in enumerate(given.tolist()) if not isinstance(value, str)), None)
    if missing is not None:
        raise InstanceError(f"group in row {missing} of the workers table is {given.iloc[missing]!r}, and no name")
    if "utility" in requests and not names:
        names = sorted(set(given))
        columns = ["utility"] * len(names)  # liked alike by all of them
    else:
        columns = named
        alien = next((i for i, value in enumerate(given) if value not in names), None)
        if alien is not None:
            near = get_close_matches(given.iloc[alien], names, n=1)
            raise InstanceError(
                f"group in row {alien} of the workers table is {given.iloc[alien]!r}, and the requests table has no "
                f"column {PREFIX + given.iloc[alien]!r}; it has {', '.join(columns) or 'no utilities'}"
                + (f" (do you mean {near[0]!r}?)" if near else "")
            )
    place = {name: d for d, name in enumerate(names)}
    numbers = np.array([place[value] for value in given], dtype=np.int64)
    return numbers, names_of("group_names", names, len(names)), columns


def _numbered_groups(given: pd.Series, count: int) -> Ints:
    group = ints("group", given, (len(given),), error=InstanceError)
    alien = (group < 0) | (group >= count)
    if alien.any():
        row = int(alien.argmax())
        raise InstanceError(
            f"group in row {row} of the workers table is {group[row]}, and the requests table has utilities for the "
            f"groups 0..{count - 1}: add the column {PREFIX}{group[row]}, or mend the group"
        )
    return group


@dataclass(frozen=True)
class Steps:
    """When requests and workers come, in steps, and what falls outside.

    Attributes
    ----------
    arrival, expiry, worker : int arrays
        Steps from 0; workers join the queue then, or are seen.
    seen : int array or None
        Steps at which workers are seen, where they joined earlier.
    clock : Clock or None
    before, after : str
        What to say of what comes before the first step and after the last.
    """

    arrival: Ints
    expiry: Ints
    worker: Ints
    seen: Ints | None
    clock: Clock | None
    before: str = ""
    after: str = ""


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
    steps = _steps(tables, start, step)
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
        "reward": floats("reward", requests["reward"], keep.shape, error=InstanceError),
        "penalty": _optional(requests, "penalty"),
        "pickup": _optional(requests, "pickup", whole=True),
        "dropoff": _optional(requests, "dropoff", whole=True),
        "features": _matrix("features", requests, tables.features, flags=True),
    }
    if "request_id" in requests:
        columns["request_id"] = identifiers("request_id", requests["request_id"].to_numpy(dtype=object), keep.size)
    return dict(
        horizon=horizon,
        **{name: column[keep] for name, column in columns.items()},
        utility=_matrix("utility", requests, tables.columns)[keep].T,
        mu=_by_group("mu", mu, tables),
        outside_utility=_by_group("outside_utility", outside_utility, tables, one=True),
        group_names=tables.groups,
        feature_names=tuple(tables.features) or None,
        clock=steps.clock,
        **_workers(tables, steps, horizon),
    )


def _optional(requests: pd.DataFrame, name: str, whole: bool = False) -> npt.NDArray[Any]:
    """Return a column that may be left out, and is 0 then."""
    if name not in requests:
        return np.zeros(len(requests), np.int64 if whole else float)
    column = (ints if whole else floats)(name, requests[name], (len(requests),), error=InstanceError)
    wrong = column < 0 if whole else column > 0
    if wrong.any():
        why = "is negative; locations count from 0" if whole else "is positive; write a cost of expiry as a number <= 0"
        raise InstanceError(f"{name}[{int(wrong.argmax())}] = {column[int(wrong.argmax())]} {why}")
    return column


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
        named = identifiers("worker_id", workers["worker_id"].to_numpy(dtype=object), len(workers))[chosen]
    return {
        "worker_step": seen,
        "worker_group": tables.group[chosen],
        "worker_id": named,
        "worker_joined": earlier if "joined" in workers or tables.queue else None,
    }


def _steps(tables: Tables, start: Any, step: Any) -> Steps:
    """Return all times as steps: as they are, or by the clock."""
    requests, workers = tables.requests, tables.workers
    come = "joined" if "joined" in workers else "step"
    columns = {"arrival": requests["arrival"], "expiry": requests["expiry"], come: workers[come]}
    if "joined" in workers and "step" in workers and not tables.queue:
        columns["step"] = workers["step"]
    timed = {name: is_time(column) for name, column in columns.items() if len(column)}
    if not any(timed.values()):
        if timed and (start is not None or step is not None):
            wanted = "start" if start is not None else "step"
            raise InstanceError(f"{wanted} goes with timestamps, and the tables count steps: leave it out")
        whole = {
            name: ints(name, column if len(column) else [], (len(column),), error=InstanceError)
            for name, column in columns.items()
        }
        seen = whole.get("step") if come == "joined" else None
        return Steps(whole["arrival"], whole["expiry"], whole[come], seen, None)
    if not all(timed.values()):
        at, count = (next(name for name, is_ in timed.items() if is_ == want) for want in (True, False))
        raise InstanceError(f"{at} holds times and {count} numbers of steps: give times in both, or in none")
    if step is None:
        raise InstanceError("arrival holds times: say how long a step is, such as 15s (step)")
    return _by_clock({name: instants(name, column) for name, column in columns.items()}, come, start, seconds_of(step))


def _by_clock(found: dict[str, Instants], come: str, start: Any, seconds: float) -> Steps:
    import pandas as pd

    zones = {name: one.zone for name, one in found.items() if one.nanoseconds.size}
    aware = [name for name, zone in zones.items() if zone is not None]
    if aware and len(aware) < len(zones):
        bare = next(name for name, zone in zones.items() if zone is None)
        raise InstanceError(f"{aware[0]} has a time zone and {bare} has none: give both one, or neither")
    width = round(seconds * SECOND)
    first = _first([found["arrival"], found[come]])
    opening = first.floor(pd.Timedelta(width, unit="ns")) if start is None else _start(start, first)
    begin = int(opening.value)

    def floor(name: str) -> Ints:
        return np.asarray((found[name].nanoseconds - begin) // width, dtype=np.int64)

    # A deadline at the very beginning of a step leaves no time in it.
    expiry = np.asarray(-((begin - found["expiry"].nanoseconds) // width) - 1, dtype=np.int64)
    early = found["expiry"].nanoseconds < found["arrival"].nanoseconds
    if early.any():
        raise InstanceError(f"expiry in row {int(early.argmax())} comes before its arrival")
    clock = Clock(opening.isoformat(), seconds)
    return Steps(
        arrival=floor("arrival"), expiry=np.maximum(expiry, floor("arrival")), worker=floor(come),
        seen=floor("step") if come == "joined" and "step" in found else None, clock=clock,
        before=f"before the start, {opening.time()}", after="after the day's last step",
    )  # fmt: skip


def _first(found: Sequence[Instants]) -> pd.Timestamp:
    """Return the earliest of all times, in its time zone."""
    import pandas as pd

    one = min((one for one in found if one.nanoseconds.size), key=lambda one: int(one.nanoseconds.min()))
    first = pd.Timestamp(int(one.nanoseconds.min()), tz=None if one.zone is None else "UTC")
    return first if one.zone is None else first.tz_convert(one.zone)


def first_time(tables: Tables) -> pd.Timestamp | None:
    """Return when the first request or worker comes; None if nobody does, or steps are counted."""
    columns = {"arrival": tables.requests["arrival"]}
    columns |= {name: tables.workers[name] for name in ("joined", "step") if name in tables.workers}
    timed = [instants(name, column) for name, column in columns.items() if len(column) and is_time(column)]
    return _first(timed) if timed else None


def _start(start: Any, first: pd.Timestamp) -> pd.Timestamp:
    """Return the start that somebody gave: a date and time, a time of day of the first date, or a date with one."""
    if isinstance(start, tuple):
        return at_time_of_day(*start)
    if isinstance(start, str) and TIME_OF_DAY.fullmatch(start.strip()):
        return at_time_of_day(first, start.strip())
    found = timestamp(start)
    if found is None:
        raise InstanceError(f"start = {start!r} is no time: write it like 08:00 or 2026-03-02T08:00:00")
    if (found.tzinfo is None) != (first.tzinfo is None):
        if found.tzinfo is None:
            return found.tz_localize(first.tzinfo)
        raise InstanceError(f"start = {start!r} has a time zone and the tables have none: leave it out")
    return found


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


def no_misspelling(table: str, own: pd.DataFrame, known: Sequence[str]) -> None:
    """Refuse a column that nearly has the name of one that is not there: it would count as 0 in silence."""
    absent = [name for name in known if name not in own]
    for column in own.columns:
        near = get_close_matches(column.strip().lower(), absent, n=1, cutoff=0.75) if column not in known else []
        if near:
            raise InstanceError(
                f"the {table} table has a column {column!r} and none {near[0]!r}: rename it, or drop it if that is "
                "something else"
            )


def _need(table: str, own: pd.DataFrame, columns: Sequence[str], remedy: str = "rename") -> None:
    """Raise an error unless the columns are there, once; ``joined|step`` is one that may be called either."""
    missing = [c for c in columns if not any(name in own for name in c.split("|"))]
    if missing:
        have, named = listed(own.columns), ", ".join(repr(c).replace("|", "' or '") for c in missing)
        what = [c.partition("|")[0] for c in missing]
        raise InstanceError(f"the {table} table has no column {named}; it has: {have}. {_mend(remedy, what)}")
    _once(table, own, columns)


def _mend(remedy: str, missing: Sequence[str]) -> str:
    one = "it is" if len(missing) == 1 else "they are"
    if remedy == "rename":
        return f"Rename what {one} called otherwise"
    return f"Say what {one} called: {remedy} {','.join(f'{name}=COLUMN' for name in missing)}"


def _once(table: str, own: pd.DataFrame, columns: Sequence[str]) -> None:
    times = Counter(own.columns)
    double = next((c for c in columns if times[c] > 1), None)
    if double is not None:
        raise InstanceError(f"the {table} table has the column {double!r} twice; leave one")


def _matrix(name: str, own: pd.DataFrame, columns: list[str], flags: bool = False) -> Floats:
    """Return columns of a table as a matrix, (rows, columns); an error names the column."""
    matrix = np.empty((len(own), len(columns)))
    for c, column in enumerate(columns):
        label = column if column.startswith(name) else f"{name} {column!r}"
        matrix[:, c] = floats(label, own[column], (len(own),), flags=flags, error=InstanceError)
    return matrix


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
