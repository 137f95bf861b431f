"""What the verbs write: files that are looked at before the work starts, and tables of policies."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optkit.basics.errors import InputError, OptkitError
from optkit.basics.paths import resolved
from optkit.cli.console import print_table, say

if TYPE_CHECKING:
    import pandas as pd

    from optkit.evaluation.comparison import Comparison


def check_file(out: Path, *suffixes: str) -> None:
    """Refuse a file that could not be written, before the work and not after it.

    Raises
    ------
    InputError
        If the name ends otherwise, or its folder does not exist or may not be written to.
    """
    from optkit.basics.folders import writable_parent

    if out.suffix not in suffixes or out.is_dir():
        raise InputError(f"--out {out} must be a file that ends in {' or '.join(suffixes)}")
    if not (resolved(out).parent.is_dir() and writable_parent(out)):
        raise InputError(f"--out {out} cannot be written: its folder does not exist, or may not be written to")


def write_rows(frame: pd.DataFrame, out: Path) -> None:
    """Write a table as .csv or .parquet, whole or not at all.

    Raises
    ------
    OptkitError
        If the disk refuses.
    """
    staging = out.with_name(f".{out.name}.tmp")
    try:
        frame.to_csv(staging, index=False) if out.suffix == ".csv" else frame.to_parquet(staging, index=False)
        os.replace(staging, out)
    except OSError as error:
        staging.unlink(missing_ok=True)
        raise OptkitError(f"{out} cannot be written ({error.strerror or error})") from error


def print_comparison(title: str, comparison: Comparison) -> None:
    """Print a row per policy, and what its numbers are."""
    rows = [_row(row, i == 0) for i, row in enumerate(comparison.table.to_dict(orient="records"))]
    print_table(title, ["policy", "ratio %", "std", "95 % interval", "difference", "served %"], rows)
    say("ratio: performance ratio against full information; difference: to the first policy, paired")


def _row(row: Mapping[Any, Any], first: bool) -> list[str]:
    paired = f"{_tidy(row['difference']):+.2f} {_interval(row['difference_low'], row['difference_high'], '+.2f')}"
    return [
        row["policy"],
        f"{row['ratio']:.2f}",
        f"{row['std']:.2f}" if row["instances"] > 1 else "-",
        _interval(row["low"], row["high"], ".2f"),
        "" if first else paired,
        f"{100 * row['served']:.1f}",
    ]


def _interval(low: float, high: float, form: str) -> str:
    # NaN: one instance has no interval.
    return f"[{_tidy(low):{form}}, {_tidy(high):{form}}]" if low == low else "-"


def _tidy(number: float) -> float:
    return round(number, 2) + 0.0  # no "-0.00"
