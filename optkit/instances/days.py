"""Two tables of many days, cut into one instance a day by a column."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InstanceError
from optkit.instances.account import Account
from optkit.instances.clock import TIME_OF_DAY, seconds_of, timestamp
from optkit.instances.frames import Tables, fields_of, understood
from optkit.instances.instance import Instance
from optkit.instances.steps import first_time


@dataclass(frozen=True)
class Days:
    """Instances by day, and what became of the rows.

    Attributes
    ----------
    instances : dict of str to Instance
        In the order of the days.
    account : Account
    """

    instances: dict[str, Instance]
    account: Account


def days_from_frames(
    requests: Any,
    workers: Any,
    *,
    day: str,
    mu: npt.ArrayLike | Mapping[str, float] = 1.0,
    outside_utility: float | npt.ArrayLike | Mapping[str, float] = 0.0,
    horizon: int | None = None,
    start: Any = None,
    step: Any = None,
    features: Sequence[str] = (),
    queue: bool = False,
) -> dict[str, Instance]:
    """Cut two tables into one instance a day; all have the groups, the features and the horizon of all.

    Parameters
    ----------
    requests, workers : DataFrame, or table of polars or pyarrow
        As of :meth:`optkit.Instance.from_frames`, and each with a column of days.
    day : str
        That column: dates, or any names of days.
    mu, outside_utility : float, (D,) float, or dict or Series of group to float
        As of :meth:`optkit.Instance.from_frames`.
    horizon : int, optional
        Steps of each day; as many as the longest has, unless given.
    start : str, optional
        Time of day at which each begins, in the tables' time zone; the earliest of all days unless given.
    step : str, Timedelta or float
        As of :meth:`optkit.Instance.from_frames`.
    features : sequence of str
        As of :meth:`optkit.Instance.from_frames`.
    queue : bool
        As of :meth:`optkit.Instance.from_frames`.

    Returns
    -------
    dict of str to Instance
        By day, in order.

    Raises
    ------
    InstanceError
        As of :meth:`optkit.Instance.from_frames`, with the day; or if a row has no day.

    Warns
    -----
    LeftOutWarning
        Of all that is left out, on all days together.

    Examples
    --------
    >>> import pandas as pd
    >>> requests = pd.DataFrame({"date": ["Mon", "Tue"], "arrival": 0, "expiry": [2, 1], "reward": 9.0, "utility": 1.0})
    >>> workers = pd.DataFrame({"date": ["Mon", "Mon", "Tue"], "joined": [0, 0, 1]})
    >>> {day: one.n_workers for day, one in days_from_frames(requests, workers, day="date").items()}
    {'Mon': 2, 'Tue': 1}
    """
    given = {"mu": mu, "outside_utility": outside_utility, "horizon": horizon, "start": start, "step": step}
    found = cut_into_days(understood(requests, workers, features, queue, [str(day)]), str(day), **given)
    found.account.warn(stacklevel=2)
    return found.instances


def cut_into_days(tables: Tables, day: str, *, horizon: int | None, start: Any, step: Any, **more: Any) -> Days:
    """Return the instance of each day of tables that were understood; see :func:`days_from_frames`."""
    of = {name: _days(name, getattr(tables, name)[day]) for name in ("requests", "workers")}
    for name, other in (("requests", "workers"), ("workers", "requests")):
        alone = sorted({*of[name]} - {*of[other]}, key=_order)
        if alone:
            few = f"{', '.join(alone[:3])}{' ...' if len(alone) > 3 else ''}"
            tables.account.notes.append(f"{len(alone)} days have {name} and no {other}: {few}")
    wanted = sorted({*of["requests"], *of["workers"]}, key=_order)
    parts = {}
    for one in wanted:
        rows = {name: np.array([label == one for label in labels], bool) for name, labels in of.items()}
        parts[one] = replace(
            tables,
            requests=tables.requests[rows["requests"]],
            workers=tables.workers[rows["workers"]],
            group=tables.group[rows["workers"]],
        )
    begins = {one: _begin(one, part, start, step, parts) for one, part in parts.items()}

    def fields(one: str, horizon: int | None) -> dict[str, Any]:
        try:
            return fields_of(parts[one], horizon=horizon, start=begins[one], step=step, **more)
        except InstanceError as error:
            raise InstanceError(f"day {one}: {error}") from None

    if horizon is None:
        horizon = max((fields(one, None)["horizon"] for one in wanted), default=1)
        tables.account.forget()
    made = {}
    for one in wanted:
        try:
            made[one] = Instance(**fields(one, horizon))
        except InstanceError as error:
            raise error if str(error).startswith("day ") else InstanceError(f"day {one}: {error}") from None
    return Days(made, tables.account)


def _days(name: str, column: Any) -> list[str]:
    """Return the day of each row: a date without its time, or what it is called."""
    import pandas as pd

    labels = []
    for row, value in column.items():
        if pd.isna(value) or (isinstance(value, str) and not value.strip()):
            raise InstanceError(f"the {name} table has no day in row {row}: fill it in or drop the row")
        if isinstance(value, float) and value.is_integer():
            value = int(value)  # a gap elsewhere made it one
        date = timestamp(value)
        text = str(value).strip()
        text = text.removesuffix(".0") if re.fullmatch(r"\d+\.0", text) else text
        labels.append(text if date is None else date.date().isoformat())
    return labels


def _order(label: str) -> tuple[bool, float, str]:
    number = label.isdecimal() and len(label) < 16
    return (not number, float(label) if number else 0.0, label)


def _begin(label: str, part: Tables, start: Any, step: Any, parts: dict[str, Tables]) -> Any:
    """Return when a day begins: at the time of day that was given, or the earliest of all."""
    import pandas as pd

    if step is None:
        return start
    if start is None:
        firsts = [first_time(one.requests, one.workers) for one in parts.values()]
        width = pd.Timedelta(seconds=seconds_of(step))
        earliest = min((first.floor(width).time() for first in firsts if first is not None), default=None)
        start = None if earliest is None else earliest.replace(microsecond=0).isoformat()
    if isinstance(start, str) and TIME_OF_DAY.fullmatch(start.strip()):
        date, first = timestamp(label), first_time(part.requests, part.workers)
        if date is not None and first is not None:
            return date.replace(tzinfo=first.tzinfo), start.strip()
        return start
    if timestamp(start) is not None and len(parts) > 1:
        raise InstanceError(
            f"start = {start!r} is of one day, and there are {len(parts)}: give a time of day, like 08:00"
        )
    return start
