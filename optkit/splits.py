"""Training, test and validation instances from a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from optkit.errors import DataError
from optkit.instance import Instance
from optkit.scenarios import Split, cut
from optkit.storage import load_instances, read_description
from optkit.world import Settings

PARTS = Split._fields

NOISE_STREAM = 8
"""Key of the noise that is drawn for sets without any."""


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
        parts = [_realised(load_instances(sets[part]), k) if part in sets else ([], 0) for k, part in enumerate(PARTS)]
        return Split(*(part for part, _ in parts)), _origin(folder, sets, sum(drawn for _, drawn in parts))
    instances, drawn = _realised(load_instances(folder), len(PARTS))
    origin = _origin(folder, {"set": folder}, drawn)
    n = len(instances)
    if n < 2:
        raise DataError(f"{folder} holds {n} instance(s): at least one to tune on and one to report on are needed")
    episodes = read_description(folder)["scenario"].get("episodes")
    if isinstance(episodes, int) and n > episodes:
        raise DataError(f"{folder} realises {episodes} half-hours of trips {n} times: generate it without --count")
    train, test, validation = Settings().split
    total = train + test + validation
    held = max(1, round(n * test / total))
    kept = round(n * validation / total)
    return cut(instances, (n - held - kept, held, kept)), origin


def _realised(instances: list[Instance], part: int) -> tuple[list[Instance], int]:
    """Return instances with noise, and for how many it had to be drawn."""
    moods = np.random.SeedSequence(0, spawn_key=(NOISE_STREAM, part)).spawn(len(instances))
    bare = [one.noise is None for one in instances]
    made = [one.with_noise(mood) if none else one for one, mood, none in zip(instances, moods, bare, strict=True)]
    return made, sum(bare)


def _origin(folder: Path, sets: dict[str, Path], drawn: int) -> dict[str, Any]:
    told = {part: read_description(place) for part, place in sets.items()}
    seals = {part: {"scenario": one["scenario"], "files": one["files"]} for part, one in told.items()}
    return {"folder": folder.resolve().name, "sets": seals, **({"noise": drawn} if drawn else {})}
