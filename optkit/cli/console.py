"""What the verbs share: progress on a terminal, tables, instance sources."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optkit.basics.errors import InputError
from optkit.basics.printable import encodable, printable

if TYPE_CHECKING:
    from rich.progress import Progress

    from optkit.instances.scenario import Scenario


BETWEEN = 30.0
"""Seconds between two lines of progress where there is no terminal."""


def _left(seconds: float) -> str:
    return f"about {seconds / 60:.0f} min left" if seconds >= 90 else f"about {seconds:.0f} s left"


def _shown(bars: Progress) -> AbstractContextManager[Progress]:
    # Before Rich 14.3 a disabled one that ends writes an empty line where there is no terminal.
    return nullcontext(bars) if bars.disable else bars


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function of stage, done and total that draws bars on standard error, with the time that is left.

    Where that is no terminal it writes a line now and then, for a log.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with _shown(Progress(*columns, console=console, disable=quiet or not console.is_terminal)) as bars:
        tasks: dict[str, Any] = {}
        begun: dict[str, tuple[float, int]] = {}
        said = time.monotonic()

        def tell(stage: str, done: int, total: int) -> None:
            nonlocal said
            if stage not in tasks:
                tasks[stage], begun[stage] = bars.add_task(stage, total=total), (time.monotonic(), done)
            bars.update(tasks[stage], completed=done, total=total)
            now, (first, before) = time.monotonic(), begun[stage]
            if not quiet and not console.is_terminal and done > before and now - said > BETWEEN:
                said, left = now, (now - first) / (done - before) * (total - done)
                say(f"{stage}: {done} of {total}, {_left(left)}", err=True)

        yield tell


@contextmanager
def study_bar(name: str, quiet: bool) -> Iterator[Callable[[int, int, float], None]]:
    """Yield a function of cells done, their number and the seconds left, that draws a bar on standard error.

    Where that is no terminal it writes a line now and then, for a log.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:<13}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with _shown(Progress(*columns, console=console, disable=quiet or not console.is_terminal)) as bars:
        task = bars.add_task(name, total=None, left="")
        said = time.monotonic()

        def tell(done: int, total: int, left: float) -> None:
            nonlocal said
            bars.update(task, completed=done, total=total, left=_left(left) if done < total else "")
            if not quiet and not console.is_terminal and time.monotonic() - said > BETWEEN:
                said = time.monotonic()
                say(f"{name}: {done} of {total} cells, {_left(left)}", err=True)

        yield tell


def say(*lines: object, err: bool = False) -> None:
    """Print lines to standard output or error: what they quote of files and names cannot break or move them."""
    # Not through Typer, whose echo writes UTF-8 to whoever asked for ASCII.
    for line in lines:
        print(printable(line), file=sys.stderr if err else sys.stdout, flush=True)


def say_json(data: Any) -> None:
    """Print plain data to standard output as JSON, in ASCII."""
    from optkit.basics.plain_json import to_json

    print(to_json(data), flush=True)


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table to standard output: first column to the left, numbers to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    # Never cut a number off: in a narrow terminal the lines wrap.
    console = Console(markup=False, emoji=False, highlight=False)

    def shown(cells: Sequence[str]) -> list[str]:
        return [encodable(cell, console.encoding) for cell in cells]

    table = Table(title=shown([title])[0], title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for i, name in enumerate(shown(header)):
        table.add_column(name, justify="left" if i == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*shown(row))
    console.width = max(console.width, console.measure(table, options=console.options.update(width=500)).maximum)
    console.print(table, crop=False)


def open_source(
    source: str,
    *,
    seed: int,
    trips: Sequence[Path] | None,
    mode: str | None,
    fraction: float | None,
    settings: Sequence[str] | None,
) -> Scenario | Path:
    """Return the scenario of that name, or the folder of that path; the options belong to scenarios only.

    Raises
    ------
    InputError
        If it is neither, or an option does not belong to it.
    """
    from optkit.instances.catalogue import scenario
    from optkit.instances.settings import TABLE_1

    more = {name: value for name, value in (("mode", mode), ("fraction", fraction)) if value is not None}
    if source.lower().replace("_", "-") in {name.lower() for name in TABLE_1}:
        if source.lower().startswith("nyc") and not trips:
            raise InputError(f"{source} needs trip records: give --trips, a TLC file (parquet or CSV) or a folder")
        if more and not trips:
            raise InputError(f"--{next(iter(more))} goes with --trips and a scenario of New York")
        return scenario(source, seed, trips=list(trips) if trips else None, **more, **parsed_settings(settings or ()))
    if trips or more or settings:
        raise InputError(f"--trips, --mode, --fraction and --set go with the name of a scenario, not with {source}")
    if Path(source).is_dir():
        return Path(source)
    raise InputError(f"{source!r} is neither a scenario ({', '.join(TABLE_1)}) nor a folder of instances")


def parsed_settings(settings: Sequence[str]) -> dict[str, Any]:
    """Read NAME=NUMBER, or split=TRAIN,TEST,VALIDATION; the scenario checks ranges."""
    from optkit.instances.settings import ScenarioSettings

    known = [one.name for one in fields(ScenarioSettings)]
    found: dict[str, Any] = {}
    for text in settings:
        name, equals, value = (part.strip() for part in text.partition("="))
        if equals and name not in known:
            raise InputError(f"no setting {name!r}; there are {', '.join(known)}")
        try:
            found[name] = tuple(map(int, value.split(","))) if name == "split" else float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--set {text} is not of the form NAME=NUMBER, like horizon=1000 (or split=480,120,30)")
    return found


def trips_line(origin: dict[str, Any]) -> str | None:
    """Say what became of the rows of trip records, or None if there were none."""
    trips = origin.get("trips")
    if not trips:
        return None
    left = ", ".join(f"{count:,} {reason}" for reason, count in trips["dropped"].items() if count) or "none"
    return f"trips: {trips['rows']:,} rows read from {', '.join(trips['files'])}; left out: {left}"
