"""``optkit generate``: instances as a folder that any language can read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from optkit.cli.console import PARTS, open_source
from optkit.cli.options import Fraction, Json, Mode, Seed, Setting, Trips
from optkit.errors import InputError


def generate(
    source: Annotated[str, typer.Argument(help="A scenario: I.1, I.2, I.3, II, nyc-weak or nyc-strong.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    seed: Seed = 0,
    count: Annotated[
        int | None, typer.Option(help="Write one set of this many instances, instead of train, test and validation.")
    ] = None,
    sample_seed: Annotated[int, typer.Option(help="Seed of these instances, apart from the world's.")] = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    overwrite: Annotated[bool, typer.Option(help="Replace instance sets that are there.")] = False,
    as_json: Json = False,
) -> None:
    """Draw instances of a scenario and write them: requests, workers and noise as parquet, the rest as JSON."""
    from optkit.storage import save_instances

    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    if isinstance(opened, Path):
        raise InputError(f"{source} is a folder: generate takes a scenario's name")
    told: dict[str, dict[str, Any]]
    if count is None:
        sets = dict(zip(PARTS, opened.split(), strict=True))
        told = {part: {"part": part} for part in PARTS}
    else:
        sets, told = {"": opened.sample(count, sample_seed)}, {"": {"sample_seed": sample_seed}}
    for part, instances in sets.items():
        save_instances(out / part, instances, scenario=opened.describe() | told[part], overwrite=overwrite)
    sizes = {part or "instances": len(instances) for part, instances in sets.items()}
    if as_json:
        typer.echo(json.dumps({"folder": str(out), "scenario": opened.name, "seed": seed, "instances": sizes}))
    else:
        typer.echo(f"{out}: " + ", ".join(f"{size} {part}" for part, size in sizes.items()))
