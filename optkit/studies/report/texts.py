"""The tables of a study as people read them: headings with units, sensible digits, intervals in one column."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

NOTHING = "–"
"""Stands where there is no number."""

CAPTIONS = {
    "worlds": "Policies over worlds: mean of the worlds' mean performance ratios, with an interval over worlds where "
    "there are several, the least and the most of them, and the lead over the better of PP and FP.",
    "ratios": "Policies in each scenario and world: performance ratio with its interval over instances, share of the "
    "arrival-information bound, requests served, and the lead over the better rule, paired by instance.",
    "bounds": "Mean of each bound, in money and in points of full information, and the largest gap that one of its "
    "certificates leaves open.",
    "gap": "Certified gap to optimality: points of full information that separate a policy from the best bound.",
    "estimation": "Errors of learned utilities on the test instances' requests, true less estimated, by group.",
    "operations": "What workers got beyond their burden, how many were used, and how evenly pairs of places were "
    "served (coefficient of variation of their shares).",
    "sensitivity": "One row per perturbation of the believed preferences.",
    "pairs": "Share of requests served by pair of places, and their mean true utility.",
    "trainings": "One row per training seed, with the reward in validation by which one was chosen.",
    "rows": "One row per policy and test instance.",
    "over": "Compensation plus true utility, one row per accepted request.",
    "errors": "Errors of learned utilities, true less estimated, one row per kind of request.",
    "utilities": "True utilities, one row per kind of request.",
}
"""Of every table, in the order in which a report has them."""

# Heading and number of digits; None for words and whole numbers, -1 for powers of ten.
_COLUMNS: dict[str, tuple[str, int | None]] = {
    "scenario": ("Scenario", None),
    "world": ("World", None),
    "policy": ("Policy", None),
    "seed": ("Training seed", None),
    "instances": ("Instances", None),
    "ratio": ("Ratio (%)", 2),
    "std": ("Std (%)", 2),
    "low": ("95 % interval", 2),
    "of_arrival": ("Of arrival bound (%)", 2),
    "served": ("Served (%)", 2),
    "rule": ("Better rule", None),
    "gain": ("Lead over rule (points)", 2),
    "gain_low": ("95 % interval", 2),
    "worlds": ("Worlds", None),
    "least": ("Least (%)", 2),
    "most": ("Most (%)", 2),
    "instance": ("Instance", None),
    "reward": ("Reward (money)", 2),
    "paid": ("Paid (money)", 2),
    "requests": ("Requests", None),
    "workers": ("Workers", None),
    "validation_reward": ("Validation reward (money)", 2),
    "chosen": ("Chosen", None),
    "bound": ("Bound", None),
    "money": ("Mean (money)", 2),
    "points": ("Points", 2),
    "worst_gap": ("Worst certificate (money)", -1),
    "bound_points": ("Bound (points)", 2),
    "policy_points": ("Policy (points)", 2),
    "gap": ("Gap (points)", 2),
    "gap_low": ("95 % interval", 2),
    "at_most": ("At most, with 95 % confidence (points)", 2),
    "failures": ("Failures", None),
    "choice": ("Preferences", None),
    "group": ("Group", None),
    "rmse": ("RMSE (money)", 2),
    "mbe": ("MBE (money)", 2),
    "type": ("Type", None),
    "pickup": ("Pick-up", None),
    "dropoff": ("Drop-off", None),
    "count": ("Count", None),
    "error": ("Error (money)", 2),
    "utility": ("Utility (money)", 2),
    "epsilon": ("ε", 0),
    "draw": ("Draw", None),
    "over": ("Beyond burden (money)", 2),
    "over_low": ("95 % interval", 2),
    "utilised": ("Workers used (%)", 2),
    "utilised_low": ("95 % interval", 2),
    "acceptance_cv": ("CV of places (%)", 2),
    "asked": ("Asked", None),
}
_OWN = {("rows", "served"): ("Requests served", None)}

LATEX: dict[str, tuple[str, ...]] = {
    "ratios": ("scenario", "world", "policy", "ratio", "std", "low", "high", "of_arrival", "served", "gain"),
    "worlds": ("scenario", "policy", "worlds", "ratio", "low", "high", "least", "most", "gain"),
    "gap": ("scenario", "world", "policy", "bound", "bound_points", "policy_points", "gap", "gap_low", "gap_high"),
    "estimation": ("scenario", "world", "choice", "group", "rmse", "mbe"),
    "operations": (
        "scenario", "world", "policy", "over", "over_low", "over_high", "utilised", "utilised_low", "utilised_high",
        "acceptance_cv",
    ),
}  # fmt: skip
"""Tables that papers print, and their columns."""


@dataclass(frozen=True)
class Shown:
    """A table as text.

    Attributes
    ----------
    headings : list of str
    numeric : list of bool
        Which columns hold numbers.
    rows : list of list of str
    """

    headings: list[str]
    numeric: list[bool]
    rows: list[list[str]]


def shown(name: str, frame: pd.DataFrame) -> Shown:
    """Write a table's numbers for people.

    Parameters
    ----------
    name : str
        Name of the table, of :data:`CAPTIONS`; any other may have columns of its own.
    frame : DataFrame

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"policy": ["FP"], "ratio": [79.934], "low": [79.034], "high": [80.841], "gain": [None]})
    >>> shown("ratios", table).rows
    [['FP', '79.93', '[79.03, 80.84]', '–']]
    """
    headings, numeric, columns = [], [], []
    for column in map(str, frame.columns):
        if column == "high" or column.endswith("_high"):
            continue  # stands with the lower end
        heading, digits = _OWN.get((name, column)) or _COLUMNS.get(column, (column.capitalize(), None))
        texts = [_text(value, digits) for value in frame[column].tolist()]
        upper = column[: -len("low")] + "high" if column.endswith("low") else ""
        if upper in frame.columns:
            ends = zip(texts, (_text(value, digits) for value in frame[upper].tolist()), strict=True)
            texts = [NOTHING if NOTHING in pair else f"[{', '.join(pair)}]" for pair in ends]
        headings.append(heading)
        numeric.append(all(not isinstance(value, str | bool) for value in frame[column].tolist()))
        columns.append(texts)
    return Shown(headings, numeric, [list(row) for row in zip(*columns, strict=True)])


def _text(value: Any, digits: int | None) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and math.isfinite(value):
        if digits == -1:
            return f"{value:.1e}"
        return f"{round(value, 2 if digits is None else digits) + 0.0:.{2 if digits is None else digits}f}"  # no -0.00
    return str(value)


def latex(name: str, frame: pd.DataFrame) -> str:
    r"""Write a table of :data:`LATEX` as a LaTeX table, which needs the package booktabs.

    Examples
    --------
    >>> import pandas as pd
    >>> print(latex("estimation", pd.DataFrame({"scenario": ["II"], "group": [1], "rmse": [1.804]})))
    \begin{table}
    \caption{Errors of learned utilities on the test instances' requests, true less estimated, by group.}
    \label{tab:estimation}
    \begin{tabular}{lrr}
    \toprule
    Scenario & Group & RMSE (money) \\
    \midrule
    II & 1 & 1.80 \\
    \bottomrule
    \end{tabular}
    \end{table}
    """
    import pandas as pd

    columns = [one for one in LATEX[name] if one in frame.columns]
    if "world" in columns and frame["world"].nunique() == 1:
        columns.remove("world")
    told = shown(name, frame[columns])
    rows = [["--" if cell == NOTHING else cell for cell in row] for row in told.rows]
    table = pd.DataFrame(rows)
    table.columns = pd.Index([_escape(heading) for heading in told.headings])
    text = table.map(_escape).to_latex(
        index=False,
        escape=False,
        column_format="".join("r" if number else "l" for number in told.numeric),
        caption=_escape(CAPTIONS[name]),
        label=f"tab:{name}",
    )
    return str(text)


_SPECIAL = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{mark: f"\\{mark}" for mark in "&%$#_{}"},
}  # fmt: skip


def _escape(text: str) -> str:
    escaped = "".join(_SPECIAL.get(mark, mark) for mark in text)
    return "{}" + escaped if escaped.startswith("[") else escaped  # \\ would take a bracket for its own


def long_table(name: str, frame: pd.DataFrame, most: int) -> bool:
    """Whether a table is too long to be read, and is only begun in a report."""
    return name in ("rows", "over", "errors", "utilities") or len(frame) > most


def in_order(names: Sequence[str]) -> list[str]:
    """Names of tables in the order of :data:`CAPTIONS`, others after them.

    Examples
    --------
    >>> in_order(["rows", "own", "ratios"])
    ['ratios', 'rows', 'own']
    """
    return [name for name in CAPTIONS if name in names] + [name for name in names if name not in CAPTIONS]
