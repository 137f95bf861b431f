"""The results folder of the main job."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

from optkit.basics.files import cannot_write
from optkit.basics.folders import ResultsFolder, publish
from optkit.basics.paths import resolved
from optkit.basics.plain_json import to_json
from optkit.evaluation.main_job import RunResult
from optkit.plotting.boxes import box_plot
from optkit.plotting.files import figure_bytes, settled

FORMAT = "optkit-run"
FILES = ("summary.json", "table.csv", "per_instance.parquet", "performance_ratio.png", "performance_ratio.pdf")
"""What a results folder holds."""

FOLDER = ResultsFolder("summary.json", FORMAT, "the results of optkit run", early=FILES)


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
        If the folder holds anything but results of an earlier run of the same origin, as they were written, or cannot
        be made.
    """

    def differs(told: dict[str, Any]) -> str | None:
        record = told.get("record")
        before = record.get("origin") if isinstance(record, dict) else None
        same = origin is None or before == json.loads(to_json(origin))
        return None if same else "results of other instances or settings"

    return FOLDER.check(folder, differs)


def write_results(folder: str | os.PathLike[str], result: RunResult, title: str) -> Path:
    """Write a results folder, whole or not at all; an earlier run's results in that place are replaced.

    ``summary.json`` (everything but the rows, and the digest of every file), ``table.csv``, ``per_instance.parquet``,
    and the box plot of performance ratios as ``performance_ratio.png`` and ``.pdf``.

    Raises
    ------
    InputError
        If the folder exists and does not hold results of an earlier run.
    OptkitError
        If the disk refuses.
    """
    check_target(folder)
    rows = io.BytesIO()
    result.comparison.per_instance.to_parquet(rows, index=False)
    axes = box_plot(result.comparison.ratios(), title=title)
    settled(axes.get_figure(root=True))  # type: ignore[arg-type]
    contents = {
        "table.csv": result.comparison.table.to_csv(index=False).encode(),
        "per_instance.parquet": rows.getvalue(),
        "performance_ratio.png": figure_bytes(axes, "png"),
        "performance_ratio.pdf": figure_bytes(axes, "pdf"),
    }
    try:
        publish(resolved(folder), FOLDER.files(contents, result.to_dict()), lambda: check_target(folder))
    except OSError as error:
        raise cannot_write(folder, error, "choose another with --out") from error
    return Path(folder)
