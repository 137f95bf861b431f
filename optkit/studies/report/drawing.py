"""What the figures of the studies share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from optkit.basics.arrays import Floats

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Tables = Mapping[str, "pd.DataFrame"]
"""By name, from :func:`optkit.studies.tables.study_tables`."""

TITLES = {
    "nyc-weak": "New York, weak location preferences",
    "nyc-strong": "New York, strong location preferences",
}


def title_of(scenario: str) -> str:
    """Name of a scenario for people.

    Examples
    --------
    >>> title_of("I.1"), title_of("nyc-weak")
    ('Scenario I.1', 'New York, weak location preferences')
    """
    return TITLES.get(scenario, f"Scenario {scenario}")


def of_scenario(tables: Tables, name: str, scenario: str) -> pd.DataFrame | None:
    """Return a table's rows of a scenario, or None if there are none."""
    table = tables.get(name)
    if table is None:
        return None
    rows = table[table["scenario"] == scenario]
    return None if rows.empty else rows


def first_world(rows: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """Return the rows of the first world, and which that is where there are several.

    What is drawn request by request or place by place differs between worlds in kind, and is not to be pooled.

    Examples
    --------
    >>> import pandas as pd
    >>> first_world(pd.DataFrame({"world": [3, 3, 4]}))[1]
    ' (world 3 of 2 worlds)'
    """
    world, number = rows["world"].iloc[0], rows["world"].nunique()
    return rows[rows["world"] == world], f" (world {world} of {number} worlds)" if number > 1 else ""


def of_new_york(tables: Tables, name: str) -> tuple[dict[str, pd.DataFrame], str]:
    """Return a table's rows of the scenarios of New York, of the first world, and which that is."""
    found, told = {}, ""
    for scenario in TITLES:
        rows = of_scenario(tables, name, scenario)
        if rows is not None:
            found[scenario], told = first_world(rows)
    return found, told


def bare(ax: Axes) -> None:
    """Take away what a table-like figure does not need: frame and tick marks."""
    ax.tick_params(length=0)
    for side in ax.spines.values():
        side.set_visible(False)


def ink(rgba: Sequence[float] | Floats) -> str:
    """Black or white, whichever is read better on a colour.

    Examples
    --------
    >>> ink((1.0, 1.0, 0.8, 1.0)), ink((0.0, 0.1, 0.4, 1.0))
    ('black', 'white')
    """
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgba[:3]]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return "black" if luminance > 0.179 else "white"  # where the contrasts of both, by WCAG, are the same
