"""Which step it is, and at which step each open request expires, by the clock of the days that were learned from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Ints, ints, whole_number
from optkit.basics.errors import InputError
from optkit.instances.clock import SECOND, TIME_OF_DAY, Clock, Instants, at_time_of_day, instants, is_time, timestamp

if TYPE_CHECKING:
    import pandas as pd


def moment(expiry: pd.Series, step: int | None, time: Any, clock: Clock | None, horizon: int) -> tuple[int, Ints]:
    """Return the step of a moment, and the last step of each request.

    A day begins at the same time of day as those that were learned from, by the clock of the requests' own times, on
    the evening before where it goes past midnight. A time of day without a date is the last before the first deadline.

    Raises
    ------
    InputError
        If neither or both of step and time are given, there is no clock, deadlines are in another time zone, or they
        lie so far apart that a time without a date says too little.
    """
    if (step is None) == (time is None):
        raise InputError("say at which step the requests are open, or at which time: one of them")
    timed = bool(len(expiry)) and is_time(expiry)
    if not timed:
        last = ints("expiry", expiry if len(expiry) else [], (len(expiry),))
        return (whole_number("step", step, least=0) if step is not None else _clock(clock).step_at(time)), last
    known, found = _clock(clock), instants("expiry", expiry)
    day = Day(known, found)
    if step is not None:
        now = whole_number("step", step, least=0)
        begin = day.begin_before(day.first - now * day.width)
    elif isinstance(time, str) and TIME_OF_DAY.fullmatch(time.strip()):
        at = day.at(day.first, time.strip())
        at = at if at <= day.first else day.at(day.first - 24 * 3600 * SECOND, time.strip())
        begin = day.begin_before(at)
        now = (at - begin) // day.width
    else:
        begin = day.begin_before(at := day.instant(time))
        now = (at - begin) // day.width
    dated = step is None and not (isinstance(time, str) and TIME_OF_DAY.fullmatch(time.strip()))
    if not dated and int(found.nanoseconds.max()) - day.first > max(horizon * day.width, 12 * 3600 * SECOND):
        raise InputError("the requests expire on several dates: give the time with its date, or leave out old ones")
    return int(now), np.asarray(-((begin - found.nanoseconds) // day.width) - 1)


def _clock(clock: Clock | None) -> Clock:
    if clock is None:
        raise InputError("the policy was trained on days that count steps: give steps in place of times")
    return clock


class Day:
    """The time of day at which days begin, by the clock of some deadlines; instants are nanoseconds since 1970."""

    def __init__(self, clock: Clock, deadlines: Instants) -> None:
        import pandas as pd

        self.start, self.zone = pd.Timestamp(clock.start), deadlines.zone
        self.width, self.first = round(clock.step * SECOND), int(deadlines.nanoseconds.min())
        if (self.zone is None) != (self.start.tzinfo is None):
            raise InputError(f"expiry and the start of the day, {clock.start}: both have a time zone, or neither")
        if self.zone is not None:
            pair = (self.start, self.time(self.first))
            offsets = [
                (one.tz_localize(None) - one.tz_convert("UTC").tz_localize(None)).total_seconds() for one in pair
            ]
            # An hour apart are summer and winter, but a clock at UTC is a database's more often than a street's.
            if abs(offsets[0] - offsets[1]) > 3600 or (offsets[1] == 0 != offsets[0]):
                raise InputError(
                    f"expiry is in another time zone ({self.time(self.first).isoformat()}) than the days that were "
                    f"learned from ({clock.start}): convert it to theirs"
                )

    def time(self, instant: int) -> pd.Timestamp:
        """Return an instant as the deadlines' clock shows it."""
        import pandas as pd

        return pd.Timestamp(instant) if self.zone is None else pd.Timestamp(instant, tz="UTC").tz_convert(self.zone)

    def at(self, instant: int, text: str) -> int:
        """Return a time of day on the date of an instant."""
        return int(at_time_of_day(self.time(instant), text).value)

    def instant(self, time: Any) -> int:
        """Return a date and time, which is one of the deadlines' clock if it has no zone."""
        found = timestamp(time)
        if found is None:
            raise InputError(f"{time!r} is no time: write it like 11:08 or 2026-03-02T11:08:00")
        if found.tzinfo is not None and self.zone is None:
            raise InputError(f"{time!r} has a time zone, and expiry has none")
        return int((found.tz_localize(self.zone) if found.tzinfo is None and self.zone is not None else found).value)

    def begin_before(self, instant: int) -> int:
        """Return when the day began to which an instant belongs."""
        opens = self.start.time().replace(microsecond=0).isoformat()
        begin = self.at(instant, opens)
        return begin if begin <= instant else self.at(instant - 24 * 3600 * SECOND, opens)
