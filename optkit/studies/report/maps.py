"""Figures that are read like tables or maps: bubble grids, heat maps, the regions of Manhattan."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optkit.basics.errors import DataError
from optkit.basics.tables.read import open_table
from optkit.instances.new_york.trips import REGIONS, manhattan_zones
from optkit.plotting.files import new_figure
from optkit.studies.report.drawing import Tables, bare, first_world, ink, of_new_york, of_scenario, title_of
from optkit.studies.report.histograms import edges_of, utilities_by_place

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

CENTROIDS = "taxi_zone_centroids.csv"
"""Looked for beside the trip files: LocationID, lat, lon of the taxi zones' centres, in degrees."""

DIVERGING = "cividis"
"""From dark blue over grey to light yellow: sides differ in lightness too, and are told apart by the colour-blind."""

CELL = 0.62
"""Side of a cell of the bubble grid, in inches."""


def bubble_grid(tables: Tables, scenario: str) -> Figure | None:
    """Performance ratio and mean bias error under perturbed preferences: the paper's fig:sens_syn and fig:sens_syn_2.

    The number in a cell and the area of its circle are the ratio (none below 0), the colour is the MBE. The last column
    is the average over draws; without perturbation there is one draw, and it stands there.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    rows = of_scenario(tables, "sensitivity", scenario)
    if rows is None:
        return None
    rows, told = first_world(rows)
    lines = sorted({(str(g), float(e)) for g, e in zip(rows["group"], rows["epsilon"], strict=True)}, key=_order)
    draws = sorted(rows["draw"].unique())
    last = len(draws) + 0.35  # a little apart, as it is not a draw
    reach = max(float(rows["mbe"].abs().max()), 1e-9)
    scale = Normalize(-reach, reach)
    colour = ScalarMappable(scale, DIVERGING)
    figure = new_figure(1.2 + CELL * (len(draws) + 1.4), 1.8 + CELL * len(lines))
    ax = figure.subplots()
    bubbles = []
    for height, (group, epsilon) in enumerate(lines):
        own = rows[(rows["group"] == group) & (rows["epsilon"] == epsilon)]
        cells = [(last, float(own["ratio"].mean()), float(own["mbe"].mean()))]
        if epsilon > 0:
            cells += [(draws.index(d), r, m) for d, r, m in zip(own["draw"], own["ratio"], own["mbe"], strict=True)]
        else:
            ax.text((len(draws) - 1) / 2, height, "not perturbed", ha="center", va="center", color="0.35", fontsize=9)
        for place, ratio, mbe in cells:
            side = 0.7 * 72.0 * CELL * np.sqrt(np.clip(ratio, 0.4, 100.0) / 100.0)
            bubbles.append((place, height - 0.12, side**2, colour.cmap(scale(mbe))))
            bold = "bold" if place == last else "normal"
            told_ratio = ax.text(place, height + 0.36, f"{ratio:.1f}", ha="center", va="center", fontsize=8)
            told_ratio.set(fontweight=bold, in_layout=False)  # it lies within its cell
    x, y, sizes, colours = map(list, zip(*bubbles, strict=True))
    ax.scatter(x, y, sizes, c=colours, edgecolors="0.2", linewidths=0.6)
    ax.set_xlim(-0.55, last + 0.55)
    ax.set_ylim(len(lines) - 0.45, -0.55)
    ax.set_aspect("equal")
    ax.set_xticks([*range(len(draws)), last], [*map(str, draws), "average"])
    ax.set_yticks(range(len(lines)), [_line(*one) for one in lines])
    ax.axvline(len(draws) - 0.325, color="0.75", linewidth=0.8)
    for height in range(1, len(lines)):
        if lines[height][0] != lines[height - 1][0]:
            ax.axhline(height - 0.5, color="0.75", linewidth=0.8)
    bare(ax)
    ax.set_xlabel("Draw of the perturbation (number and area: performance ratio in %)")
    ax.set_title(f"{title_of(scenario)}{told}: believed preferences perturbed by up to ε", fontsize="medium")
    bar = figure.colorbar(colour, ax=ax, location="bottom", shrink=0.6, aspect=30, pad=0.02)
    bar.set_label("MBE: true less believed utility (money), below 0 where overestimated")
    return figure


def _order(line: tuple[str, float]) -> tuple[bool, bool, str, float]:
    group, epsilon = line
    return epsilon > 0, group != "all", group, epsilon


def _line(group: str, epsilon: float) -> str:
    return f"ε = {epsilon:g}" if group == "all" else f"$\\epsilon_{{{group}}}$ = {epsilon:g}"


def acceptance_maps(tables: Tables) -> Figure | None:
    """Share of requests served by pair of places and policy: the paper's fig:fair_nyt_combined.

    At the right stands each pair's average true utility, beneath a policy the coefficient of variation of its shares.
    """
    found, told = of_new_york(tables, "pairs")
    if not found:
        return None
    wide = max(rows["policy"].nunique() for rows in found.values())
    figure = new_figure(len(found) * (2.2 + 0.72 * wide), 7.6)
    panels = figure.subplots(1, 2 * len(found), width_ratios=[wide, 1.1] * len(found), squeeze=False)[0]
    for number, (scenario, rows) in enumerate(found.items()):
        heat, side = panels[2 * number : 2 * number + 2]
        policies = list(dict.fromkeys(rows["policy"]))
        served = rows.pivot(index=["pickup", "dropoff"], columns="policy", values="served")[policies]
        utility = rows.drop_duplicates(["pickup", "dropoff"]).set_index(["pickup", "dropoff"])["utility"]
        spread = of_scenario(tables, "operations", scenario)
        variation = {} if spread is None else first_world(spread)[0].set_index("policy")["acceptance_cv"].to_dict()
        names = [f"({p}, {d})" for p, d in served.index]
        labels = [name.replace(", ", ",\n") for name in policies]
        _heat(heat, served.to_numpy(), "Blues", (0.0, 100.0), "{:.0f}")
        heat.set_yticks(range(len(names)), names)
        heat.set_xticks(range(len(policies)), labels, rotation=90, fontsize=8, parse_math=False)
        heat.set_ylabel("(pick-up, drop-off) region")
        heat.set_title(f"{title_of(scenario)}{told}\nserved (%)", fontsize="medium")
        for place, name in enumerate(policies):
            if np.isfinite(variation.get(name, np.nan)):
                heat.text(place, len(names) - 0.2, f"{variation[name]:.1f}", ha="center", va="center", fontsize=8)
        if variation:
            heat.text(-0.7, len(names) - 0.2, "CV (%)", ha="right", va="center", fontsize=8)
            heat.tick_params(axis="x", pad=16)
        values = utility.reindex(served.index).to_numpy()[:, None]
        ends = (float(np.nanmin(values)), float(np.nanmax(values))) if np.isfinite(values).any() else (0.0, 1.0)
        _heat(side, values, DIVERGING, ends, "{:.1f}")
        side.set_yticks([])
        side.set_xticks([0], ["mean\nutility\n(money)"], fontsize=8)
    return figure


def _heat(ax: Axes, values: np.ndarray, colours: str, ends: tuple[float, float], form: str) -> None:
    """Draw a heat map with a number in every cell; a dash where there is none."""
    image = ax.imshow(values, cmap=colours, vmin=ends[0], vmax=max(ends[1], ends[0] + 1e-9), aspect="auto")
    for (y, x), value in np.ndenumerate(values):
        known = np.isfinite(value)
        paint = ink(image.cmap(image.norm(value))) if known else "black"
        told = ax.text(x, y, form.format(value) if known else "–", ha="center", va="center", fontsize=8, color=paint)
        told.set_in_layout(False)  # it lies within its cell
    bare(ax)


def region_map(tables: Tables, trips: Sequence[str | PathLike[str]] = ()) -> Figure | None:
    """Manhattan's regions, and utilities by pick-up and drop-off region: the paper's fig:manhattan_utilities.

    The map needs the centres of the zones, which are not in the kit: :data:`CENTROIDS` beside the trip files.
    """
    found, told = of_new_york(tables, "utilities")
    if not found:
        return None
    centres = zone_centres(trips)
    figure = new_figure(11.0 if centres is not None else 8.2, 0.9 + 2.9 * len(found), apart=0.06)
    area: FigureBase = figure
    if centres is not None:
        parts = figure.subfigures(1, 2, width_ratios=[0.9, 2.2], squeeze=False)[0]
        _zones(parts[0].subplots(), centres)
        area = parts[1]
    grid = area.subplots(len(found), 2, squeeze=False)
    for axes, (scenario, rows) in zip(grid, found.items(), strict=True):
        title = f"{scenario.removeprefix('nyc-').capitalize()} preferences"
        utilities_by_place(axes, rows, edges_of(rows["utility"]), title)
    note = "" if centres is not None else f"\n(no map of the regions: there is no {CENTROIDS} beside the trip files)"
    figure.suptitle(f"New York{told}: utilities of requests by region, share of requests, means at the right{note}")
    return figure


def zone_centres(trips: Sequence[str | PathLike[str]]) -> pd.DataFrame | None:
    """Return Manhattan's zones with their centres, from a file beside the trip files; None if it is not there or wrong.

    Parameters
    ----------
    trips : sequence of path
        Trip files, or folders of them.

    Returns
    -------
    DataFrame or None
        ``LocationID``, ``zone``, ``region`` (1 to 4), ``lat``, ``lon``.

    Examples
    --------
    >>> zone_centres([]) is None
    True
    """
    import pandas as pd

    for path in map(Path, trips):
        file = (path if path.is_dir() else path.parent) / CENTROIDS
        try:
            with open_table(file) as table:
                table.need("LocationID", "lat", "lon")
                centres = pd.DataFrame(table.columns(dict.fromkeys(("LocationID", "lat", "lon"), "numbers")))
        except DataError:
            continue  # a figure's ornament: its absence is told in the figure
        zones = manhattan_zones().merge(centres, on="LocationID")
        if len(zones):
            return zones
    return None


def _zones(ax: Axes, zones: pd.DataFrame) -> None:
    """Draw each zone's centre with its region's mark: shape and colour, so that either suffices."""
    marks = (("o", "#0072B2"), ("^", "#E69F00"), ("s", "#56B4E9"), ("D", "#CC79A7"))
    for number, (name, (marker, colour)) in enumerate(zip(REGIONS, marks, strict=True), 1):
        own = zones[zones["region"] == number]
        ax.scatter(
            own["lon"], own["lat"], 34, color=colour, marker=marker, edgecolors="black", linewidths=0.6,
            label=f"{number} {name}",
        )  # fmt: skip
    ax.set_aspect(1.0 / np.cos(np.radians(float(zones["lat"].mean()))))
    ax.set_xlabel("Longitude (°)", fontsize="small")
    ax.set_ylabel("Latitude (°)", fontsize="small")
    ax.tick_params(labelsize=8)
    ax.locator_params(axis="x", nbins=4)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=8, frameon=False)
    ax.set_title("Centres of taxi zones", fontsize="small")
