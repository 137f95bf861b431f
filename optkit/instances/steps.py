"""When requests and workers of two tables come, in steps: as the tables count them, or by a clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Ints
from optkit.basics.errors import InstanceError
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
    zone_name,
)
from optkit.instances.columns import whole_numbers_of

if TYPE_CHECKING:
    import pandas as pd


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


def steps_of(requests: pd.DataFrame, workers: pd.DataFrame, queue: bool, start: Any, step: Any) -> Steps:
    """Return all times as steps: as they are, or by the clock."""
    come = "joined" if "joined" in workers else "step"
    columns = {"arrival": requests["arrival"], "expiry": requests["expiry"], come: workers[come]}
    if "joined" in workers and "step" in workers and not queue:
        columns["step"] = workers["step"]
    timed = {name: is_time(column) for name, column in columns.items() if len(column)}
    if not any(timed.values()):
        if timed and (start is not None or step is not None):
            wanted = "start" if start is not None else "step"
            raise InstanceError(f"{wanted} goes with timestamps, and the tables count steps: leave it out")
        whole = {name: whole_numbers_of(name, column) for name, column in columns.items()}
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
        raise InstanceError(f"expiry in row {found['expiry'].rows[int(early.argmax())]} comes before its arrival")
    clock = Clock(opening.isoformat(), seconds, zone_name(opening.tzinfo))
    return Steps(
        arrival=floor("arrival"), expiry=np.maximum(expiry, floor("arrival")), worker=floor(come),
        seen=floor("step") if come == "joined" and "step" in found else None, clock=clock,
        before=f"before the start, {opening.time()}", after="after the day's last step",
    )  # fmt: skip


def _first(found: Sequence[Instants]) -> pd.Timestamp:
    """Return the earliest of all times, in the time zone of the first column that has any: the requests'."""
    import pandas as pd

    some = [one for one in found if one.nanoseconds.size]
    earliest, zone = min(int(one.nanoseconds.min()) for one in some), some[0].zone
    return pd.Timestamp(earliest) if zone is None else pd.Timestamp(earliest, tz="UTC").tz_convert(zone)


def first_time(requests: pd.DataFrame, workers: pd.DataFrame) -> pd.Timestamp | None:
    """Return when the first request or worker comes; None if nobody does, or steps are counted."""
    columns = {"arrival": requests["arrival"]}
    columns |= {name: workers[name] for name in ("joined", "step") if name in workers}
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
