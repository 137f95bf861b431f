"""``optkit collect``: log offers to learn from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from optkit.cli.console import open_source, say, say_json
from optkit.cli.options import Fraction, Json, Mode, Seed, Setting, Trips
from optkit.cli.output import OFFERS


def collect(
    source: Annotated[str, typer.Argument(help="A scenario, or the folder of an instance set.")],
    out: Annotated[Path, typer.Option(help="Parquet file to write.")],
    seed: Seed = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    low: Annotated[float, typer.Option(help="Smallest share of the reward offered.")] = 0.4,
    high: Annotated[float, typer.Option(help="Largest share of the reward offered.")] = 0.85,
    offer_seed: Annotated[int, typer.Option(help="Seed of the offers.")] = 0,
    as_json: Json = False,
) -> None:
    """Make random offers on training instances, and log what was offered and taken.

    A folder is split as optkit run splits it, so that the test instances stay unseen.
    """
    from optkit.instances.splits import read_split
    from optkit.learning.offer_log import collect as log_offers
    from optkit.policies.explore import RandomOffers

    OFFERS.check(out)
    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    instances = (read_split(opened)[0] if isinstance(opened, Path) else opened.split()).train
    offers = log_offers(instances, RandomOffers(low, high, seed=offer_seed))
    counts = {"offers": len(offers), "situations": offers.n_situations, "choices": offers.n_choices}
    if as_json:
        say_json({"file": str(out), **counts})
    else:
        say(f"{out}: " + ", ".join(f"{count:,} {name}" for name, count in counts.items()))
    OFFERS.check(out)
    offers.save(out)
