"""Training, test and validation instances from a folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from optkit.basics.arrays import whole_number
from optkit.basics.errors import DataError, InputError
from optkit.basics.paths import resolved
from optkit.basics.seeds import Stream, stream
from optkit.instances.digest import exact_digest
from optkit.instances.instance import Instance
from optkit.instances.new_york.trip_scenario import TripScenario
from optkit.instances.scenario import Scenario, Split, cut
from optkit.instances.settings import ScenarioSettings
from optkit.instances.storage import load_instances, read_description
from optkit.instances.world import check_sample

PARTS = Split._fields


def has_parts(folder: Path) -> bool:
    """Whether a folder holds the sets of a split rather than one set.

    Raises
    ------
    DataError
        If it holds both, because nobody can tell which is meant.
    """
    parts = [part for part in PARTS if (folder / part).is_dir()]
    if parts and (folder / "scenario.json").exists():
        raise DataError(f"{folder} is an instance set and also holds {', '.join(parts)}: move one of them away")
    return bool(parts)


def read_split(folder: Path) -> tuple[Split, dict[str, Any]]:
    """Read the parts that ``optkit generate`` writes, or cut one set as the paper's scenarios are cut.

    Nobody records the workers' noise, and simulated workers need some: where a set has none it is drawn here, the same
    each time.

    Returns
    -------
    Split
        The instances.
    dict
        Where they come from: the folder's name, and per set its scenario and checksum; ``noise``, for how many
        instances it was drawn, if for any.

    Raises
    ------
    DataError
        If a set cannot be read, is too small to be cut, or realises the same trips more than once.
    """
    if has_parts(folder):
        sets = {part: folder / part for part in PARTS if (folder / part).is_dir()}
        parts = [realised(load_instances(sets[part]), k) if part in sets else ([], 0) for k, part in enumerate(PARTS)]
        return Split(*(part for part, _ in parts)), _origin(folder, sets, sum(drawn for _, drawn in parts))
    instances, drawn = realised(load_instances(folder), len(PARTS))
    origin = _origin(folder, {"set": folder}, drawn)
    n = len(instances)
    if n < 2:
        raise DataError(f"{folder} holds {n} instance(s): at least one to tune on and one to report on are needed")
    episodes = read_description(folder)["scenario"].get("episodes")
    if isinstance(episodes, int) and n > episodes:
        raise DataError(f"{folder} realises {episodes} half-hours of trips {n} times: generate it without --count")
    train, test, validation = ScenarioSettings().split
    total = train + test + validation
    held = max(1, round(n * test / total))
    kept = round(n * validation / total)
    return cut(instances, (n - held - kept, held, kept)), origin


def read_apart(folder: Path, train: Path) -> tuple[Split, dict[str, Any]]:
    """Read days to measure on from one folder, and days to learn from from another; each a set, or parts of a split.

    Returns
    -------
    Split
        The folder's test part, or all of its set; training and validation parts of the other, or all of its set.
    dict
        Where they come from, as of :func:`read_split`.

    Raises
    ------
    DataError
        If a set cannot be read.
    InputError
        If a day is in both.
    """
    tested, other = (folder / "test" if has_parts(folder) else folder), {"train": train}
    if has_parts(train):
        other = {part: train / part for part in ("train", "validation") if (train / part).is_dir()}
    sets = {**other, "test": tested}
    parts = {part: realised(load_instances(place), 4 + PARTS.index(part)) for part, place in sets.items()}
    days = {part: parts.get(part, ([], 0))[0] for part in PARTS}
    known = {_bare_digest(one) for one in (*days["train"], *days["validation"]) if one.n_requests}
    both = sum(_bare_digest(one) in known for one in days["test"])
    if both:
        raise InputError(f"{both} of the days of {folder} are in {train} too: learn from others than those measured on")
    return Split(**days), _origin(folder, sets, sum(drawn for _, drawn in parts.values()))


def _bare_digest(one: Instance) -> bytes:
    return exact_digest([replace(one, noise=None, outside_noise=None)])


def realised(instances: list[Instance], part: int) -> tuple[list[Instance], int]:
    """Return instances with noise, and for how many it had to be drawn."""
    moods = stream(0, Stream.FOLDER_NOISE, part).spawn(len(instances))
    bare = [one.noise is None for one in instances]
    made = [one.with_noise(mood) if none else one for one, mood, none in zip(instances, moods, bare, strict=True)]
    return made, sum(bare)


def _origin(folder: Path, sets: dict[str, Path], drawn: int) -> dict[str, Any]:
    told = {part: read_description(place) for part, place in sets.items()}
    seals = {part: {"scenario": one["scenario"], "files": one["files"]} for part, one in told.items()}
    return {"folder": resolved(folder).name, "sets": seals, **({"noise": drawn} if drawn else {})}


def held_out(source: Scenario, count: int | None = None) -> list[Instance]:
    """Test instances of a scenario's split; beyond their number, instances that are drawn apart.

    Raises
    ------
    InputError
        If the count is no whole number or negative, or larger than the split of a scenario with trips has.
    """
    if count is not None:
        check_sample(source.settings, count)
    tests = source.split().test
    if count is None:
        return tests
    if count > len(tests) and isinstance(source, TripScenario):
        raise InputError(f"{count} instances: these trips make {len(tests)} test instances of distinct half-hours")
    return [*tests, *source.further("test", max(0, count - len(tests)))][:count]


def training_split(source: Scenario | Split, instances: int | None = None) -> Split:
    """Return what :func:`~optkit.learning.training.train` trains on and chooses by.

    Parameters
    ----------
    source : Scenario or Split
        A split is returned as it is.
    instances : int, optional
        As in :func:`~optkit.learning.training.train`.

    Returns
    -------
    Split
        With the scenario's own test instances.

    Raises
    ------
    InputError
        If instances are asked for of what is no scenario, or their number is no whole number of at least 1.

    Examples
    --------
    >>> from optkit import scenario
    >>> [len(part) for part in training_split(scenario("I.2", seed=0, split=(40, 10, 4)), 100)]
    [100, 10, 10]
    """
    if instances is None:
        return source.split() if isinstance(source, Scenario) else source
    if not isinstance(source, Scenario):
        raise InputError(f"instances = {instances} can be drawn from a scenario only: pass one, or leave instances out")
    instances = whole_number("instances", instances, least=1)
    check_sample(source.settings, instances)
    split = source.split()
    # As many to choose by, in proportion: rounds differ by less than the few of the split can tell.
    by = max(len(split.validation), round(instances * len(split.validation) / max(1, len(split.train))))
    further = {"validation": source.further("validation", by)} if split.validation else {}
    return split._replace(train=source.further("train", instances), **further)
