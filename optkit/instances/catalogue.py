"""Opens a scenario by its name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from optkit.basics.arrays import whole_number
from optkit.basics.errors import InputError
from optkit.instances.scenario import Scenario, world_generator
from optkit.instances.settings import TABLE_1, ScenarioSettings, adjust
from optkit.instances.world import World


def scenario_of(description: dict[str, Any]) -> Scenario | None:
    """Make the scenario again that an instance set says it was drawn from; None if it says none that can be made.

    Parameters
    ----------
    description : dict
        ``read_description(folder)["scenario"]``, from :meth:`optkit.instances.scenario.Scenario.describe`. A scenario
        with trips cannot be made without its trips.

    Examples
    --------
    >>> scenario_of(scenario("I.2", seed=3, horizon=20).describe()).settings.horizon
    20
    >>> scenario_of({"origin": "by hand"})
    """
    name = description.get("name")
    if not isinstance(name, str) or name not in TABLE_1 or str(name).startswith("nyc"):
        return None
    try:
        return scenario(str(name), description["seed"], **description["settings"])
    except (InputError, KeyError, TypeError):
        return None


def worker_settings(description: dict[str, Any]) -> ScenarioSettings | None:
    """Return the settings of a scenario with trips that an instance set says it was drawn from, or None."""
    name = description.get("name")
    if not isinstance(name, str) or name not in TABLE_1:
        return None
    try:
        return ScenarioSettings(**description["settings"])
    except (KeyError, TypeError):
        return None


def scenario(
    name: str, seed: int = 0, *, trips: str | Path | Sequence[str | Path] | None = None, **settings: Any
) -> Scenario:
    """Make a scenario of the paper's Table 1.

    Parameters
    ----------
    name : {"I.1", "I.2", "I.3", "II", "nyc-weak", "nyc-strong"}
        Case does not matter.
    seed : int
        The world's seed. I.1, I.2 and I.3 share their world at the same seed.
    trips : path or sequence of paths, optional
        Trip records for the two NYC scenarios, see :func:`optkit.instances.new_york.trip_scenario.trip_scenario`.
    **settings
        Fields of :class:`optkit.instances.settings.ScenarioSettings` to change, for example ``horizon=1000``; for the
        NYC scenarios also those of :func:`optkit.instances.new_york.trip_scenario.trip_scenario`.

    Returns
    -------
    Scenario
        The same for the same name, seed and settings on any machine.

    Raises
    ------
    InputError
        If the name or a setting is unknown or out of range, or trips are missing where they are needed.

    Examples
    --------
    >>> one, again = (scenario("I.1", seed=0).sample(2, seed=7) for _ in range(2))
    >>> one == again
    True
    >>> [len(part) for part in scenario("II", seed=0, split=(4, 2, 1)).split()]
    [4, 2, 1]
    """
    known = {key.lower(): key for key in TABLE_1}
    key = known.get(str(name).lower().replace("_", "-"))
    if key is None:
        raise InputError(f"no scenario {name!r}; there are {', '.join(TABLE_1)}")
    seed = whole_number("the world's seed", seed, least=0)
    if key.startswith("nyc"):
        from optkit.instances.new_york.trip_scenario import trip_scenario

        if trips is None:
            raise InputError(f"scenario {key} needs trip records: pass trips= a TLC file (parquet or CSV)")
        return trip_scenario(key, int(seed), trips, **settings)
    if trips is not None:
        raise InputError(f"scenario {key} takes no trips; the scenarios with trips are nyc-weak and nyc-strong")
    chosen = adjust(TABLE_1[key], settings)
    return Scenario(key, int(seed), chosen, World.draw(chosen, world_generator(int(seed))))
