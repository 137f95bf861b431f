"""The figures of the studies, one for each figure of the paper's sections 4 and 5, named by its label."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, NamedTuple

from optkit.plotting.boxes import box_plot
from optkit.plotting.files import new_figure
from optkit.studies.report.drawing import Tables, of_scenario, title_of
from optkit.studies.report.histograms import errors_by_group, errors_by_place, utilities_by_type
from optkit.studies.report.maps import acceptance_maps, bubble_grid, region_map
from optkit.studies.tables import hopeful

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Drawing(NamedTuple):
    """How a figure is made.

    Attributes
    ----------
    study : str
        The study whose figure it is.
    draw : callable
        Of the tables; None where they do not suffice.
    tables : tuple of str
        Where its numbers are.
    caption : str
    """

    study: str
    draw: Callable[[Tables], Figure | None]
    tables: tuple[str, ...]
    caption: str


def ratio_boxes(tables: Tables, scenario: str) -> Figure | None:
    """Performance ratios by policy: the paper's fig:perf_syn, fig:perf_syn_2, fig:perf_nyt_weak and its strong twin.

    The instances of several worlds are pooled.
    """
    rows = of_scenario(tables, "rows", scenario)
    if rows is None:
        return None
    rows = hopeful(rows)
    if rows.empty:
        return None
    instances, worlds = len(rows[["world", "instance"]].drop_duplicates()), rows["world"].nunique()
    pooled = f" of {worlds} worlds, pooled" if worlds > 1 else ""
    ratios = {str(name): own["ratio"].to_numpy() for name, own in rows.groupby("policy", sort=False)}
    ax = box_plot(ratios, title=f"{title_of(scenario)}: {instances} test instances{pooled}")
    _dress(ax, list(ratios))
    return ax.get_figure(root=True)


def pay_and_use(tables: Tables, scenario: str) -> Figure | None:
    """Compensation beyond the burden, and workers used: the paper's fig:comp_nyt_weak and fig:comp_nyt_strong.

    The instances of several worlds are pooled.
    """
    over, rows = of_scenario(tables, "over", scenario), of_scenario(tables, "rows", scenario)
    if over is None or rows is None:
        return None
    used = rows.assign(used=100.0 * rows["served"] / rows["workers"].clip(lower=1))
    names = list(dict.fromkeys(rows["policy"]))
    worlds = rows["world"].nunique()
    figure = new_figure(max(5.0, 1.5 + 1.15 * len(names)), 7.6)
    upper, lower = figure.subplots(2, 1)
    paid, busy = _by_policy(over, names, "over"), _by_policy(used, names, "used")
    box_plot(paid, ax=upper, title="Compensation plus true utility, accepted requests")
    upper.set(ylabel="Compensation plus utility (money)", xlabel="Policy, with the mean")
    upper.axhline(0.0, color="0.35", linewidth=0.9, linestyle=":")
    box_plot(busy, ax=lower, title="Workers who took a request, instance by instance")
    lower.set(ylabel="Workers used (%)", xlabel="Policy, with the mean")
    _dress(upper, list(paid))
    _dress(lower, list(busy))
    figure.suptitle(title_of(scenario) + (f": {worlds} worlds, pooled" if worlds > 1 else ""))
    return figure


def _by_policy(rows: pd.DataFrame, names: Sequence[str], column: str) -> dict[str, pd.Series[float]]:
    """Return a column by policy; who served nothing at all has no box."""
    parts = {name: rows.loc[rows["policy"] == name, column] for name in names}
    return {name: values for name, values in parts.items() if len(values)}


_COLOURS = {"Myopic": "#CC79A7", "Linear": "#56B4E9", "Kernel": "#009E73", "Attention": "#E69F00", "FP": "#999999"}
_HATCHES = {"single": "xx", "paper's": "//", "re-estimated": ".."}


def _dress(ax: Axes, names: Sequence[str]) -> None:
    """Give policies of a family one colour in all figures, and a hatching by what they know of workers."""
    for box, name in zip(ax.patches, names, strict=True):
        belief = name.partition(", ")[2]
        hatch = next((mark for word, mark in _HATCHES.items() if word in belief), None)
        colour = _COLOURS.get(name.split(",")[0].split(" ")[0], "#F0E442")
        box.set(facecolor=colour, hatch=hatch, alpha=1.0, edgecolor="black")


_BOXES = (
    "Performance ratios of the policies on the test instances. Boxes span the quartiles, whiskers reach 1.5 times as "
    "far, dots lie beyond; the diamond is the mean, which is also written beneath. Colour tells the value function, "
    "hatching what is known of workers."
)
_BUBBLES = (
    "Performance ratio and mean bias error (MBE) of a policy that prices and trains with perturbed preferences. Lines "
    "are the bounds of the perturbation{who}, columns its draws, the last one their average. Number and area of the "
    "circle are the ratio in per cent, the colour is the MBE; where it is negative, utilities are overestimated."
)
_PAY = (
    "Above: what workers got beyond their burden, compensation plus the deterministic part of the true utility, for "
    "all accepted requests; below 0 the worker's own mood made up for it. Below: the share of workers who took a "
    "request."
)

DRAWINGS: dict[str, Drawing] = {
    **{
        f"perf_syn_{one}": Drawing("homogeneous", partial(ratio_boxes, scenario=one), ("rows", "ratios"), _BOXES)
        for one in ("I.1", "I.2", "I.3")
    },
    "utility_scen_2": Drawing(
        "heterogeneous",
        utilities_by_type,
        ("utilities",),
        "True utilities of the requests for each group of workers, by type of request: share of the requests, all rows "
        "of a panel to one scale; the line is the mean, which is also written at the right.",
    ),
    "mnl_momnl": Drawing(
        "heterogeneous",
        errors_by_group,
        ("errors", "estimation"),
        "True less estimated utility of the requests by group of workers, with one multinomial logit model (MNL) for "
        "all groups and with one for each, from the paper's random offers and after re-estimation.",
    ),
    "perf_syn_2": Drawing("heterogeneous", partial(ratio_boxes, scenario="II"), ("rows", "ratios"), _BOXES),
    "sens_syn": Drawing("sensitivity", partial(bubble_grid, scenario="I.1"), ("sensitivity",), _BUBBLES.format(who="")),
    "sens_syn_2": Drawing(
        "sensitivity",
        partial(bubble_grid, scenario="II"),
        ("sensitivity",),
        _BUBBLES.format(who=" (with an index: of that group's preferences only)"),
    ),
    "manhattan_utilities": Drawing(
        "nyc",
        region_map,
        ("utilities",),
        "Manhattan's four regions, and true utilities of the requests by pick-up (p) and drop-off (d) region, for weak "
        "and for strong location preferences.",
    ),
    "nyt_combined_mnl": Drawing(
        "nyc",
        errors_by_place,
        ("errors", "estimation"),
        "True less estimated utility of the requests by pick-up (p) and drop-off (d) region, for weak and for strong "
        "location preferences. Each way to learn has its own scale.",
    ),
    **{
        f"{label}_nyt_{one}": Drawing("nyc", partial(draw, scenario=f"nyc-{one}"), tables, caption)
        for one in ("weak", "strong")
        for label, draw, tables, caption in (
            ("perf", ratio_boxes, ("rows", "ratios"), _BOXES),
            ("comp", pay_and_use, ("over", "rows", "operations"), _PAY),
        )
    },
    "fair_nyt_combined": Drawing(
        "nyc",
        acceptance_maps,
        ("pairs", "operations"),
        "Share of requests served for each pair of pick-up and drop-off region, by policy, with the pair's average "
        "true utility at the right and, beneath, the coefficient of variation (CV) of a policy's shares. A dash: no "
        "request.",
    ),
}
"""By label, in the order of the paper."""


def study_figures(tables: Tables, *, trips: Sequence[str | PathLike[str]] = ()) -> dict[str, Figure]:
    """Draw all figures that the tables suffice for.

    Parameters
    ----------
    tables : mapping from str to DataFrame
        From :func:`optkit.studies.tables.study_tables`.
    trips : sequence of path
        Trip files or folders, beside which the centres of the taxi zones may lie.

    Returns
    -------
    dict of str to matplotlib Figure
        By the paper's labels, see :data:`DRAWINGS`; a figure whose tables are missing is not there. Figures belong to
        nobody's pyplot state.

    Examples
    --------
    >>> import pandas as pd
    >>> rows = {"scenario": "I.1", "world": 0, "policy": ["FP", "PP"] * 2, "instance": [0, 0, 1, 1]}
    >>> rows |= {"ratio": [90.0, 80.0, 92.0, 85.0], "of_arrival": [95.0, 85.0, 96.0, 90.0]}
    >>> list(study_figures({"rows": pd.DataFrame(rows)}))
    ['perf_syn_I.1']
    """
    made = {}
    for label, drawing in DRAWINGS.items():
        draw = partial(region_map, trips=trips) if label == "manhattan_utilities" else drawing.draw
        figure = draw(tables)
        if figure is not None:
            made[label] = figure
    return made
