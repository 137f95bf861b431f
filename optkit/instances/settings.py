"""Table 1, and changes to it, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from optkit.basics.arrays import Known, number, whole_number
from optkit.basics.errors import InputError


def adjust(base: ScenarioSettings, changes: dict[str, Any]) -> ScenarioSettings:
    """Change some settings after checking their names and ranges.

    Raises
    ------
    InputError
        If a name is unknown or a number out of range.
    """
    names = [f.name for f in fields(ScenarioSettings)]
    for name in changes:
        if name not in names:
            raise InputError(f"no setting {name!r}; there are {', '.join(names)}")
    checked = {name: _setting(name, value) for name, value in changes.items()}
    return replace(base, **checked)


LARGEST = 100_000_000
"""Upper limit of every setting: beyond it nothing fits in memory."""

MOST_KINDS = 1_000_000
"""Upper limit of what there may be many kinds of."""


_WHOLE = {"groups": 1, "horizon": 1, "types": 1, "pickups": 1, "dropoffs": 1, "characteristics": 0}


_POSITIVE = ("mean_lifetime", "mu")


_NOT_NEGATIVE = ("request_rate", "worker_rate", "utility_noise")


def _setting(name: str, value: Any) -> Any:
    """Return a setting's value in its own type, or raise an InputError."""
    if name == "split":
        if not isinstance(value, Sequence) or len(value) != 3:
            raise InputError(f"setting split = {value!r} must be three whole numbers: training, test, validation")
        return tuple(whole_number("setting split", size, least=0, most=LARGEST) for size in value)
    if name in _WHOLE:
        most = LARGEST if name == "horizon" else MOST_KINDS
        return whole_number(f"setting {name}", value, least=_WHOLE[name], most=most)
    least, above = 0.0 if name in _NOT_NEGATIVE else -LARGEST, 0.0 if name in _POSITIVE else -np.inf
    return number(f"setting {name}", value, least=least, above=above, most=LARGEST)


@dataclass(frozen=True)
class ScenarioSettings(Known):
    """One row of the paper's Table 1.

    Attributes
    ----------
    groups : int
        Number of worker groups D, equally likely.
    request_rate, worker_rate : float
        Mean number of requests and of workers that arrive per step (Poisson).
    horizon : int
        Number of steps T.
    types, characteristics : int
        Number k of request types and number m of characteristics of a type.
    pickups, dropoffs : int
        Number of possible locations.
    mean_lifetime : float
        Mean of the exponential time that a request waits, in steps.
    mu : float
        Gumbel scale of every group, in money.
    utility_noise : float
        Standard deviation of the paper's optional random term of the utility, in money.
    loved_pickup, shunned_dropoff : float
        Money added to the utility of pick-up region 1 and taken from that of drop-off region 1.
    split : tuple of int
        Number of training, test and validation instances.
    """

    groups: int = 1
    request_rate: float = 0.5
    worker_rate: float = 0.5
    horizon: int = 50
    types: int = 5
    characteristics: int = 3
    pickups: int = 5
    dropoffs: int = 5
    mean_lifetime: float = 10.0
    mu: float = 1.0
    utility_noise: float = 0.0
    loved_pickup: float = 0.0
    shunned_dropoff: float = 0.0
    split: tuple[int, int, int] = (480, 120, 30)


_NYC = ScenarioSettings(
    request_rate=50 / 120, worker_rate=0.75, horizon=120, characteristics=2, pickups=4, dropoffs=4, split=(76, 20, 10)
)


TABLE_1: dict[str, ScenarioSettings] = {
    "I.1": ScenarioSettings(),
    "I.2": ScenarioSettings(request_rate=0.3),
    "I.3": ScenarioSettings(request_rate=1.0),
    "II": ScenarioSettings(groups=3),
    "nyc-weak": _NYC,
    "nyc-strong": ScenarioSettings(**{**_NYC.__dict__, "loved_pickup": 30.0, "shunned_dropoff": 30.0}),
}
"""The paper's scenarios. With trips, the request rate is what the thinning aims at."""
