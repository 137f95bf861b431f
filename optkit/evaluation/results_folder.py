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
"""What a results folder held before it also had a README."""

README = """\
# Results of optkit run

Money is in the unit of the instances. Means are over the test instances whose bound was proven.

## table.csv, a row per policy

- policy: *Myopic* prices optimally and gives the future no value; *Learned MNL* too, with preferences from offers that
  were logged: *paper's data* is one round of random offers, *re-estimated* are rounds of offers near its own prices.
  *Linear* and *Kernel* also know what a request is worth that waits. FP pays by a tuned formula of reward, distance,
  penalty and urgency (`expiry_boost`), PP a tuned share of the reward. *Given MNL* believes the preferences given.
- ratio: mean performance ratio in per cent: 100 for a clairvoyant, 0 if every request expires; std, low, high: its
  standard deviation over instances and 95 % confidence interval.
- difference, difference_low, difference_high: of the ratio to the first policy, paired by instance, with its 95 %
  confidence interval; p_value: of the paired t-test that there is none.
- reward: mean total reward, money; instances: how many the means are over; served: share of requests that were served;
  margin_share: share of their rewards that the platform kept.

## per_instance.parquet, a row per policy and instance

- instance: its number among the test instances; bound: the full-information bound, money; requests, workers: how many.
- reward: total reward, money; ratio: performance ratio, per cent; served: requests served; paid: compensations, money.

## summary.json

The table, and under `record`: settings, versions, tuned weights, seconds by stage, and of learning for each round
`standard_error` (money), `rmse` and `mbe` (root mean square and mean error of utilities against the truth, money),
`fit_converged` (the likelihood's search ended at its maximum), and `verdict`: *identified* where the offers tell the
level of utility, *weak* where they hardly do, *not identified* where they do not. `within_tolerance`: whether the last
standard error was below `tolerance`.

## performance_ratio.png and .pdf

Boxes span the quartiles, the line is the median, the diamond the mean; whiskers reach 1.5 times the box, dots lie
beyond.
"""
"""What the files and columns of a results folder mean."""

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

    ``README.md`` says what all of it means; ``summary.json`` (everything but the rows, and the digest of every file),
    ``table.csv``, ``per_instance.parquet``, and the box plot of performance ratios as ``performance_ratio.png`` and
    ``.pdf``.

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
        "README.md": README.encode(),
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
