"""Figures, as matplotlib axes."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InputError
from optkit.plotting.files import shown_in_notebooks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's colours, lightest last: told apart by the colour-blind, and in grey by their lightness.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#999999", "#000000")


KEY = "Box: quartiles; line: median; diamond: mean; whiskers: 1.5 times the box; dots: beyond"


def box_plot(ratios: Mapping[str, npt.ArrayLike], *, ax: Axes | None = None, title: str | None = None) -> Axes:
    """Box plot of performance ratios by policy with the mean beneath, in the form of the paper's fig:perf_syn.

    Boxes span the quartiles, whiskers reach 1.5 times as far, dots lie beyond; the diamond is the mean.

    Parameters
    ----------
    ratios : mapping from policy to (B,) float
        Performance ratios in per cent.
    ax : matplotlib axes, optional
        Where to draw; a new figure by default, which belongs to nobody's pyplot state.
    title : str, optional
        Stands above the axes.

    Returns
    -------
    matplotlib.axes.Axes
        The axes drawn on; their figure is ``ax.figure``.

    Examples
    --------
    >>> ax = box_plot({"myopic": [90.0, 92.0, 88.0], "PP": [70.0, 75.0, 72.0]})
    >>> [label.get_text().split() for label in ax.get_xticklabels()]
    [['myopic', '90.0'], ['PP', '72.3']]
    """
    if not ratios:
        raise InputError("a box plot needs at least one policy")
    key = ""
    if ax is None:
        from matplotlib.figure import Figure

        width = max(4.0, 1.5 + 1.15 * len(ratios))
        key = fill(KEY, round(13 * width))
        ax = shown_in_notebooks(Figure(figsize=(width, 3.8), layout="constrained").subplots())
    values = [np.asarray(column, dtype=float) for column in ratios.values()]
    values = [column[np.isfinite(column)] for column in values]
    boxes = ax.boxplot(
        values,
        widths=0.6,
        showmeans=True,
        patch_artist=True,
        medianprops={"color": "black", "linewidth": 1.4},
        meanprops={"marker": "D", "markerfacecolor": "white", "markeredgecolor": "black", "markersize": 5},
        flierprops={"marker": "o", "markersize": 3, "markerfacecolor": "none", "markeredgecolor": "0.35"},
    )
    for box, colour in zip(boxes["boxes"], [COLOURS[i % len(COLOURS)] for i in range(len(values))], strict=True):
        box.set(facecolor=colour, alpha=0.75)
    # A long name breaks where it has a comma, so that neighbours do not run into each other.
    labels = [f"{n.replace(', ', ',' + chr(10))}\n{v.mean():.1f}" for n, v in zip(ratios, values, strict=True)]
    ax.set_xticks(range(1, len(values) + 1), labels, parse_math=False)
    ax.set_ylabel("Performance ratio (%)")
    ax.set_xlabel(f"Policy, with the mean of its performance ratio\n{key}".rstrip())
    ax.grid(axis="y", color="0.9")
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    if title:
        ax.set_title(title, parse_math=False)
    return ax
