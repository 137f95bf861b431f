"""Benchmark instance sets: generated, versioned, checksummed, and readable without optkit.

Version 1 holds scenarios I.1, I.2, I.3 and II in worlds 0 to 4, each cut into 480 training, 120 test and 30 validation
instances (``docs/explanation/scenarios.md``). ``benchmark_datasheet.md`` describes them and is written beside them as
``README.md``; ``benchmark_sets_v1.json`` holds their numbers and digests, frozen.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from optkit.basics.arrays import flag
from optkit.basics.errors import DataError, InputError
from optkit.basics.files import locked_folder, write_together
from optkit.basics.keeper import Form
from optkit.basics.version import __version__
from optkit.instances.benchmark.digest import DECIMALS, benchmark_digest
from optkit.instances.catalogue import scenario
from optkit.instances.instance import Instance
from optkit.instances.splits import PARTS
from optkit.instances.storage import load_instances, save_instances
from optkit.instances.storage.save import check_replaceable
from optkit.instances.storage.schema import read_bytes

__all__ = [
    "benchmark_digest",
    "check_benchmark_sets",
    "datasheet",
    "freeze",
    "frozen",
    "write_benchmark_sets",
]

FORMAT = "optkit-benchmark"
VERSION = 1
SCENARIOS = ("I.1", "I.2", "I.3", "II")
WORLDS = (0, 1, 2, 3, 4)

CHECKSUMS = Form(
    FORMAT,
    VERSION,
    "the CHECKSUMS.json of benchmark sets",
    "choose another folder",
    any_release=True,
    is_whole=lambda about: all(isinstance(about.get(key), dict) for key in ("sets", "files")),
)

Progress = Callable[[str, int, int], None]


def frozen() -> dict[str, Any]:
    """Return what version 1 is: per set and part the numbers of instances, requests and workers, and the digest.

    Returns
    -------
    dict
        The content of ``benchmark_sets_v1.json``.

    Examples
    --------
    >>> len(frozen()["sets"]), frozen()["sets"]["II-4"]["test"]["instances"]
    (20, 120)
    """
    told: dict[str, Any] = json.loads(_packaged(f"benchmark_sets_v{VERSION}.json"))
    return told


def datasheet() -> str:
    """Return the datasheet of version 1, in Markdown.

    Returns
    -------
    str
        What stands in the ``README.md`` beside the sets.

    Examples
    --------
    >>> datasheet().splitlines()[0]
    '# The optkit benchmark sets, version 1'
    """
    return _packaged("benchmark_datasheet.md").decode()


def _packaged(name: str) -> bytes:
    return files("optkit.instances.benchmark").joinpath(name).read_bytes().replace(b"\r\n", b"\n")


def freeze(scenarios: Sequence[str] = SCENARIOS, worlds: Sequence[int] = WORLDS) -> dict[str, Any]:
    """Draw sets and return their numbers and digests: how ``benchmark_sets_v1.json`` was made.

    Parameters
    ----------
    scenarios : sequence of str
        Names in the paper's Table 1.
    worlds : sequence of int
        World seeds.

    Returns
    -------
    dict
        In the form of :func:`frozen`.

    Examples
    --------
    >>> freeze(["I.2"], [0])["sets"]["I.2-0"] == frozen()["sets"]["I.2-0"]
    True
    """
    sets = {
        f"{name}-{world}": {part: _record(drawn) for part, drawn in scenario(name, world).split()._asdict().items()}
        for name in scenarios
        for world in worlds
    }
    made = {"optkit": __version__, "numpy": np.__version__}
    return {"format": FORMAT, "version": VERSION, "decimals": DECIMALS, "made_with": made, "sets": sets}


def _record(instances: Sequence[Instance]) -> dict[str, Any]:
    return {
        "instances": len(instances),
        "requests": sum(one.n_requests for one in instances),
        "workers": sum(one.n_workers for one in instances),
        "sha256": benchmark_digest(instances),
    }


def write_benchmark_sets(
    folder: str | os.PathLike[str],
    scenarios: Sequence[str] = SCENARIOS,
    worlds: Sequence[int] = WORLDS,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write benchmark sets, their datasheet (``README.md``) and ``CHECKSUMS.json``.

    Each part of a set, ``<scenario>-<world>/train``, ``test`` and ``validation``, appears whole or not at all. Parts
    that are there and right are kept: the same call goes on after an interruption, and others add further sets.

    Parameters
    ----------
    folder : path
        Created, with its parents.
    scenarios : sequence of str
        Of I.1, I.2, I.3 and II; case does not matter.
    worlds : sequence of int
        Of 0 to 4.
    overwrite : bool
        Replace instance sets that stand where a part belongs and are not right.
    progress : callable, optional
        Told a stage, how many sets are done, and how many there are.

    Returns
    -------
    dict
        ``sets``, the numbers and digests of those asked for, and the names of the parts ``written`` and ``kept``.

    Raises
    ------
    InputError
        If version 1 has no such set, or the folder holds something else under a name that is to be written.
    DataError
        If a part that is there is damaged or another one, or if what is drawn here is not version 1.
    OptkitError
        If the disk refuses.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     made = write_benchmark_sets(place, ["I.2"], [0])
    ...     print(made["written"], sorted(one.name for one in Path(place).iterdir()))
    ['I.2-0/train', 'I.2-0/test', 'I.2-0/validation'] ['CHECKSUMS.json', 'I.2-0', 'README.md']
    """
    flag("overwrite", overwrite)
    place, whole = Path(folder), frozen()["sets"]
    asked = [(name, world) for name in _names(scenarios) for world in _worlds(worlds)]
    names = [f"{name}-{world}" for name, world in asked]
    _listed_before(place, names)
    tell = progress or _silent
    # Look at everything before the first part is written.
    kept: list[str] = []
    for at, name in enumerate(names):
        tell("look", at, len(names))
        kept += [f"{name}/{part}" for part in PARTS if _is_there(place / name / part, whole[name][part], overwrite)]
    tell("look", len(names), len(names))
    written: list[str] = []
    for at, (name, world) in enumerate(asked):
        tell("write", at, len(names))
        missing = [part for part in PARTS if f"{name}-{world}/{part}" not in kept]
        written += _write_parts(place / f"{name}-{world}", name, world, missing, overwrite) if missing else []
    tell("write", len(names), len(names))
    with locked_folder(place):
        before = _listed_before(place, names)  # another process may have added sets
        stay = [name for name in whole if name in names or (name in before["sets"] and (place / name).is_dir())]
        hashes = {"README.md": hashlib.sha256(datasheet().encode()).hexdigest()}
        for name in stay:
            old = {file: digest for file, digest in before["files"].items() if file.startswith(f"{name}/")}
            hashes |= old if name not in names else _hashes(place, name)
        about = {"format": FORMAT, "version": VERSION, "sets": {name: whole[name] for name in stay}, "files": hashes}
        listed = json.dumps(about, indent=1) + "\n"
        write_together({place / "README.md": datasheet(), place / "CHECKSUMS.json": listed})
    return {"sets": {name: whole[name] for name in names}, "written": written, "kept": kept}


def check_benchmark_sets(folder: str | os.PathLike[str], *, progress: Progress | None = None) -> dict[str, Any]:
    """Verify a folder of benchmark sets: every file by its checksum, every part by its frozen digest.

    Parameters
    ----------
    folder : path
        Written by :func:`write_benchmark_sets`, or a copy.
    progress : callable, optional
        Told a stage, how many sets are done, and how many there are.

    Returns
    -------
    dict
        ``sets``, the numbers and digests of those that the folder holds.

    Raises
    ------
    DataError
        If a file is missing, changed or damaged, or a part is not version 1's; the message names it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     made = write_benchmark_sets(place, ["I.2"], [0])
    ...     print(list(check_benchmark_sets(place)["sets"]))
    ['I.2-0']
    """
    place, path, whole = Path(folder), Path(folder) / "CHECKSUMS.json", frozen()["sets"]
    if not place.is_dir():
        raise DataError(f"{place} is not a folder: give one that optkit generate benchmark wrote")
    if not path.exists():
        raise DataError(f"{path} is missing: optkit generate benchmark --out {place} makes the folder complete")
    about = _read_checksums(path)
    wrong = [name for name in {**whole, **about["sets"]} if about["sets"].get(name) != whole.get(name)]
    wrong = [name for name in wrong if name in about["sets"] or (place / name).exists()]
    if wrong or not about["sets"]:
        what = f"does not say of {wrong[0]} what version {VERSION} is" if wrong else "lists no set"
        raise DataError(f"{path} {what}: copy the folder again, or write it anew with optkit generate benchmark")
    tell = progress or _silent
    for at, name in enumerate(about["sets"]):
        tell("check", at, len(about["sets"]))
        for part in PARTS:
            _demand_right(place / name / part, benchmark_digest(load_instances(place / name / part)), whole[name][part])
        stated = {file: digest for file, digest in about["files"].items() if file.startswith(f"{name}/")}
        _demand_same(place, _hashes(place, name), stated)
    _demand_same(place, {"README.md": _sha256(place / "README.md")}, {"README.md": about["files"].get("README.md")})
    tell("check", len(about["sets"]), len(about["sets"]))
    return {"sets": about["sets"]}


def _silent(stage: str, done: int, total: int) -> None:
    pass


def _names(scenarios: Sequence[str]) -> list[str]:
    known = {name.lower(): name for name in SCENARIOS}
    asked = [scenarios] if isinstance(scenarios, str) else scenarios
    for name in asked:
        if str(name).lower() not in known:
            raise InputError(f"the benchmark sets have no scenario {name!r}; there are {', '.join(SCENARIOS)}")
    return list(dict.fromkeys(known[str(name).lower()] for name in asked))


def _worlds(worlds: Sequence[int]) -> list[int]:
    for world in worlds:
        if world not in WORLDS:
            raise InputError(f"the benchmark sets have no world {world}; there are {WORLDS[0]} to {WORLDS[-1]}")
    return list(dict.fromkeys(int(world) for world in worlds))


def _is_there(folder: Path, wanted: dict[str, Any], overwrite: bool) -> bool:
    """Whether a part need not be written; an error if something else is there and stays."""
    if not os.path.lexists(folder):
        return False
    try:
        _demand_right(folder, benchmark_digest(load_instances(folder)), wanted)
    except DataError as error:
        if not overwrite:
            raise DataError(f"{error}; or pass overwrite=True to replace it") from error
        check_replaceable(folder, overwrite)
        return False
    return True


def _demand_right(folder: Path, digest: str, wanted: dict[str, Any]) -> None:
    if digest != wanted["sha256"]:
        raise DataError(
            f"{folder} is not this part of version {VERSION} (content {digest[:12]}, not {wanted['sha256'][:12]}): "
            "move it away and write it anew with optkit generate benchmark"
        )


def _write_parts(folder: Path, name: str, world: int, parts: Sequence[str], overwrite: bool) -> list[str]:
    """Draw a set, compare it with what is frozen, and write some of its parts."""
    whole, opened = frozen(), scenario(name, world)
    drawn = opened.split()._asdict()
    for part in parts:
        digest, wanted = benchmark_digest(drawn[part]), whole["sets"][folder.name][part]["sha256"]
        if digest != wanted:
            raise DataError(
                f"what is drawn here for {folder.name}/{part} is not version {VERSION} (content {digest[:12]}, not "
                f"{wanted[:12]}; NumPy {np.__version__}): use NumPy {whole['made_with']['numpy']}, or copy the sets"
            )
    for part in parts:
        save_instances(folder / part, drawn[part], scenario=opened.describe() | {"part": part}, overwrite=overwrite)
    return [f"{folder.name}/{part}" for part in parts]


def _listed_before(folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """Return what a folder's CHECKSUMS.json lists; an error if the folder holds something else than our sets."""
    for place in (folder, *(folder / name for name in names)):
        if place.exists() and not place.is_dir():
            raise InputError(f"{place} is not a folder: choose another --out")
        if (place / "scenario.json").exists():
            raise InputError(f"{place} holds one instance set: choose another --out")
    readme, sums = folder / "README.md", folder / "CHECKSUMS.json"
    listed = _read_checksums(sums) if sums.exists() else {"sets": {}, "files": {}}
    ours = (hashlib.sha256(datasheet().encode()).hexdigest(), listed["files"].get(readme.name))
    if readme.exists() and _sha256(readme) not in ours:
        raise InputError(f"{readme} is not the datasheet, so it stays: choose another --out")
    return listed


def _read_checksums(path: Path) -> dict[str, Any]:
    about = CHECKSUMS.read(read_bytes(path), path)
    if about is None:
        raise DataError(f"{path} is damaged: remove it and run optkit generate benchmark")
    return about


def _hashes(folder: Path, name: str) -> dict[str, str]:
    """Return the checksums of all files of a set."""
    found = sorted(path for part in PARTS for path in (folder / name / part).iterdir())
    return {path.relative_to(folder).as_posix(): _sha256(path) for path in found}


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _demand_same(folder: Path, have: dict[str, str], stated: dict[str, Any]) -> None:
    for file in sorted({*have, *stated}):
        if have.get(file) != stated.get(file):
            state = "is missing" if file not in have else "is not listed" if file not in stated else "was changed"
            raise DataError(
                f"{folder / file} {state} (by CHECKSUMS.json): copy the folder again, or write it anew with "
                "optkit generate benchmark"
            )
