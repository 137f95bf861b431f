"""The requests of one decision, read from a CSV, JSON or parquet file without guessing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optkit.basics.arrays import Bools, Floats
from optkit.basics.errors import DataError
from optkit.basics.tables.cells import Cells, Column, Converter, flags, labels, numbers
from optkit.basics.tables.read import open_table


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


def read_requests(path: Path) -> RequestTable:
    """Read the requests of one decision.

    Columns, in any order and case: ``utility``, ``-inf`` where the worker cannot serve the request; either ``value``,
    or ``reward`` with ``penalty`` (at most 0), ``expires`` (0 or 1) and ``opportunity_cost`` where they apply: value =
    reward - penalty * expires - opportunity_cost; ``offered`` (0 or 1); ``compensation`` for a proposal; ``request``
    for names, which are read as text; ``decision`` for rows that are priced together. JSON is a list of objects, or an
    object with such a list under ``requests``.

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
        place = {lower: name for name, lower in written.items() if lower in KNOWN}
        table.need("utility", "value|reward", among=place)
        clash = [name for name in PARTS_OF_VALUE if name in place] if "value" in place else []
        if clash:
            raise DataError(f"{path} has both value and {clash[0]}: give the value, or the parts it is made of")
        found = table.columns({name: KNOWN[lower] for lower, name in place.items()})
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
    return RequestTable(
        names=columns.get("request", np.arange(rows).astype(str)).tolist(),
        value=value,
        utility=columns["utility"],
        offered=columns.get("offered", np.ones(rows)) == 1,
        compensation=columns.get("compensation"),
        ignored=[name for name, lower in written.items() if lower not in KNOWN],
        decision=columns["decision"].tolist() if "decision" in columns else None,
    )
