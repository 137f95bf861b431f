"""Tables as people have them, spoiled in any way: every row is in an instance or counted, or one line says why not.

``python -m tests.instances.odd_tables 10000`` makes so many pairs of tables and says what became of them; a second
number is the first seed.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa

from optkit import Instance
from optkit.basics.errors import OptkitError
from optkit.instances.account import LeftOutWarning
from optkit.instances.days import days_from_frames

ZONES = (None, "UTC", "Europe/Berlin", "America/New_York", "Asia/Kolkata")
DAYS = ("2026-03-28", "2026-03-29", "2026-10-25", "2026-11-01", "2026-07-06")
"""Among them those on which clocks change."""


def tables(rng: np.random.Generator) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sound tables: a few days of two hours, times in a zone or in none, groups with names."""
    zone, dates = rng.choice(np.array(ZONES, dtype=object)), rng.choice(DAYS, int(rng.integers(1, 4)), replace=False)
    n, J = int(rng.integers(0, 12)), int(rng.integers(0, 8))
    groups = ["bike", "car"][: int(rng.integers(1, 3))]

    def times(size: int) -> pd.Series:
        """Moments between 6:00 and 8:00 of those dates."""
        day = rng.choice(dates, size)
        seconds = pd.to_timedelta(rng.integers(6 * 3600, 8 * 3600, size), unit="s")
        found = pd.Series(pd.to_datetime(day) + seconds)
        return found.dt.tz_localize(zone) if zone is not None else found

    arrival = times(n)
    asked = pd.DataFrame({"day": arrival.dt.date, "arrival": arrival})
    asked["expiry"] = arrival + pd.to_timedelta(rng.integers(0, 1800, n), unit="s")
    asked["reward"], asked["penalty"] = rng.uniform(5, 50, n).round(2), -rng.uniform(0, 5, n).round(2)
    for group in groups:
        asked[f"utility_{group}"] = rng.normal(-10, 5, n).round(3)
    asked["request_id"], asked["km"] = [f"order {i}" for i in range(n)], rng.uniform(0, 9, n)
    joined = times(J)
    came = pd.DataFrame({"day": joined.dt.date, "joined": joined, "group": rng.choice(groups, J)})
    came["worker_id"] = np.arange(J) + 100
    return asked, came


def _text(table: pd.DataFrame, rng: np.random.Generator) -> Any:
    return table.map(lambda x: x.isoformat() if hasattr(x, "isoformat") else x)


def _cell(value: Any) -> Callable[[pd.DataFrame, np.random.Generator], Any]:
    def spoil(table: pd.DataFrame, rng: np.random.Generator) -> Any:
        if table.empty:
            return table
        column = str(rng.choice(table.columns))
        odd = table.astype({column: object})
        odd.iloc[int(rng.integers(len(table))), odd.columns.get_loc(column)] = value
        return odd

    return spoil


def _polars(table: pd.DataFrame, rng: np.random.Generator) -> Any:
    return pl.from_pandas(table.reset_index(drop=True))


def _arrow(table: pd.DataFrame, rng: np.random.Generator) -> Any:
    return pa.Table.from_pandas(table, preserve_index=False)


SPOIL: dict[str, Callable[[pd.DataFrame, np.random.Generator], Any]] = {
    "rows shuffled": lambda t, rng: t.sample(frac=1.0, random_state=int(rng.integers(2**31))),
    "columns shuffled": lambda t, rng: t[rng.permutation(t.columns)],
    "a column missing": lambda t, rng: t.drop(columns=rng.choice(t.columns)),
    "a column more": lambda t, rng: t.assign(note="x"),
    "a column misspelt": lambda t, rng: t.rename(columns={(c := rng.choice(t.columns)): f"{c}s"}),
    "a column twice": lambda t, rng: pd.concat([t, t[[rng.choice(t.columns)]]], axis=1),
    "rows twice": lambda t, rng: pd.concat([t, t.head(2)]),
    "no rows": lambda t, rng: t.head(0),
    "another zone": lambda t, rng: t.assign(
        **{c: t[c].dt.tz_convert("Asia/Tokyo") for c in t.select_dtypes("datetimetz").columns}
    ),
    "categories": lambda t, rng: t.astype({c: "category" for c in ("group", "request_id") if c in t}),
    "nullable": lambda t, rng: t.convert_dtypes(),
    "an index": lambda t, rng: t.set_index(str(rng.choice(t.columns))),
    "text": _text,
    "polars": _polars,
    "pyarrow": _arrow,
    **{f"a cell {value!r}": _cell(value) for value in (None, np.nan, "", "x", -1, 1e400, True, 1e17, "2026-13-01", 7)},
}
"""What is done to a table."""


def account(size: int, name: str, told: str) -> int:
    """How many rows of a table the warnings say are left out."""
    found = re.search(rf"(\d+) of (\d+) {name} are left out", told)
    assert found is None or int(found[2]) == size, told
    return 0 if found is None else int(found[1])


def attempt(seed: int) -> str:
    """Make tables, spoil them, and read them; AssertionError if a row is lost, or the refusal is no line."""
    rng = np.random.default_rng(seed)
    both: list[Any] = [*tables(rng)]
    for _ in range(int(rng.integers(0, 3))):
        which, how = int(rng.integers(2)), str(rng.choice(list(SPOIL)))
        if isinstance(both[which], pd.DataFrame) and not both[which].columns.duplicated().any():
            try:
                both[which] = SPOIL[how](both[which], rng)
            except (pa.ArrowException, OverflowError, TypeError):  # those packages hold no such column
                continue
    by_day = rng.random() < 0.7
    options: dict[str, Any] = {"step": rng.choice(["15s", "1min", "5min"]), "features": ["km"]}
    if rng.random() < 0.5:
        options["start"] = rng.choice(["06:00", "07:00", "05:30:30"])
    if rng.random() < 0.3:
        options["horizon"] = int(rng.integers(1, 600))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            if by_day:
                found = list(days_from_frames(*both, day="day", **options).values())
            else:
                bare = [t.drop("day") if isinstance(t, pl.DataFrame) else t for t in both]
                bare = [t.drop(["day"]) if isinstance(t, pa.Table) and "day" in t.column_names else t for t in bare]
                bare = [t.drop(columns="day", errors="ignore") if isinstance(t, pd.DataFrame) else t for t in bare]
                found = [Instance.from_frames(*bare, **options)]
            why = None
        except OptkitError as error:
            why = str(error)
        except pl.exceptions.ColumnNotFoundError:
            return "no such column"
    if why is not None:
        assert why
        assert "\n" not in why, why
        return "refused"
    told = "; ".join(str(one.message) for one in caught if issubclass(one.category, LeftOutWarning))
    strange = [one for one in caught if not issubclass(one.category, LeftOutWarning)]
    assert not strange, [str(one.message) for one in strange]
    for name, size, kept in (
        ("requests", len(both[0]), sum(one.n_requests for one in found)),
        ("workers", len(both[1]), sum(one.n_workers for one in found)),
    ):
        assert kept + account(size, name, told) == size, (seed, name, kept, size, told)
    return "told" if told else "whole"


def main(count: int, first: int = 0) -> None:
    """Try so many, and print what became of them."""
    print(dict(Counter(attempt(seed) for seed in range(first, first + count))))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
