"""Which step it is, and at which step each open request expires, by the clock of the days that were learned from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optkit.basics.arrays import Ints, whole_number
from optkit.basics.errors import InputError
from optkit.instances.clock import (
    SECOND,
    TIME_OF_DAY,
    Clock,
    Instants,
    at_time_of_day,
    instants,
    is_time,
    timestamp,
    zone_name,
)
from optkit.instances.columns import whole_numbers_of

if TYPE_CHECKING:
    import pandas as pd


class Moment(NamedTuple):
    """A step, the last step of each request, and what was taken for granted."""

    step: int
    last: Ints
    notes: list[str]


def moment(expiry: pd.Series, step: int | None, time: Any, clock: Clock | None, horizon: int) -> Moment:
    """Return the step of a moment, and the last step of each request.

    A day begins at the same time of day as those that were learned from, by their clock, on the evening before where it
    goes past midnight. A time of day without a date is the last before the first deadline.

    Raises
    ------
    InputError
        If neither or both of step and time are given, there is no clock, nobody can tell by which clock a time or a
        deadline is meant, or a time without a date says too little: requests expire on several dates, or the first
        deadline has passed or lies beyond the day.
    """
    if (step is None) == (time is None):
        raise InputError("say at which step the requests are open, or at which time: one of them")
    if not (len(expiry) and is_time(expiry)):
        now = whole_number("step", step, least=0) if step is not None else _clock(clock).step_at(time)
        if now < 0 and isinstance(time, str) and TIME_OF_DAY.fullmatch(time.strip()):
            now += round(24 * 3600 / _clock(clock).step)  # past midnight
        return Moment(now, whole_numbers_of("expiry", expiry), [])
    day = Day(_clock(clock), instants("expiry", expiry))
    dated = step is None and not (isinstance(time, str) and TIME_OF_DAY.fullmatch(time.strip()))
    if step is not None:
        begin = day.begin_before(day.first - whole_number("step", step, least=0) * day.width)
        now = step
    else:
        at = day.instant(time) if dated else day.last_before_first(time.strip())
        begin = day.begin_before(at)
        now = (at - begin) // day.width
    if not dated and day.latest - day.first > max(horizon * day.width, 12 * 3600 * SECOND):
        raise InputError("the requests expire on several dates: give the time with its date, or leave out old ones")
    if not dated and day.first >= begin + horizon * day.width:
        raise InputError(
            f"the first request expires at {day.time(day.first).isoformat()}, which is not on the day of "
            f"{'step ' if time is None else ''}{now if time is None else time}: leave out what has expired, or give "
            "the time with its date"
        )
    return Moment(int(now), np.asarray(-((begin - day.deadlines) // day.width) - 1), day.notes)


def _clock(clock: Clock | None) -> Clock:
    if clock is None:
        raise InputError("the policy was trained on days that count steps: give steps in place of times")
    return clock


def _offset(time: pd.Timestamp) -> float:
    """Seconds by which a clock is ahead of UTC."""
    return float((time.tz_localize(None) - time.tz_convert("UTC").tz_localize(None)).total_seconds())


class Day:
    """The time of day at which days begin, by their clock; instants are nanoseconds since 1970."""

    def __init__(self, clock: Clock, found: Instants) -> None:
        import pandas as pd

        self.start, self.width = pd.Timestamp(clock.start), round(clock.step * SECOND)
        self.deadlines = found.nanoseconds
        self.first, self.latest = int(self.deadlines.min()), int(self.deadlines.max())
        self.notes: list[str] = []
        if (found.zone is None) != (self.start.tzinfo is None):
            raise InputError(f"expiry and the start of the day, {clock.start}: both have a time zone, or neither")
        self.theirs = self.zone = found.zone
        if clock.zone is not None:
            self.zone, self.start = clock.zone, self.start.tz_convert(clock.zone)
        elif self.zone is not None:
            self._same_clock()

    def _same_clock(self) -> None:
        """Refuse deadlines of another zone than that of a day of which only the offset is known."""
        shown = self.time(self.first)
        if zone_name(self.zone) is not None:
            same = _offset(self.start.tz_convert(self.zone)) == _offset(self.start)
        else:
            # An hour apart are summer and winter, but a clock at UTC is a database's more often than a street's.
            apart = abs(_offset(shown) - _offset(self.start))
            same = apart == 0 or (apart == 3600 and zone_name(self.start.tzinfo) is None)
            if same and apart:
                self.notes.append(
                    f"expiry is an hour off the clock of the days that were learned from ({self.start.isoformat()}): "
                    "taken for summer and winter of one time zone"
                )
        if not same:
            raise InputError(
                f"expiry is in another time zone ({shown.isoformat()}) than the days that were learned from "
                f"({self.start.isoformat()}): convert it to theirs"
            )

    def time(self, instant: int) -> pd.Timestamp:
        """Return an instant as the days' clock shows it."""
        import pandas as pd

        return pd.Timestamp(instant) if self.zone is None else pd.Timestamp(instant, tz="UTC").tz_convert(self.zone)

    def at(self, instant: int, text: str) -> int:
        """Return a time of day on the date of an instant."""
        return int(at_time_of_day(self.time(instant), text).value)

    def last_before_first(self, text: str) -> int:
        """Return the last time of day before the first deadline."""
        self._one_clock(text)
        at = self.at(self.first, text)
        return at if at <= self.first else self.at(self.first - 24 * 3600 * SECOND, text)

    def instant(self, time: Any) -> int:
        """Return a date and time, which is one of the days' clock if it has no zone."""
        found = timestamp(time)
        if found is None:
            raise InputError(f"{time!r} is no time: write it like 11:08 or 2026-03-02T11:08:00")
        if found.tzinfo is not None and self.zone is None:
            raise InputError(f"{time!r} has a time zone, and expiry has none")
        if found.tzinfo is None:
            self._one_clock(time)
        return int((found.tz_localize(self.zone) if found.tzinfo is None and self.zone is not None else found).value)

    def _one_clock(self, time: Any) -> None:
        """Refuse a time without a zone where the deadlines' clock and the days' differ."""
        if self.zone is None:
            return
        days, theirs = self.time(self.first), self.time(self.first).tz_convert(self.theirs)
        if _offset(days) != _offset(theirs):
            told = f"expiry is written as {theirs.isoformat()}, on the days that were learned from {days.isoformat()}"
            raise InputError(f"{time!r} by which clock? {told}: give the time with its date and its offset from UTC")

    def begin_before(self, instant: int) -> int:
        """Return when the day began to which an instant belongs."""
        opens = self.start.time().replace(microsecond=0).isoformat()
        begin = self.at(instant, opens)
        return begin if begin <= instant else self.at(instant - 24 * 3600 * SECOND, opens)
