"""The gap report as a figure."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from optkit.plotting.files import shown_in_notebooks

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def ladder_plot(report: Any, *, ax: Axes | None = None, title: str | None = None) -> Axes:
    """Bounds above, policies below, on one axis in points of full information and in money.

    Bounds are open squares, policies filled circles, each with its interval, in the order of their means; the band is
    the room between the best policy and the best bound.

    Parameters
    ----------
    report : object with ``bounds``, ``policies`` and ``claim()``
        From :func:`optkit.gap.report.gap_report`.
    ax : matplotlib axes, optional
        Where to draw; a new figure by default, which belongs to nobody's pyplot state.
    title : str, optional
        What the report claims of the best policy, by default.

    Returns
    -------
    matplotlib.axes.Axes

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.gap.report import gap_report
    >>> days = scenario("I.2", seed=0).sample(4, seed=1)
    >>> ax = gap_report(days, {"half": lambda state: 0.5 * state.reward}).plot()
    >>> [label.get_text() for label in ax.get_yticklabels()]
    ['half', 'arrival', 'lagrangian', 'full']
    """
    bounds = report.bounds.assign(name=report.bounds["kind"], bound=True)
    policies = report.policies.assign(name=report.policies["policy"], bound=False)
    # Bounds stand above all policies, even where chance has put one below.
    rungs = pd.concat([policies.sort_values("money"), bounds.sort_values("money")], ignore_index=True)
    # Without anything to be gained there are no points, and money must do.
    measure, half = ("points", "half_width") if rungs["points"].notna().all() else ("money", "money_half_width")
    if ax is None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 1.4 + 0.36 * len(rungs)), layout="constrained")
        ax = shown_in_notebooks(figure.subplots())
    low, high = (float(getattr(frame[measure], end)()) for frame, end in ((policies, "max"), (bounds, "min")))
    ax.axvspan(low, high, color="0.88", zorder=0)
    for place, rung in rungs.iterrows():
        colour, face, marker = ("black", "white", "s") if rung["bound"] else ("#0072B2", "#0072B2", "o")
        width = np.nan_to_num(float(rung[half]))
        style = {"color": colour, "markerfacecolor": face, "markersize": 6, "capsize": 3}
        ax.errorbar(rung[measure], place, xerr=width, fmt=marker, **style)  # type: ignore[arg-type]
        ax.annotate(
            f"{rung[measure]:.2f}", (rung[measure], place), (0, 6), textcoords="offset points", ha="center", fontsize=8
        )
    ax.set_yticks(range(len(rungs)), [str(name) for name in rungs["name"]], parse_math=False)
    ax.set_ylim(-0.6, len(rungs) - 0.2)
    ax.set_xlabel("Points of full information" if measure == "points" else "Money an instance")
    ax.grid(axis="x", color="0.9")
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    if measure == "points" and np.ptp(bounds["points"]) > 0:
        slope, start = np.polyfit(bounds["points"], bounds["money"], 1)
        money = ax.secondary_xaxis("top", functions=(lambda x: start + slope * x, lambda x: (x - start) / slope))
        money.set_xlabel("Money an instance")
    title = fill(report.claim() if title is None else title, 64)  # as wide as the figure
    ax.set_title(title, fontsize="medium", parse_math=False)
    return ax
