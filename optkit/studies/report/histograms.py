"""Histograms of utilities and of errors in them, in rows above each other so that grey tells them apart as well."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from optkit.basics.arrays import Floats
from optkit.plotting.files import new_figure
from optkit.studies.report.drawing import Tables, first_world, of_new_york, of_scenario, title_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 40
TALL = 0.86
"""Height of the highest bar of a panel; rows are 1 apart."""

CHOICES = {
    "single-paper": "one MNL for all groups, paper's data",
    "paper": "paper's data",
    "single": "one MNL for all groups, re-estimated",
    "learned": "re-estimated",
}
"""Ways to learn preferences, as titles have them."""


def histogram_rows(ax: Axes, rows: pd.DataFrame, by: str, value: str, edges: Floats, names: Sequence[str]) -> None:
    """Draw a histogram of ``value`` for each of ``names``, one above the other, each with its mean.

    Parameters
    ----------
    ax : matplotlib axes
    rows : DataFrame
        One row per kind of request, which stands for ``count`` of them.
    by : str
        Column that says which histogram a row belongs to: 1 for the first of ``names``, which comes on top.
    value : str
        Column.
    edges : (n + 1,) float
        Of the bars.
    names : sequence of str

    Examples
    --------
    >>> import pandas as pd
    >>> rows = pd.DataFrame({"group": [1, 1, 2], "utility": [-3.0, -2.0, -1.0], "count": [3, 1, 2]})
    >>> ax = new_figure(3, 3).subplots()
    >>> histogram_rows(ax, rows, "group", "utility", np.linspace(-3, 0, 4), ["group 1", "group 2"])
    >>> [text.get_text() for text in ax.texts]
    ['-2.75', '-1.00']
    """
    shares = []
    which, values, weights = (rows[column].to_numpy() for column in (by, value, "count"))
    for number in range(1, len(names) + 1):
        own = which == number
        count = np.histogram(values[own], edges, weights=weights[own])[0]
        shares.append(count / max(count.sum(), 1))
    top = max(float(share.max()) for share in shares) or 1.0
    for number, share in enumerate(shares, 1):
        base = len(names) - number
        heights = base + TALL * share / top
        ax.stairs(heights, edges, baseline=base, fill=True, facecolor="#56B4E9", edgecolor="#0072B2", linewidth=0.7)
        ax.axhline(base, color="0.6", linewidth=0.6)
        own = which == number
        if not own.any():
            continue
        mean = float(np.average(values[own], weights=weights[own]))
        ax.plot([mean, mean], [base, base + TALL], color="black", linewidth=1.2)
        said = f"{round(mean, 2) + 0.0:.2f}"  # never "-0.00"
        ax.annotate(
            said, (1.0, base + 0.45), (4, 0), xycoords=("axes fraction", "data"), textcoords="offset points",
            va="center", fontsize=8,
        )  # fmt: skip
    ax.set_yticks([len(names) - 0.55 - i for i in range(len(names))], list(names))
    ax.set_ylim(-0.05, len(names))
    ax.tick_params(axis="y", length=0)
    ax.set_xlim(edges[0], edges[-1])
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)


def edges_of(values: pd.Series[float], *, zero: bool = False) -> Floats:
    """Edges of the bars for some values; with ``zero``, one of them is 0."""
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    if not zero:
        return np.linspace(low, high, BINS + 1)
    width = (max(high, 0.0) - min(low, 0.0)) / BINS
    return width * np.arange(np.floor(min(low, 0.0) / width), np.ceil(max(high, 0.0) / width) + 1)


def utilities_by_type(tables: Tables, scenario: str = "II") -> Figure | None:
    """True utilities of each group by type of request: the paper's fig:utility_scen_2."""
    rows = of_scenario(tables, "utilities", scenario)
    if rows is None:
        return None
    rows, told = first_world(rows)
    groups, kinds = sorted(rows["group"].unique()), int(rows["type"].max())
    figure = new_figure(3.6 * len(groups) + 0.6, 0.9 + 0.62 * kinds, apart=0.06)
    edges = edges_of(rows["utility"])
    axes = figure.subplots(1, len(groups), squeeze=False)[0]
    names = [f"type {kind}" for kind in range(1, kinds + 1)]
    for ax, group in zip(axes, groups, strict=True):
        histogram_rows(ax, rows[rows["group"] == group], "type", "utility", edges, names)
        ax.set_title(f"Group {group}", fontsize="medium")
        ax.set_xlabel("Utility (money), mean at the right")
    figure.suptitle(f"{title_of(scenario)}{told}: utilities of requests by type, share of requests")
    return figure


def errors_by_group(tables: Tables, scenario: str = "II") -> Figure | None:
    """Errors of learned utilities, one model for all groups against one each: the paper's fig:mnl_momnl."""
    rows = of_scenario(tables, "errors", scenario)
    if rows is None:
        return None
    rows, told = first_world(rows)
    choices = [name for name in CHOICES if (rows["choice"] == name).any()]
    columns = min(2, len(choices))
    groups = sorted(rows["group"].unique())
    lines = -(-len(choices) // columns)
    figure = new_figure(5.2 * columns, 0.8 + lines * (1.1 + 0.6 * len(groups)), apart=0.06)
    edges = edges_of(rows["error"], zero=True)
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for ax in axes[len(choices) :]:
        ax.set_visible(False)
    for ax, choice in zip(axes, choices, strict=False):
        own = rows[rows["choice"] == choice]
        names = [f"group {group}\nRMSE {_rmse(own[own['group'] == group]):.2f}" for group in groups]
        histogram_rows(ax, own, "group", "error", edges, names)
        _mark_zero(ax)
        plain = CHOICES[choice] if choice.startswith("single") else f"one MNL each, {CHOICES[choice]}"
        ax.set_title(plain[0].upper() + plain[1:], fontsize="medium")
        ax.set_xlabel("True less estimated utility (money), mean at the right")
    figure.suptitle(f"{title_of(scenario)}{told}: errors of learned utilities, share of requests")
    return figure


def errors_by_place(tables: Tables) -> Figure | None:
    """Errors of learned utilities by pick-up and drop-off region: the paper's fig:nyt_combined_mnl."""
    found, told = of_new_york(tables, "errors")
    if not found:
        return None
    choices = [name for name in CHOICES if any((rows["choice"] == name).any() for rows in found.values())]
    figure = new_figure(6.6 * len(found), 0.6 + 3.3 * len(choices), apart=0.06)
    grid = figure.subplots(len(choices), 2 * len(found), squeeze=False)
    for line, choice in zip(grid, choices, strict=True):
        own = {one: rows[rows["choice"] == choice] for one, rows in found.items()}
        # Each way to learn has its own axis: re-estimated errors are smaller by far.
        edges = edges_of(_joined([rows["error"] for rows in own.values()]), zero=True)
        for number, (one, rows) in enumerate(own.items()):
            for ax, by in zip(line[2 * number : 2 * number + 2], ("pickup", "dropoff"), strict=True):
                if rows.empty:
                    ax.set_visible(False)
                    continue
                histogram_rows(ax, rows, by, "error", edges, _regions(by))
                _mark_zero(ax)
                ax.set_title(
                    f"{one.removeprefix('nyc-').capitalize()} preferences, {CHOICES[choice]}\n"
                    f"RMSE {_rmse(rows):.2f}, MBE {_mean(rows):.2f}, by {_PLACE[by]}",
                    fontsize="small",
                )
                ax.set_xlabel("True less estimated utility (money)", fontsize="small")
    figure.suptitle(f"New York{told}: errors of learned utilities, share of requests, means at the right")
    return figure


_PLACE = {"pickup": "pick-up region", "dropoff": "drop-off region"}


def utilities_by_place(axes: Sequence[Axes], rows: pd.DataFrame, edges: Floats, title: str) -> None:
    """Draw true utilities by pick-up and by drop-off region on two axes."""
    for ax, by in zip(axes, ("pickup", "dropoff"), strict=True):
        histogram_rows(ax, rows, by, "utility", edges, _regions(by))
        ax.set_title(f"{title}, by {_PLACE[by]}", fontsize="small")
        ax.set_xlabel("Utility (money)", fontsize="small")


def _regions(by: str) -> list[str]:
    letter = "p" if by == "pickup" else "d"
    return [f"{letter} = {number}" for number in range(1, 5)]


def _mark_zero(ax: Axes) -> None:
    ax.axvline(0.0, color="0.35", linewidth=0.9, linestyle=":")


def _rmse(rows: pd.DataFrame) -> float:
    return float(np.sqrt(np.average(rows["error"] ** 2, weights=rows["count"])))


def _mean(rows: pd.DataFrame) -> float:
    return float(np.average(rows["error"], weights=rows["count"]))


def _joined(parts: Sequence[pd.Series[float]]) -> pd.Series[float]:
    import pandas as pd

    return pd.concat(parts)
