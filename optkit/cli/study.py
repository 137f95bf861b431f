"""``optkit study``: the paper's experiments, resumable, on one machine or a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from optkit.basics.errors import InputError
from optkit.cli.console import say, say_json
from optkit.cli.options import Fraction, Json, Mode, Quiet, Setting, Trips

if TYPE_CHECKING:
    import pandas as pd

    from optkit.studies.grids import Study
    from optkit.studies.runner import StudyRun


def study(
    name: Annotated[
        str, typer.Argument(help="homogeneous, heterogeneous, sensitivity, nyc, or all (nyc needs --trips).")
    ],
    worlds: Annotated[str, typer.Option(help="World seeds: a number of worlds, or seeds by commas, like 0,1,2.")] = "1",
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds; validation chooses between them.")] = 5,
    draws: Annotated[int, typer.Option(min=1, help="Draws of each wrong belief, for sensitivity.")] = 10,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    gap: Annotated[
        bool, typer.Option("--gap/--no-gap", help="Certify the gap to optimality; it takes longest.")
    ] = True,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    dask: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler, tcp://HOST:PORT, or local; needs optkit[dask]."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the results; finished cells are kept in its cells/.")] = Path(
        "results/studies"
    ),
    force: Annotated[bool, typer.Option("--force", help="Work out anew what is finished.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done, and how long it would take.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Reproduce the paper's experiments: tables, figures and a report, and how they compare with the paper's results.

    A study is a grid of cells. Each is kept as it ends, so that the same command goes on after an interruption of any
    kind, with the same final tables. A cell that fails is reported, and the others go on; the exit status is then 1.
    """
    from optkit.basics.parallel import check_jobs
    from optkit.studies.grids import STUDIES

    if name != "all" and name not in STUDIES:
        raise InputError(f"no study {name!r}; there are {', '.join(STUDIES)}, and all")
    if name == "nyc" and not trips:
        raise InputError("the study nyc needs trip records: give --trips, a TLC file (parquet or CSV) or a folder")
    if trips and name not in ("nyc", "all"):
        raise InputError(f"--trips goes with the studies nyc and all, not with {name}")
    selection = {key: value for key, value in (("mode", mode), ("fraction", fraction)) if value is not None}
    if selection and not trips:
        raise InputError(f"--{next(iter(selection))} goes with --trips and the study nyc")
    chosen = [one for one in STUDIES if name == one or (name == "all" and (one != "nyc" or trips))]
    studies = [_study(one, worlds, seeds, draws, trips, selection, settings, gap) for one in chosen]
    jobs = check_jobs(jobs, "--jobs")
    if dry_run:
        plans = [_plan(one, out, jobs) for one in studies]
        if as_json:
            say_json(plans)
        else:
            say(*(line for plan in plans for line in _told(plan)))
        return
    finished = []
    for one in studies:
        finished.append(_run(one, out, jobs, dask, force, quiet or as_json))
        if not as_json:
            _print(finished[-1])  # before it is written: a full disk must not take it away
            say(f"report: {_write(finished[-1])}")
    if as_json:
        say_json([_summary(one) for one in finished])
        for done in finished:
            _write(done)
    elif name == "all" and not trips:
        say("nyc is left out: it needs --trips")
    if any(one.run.failed for one in finished):
        raise typer.Exit(1)


class _Finished(NamedTuple):
    study: Study
    run: StudyRun
    tables: dict[str, pd.DataFrame]
    claims: list[dict[str, Any]]
    folder: Path


def _study(
    name: str,
    worlds: str,
    seeds: int,
    draws: int,
    trips: list[Path] | None,
    selection: dict[str, Any],
    settings: list[str] | None,
    gap: bool,
) -> Study:
    from optkit.cli.console import parsed_settings
    from optkit.studies.grids import Study

    files = tuple(str(path) for path in trips or ()) if name == "nyc" else ()
    more = selection if name == "nyc" else {}
    return Study(name, _worlds(worlds), seeds, parsed_settings(settings or ()), files, gap, draws=draws, **more)


def _worlds(text: str) -> tuple[int, ...]:
    from optkit.studies.grids import MOST

    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < 0 or len(set(numbers)) < len(numbers) or (numbers == (0,) and "," not in text):
        raise InputError(f"--worlds {text} is neither a number of worlds (1 or more) nor seeds by commas, like 0,1,2")
    if "," not in text and numbers[0] > MOST:
        raise InputError(f"--worlds {text} are too many: take {MOST:,} at most")
    return tuple(range(numbers[0])) if "," not in text else tuple(part for part in numbers)


def _plan(study: Study, out: Path, jobs: int) -> dict[str, Any]:
    from optkit.studies.runner import load
    from optkit.studies.store import CellStore

    cells = study.cells()
    if (out / "cells").is_dir():
        run = load(cells, CellStore(out / "cells"))
        missing, seconds = run.missing, run.expected_seconds
    else:
        from optkit.studies.runner import expected_seconds

        missing, seconds = cells, sum(expected_seconds(cell) for cell in cells)
    kinds = {kind: sum(cell.kind == kind for cell in cells) for kind in dict.fromkeys(cell.kind for cell in cells)}
    about = {"study": study.name, "cells": len(cells), "missing": len(missing), "kinds": kinds}
    return {**about, "expected_seconds": seconds / jobs, "list": [str(cell) for cell in missing]}


def _told(plan: dict[str, Any]) -> list[str]:
    kinds = ", ".join(f"{count} {kind}" for kind, count in plan["kinds"].items())
    lines = [
        f"{plan['study']}: {plan['cells']} cells ({kinds}), {plan['missing']} to be worked out, "
        f"in about {_time(plan['expected_seconds'])}"
    ]
    return lines + [f"  {cell}" for cell in plan["list"]]


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def _run(study: Study, out: Path, jobs: int, dask: str | None, force: bool, quiet: bool) -> _Finished:
    from optkit.cli.console import study_bar
    from optkit.studies.claims.verdicts import claims
    from optkit.studies.report.report import check_report
    from optkit.studies.runner import run_cells
    from optkit.studies.store import CellStore
    from optkit.studies.tables import study_tables

    cells = study.cells()
    check_report(out / study.name)
    store = CellStore(out / "cells")
    if force:
        store.forget(cells)
    with study_bar(study.name, quiet) as tell:
        run = run_cells(cells, store, trips=study.trips, jobs=jobs, dask=dask, progress=tell)
    if store.damaged:
        say(f"{store.damaged} damaged files in {store.folder} were worked out again", err=True)
    tables = study_tables(run)
    found = claims(study.name, tables)
    return _Finished(study, run, tables, found, out / study.name)


def _write(one: _Finished) -> Path:
    from optkit.studies.report.report import write_report

    return write_report(one.folder, one.study, one.run, one.claims)


def _summary(one: _Finished) -> dict[str, Any]:
    failed = {str(cell): one.run.failed[cell.key] for cell in one.run.cells if cell.key in one.run.failed}
    kept = {name: frame.to_dict(orient="records") for name, frame in one.tables.items() if name in ("worlds", "gap")}
    about = {"study": one.study.name, "cells": len(one.run.cells), "fresh": one.run.fresh, "failed": failed}
    return {**about, "report": str(one.folder / "report.html"), "claims": one.claims, "tables": kept}


def _print(one: _Finished) -> None:
    from optkit.cli.console import print_table

    if "worlds" in one.tables:
        header = ["policy", "ratio %", "std", "of arrival %"]
        rows = one.tables["worlds"].to_dict(orient="records")
        shown = [
            [f"{row['scenario']}: {row['policy']}", *(f"{row[name]:.2f}" for name in ("ratio", "std", "of_arrival"))]
            for row in rows
        ]
        print_table(one.study.name, header, shown)
    for row in one.tables["gap"].to_dict(orient="records") if "gap" in one.tables else []:
        at = f"{row['scenario']}, world {row['world']}: {row['policy']}"
        say(f"{at} is at most {row['at_most']:.2f} points from optimal (gap {row['gap']:.2f}, {row['bound']})")
    for claim in one.claims:
        say(f"Result {claim['result']}, {claim['verdict']}: {claim['pattern']} {claim['here']}")
    for cell in one.run.cells:
        if cell.key in one.run.failed:
            say(f"failed: {cell}: {one.run.failed[cell.key]}", err=True)
    spent: dict[str, float] = {}
    for cell in one.run.cells:
        if cell.key in one.run.found:
            spent[cell.kind] = spent.get(cell.kind, 0.0) + one.run.found[cell.key].seconds
    done = f"{len(one.run.found)} of {len(one.run.cells)} cells, {one.run.fresh} worked out now"
    stages = ", ".join(f"{kind} {seconds:.0f} s" for kind, seconds in spent.items())
    say(f"{done}; {sum(spent.values()):.0f} s of work in all: {stages}")
