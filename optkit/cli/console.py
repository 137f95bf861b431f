"""What the verbs share: progress on a terminal, tables, instance sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optkit.errors import DataError, InputError

if TYPE_CHECKING:
    from optkit.scenarios import Scenario, Split

PARTS = ("train", "test", "validation")


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """Yield a function of stage, done and total that draws bars on standard error, if that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as bars:
        tasks: dict[str, Any] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield tell


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table to standard output: first column to the left, numbers to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for i, name in enumerate(header):
        table.add_column(name, justify="left" if i == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # Never cut a number off: in a narrow terminal the lines wrap.
    console = Console()
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
    from optkit.scenarios import scenario
    from optkit.world import TABLE_1

    more = {name: value for name, value in (("mode", mode), ("fraction", fraction)) if value is not None}
    if source.lower().replace("_", "-") in {name.lower() for name in TABLE_1}:
        if more and not trips:
            raise InputError(f"--{next(iter(more))} goes with --trips and a scenario of New York")
        return scenario(source, seed, trips=list(trips) if trips else None, **more, **_parsed(settings or ()))
    if trips or more or settings:
        raise InputError(f"--trips, --mode, --fraction and --set go with the name of a scenario, not with {source}")
    if Path(source).is_dir():
        return Path(source)
    raise InputError(f"{source!r} is neither a scenario ({', '.join(TABLE_1)}) nor a folder of instances")


def _parsed(settings: Sequence[str]) -> dict[str, float]:
    """Read NAME=NUMBER; the scenario checks names and ranges."""
    found = {}
    for text in settings:
        name, equals, number = text.partition("=")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--set {text} is not of the form NAME=NUMBER, for example horizon=1000")
    return found


def read_split(folder: Path) -> Split:
    """Read the training, test and validation sets of a folder, or cut one set into parts of 480 : 120 : 30.

    Raises
    ------
    DataError
        If a set cannot be read, or is too small to be cut.
    """
    from optkit.scenarios import Split, cut
    from optkit.storage import load_instances

    if (folder / "train").is_dir() or (folder / "test").is_dir():
        return Split(*(load_instances(folder / part) if (folder / part).is_dir() else [] for part in PARTS))
    instances = load_instances(folder)
    n = len(instances)
    if n < 2:
        raise DataError(f"{folder} holds {n} instance(s): at least one to tune on and one to report on are needed")
    test = max(1, round(n * 120 / 630))
    validation = round(n * 30 / 630)
    return cut(instances, (n - test - validation, test, validation))
