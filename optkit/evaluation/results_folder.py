"""The results folder of the main job."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

from optkit.basics.errors import InputError, OptkitError
from optkit.basics.folders import foreign_entry, publish, set_aside, writable_parent
from optkit.basics.plain_json import to_json
from optkit.evaluation.main_job import RunResult
from optkit.plotting.boxes import box_plot
from optkit.plotting.files import figure_bytes

FORMAT = "optkit-run"
FILES = ("summary.json", "table.csv", "per_instance.parquet", "performance_ratio.png", "performance_ratio.pdf")
"""What a results folder holds."""


def check_target(folder: str | os.PathLike[str], origin: dict[str, Any] | None = None) -> bool:
    """Return whether results are there that may be replaced; call it before the work, not after.

    Parameters
    ----------
    folder : path
        The results folder.
    origin : dict, optional
        Where the instances come from; results of another origin are not replaced.

    Raises
    ------
    InputError
        If the folder holds anything but results of an earlier run of the same origin, or cannot be made.
    """
    target, remedy = Path(folder), "choose another folder with --out"
    aside = set_aside(target)
    if aside is not None:
        raise InputError(f"{folder} is missing: writing was interrupted; the old results are {aside}: move them back")
    if not target.exists():
        if not writable_parent(target):
            raise InputError(f"{folder} cannot be written: {remedy}")
        return False
    found = _summary(target)
    if found is None:
        raise InputError(f"{folder} exists and holds no results of optkit run: {remedy}")
    foreign = foreign_entry(target, FILES)
    if foreign is not None:
        raise InputError(f"{folder} also holds {foreign!r}: move that away, or {remedy}")
    if origin is not None and found.get("record", {}).get("origin") != json.loads(to_json(origin)):
        raise InputError(f"{folder} holds results of other instances or settings: {remedy}")
    return True


def write_results(folder: str | os.PathLike[str], result: RunResult, title: str) -> Path:
    """Write a results folder, whole or not at all; an earlier run's results in that place are replaced.

    ``summary.json`` (everything but the rows), ``table.csv``, ``per_instance.parquet``, and the box plot of performance
    ratios as ``performance_ratio.png`` and ``.pdf``.

    Raises
    ------
    InputError
        If the folder exists and does not hold results of an earlier run.
    OptkitError
        If the disk refuses.
    """
    replacing = check_target(folder)
    rows = io.BytesIO()
    result.comparison.per_instance.to_parquet(rows, index=False)
    axes = box_plot(result.comparison.ratios(), title=title)
    contents = {
        "summary.json": (to_json({"format": FORMAT, **result.to_dict()}) + "\n").encode(),
        "table.csv": result.comparison.table.to_csv(index=False).encode(),
        "per_instance.parquet": rows.getvalue(),
        "performance_ratio.png": figure_bytes(axes, "png"),
        "performance_ratio.pdf": figure_bytes(axes, "pdf"),
    }
    try:
        publish(Path(folder).resolve(), contents, replacing)
    except OSError as error:
        why = error.strerror or str(error)
        raise OptkitError(f"{folder} cannot be written ({why}); choose another with --out") from error
    return Path(folder)


def _summary(folder: Path) -> dict[str, Any] | None:
    """Return the summary of an earlier run, or None if there is none."""
    try:
        found = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and found.get("format") == FORMAT else None
