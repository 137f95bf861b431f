"""``optkit generate``: instances as a folder that any language can read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from optkit.cli.console import open_source, trips_line
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
    from optkit.splits import PARTS, has_parts
    from optkit.storage import save_instances
    from optkit.storage.save import check_replaceable

    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    if isinstance(opened, Path):
        raise InputError(f"{source} is a folder: generate takes a scenario's name")
    told: dict[str, dict[str, Any]]
    if count is None:
        sets = dict(zip(PARTS, opened.split(), strict=True))
        told = {part: {"part": part} for part in PARTS}
    else:
        sets, told = {"": opened.sample(count, sample_seed)}, {"": {"sample_seed": sample_seed}}
    # All or nothing: look at every target before the first is written.
    if out.is_dir() and (has_parts(out) if count is not None else (out / "scenario.json").exists()):
        held = "the sets of a split" if count is not None else "one set"
        raise InputError(f"{out} holds {held}: choose another --out")
    for part in sets:
        if (out / part).exists():
            try:
                check_replaceable(out / part, overwrite)
            except InputError as error:
                raise InputError(str(error).replace("pass overwrite=True", "pass --overwrite")) from None
    for part, instances in sets.items():
        save_instances(out / part, instances, scenario=opened.describe() | told[part], overwrite=overwrite)
    sizes = {part or "instances": len(instances) for part, instances in sets.items()}
    if as_json:
        typer.echo(json.dumps({"folder": str(out), "scenario": opened.name, "seed": seed, "instances": sizes}))
    else:
        line = trips_line(opened.describe())
        if line is not None:
            typer.echo(line)
        typer.echo(f"{out}: " + ", ".join(f"{size} {part}" for part, size in sizes.items()))
