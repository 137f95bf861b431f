"""The requests of one decision, read from a CSV, JSON or parquet file without guessing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints, ints
from optkit.basics.errors import DataError
from optkit.basics.tables.cells import Cells, Column, Converter, flags, labels, numbers
from optkit.basics.tables.read import open_table

if TYPE_CHECKING:
    from optkit.models.preferences.preferences import Preferences


def utilities(cells: Cells) -> Column:
    """Return finite numbers, or ``-inf`` where a cell says so: the worker cannot serve the request.

    Raises
    ------
    DataError
        If a cell is empty or holds anything else.
    """
    try:
        return numbers(cells)
    except DataError:
        never = np.array([str(value).strip().lower() in ("-inf", "-infinity") for value in cells.values])
        if not never.any():
            raise
    served = [0.0 if no else value for value, no in zip(list(cells.values), never.tolist(), strict=True)]
    return np.where(never, -np.inf, numbers(Cells(cells.path, cells.name, cells.first, served)))


PARTS_OF_VALUE = ("reward", "penalty", "expires", "opportunity_cost")
KNOWN: dict[str, Converter] = {
    "request": labels,
    "decision": labels,
    "value": numbers,
    "utility": utilities,
    "offered": flags,
    "compensation": numbers,
    "reward": numbers,
    "penalty": numbers,
    "expires": flags,
    "opportunity_cost": numbers,
}
"""Columns that have a meaning, and what each holds."""


@dataclass(frozen=True, eq=False)
class RequestTable:
    """Requests on offer to one worker.

    Attributes
    ----------
    names : list of str
        What the file calls the requests, as it writes them, or their numbers.
    value, utility : (n,) float
        Worth of serving each request now, and its utility to the worker, in money; ``-inf`` where he cannot serve it.
    offered : (n,) bool
        Which requests are on offer.
    compensation : (n,) float or None
        Somebody's proposal, in money.
    ignored : list of str
        Columns that have no meaning here.
    decision : list of str or None
        The decision that each request belongs to, if there are several.
    """

    names: list[str]
    value: Floats
    utility: Floats
    offered: Bools
    compensation: Floats | None
    ignored: list[str]
    decision: list[str] | None = None


def read_requests(path: Path, believed: Preferences | None = None, group: int = 0) -> RequestTable:
    """Read the requests of one decision.

    Columns, in any order and case: ``utility``, ``-inf`` where the worker cannot serve the request; either ``value``,
    or ``reward`` with ``penalty`` (at most 0), ``expires`` (0 or 1) and ``opportunity_cost`` where they apply: value =
    reward - penalty * expires - opportunity_cost; ``offered`` (0 or 1); ``compensation`` for a proposal; ``request``
    for names, which are read as text; ``decision`` for rows that are priced together. JSON is a list of objects, or an
    object with such a list under ``requests``.

    Parameters
    ----------
    path : Path
    believed : Preferences, optional
        They tell the utility, and the columns are those that they know, ``pickup`` and ``dropoff`` in place of it.
    group : int
        The worker's.

    Raises
    ------
    DataError
        If the file cannot be read, rows and header differ in length, a column is missing, double, contradictory or out
        of range, or an entry is not a finite number.
    """
    remedy = "give a CSV or a JSON list with one row per request"
    with open_table(path, remedy=remedy, under="requests") as table:
        written = {name: name.lower() for name in table.names}
        double = [name for name, times in Counter(written.values()).items() if times > 1]
        if double:
            raise DataError(f"{path} has the column {double[0]!r} twice, but for case; leave one")
        known = KNOWN if believed is None else {**KNOWN, **_attributes(believed)}
        place = {lower: name for name, lower in written.items() if lower in known}
        if believed is None:
            table.need("utility", "value|reward", among=place)
        else:
            table.need(*_attributes(believed), "value|reward", among=place)
            if "utility" in place:
                raise DataError(f"{path} has a column utility, and preferences to tell it: leave one out")
        clash = [name for name in PARTS_OF_VALUE if name in place] if "value" in place else []
        if clash:
            raise DataError(f"{path} has both value and {clash[0]}: give the value, or the parts it is made of")
        found = table.columns({name: known[lower] for lower, name in place.items()})
        rows = table.rows
    if not rows:
        raise DataError(f"{path} holds no requests; give one row per request")
    columns: dict[str, Any] = {lower: found[name] for lower, name in place.items()}
    zero = np.zeros(rows)
    penalty, expires = columns.get("penalty", zero), columns.get("expires", zero)
    if (penalty > 0).any():
        i = int((penalty > 0).argmax())
        raise DataError(
            f"{path}: penalty in row {i + 1} = {penalty[i]:g} is positive; write a cost of expiry as a number <= 0"
        )
    value = columns.get("value")
    if value is None:
        with np.errstate(over="ignore"):
            value = columns["reward"] - penalty * expires - columns.get("opportunity_cost", zero)
        if not np.isfinite(value).all():
            i = int((~np.isfinite(value)).argmax())
            raise DataError(f"{path}: the value of row {i + 1}, made of its parts, is beyond any money")
    if believed is not None:
        columns["utility"] = _believed(believed, columns, np.full(rows, group))
    return RequestTable(
        names=columns.get("request", np.arange(rows).astype(str)).tolist(),
        value=value,
        utility=columns["utility"],
        offered=columns.get("offered", np.ones(rows)) == 1,
        compensation=columns.get("compensation"),
        ignored=[name for name, lower in written.items() if lower not in known],
        decision=columns["decision"].tolist() if "decision" in columns else None,
    )


def _attributes(believed: Preferences) -> dict[str, Converter]:
    """Columns from which preferences tell a utility; places where there is more than one."""
    told = believed.attributes
    places = [name for name, many in (("pickup", told.pickups), ("dropoff", told.dropoffs)) if many > 1]
    return {name.lower(): numbers for name in (*told.names, *places)}


def _believed(believed: Preferences, columns: dict[str, Any], group: Ints) -> Floats:
    rows = len(group)
    features = [columns[name.lower()] for name in believed.attributes.names]
    pickup, dropoff = (ints(name, columns.get(name, np.zeros(rows)), (rows,)) for name in ("pickup", "dropoff"))
    return believed.utility_of(np.column_stack(features) if features else np.zeros((rows, 0)), pickup, dropoff, group)
