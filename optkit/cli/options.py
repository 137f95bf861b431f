"""Options that several verbs have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Seed = Annotated[int, typer.Option(help="The world's seed: types, places, weights, and the instances of the split.")]
Trips = Annotated[
    list[Path] | None,
    typer.Option(help="TLC trip records for nyc-weak and nyc-strong: parquet or CSV files, or a folder; repeatable."),
]
Mode = Annotated[str | None, typer.Option(help="How trips become instances: folded (default) or mondays.")]
Fraction = Annotated[float | None, typer.Option(help="Share of the trips that become requests.")]
Setting = Annotated[
    list[str] | None,
    typer.Option(
        "--set", help="Change a setting of the scenario, e.g. --set horizon=1000; repeatable.", metavar="NAME=NUMBER"
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON to standard output instead of a table.")]
Traceback = Annotated[bool, typer.Option("--traceback", help="If it fails, show where, before the line that says why.")]
Jobs = Annotated[
    int | None,
    typer.Option(help="Processes; 0 for one per core, which is the default where it would last some seconds."),
]
Believed = Annotated[
    Path | None,
    typer.Option("--preferences", help="What workers like: preferences.json, which optkit fit --out FOLDER writes."),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]
