"""``optkit train``: a pricing policy from instances."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.basics.errors import InputError
from optkit.cli.console import open_source, print_table, progress_bar, say, say_json
from optkit.cli.options import Believed, Fraction, Json, Mode, Quiet, Seed, Setting, Trips
from optkit.cli.output import FEW, POLICY
from optkit.models.value.catalogue import VALUES

if TYPE_CHECKING:
    from optkit.instances.scenario import Split
    from optkit.learning.trained import Trained


def train(
    source: Annotated[str, typer.Argument(help="A scenario (I.1, I.2, I.3, II, nyc-weak, nyc-strong) or a folder.")],
    seed: Seed = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    value: Annotated[
        str,
        typer.Option(help=f"Value function: {', '.join(VALUES)}."),
    ] = "linear",
    choice: Annotated[
        str | None,
        typer.Option(
            help="Choice model: learned (one per worker group), pooled (one for all), or true: the instances' own "
            "utilities. Learned by default, true where instances have no features to learn from."
        ),
    ] = None,
    preferences: Believed = None,
    instances: Annotated[
        int | None,
        typer.Option(help="Train on so many instances drawn for it, not on the split's; of a scenario only."),
    ] = None,
    seeds: Annotated[int, typer.Option(help="Trainings to choose from by validation instances.")] = 1,
    training_seed: Annotated[int | None, typer.Option(help="Seed of the training; the world's by default.")] = None,
    deviations: Annotated[
        str | None,
        typer.Option(help="Exploration noise of each round, money, e.g. 8,4; the value function's own by default."),
    ] = None,
    discount: Annotated[
        float | None, typer.Option(help="Of the future, in [0, 1]; the value function's own by default.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Policy file to write; an earlier policy there is replaced.")] = Path(
        "policy.json"
    ),
    checkpoint: Annotated[
        Path | None, typer.Option(help="Keep each seed's outcome in this folder; the same command goes on from there.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn the workers' preferences and the value of waiting, and write a policy for optkit evaluate.

    Trains on training instances and chooses the round and the seed by validation instances; a folder is split as optkit
    run splits it. Test instances stay unseen.
    """
    from optkit.instances.splits import read_split, training_split
    from optkit.learning.training import train as train_policy
    from optkit.models.preferences.preferences import Preferences

    POLICY.check(out, reads=[preferences] if preferences is not None else [])
    _check_checkpoint(checkpoint)
    if preferences is not None and choice is not None:
        raise InputError(f"--choice {choice} goes without --preferences, which are the choice model")
    given = None if preferences is None else Preferences.load(preferences)
    chosen: dict[str, Any] = {"seeds": seeds, "seed": seed if training_seed is None else training_seed}
    if deviations is not None:
        chosen["deviations"] = _numbers(deviations)
    if discount is not None:
        chosen["discount"] = discount
    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    split = training_split(read_split(opened)[0] if isinstance(opened, Path) else opened, instances)
    bare = any(one.features.shape[1] == 0 for one in split.train)
    if choice is None:
        choice = "given" if given is not None else "true" if bare else "learned"
    if bare and choice != "given":
        say(f"optkit: {FEW}" + "; utilities are the instances' own" * (choice == "true"), err=True)
    started = time.perf_counter()
    try:
        with progress_bar(quiet or as_json) as tell:
            trained = train_policy(
                split,
                value,
                choice=choice if given is None else given,  # type: ignore[arg-type]
                checkpoint=checkpoint,
                progress=lambda k, n: tell("training", k, n),
                **chosen,
            )
    except KeyboardInterrupt:
        say(f"optkit: {_how_to_go_on(checkpoint)}", err=True)
        raise
    seconds = time.perf_counter() - started
    at = _chosen(trained)
    if as_json:
        told: dict[str, Any] = {"file": str(out), "source": source, "value": value, "choice": choice, "chosen": at}
        told |= {
            "trained_on": trained.source,
            "settings": trained.settings,
            "record": trained.record,
            "failures": trained.failures,
        }
        say_json({**told, "seconds": round(seconds, 3)})
    else:
        _print(trained, split, f"{source}: {value}, {choice} MNL", seconds)
    POLICY.check(out)
    trained.save(out)
    if not as_json:
        say(f"policy: {out}")


def _print(trained: Trained, split: Split, title: str, seconds: float) -> None:
    at = _chosen(trained)
    header = ["seed", "round", "exploration", "validation reward", "residual", "seconds"]
    print_table(title, header, [_row(row) for row in trained.record])
    for row in trained.record:
        if row["error"]:
            say(f"seed {row['seed']}, round {row['round']}: {row['error']}")
    for why in trained.failures:
        say(f"a seed is left out: {why}")
    by = "the best on validation instances" if split.validation else "the last, for there are no validation instances"
    say(f"chosen: seed {at['seed']}, round {at['round']}: {by}")
    say(f"instances: {len(split.train)} for training, {len(split.validation)} for validation")
    say(f"time: {seconds:.1f} s")


def _check_checkpoint(folder: Path | None) -> None:
    from optkit.basics.folders import writable_parent

    if folder is not None and not (folder.is_dir() or (not folder.exists() and writable_parent(folder))):
        raise InputError(f"--checkpoint {folder} cannot be made, or is no folder: choose another")


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(number) for number in text.split(","))
    except ValueError:
        raise InputError(f"--deviations {text} is not of the form 8,4: numbers, one for each round") from None


def _how_to_go_on(checkpoint: Path | None) -> str:
    if checkpoint is None:
        return "no seed was kept; with --checkpoint FOLDER each would be, once it is done"
    return f"seeds that were done are kept in {checkpoint}: the same command goes on from there"


def _chosen(trained: Trained) -> dict[str, Any]:
    """Seed, round and validation score of the round that was taken: of equals, the first seed and the last round."""
    done = [row for row in trained.record if not row["error"]]
    best = [row for row in done if row["score"] == trained.score] or done
    taken = [row for row in best if row["seed"] == best[0]["seed"]][-1]
    return {name: taken[name] for name in ("seed", "round", "score")}


def _row(row: dict[str, Any]) -> list[str]:
    def shown(name: str, form: str) -> str:
        number = row.get(name)
        return "-" if number is None else f"{number:{form}}"

    first = [str(row["seed"]), str(row["round"]), f"{row['deviation']:g}"]
    return [*first, shown("score", ".2f"), shown("residual", ".3f"), shown("seconds", ".2f")]
