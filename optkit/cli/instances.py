"""``optkit instances``: tables of one's own as a folder that all other verbs take."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.basics.errors import InputError
from optkit.basics.printable import listed
from optkit.cli.console import print_table, say, say_json
from optkit.cli.options import Json
from optkit.cli.own_tables import by_group, parsed_map, read_table

if TYPE_CHECKING:
    import pandas as pd

    from optkit.instances.days import Days
    from optkit.instances.frames import Tables
    from optkit.instances.instance import Instance

ONE = "day"
"""What the only day is called."""

SHOWN = 3
"""Rows of a dry run."""


def instances(
    requests: Annotated[
        Path,
        typer.Argument(
            help="CSV, JSON or parquet, a row per request: arrival, expiry, reward; penalty, pickup, dropoff, "
            "request_id if there; and utility, or utility_GROUP for each group of workers."
        ),
    ],
    workers: Annotated[
        Path,
        typer.Argument(
            help="CSV, JSON or parquet, a row per worker: joined, when he joined the queue, or step, when he was "
            "seen; group, worker_id if there."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; without it only what was understood is shown.")
    ] = None,
    step: Annotated[
        str | None, typer.Option(help="How long a step is, such as 15s or 2min, where the tables hold dates and times.")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="When step 0 begins: a time of day, or a date and time. The earliest if not given."),
    ] = None,
    horizon: Annotated[
        int | None, typer.Option(help="Steps of a day. As many as the longest has, if not given.")
    ] = None,
    day_column: Annotated[
        str | None, typer.Option(help="Column of days, in both tables: one instance for each.", metavar="COLUMN")
    ] = None,
    mapped: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            help="What columns are, e.g. --map reward=fare,arrival=requested_at; repeatable.",
            metavar="MEANING=COLUMN",
        ),
    ] = None,
    features: Annotated[
        str | None,
        typer.Option(help="Columns of the requests that describe them, with commas between; travel time last."),
    ] = None,
    mu: Annotated[str, typer.Option(help="Noise scale, in money: a number, or bike=1.2,car=0.8.")] = "1",
    outside_utility: Annotated[
        str, typer.Option(help="Utility of taking nothing, in money: a number, or by group as for --mu.")
    ] = "0",
    queue: Annotated[bool, typer.Option("--queue", help="Take step for the time at which workers joined.")] = False,
    overwrite: Annotated[bool, typer.Option(help="Replace an instance set that is there.")] = False,
    as_json: Json = False,
) -> None:
    """Make instances of two tables of your own, one a day, and write them as a folder that the other verbs take.

    Times are steps, counted from 0, or dates and times with --step. All that is left out is counted. Without --out
    nothing is written: it shows what each column was taken for, and the first rows.
    """
    from optkit.instances.days import Days, cut_into_days
    from optkit.instances.frames import fields_of, understood
    from optkit.instances.instance import Instance
    from optkit.instances.storage import save_instances
    from optkit.instances.storage.save import check_replaceable

    if out is not None and out.exists():
        try:
            check_replaceable(out, overwrite)
        except InputError as error:
            raise InputError(str(error).replace("pass overwrite=True", "pass --overwrite")) from None
    meaning = parsed_map(mapped or ())
    described = [name.strip() for name in (features or "").split(",") if name.strip()]
    read = {
        name: read_table(path, name, meaning[name], described, day_column)
        for name, path in (("requests", requests), ("workers", workers))
    }
    for name, renamed in meaning.items():
        absent = next((column for column, what in renamed.items() if what not in read[name]), None)
        if absent is not None:
            raise InputError(f"--map {renamed[absent]}={absent}: the table of {name} has no column {absent!r}")
    _need_columns(read["requests"], requests, [("--features", name) for name in described])
    for name, path in (("requests", requests), ("workers", workers)):
        _need_columns(read[name], path, [("--day-column", day_column)] if day_column is not None else [])
    own = [] if day_column is None else [day_column]
    tables = understood(read["requests"], read["workers"], described, queue, own, "--map")
    given: dict[str, Any] = {"mu": by_group("mu", mu), "outside_utility": by_group("outside-utility", outside_utility)}
    given |= {"horizon": horizon, "start": start, "step": step}
    if day_column is None:
        found = Days({ONE: Instance(**fields_of(tables, **given))}, tables.account)
    else:
        found = cut_into_days(tables, day_column, **given)
    if out is not None:
        told = {"origin": "two tables", "days": list(found.instances), "left out": _counts(found)}
        save_instances(out, list(found.instances.values()), scenario=told, overwrite=overwrite)
    if as_json:
        say_json(_plain(found, tables, out))
    else:
        _show(found, tables, out)


def _need_columns(table: pd.DataFrame, path: Path, wanted: Sequence[tuple[str, str]]) -> None:
    for option, column in wanted:
        if column not in table:
            raise InputError(f"{option} {column}: {path} has no column {column!r}; it has {listed(table.columns)}")


def _counts(found: Days) -> dict[str, Any]:
    account = found.account
    left = {table: dict(reasons) for table, reasons in account.left_out.items()}
    return {"rows": account.rows, **left, "cut": account.cut, "unused": account.unused}


def _plain(found: Days, tables: Tables, out: Path | None) -> dict[str, Any]:
    days = {
        label: {"horizon": one.horizon, "requests": one.n_requests, "workers": one.n_workers}
        for label, one in found.instances.items()
    }
    groups = list(tables.groups) if tables.groups else list(range(len(tables.columns)))
    return {
        "folder": None if out is None else str(out), "days": days, "groups": groups, "features": tables.features,
        "left_out": _counts(found),
    }  # fmt: skip


def _show(found: Days, tables: Tables, out: Path | None) -> None:
    first = next(iter(found.instances.values()), None)
    if out is None and first is not None:
        _show_rows(first)
    if first is not None:
        groups = f", groups {', '.join(tables.groups)}" if tables.groups else ""
        say(f"mu {', '.join(f'{x:g}' for x in first.mu)} (money){groups}; {first.horizon} steps{_clock(first)}")
    sizes = [(one.n_requests, one.n_workers) for one in found.instances.values()]
    n, J = (sum(column) for column in zip(*sizes, strict=True)) if sizes else (0, 0)
    days = "1 day" if len(sizes) == 1 else f"{len(sizes)} days"
    for line in found.account.lines():
        say(line)
    rows = found.account.rows
    told = f"{days}, {n:,} of {rows['requests']:,} requests, {J:,} of {rows['workers']:,} workers"
    say(f"{out}: {told}" if out is not None else f"{told}; nothing is written without --out")


def _show_rows(first: Instance) -> None:
    for title, table in zip(("requests", "workers"), first.to_frames(), strict=True):
        rows = [[str(value) for value in row] for row in table.head(SHOWN).itertuples(index=False)]
        print_table(f"first {title}", list(table.columns), rows)


def _clock(one: Instance) -> str:
    return "" if one.clock is None else f" of {one.clock.step:g} s from {one.clock.start}"
