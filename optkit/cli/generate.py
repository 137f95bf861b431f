"""``optkit generate``: instances as a folder that any language can read, and the benchmark sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from optkit.basics.errors import DataError, InputError
from optkit.cli.console import open_source, progress_bar, say, say_json, trips_line
from optkit.cli.options import Fraction, Json, Mode, Quiet, Seed, Setting, Trips

BENCHMARK_ONLY = ("scenarios", "worlds", "check")
SCENARIO_ONLY = ("seed", "count", "sample_seed", "trips", "mode", "fraction", "settings")
NAMES = {"settings": "set", "sample_seed": "sample-seed", "scenarios": "scenario", "worlds": "world"}


def generate(
    context: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            help="A scenario (I.1, I.2, I.3, II, nyc-weak or nyc-strong), or benchmark for the benchmark sets."
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Folder to write; required, but for --check.")] = None,
    seed: Seed = 0,
    count: Annotated[
        int | None, typer.Option(help="Write one set of this many instances, instead of train, test and validation.")
    ] = None,
    sample_seed: Annotated[int, typer.Option(help="Seed of these instances, apart from the world's.")] = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    scenarios: Annotated[
        list[str] | None,
        typer.Option("--scenario", help="benchmark: sets of this scenario alone; repeatable.", metavar="NAME"),
    ] = None,
    worlds: Annotated[
        list[int] | None,
        typer.Option("--world", help="benchmark: sets of this world alone, 0 to 4; repeatable.", metavar="SEED"),
    ] = None,
    check: Annotated[Path | None, typer.Option(help="benchmark: verify the sets of this folder.")] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace instance sets that are there.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw instances of a scenario and write them: requests, workers and noise as parquet, the rest as JSON.

    `optkit generate benchmark --out FOLDER` writes the benchmark sets, versioned and checksummed, with their datasheet:
    scenarios I.1, I.2, I.3 and II in worlds 0 to 4. The same command goes on after an interruption.
    """
    benchmark = source.lower() == "benchmark"
    for name in SCENARIO_ONLY if benchmark else BENCHMARK_ONLY:
        if _given(context, name):
            option = NAMES.get(name, name)
            raise InputError(f"--{option} goes with {'a scenario, not with benchmark' if benchmark else 'benchmark'}")
    if check is not None:
        if out is not None or any(_given(context, name) for name in ("scenarios", "worlds", "overwrite")):
            raise InputError("--check takes a folder and all that it holds: leave the other options out")
        _check(check, as_json, quiet)
        return
    if out is None:
        raise InputError("--out is missing: name the folder to write")
    if benchmark:
        _write(out, scenarios, worlds, overwrite, as_json, quiet)
        return
    from optkit.instances.splits import PARTS, has_parts
    from optkit.instances.storage import save_instances
    from optkit.instances.storage.save import check_replaceable

    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    if isinstance(opened, Path):
        raise InputError(f"{source} is a folder: generate takes a scenario's name")
    told: dict[str, dict[str, Any]]
    if count is not None and count < 1:
        raise InputError(f"--count {count}: a set has at least one instance")
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
        say_json({"folder": str(out), "scenario": opened.name, "seed": seed, "instances": sizes})
    else:
        line = trips_line(opened.describe())
        if line is not None:
            say(line)
        say(f"{out}: " + ", ".join(f"{size} {part}" for part, size in sizes.items()))


def _given(context: typer.Context, name: str) -> bool:
    """Whether an option was written on the command line, be it with its default."""
    source = context.get_parameter_source(name)
    return source is not None and source.name != "DEFAULT"


def _write(
    out: Path, scenarios: list[str] | None, worlds: list[int] | None, overwrite: bool, as_json: bool, quiet: bool
) -> None:
    from optkit.instances.benchmark.sets import SCENARIOS, VERSION, WORLDS, write_benchmark_sets

    with progress_bar(quiet or as_json) as progress:
        try:
            made = write_benchmark_sets(
                out, scenarios or SCENARIOS, worlds or WORLDS, overwrite=overwrite, progress=progress
            )
        except DataError as error:
            raise DataError(str(error).replace("pass overwrite=True", "pass --overwrite")) from None
    if as_json:
        say_json({"folder": str(out), "version": VERSION, **made})
    else:
        counts = f"{len(made['written'])} parts written, {len(made['kept'])} kept"
        say(f"{out}: version {VERSION}, {_sizes(made)}; {counts}")


def _check(folder: Path, as_json: bool, quiet: bool) -> None:
    from optkit.instances.benchmark.sets import VERSION, check_benchmark_sets

    with progress_bar(quiet or as_json) as progress:
        found = check_benchmark_sets(folder, progress=progress)
    if as_json:
        say_json({"folder": str(folder), "version": VERSION, **found})
    else:
        say(f"{folder}: version {VERSION}, {_sizes(found)}; all files and contents are right")


def _sizes(told: dict[str, Any]) -> str:
    parts = [part for one in told["sets"].values() for part in one.values()]
    sets = "1 set" if len(told["sets"]) == 1 else f"{len(told['sets'])} sets"
    return f"{sets}, {sum(part['instances'] for part in parts):,} instances"
