"""``optkit evaluate``: a trained policy on instances."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optkit.basics.errors import InputError
from optkit.cli.console import open_source, progress_bar, say, say_json, trips_line
from optkit.cli.options import Believed, Fraction, Json, Mode, Quiet, Seed, Setting, Trips
from optkit.cli.output import ROWS, print_comparison, write_rows

if TYPE_CHECKING:
    from optkit.instances.instance import Instance
    from optkit.instances.scenario import Scenario

MYOPIC = "Myopic, same MNL"
"""The row that the policy is compared with: the same choice model, and a future that is worth nothing."""


def evaluate(
    policy: Annotated[Path, typer.Argument(help="Policy file, written by optkit train.")],
    source: Annotated[str, typer.Argument(help="A scenario (I.1, I.2, I.3, II, nyc-weak, nyc-strong) or a folder.")],
    seed: Seed = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    part: Annotated[
        str, typer.Option(help="test, validation or train, as optkit run splits the source; or all instances.")
    ] = "test",
    preferences: Believed = None,
    out: Annotated[
        Path | None, typer.Option(help="Also write a row per policy and instance to this .csv or .parquet file.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare a trained policy with the myopic one of the same choice model, and with full information.

    Both meet the same workers on the same instances. An instance whose bound could not be computed is left out and
    named; the exit status is then 1.
    """
    from optkit.evaluation.comparison import compare
    from optkit.evaluation.proven import proven_bounds
    from optkit.learning.trained import Trained
    from optkit.models.preferences.preferences import Preferences
    from optkit.policies import PostDecisionPricing
    from optkit.simulation.batch import Batch
    from optkit.simulation.simulator import simulate

    if out is not None:
        ROWS.check(out, reads=[policy] if preferences is None else [policy, preferences])
    trained = Trained.load(policy)
    if preferences is not None:
        trained = trained.believing(Preferences.load(preferences))
    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    instances = _instances(opened, source, part)
    batch = Batch.of(instances)
    try:
        simulate(batch, trained.policy)
    except InputError as error:
        raise InputError(f"{policy} does not fit the instances of {source}: {error}") from None
    with progress_bar(quiet or as_json) as tell:
        kept, bounds, failures, worst = proven_bounds(instances, tell)
    policies = {MYOPIC: PostDecisionPricing(choice=trained.policy.choice), policy.name: trained.policy}
    comparison = compare([instances[i] for i in kept], policies, bounds, labels=kept)
    horizon = trained.source.get("horizon", batch.horizon)
    other = f"trained on instances of {horizon} steps, these have {batch.horizon}: prices near the end may be off"
    note = None if horizon == batch.horizon else other
    if as_json:
        told = {"policy": str(policy), "source": source, "part": part, "instances": len(instances), "note": note}
        table = comparison.table.to_dict(orient="records")
        say_json({**told, "policies": table, "worst_bound_gap": worst, "bound_failures": failures})
    else:
        print_comparison(f"{source}: {len(kept)} {part} instances", comparison)
        trips_told = None if isinstance(opened, Path) else trips_line(opened.describe())
        if trips_told is not None:
            say(trips_told)
        say(f"bounds: every certificate checked, largest gap {worst:.1e} (money)")
        if note is not None:
            say(f"note: {note}")
        for i, why in failures.items():
            say(f"bounds: instance {i} is left out: {why}")
    if out is not None:
        write_rows(comparison.per_instance, out)
        if not as_json:
            say(f"rows: {out}")
    if failures:
        raise typer.Exit(1)


def _instances(opened: Scenario | Path, source: str, part: str) -> list[Instance]:
    from optkit.instances.splits import PARTS, has_parts, read_split, realised
    from optkit.instances.storage import load_instances

    if part not in (*PARTS, "all"):
        raise InputError(f"--part {part} is unknown; there are {', '.join(PARTS)} and all")
    if part == "all" and isinstance(opened, Path) and not has_parts(opened):
        found, _ = realised(load_instances(opened), len(PARTS))
    else:
        split = read_split(opened)[0] if isinstance(opened, Path) else opened.split()
        found = [one for each in split for one in each] if part == "all" else getattr(split, part)
    if not found:
        raise InputError(f"{source} has no instances in --part {part}")
    return found
