"""Half-hours of real trips: what one instance of an NYC scenario draws its requests from (paper section 4.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import date, timedelta
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats
from optkit.basics.errors import DataError
from optkit.instances.new_york.trips import Mask, Times, Trips

Mode: TypeAlias = Literal["folded", "mondays"]

HALF_HOUR = 1800
"""Length of an episode, in seconds."""


@dataclass(frozen=True, eq=False)
class Episode:
    """The trips that one half-hour can draw its requests from.

    Attributes
    ----------
    label : str
        Which week (ISO) or day, and which half of the hour.
    arrival : (n,) int
        Step of the pick-up, non-decreasing.
    pickup, dropoff : (n,) int
        Region, 0 to 3.
    travel_time : (n,) float
        Of the trip, in half-hours.
    """

    label: str
    arrival: npt.NDArray[np.int32]
    pickup: npt.NDArray[np.int8]
    dropoff: npt.NDArray[np.int8]
    travel_time: Floats


class Rule(NamedTuple):
    """Which hours a mode takes, how many days one episode pools, and what to say if there is no trip."""

    hours: Callable[[Times], Mask]
    pool: int
    nothing: str


def _clock(times: Times) -> tuple[npt.NDArray[np.int64], ...]:
    """Day (from a Monday on), day of the week (Monday is 0), second of the day."""
    day, second = np.divmod(times.astype("datetime64[s]").astype(np.int64), 86_400)
    return day + 3, (day + 3) % 7, second  # 1970 began on a Thursday


def _working_hours(times: Times) -> Mask:
    _, weekday, second = _clock(times)
    return np.asarray((weekday < 5) & (second >= 7 * 3600) & (second < 19 * 3600))


def _monday_at_eleven(times: Times) -> Mask:
    _, weekday, second = _clock(times)
    return np.asarray((weekday == 0) & (second // 3600 == 11))


MODES = {
    "folded": Rule(_working_hours, 7, "no weekday between 7 and 19 among trips from {} to {}; bring more trips"),
    "mondays": Rule(_monday_at_eleven, 1, "no Monday between 11 and 12 among trips from {} to {}; use mode folded"),
}


def cut_episodes(trips: Trips, mode: Mode, horizon: int) -> list[Episode]:
    """Return the episodes of a mode in order of time, those without any trip left out.

    Raises
    ------
    DataError
        If no trip lies in the hours of the mode.
    """
    rule = MODES[mode]
    times = trips.frame["pickup_time"].to_numpy("datetime64[s]")
    asked = rule.hours(times)
    if not asked.any():
        raise DataError(rule.nothing.format(*(np.datetime_as_string(end, unit="D") for end in trips.period)))
    day, _, second = _clock(times[asked])
    number, place = 2 * (day // rule.pool) + second // HALF_HOUR % 2, second % HALF_HOUR
    columns = [trips.frame[name].to_numpy()[asked] for name in ("pickup", "dropoff", "travel_time")]
    # Sorted by all they have, so that the order of rows and files does not matter.
    order = np.lexsort((*columns[::-1], place, number))
    arrival = (place[order] * horizon // HALF_HOUR).astype(np.int32)
    pickup, dropoff, minutes = (column[order] for column in columns)
    numbers, starts = np.unique(number[order], return_index=True)
    return [
        Episode(_label(int(n), mode), arrival[own], pickup[own], dropoff[own], minutes[own] / 30.0)
        for n, own in zip(numbers, map(slice, starts, [*starts[1:], order.size]), strict=True)
    ]


def _label(number: int, mode: Mode) -> str:
    pooled, half = divmod(number, 2)
    first = date(1969, 12, 29) + timedelta(days=pooled * MODES[mode].pool)
    when = "{}-W{:02d}".format(*first.isocalendar()) if mode == "folded" else first.isoformat()
    return f"{when} {('first', 'second')[half]} half"
