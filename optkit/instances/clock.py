"""Times and steps: what a platform's clock says, and the steps that it is cut into."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Ints, number
from optkit.basics.errors import InstanceError

if TYPE_CHECKING:
    import pandas as pd

SECOND = 1_000_000_000
"""Nanoseconds."""

ZONED = re.compile(r"(?:Z|[+-]\d{2}:?\d{2})$")
TIME_OF_DAY = re.compile(r"\d{1,2}:\d{2}(?::\d{2})?")


@dataclass(frozen=True)
class Clock:
    """When step 0 begins, and how long a step is.

    Attributes
    ----------
    start : str
        Date and time in ISO form, with the offset from UTC if the tables have one.
    step : float
        Seconds.
    zone : str, optional
        Name of the time zone, such as Europe/Berlin, if the tables have one whose clocks may change.

    Examples
    --------
    >>> clock = Clock("2026-03-02T08:00:00", 15.0)
    >>> clock.time_of(2).isoformat(), clock.step_at("2026-03-02T08:00:31"), clock.step_at("8:01")
    ('2026-03-02T08:00:30', 2, 4)
    """

    start: str
    step: float
    zone: str | None = None

    def __post_init__(self) -> None:
        import pandas as pd

        if timestamp(self.start) is None or not isinstance(self.start, str):
            raise InstanceError(f"the clock starts at {self.start!r}: give a date and time, like 2026-03-02T08:00:00")
        object.__setattr__(self, "step", number("the clock's step", self.step, above=0.0, error=InstanceError))
        if self.zone is not None:
            try:
                known = pd.Timestamp(self.start).tz_convert(self.zone)
            except (IndexError, KeyError, OSError, TypeError, ValueError):
                known = None
            if known is None or known.utcoffset() != pd.Timestamp(self.start).utcoffset():
                raise InstanceError(f"the clock's zone {self.zone!r} is none in which it is {self.start}")

    @staticmethod
    def describes(plain: Any) -> bool:
        """Whether plain data have the attributes of a clock and no others."""
        return isinstance(plain, dict) and {"start", "step"} <= set(plain) <= {"start", "step", "zone"}

    @classmethod
    def read(cls, plain: Any) -> Clock:
        """Make a clock again from its attributes in a dict.

        Raises
        ------
        InstanceError
            If one is missing, unknown or wrong.
        """
        if not cls.describes(plain):
            raise InstanceError(f"a clock has start, step and perhaps zone, and not {str(plain)[:80]}")
        return cls(**plain)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for :meth:`read`."""
        return {"start": self.start, "step": self.step} | ({} if self.zone is None else {"zone": self.zone})

    def time_of(self, step: int) -> pd.Timestamp:
        """Return when a step begins."""
        import pandas as pd

        start = pd.Timestamp(self.start) if self.zone is None else pd.Timestamp(self.start).tz_convert(self.zone)
        return start + pd.Timedelta(int(step) * round(self.step * SECOND), unit="ns")

    def step_at(self, time: Any) -> int:
        """Return the step in which a time falls, below 0 before the start; a time of day is one of the first day.

        Raises
        ------
        InstanceError
            If it is no time, or has an offset from UTC where the start has none, or the reverse.
        """
        import pandas as pd

        start = pd.Timestamp(self.start) if self.zone is None else pd.Timestamp(self.start).tz_convert(self.zone)
        if isinstance(time, str) and TIME_OF_DAY.fullmatch(time.strip()):
            wanted = at_time_of_day(start, time.strip())
        else:
            found = timestamp(time)
            if found is None:
                raise InstanceError(f"{time!r} is no time: write it like 11:08 or 2026-03-02T11:08:00")
            wanted = found
        if (wanted.tzinfo is None) != (start.tzinfo is None):
            raise InstanceError(f"{time!r} and the start {self.start}: give both an offset from UTC, or neither")
        return int((wanted.value - start.value) // round(self.step * SECOND))


def zone_name(zone: Any) -> str | None:
    """Return the name of a time zone whose clocks may change, or of UTC; None for a bare offset, or no zone.

    Examples
    --------
    >>> import pandas as pd
    >>> [zone_name(pd.Timestamp(f"2026-03-02T08:00{offset}").tzinfo) for offset in ("", "Z", "+01:00")]
    [None, 'UTC', None]
    >>> zone_name(pd.Timestamp("2026-03-02T08:00", tz="Europe/Berlin").tzinfo)
    'Europe/Berlin'
    """
    name = getattr(zone, "key", None) or getattr(zone, "zone", None)
    return "UTC" if name is None and str(zone) == "UTC" else name


def at_time_of_day(day: pd.Timestamp, text: str) -> pd.Timestamp:
    """Return a time of day on the date of ``day``, in its time zone.

    Raises
    ------
    InstanceError
        If there is no such time, or, where clocks change, none or two on that date.
    """
    import pandas as pd

    try:
        wall = pd.Timestamp(f"{day.date().isoformat()}T{text.rjust(8 if text.count(':') == 2 else 5, '0')}")
    except ValueError:
        raise InstanceError(f"{text} is no time of day: they go from 00:00 to 23:59") from None
    try:
        return wall.tz_localize(day.tzinfo) if day.tzinfo is not None else wall
    except Exception:  # the zone's own: the clock is put forward or back
        raise InstanceError(
            f"{text} on {day.date()} is no one time there, for clocks change: begin earlier or later"
        ) from None


def timestamp(value: Any) -> pd.Timestamp | None:
    """Return one date and time, or None if it is none."""
    import pandas as pd

    if isinstance(value, bool | int | float) or (isinstance(value, str) and not re.match(r"\d{4}-\d\d-\d\d", value)):
        return None
    try:
        found = pd.Timestamp(value)
    except (TypeError, ValueError):
        return None
    return None if pd.isna(found) else found


def seconds_of(step: Any) -> float:
    """Return how long a step is, in seconds: a number of them, or "15s", "2min", or a time span.

    Raises
    ------
    InstanceError
        If it is none, or not longer than nothing.

    Examples
    --------
    >>> seconds_of("15s"), seconds_of("2min"), seconds_of(30)
    (15.0, 120.0, 30.0)
    """
    import pandas as pd

    try:
        if isinstance(step, str) and re.fullmatch(r"\s*\d+(\.\d*)?\s*", step):
            step = float(step)  # which pandas would take for nanoseconds
        plain = isinstance(step, int | float) and not isinstance(step, bool)
        span = float(step) if plain else pd.Timedelta(step).total_seconds()
    except (TypeError, ValueError):
        raise InstanceError(f"step = {step!r} is no length of time: write it like 15s or 2min") from None
    if not span * SECOND >= 1 or span == float("inf"):
        raise InstanceError(f"step = {step!r} is no length of time: it must be longer than nothing")
    return span


def is_time(column: pd.Series) -> bool:
    """Whether a column holds timestamps, or text or objects that look like them."""
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(column.dtype) or "timestamp" in str(column.dtype):
        return True
    if pd.api.types.is_numeric_dtype(column.dtype):
        return False
    first = next((value for value in column if not _missing(value)), None)
    return first is not None and timestamp(first) is not None


def _missing(value: Any) -> bool:
    import pandas as pd

    return value is None or value is pd.NA or value is pd.NaT or bool(value != value)


@dataclass(frozen=True)
class Instants:
    """A column of times: nanoseconds since 1970 (UTC where ``zone`` is one), their time zone, and the rows' names."""

    nanoseconds: Ints
    zone: Any
    rows: Any


def instants(name: str, column: pd.Series) -> Instants:
    """Read a column of timestamps: of pandas, pyarrow, or text in ISO form.

    Raises
    ------
    InstanceError
        If a row is missing or no time, or some have an offset from UTC and some have none.
    """
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(column.dtype) or "timestamp" in str(column.dtype):
        index = pd.DatetimeIndex(column)
    else:
        read = [timestamp(value) for value in column]
        wrong = next((i for i, one in enumerate(read) if one is None), None)
        if wrong is not None:
            value = column.iloc[wrong]
            why = "is missing" if _missing(value) else f"= {str(value)[:60]!r} is no date and time"
            raise InstanceError(f"{name} in row {column.index[wrong]} {why}: write it like 2026-03-02T08:00:00")
        aware = [one.tzinfo is not None for one in read if one is not None]
        if any(aware) and not all(aware):
            i, j = aware.index(True), aware.index(False)
            rows = f"in row {column.index[i]} and none in row {column.index[j]}"
            raise InstanceError(f"{name} has an offset from UTC {rows}: give all one, or none")
        zones = {str(one.tzinfo) for one in read if one is not None}
        if any(aware) and len(zones) > 1:  # an offset each, as where clocks change: the first in time is the day's
            zone = min(one for one in read if one is not None).tzinfo
            read = [one.tz_convert(zone) for one in read if one is not None]
        index = pd.DatetimeIndex(read)
    if index.hasnans:
        row = column.index[int(index.isna().argmax())]
        raise InstanceError(f"{name} in row {row} is missing: drop the row or fill it in")
    zone = index.tz
    plain = index.tz_convert("UTC").tz_localize(None) if zone is not None else index
    try:
        return Instants(np.asarray(plain.as_unit("ns").asi8, dtype=np.int64), zone, column.index)
    except ValueError:  # pandas: out of bounds
        raise InstanceError(f"{name} holds times before 1678 or after 2261: nanoseconds cannot count them") from None
