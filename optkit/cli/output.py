"""What the verbs write: kinds of files by which their own are known again, and tables of policies."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optkit.basics.own_files import OwnFile
from optkit.basics.plain_json import is_sealed, parse_object, sealed
from optkit.basics.written import remember, remembered
from optkit.cli.console import print_table, say

if TYPE_CHECKING:
    import pandas as pd

    from optkit.evaluation.comparison import Comparison


def _is_table(data: bytes) -> bool:
    if data.startswith(b"PAR1"):
        return _has_mark(data, b"optkit")
    return remembered(data)


def _has_mark(data: bytes, mark: bytes) -> bool:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return mark in (pq.read_schema(pa.BufferReader(data)).metadata or {})
    except (OSError, pa.ArrowException):
        return False


def _is_figure(data: bytes) -> bool:
    from optkit.plotting.files import drawn_here

    return drawn_here(data)


def _is_policy(data: bytes) -> bool:
    from optkit.learning.trained import FORMAT

    found = parse_object(data)
    return found is not None and found.get("format") == FORMAT and is_sealed(found)


ROWS = OwnFile("rows of optkit as it wrote them here", _is_table, (".csv", ".parquet"))
FIGURE = OwnFile("figure of optkit", _is_figure, (".png", ".pdf"))
OFFERS = OwnFile("offers of optkit collect", lambda data: _has_mark(data, b"optkit-offers"), (".parquet",))
POLICY = OwnFile("trained policy", _is_policy, (".json",))


def _is_preferences(data: bytes) -> bool:
    found = parse_object(data)
    return found is not None and found.get("format") == "optkit preferences" and is_sealed(found)


PREFERENCES = OwnFile("preferences of optkit", _is_preferences, (".json",))

FIT = "optkit fit"


def fit_text(text: str) -> str:
    """Return the text file of a fit, by which it is known again: with a digest of what it tells."""
    return f"{FIT}, digest {hashlib.sha256(text.encode()).hexdigest()[:16]}\n\n{text}"


def _is_fit_text(data: bytes) -> bool:
    try:
        return fit_text(data.decode().partition("\n\n")[2]).encode() == data
    except UnicodeDecodeError:
        return False


def _is_fit(data: bytes) -> bool:
    found = parse_object(data)
    return found is not None and found.get("format") == FIT and is_sealed(found)


FIT_TEXT = OwnFile("summary of optkit fit", _is_fit_text)
FIT_JSON = OwnFile("summary of optkit fit", _is_fit, (".json",))


def fit_document(plain: dict[str, Any]) -> dict[str, Any]:
    """Return what is told of a fit as it stands in its JSON file, which is known again by it."""
    return sealed({"format": FIT, **plain})


FEW = "without features, learned preferences are little more than one level of utility for all requests"
"""What is to be known of them."""


def write_rows(frame: pd.DataFrame, out: Path) -> None:
    """Write a table as .csv or .parquet, whole or not at all.

    Raises
    ------
    InputError
        If something else is there by now.
    OptkitError
        If the disk refuses.
    """
    if out.suffix == ".csv":
        data = frame.to_csv(index=False).encode()
        ROWS.write(out, data)
        remember(data)
        return
    import pyarrow as pa
    import pyarrow.parquet as pq

    table, sink = pa.Table.from_pandas(frame, preserve_index=False), io.BytesIO()
    pq.write_table(table.replace_schema_metadata({**table.schema.metadata, "optkit": "rows"}), sink)
    ROWS.write(out, sink.getvalue())


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
