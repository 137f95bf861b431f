"""Trip records of New York's taxis: the good trips within Manhattan, and a count of all others by reason.

Records as the Taxi and Limousine Commission (TLC) publishes them, month by month, since July 2016 (older files
hold coordinates instead of zones). The paper groups Manhattan's taxi zones "roughly" into four regions (section
4.2, New York Taxi data) and prints no table. Ours, ``data/manhattan_zones.csv``, follows one rule, by where the
centre of a zone lies: (1) Lower Manhattan is south of 14th Street, (2) Midtown from 14th to 59th Street, and
north of it Fifth Avenue parts (3) the Upper West Side from (4) the Upper East Side, all the way up: Central Park,
west of the Avenue, is 3, as are Central Harlem, Washington Heights and Inwood, while East Harlem is 4. Islands go
with the shore they are next to: those in the harbour to 1, Roosevelt and Randalls Island to 4.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import DataError
from optkit.instances.new_york.same_trips import Sketch, check_apart
from optkit.instances.new_york.trip_files import Paths, find_files, read_pieces

if TYPE_CHECKING:
    import pandas as pd

Times: TypeAlias = npt.NDArray[np.datetime64]
Mask: TypeAlias = npt.NDArray[np.bool_]

REGIONS = ("Lower Manhattan", "Midtown", "Upper West Side", "Upper East Side")
"""The paper's regions 1 to 4; trips and instances count them from 0."""

BAD = (
    "missing value",
    "unreadable date",
    "unknown zone",
    "drop-off not after pick-up",
    "longer than two hours",
    "implausible date",
)
"""Why a row is bad, in the order of the checks: a row counts under the first that it fails."""

ELSEWHERE, UNASKED = "outside Manhattan", "outside the hours asked for"


@dataclass(frozen=True, eq=False)
class Trips:
    """Good trips within Manhattan, and what became of the other rows.

    Attributes
    ----------
    frame : DataFrame
        One row per trip: ``pickup_time`` (local time, to the second), ``pickup`` and ``dropoff`` (region 0 to 3, see
        :data:`REGIONS`), ``travel_time`` (minutes). In the order of the files.
    report : dict
        Number of rows left out by reason: those of :data:`BAD`, then good ones outside Manhattan or outside the hours
        asked for. With the rows of ``frame`` they add up to ``rows``.
    rows : int
        Number of rows read.
    files : tuple of str
        Names of the files read.
    period : (datetime64, datetime64)
        First and last pick-up within Manhattan, at whatever hour; two NaT if there is none.
    """

    frame: pd.DataFrame
    report: dict[str, int]
    rows: int
    files: tuple[str, ...]
    period: tuple[np.datetime64, np.datetime64]

    def summary(self) -> str:
        """Text for people: what was read, left out and why, and where the trips start."""
        first, last = (np.datetime_as_string(day, unit="D") for day in self.period)
        lines = [f"{self.rows:,} rows from {len(self.files)} file(s), trips in Manhattan from {first} to {last}"]
        lines += [f"{n:>12,}  {reason}" for reason, n in self.report.items() if n]
        lines.append(f"{len(self.frame):>12,}  trips kept; pick-ups by region:")
        picked = np.bincount(self.frame["pickup"], minlength=len(REGIONS)) / max(len(self.frame), 1)
        lines += [f"{share:>14.1%}  {r} {name}" for r, (name, share) in enumerate(zip(REGIONS, picked, strict=True), 1)]
        return "\n".join(lines)


def read_trips(paths: Paths, *, when: Callable[[Times], Mask] | None = None) -> Trips:
    """Read TLC trip records, keep the good trips within Manhattan, count the rest by reason.

    Files are read in pieces and only the four columns needed, so that a month of nine million rows fits anywhere.

    Parameters
    ----------
    paths : path or sequence of paths
        Parquet, CSV or gzipped CSV files (``.parquet``, ``.csv``, ``.csv.gz``), of yellow or green cabs, or folders of
        them; if some files of a folder have ``tripdata`` in their name, as TLC's have, only these are read. A file
        named twice is read once. Hidden files of a folder are not read.
    when : callable, optional
        Of pick-up times, (n,) datetime64[s], which to keep: saves memory if only some hours matter.

    Returns
    -------
    Trips

    Raises
    ------
    DataError
        If a file is missing, of another kind or damaged, lacks a column, has a row with more or fewer entries than the
        header (empty ones at its end apart), or holds trips of another file, which would count twice: at least
        :data:`optkit.instances.new_york.same_trips.SHARE` of the smaller one's. Or if there is no good trip within
        Manhattan at any hour; an hour of ``when`` without trips is no error: the frame is empty.

    Notes
    -----
    Column names in any case. Times are wall-clock times; a time zone is ignored. A date is implausible before 2009,
    from 2100 on, or outside the month (or year) in a file name like ``yellow_tripdata_2018-01.parquet``. Zones 264 and
    265 are TLC's own "unknown" and "outside": known numbers, but not Manhattan.

    Examples
    --------
    >>> import pandas as pd, tempfile
    >>> rows = {"tpep_pickup_datetime": ["2018-01-01 11:00:15", "2018-01-01 12:00:00"],
    ...         "tpep_dropoff_datetime": ["2018-01-01 11:12:15", "2018-01-01 11:00:00"],
    ...         "PULocationID": [261, 43], "DOLocationID": [236, 230]}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pd.DataFrame(rows).to_csv(f"{folder}/yellow_tripdata_2018-01.csv", index=False)
    ...     trips = read_trips(folder)
    >>> print(trips.frame.to_string(index=False))
            pickup_time  pickup  dropoff  travel_time
    2018-01-01 11:00:15       0        3         12.0
    >>> trips.rows, trips.report["drop-off not after pick-up"]
    (2, 1)
    """
    names = find_files(paths)
    report = dict.fromkeys((*BAD, ELSEWHERE, *([UNASKED] if when else [])), 0)
    parts, rows, ends = [_frame()], 0, [np.datetime64("NaT", "s")]
    sketches: list[Sketch] = []
    for path in names:
        sketch = Sketch(path)
        for raw in read_pieces(path):
            rows += len(raw["from"])
            good = _good(raw, _plausible(path), report, sketch)
            times = good["pickup_time"].to_numpy("datetime64[s]")
            if times.size:
                ends += [times.min(), times.max()]
            if when:
                asked = when(times)
                report[UNASKED] += int((~asked).sum())
                good = good[asked]
            parts.append(good)
        check_apart(sketch, sketches)
        sketches.append(sketch)
    period = (np.fmin.reduce(ends), np.fmax.reduce(ends))
    if np.isnat(period[0]):
        counts = ", ".join(f"{n:,} {reason}" for reason, n in report.items() if n) or "the files are empty"
        raise DataError(f"no usable trip within Manhattan among {rows:,} rows of {_list(names)}: {counts}")
    import pandas as pd

    return Trips(pd.concat(parts, ignore_index=True), report, rows, tuple(p.name for p in names), period)


@cache
def manhattan_zones() -> pd.DataFrame:
    """Manhattan's 69 taxi zones: LocationID, zone (TLC's name) and region (1 to 4).

    Examples
    --------
    >>> manhattan_zones().groupby("region").size().to_dict()
    {1: 22, 2: 19, 3: 18, 4: 10}
    """
    import pandas as pd

    with (files("optkit.instances.new_york") / "manhattan_zones.csv").open(encoding="utf-8") as table:
        return pd.read_csv(table)


def _good(
    raw: dict[str, Any], plausible: tuple[np.datetime64, np.datetime64], report: dict[str, int], sketch: Sketch
) -> pd.DataFrame:
    start, end = _times(raw["start"]), _times(raw["end"])
    seconds = (end - start).astype("timedelta64[s]").astype(np.int64)
    pickup, dropoff = raw["from"], raw["to"]
    known = [(zone >= 1) & (zone <= 265) & (zone == np.floor(zone)) for zone in (pickup, dropoff)]
    region = np.full(266, -1, np.int8)
    region[manhattan_zones()["LocationID"]] = manhattan_zones()["region"] - 1
    zones = [np.where(k, z, 0).astype(int) for k, z in zip(known, (pickup, dropoff), strict=True)]
    missing = raw["start"].isna() | raw["end"].isna() | np.isnan(pickup) | np.isnan(dropoff)
    pickup, dropoff = (region[zone] for zone in zones)
    checks = (
        missing.to_numpy(bool),
        np.isnat(start) | np.isnat(end),
        ~(known[0] & known[1]),
        seconds <= 0,
        seconds > 7200,
        (start < plausible[0]) | (start >= plausible[1]),
        (pickup < 0) | (dropoff < 0),
    )
    left = np.ones(start.size, bool)
    for reason, fails in zip((*BAD, ELSEWHERE), checks, strict=True):
        report[reason] += int((left & fails).sum())
        left &= ~fails
    sketch.add(start[left].astype(np.int64), end[left].astype(np.int64), *(zone[left] for zone in zones))
    return _frame(start[left], pickup[left], dropoff[left], seconds[left] / 60.0)


def _frame(start: Any = (), pickup: Any = (), dropoff: Any = (), minutes: Any = ()) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame(
        {
            "pickup_time": np.asarray(start, "datetime64[s]"),
            "pickup": np.asarray(pickup, np.int8),
            "dropoff": np.asarray(dropoff, np.int8),
            "travel_time": np.asarray(minutes, np.float64),
        }
    )


def _times(values: pd.Series[Any]) -> Times:
    import pandas as pd

    if not pd.api.types.is_datetime64_any_dtype(values):
        text = values.astype("string").str.strip()
        if text.str.slice(10).str.contains("[Z+-]", regex=True).any():  # time zones, after the date
            text = text.str.replace(r"^(.{10}.*?)\s*(?:Z|[+-]\d\d(?::?\d\d)?)$", r"\1", regex=True)
        # All in one zone: a column of several has no dates in pandas.
        values = pd.to_datetime(text, format="ISO8601", errors="coerce", utc=True)
        if values.isna().any():
            values = values.fillna(pd.to_datetime(text, format="%m/%d/%Y %I:%M:%S %p", errors="coerce", utc=True))
    return np.asarray(values.dt.tz_localize(None).to_numpy("datetime64[s]"))


def _plausible(path: Path) -> tuple[np.datetime64, np.datetime64]:
    named = re.search(r"tripdata_(\d{4})(?:-(0[1-9]|1[0-2])(?!\d))?", path.name)
    if named is None:
        return np.datetime64("2009", "Y"), np.datetime64("2100", "Y")
    first = np.datetime64("-".join(filter(None, named.groups())))
    return first, first + (np.timedelta64(1, "Y") if named[2] is None else np.timedelta64(1, "M"))


def _list(names: list[Path]) -> str:
    return str(names[0]) if len(names) == 1 else f"{len(names)} files"
