"""The requests of one decision, read from a CSV or JSON file without guessing."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optkit.basics.arrays import Floats
from optkit.basics.errors import DataError

PARTS_OF_VALUE = ("reward", "penalty", "expires", "opportunity_cost")
KNOWN = ("request", "value", "utility", "compensation", *PARTS_OF_VALUE)


@dataclass(frozen=True, eq=False)
class RequestTable:
    """Requests on offer to one worker.

    Attributes
    ----------
    names : list of str
        What the file calls the requests, or their numbers.
    value, utility : (n,) float
        Worth of serving each request now, and its utility to the worker, in money.
    compensation : (n,) float or None
        Somebody's proposal, in money.
    ignored : list of str
        Columns that have no meaning here.
    """

    names: list[str]
    value: Floats
    utility: Floats
    compensation: Floats | None
    ignored: list[str]


def read_requests(path: Path) -> RequestTable:
    """Read the requests of one decision.

    Columns, in any order and case: ``utility``; either ``value``, or ``reward`` with ``penalty`` (at most 0),
    ``expires`` (0 or 1) and ``opportunity_cost`` where they apply: value = reward - penalty * expires -
    opportunity_cost; ``compensation`` for a proposal; ``request`` for names. JSON is a list of objects, or an object
    with such a list under ``requests``.

    Raises
    ------
    DataError
        If the file cannot be read, rows and header differ in length, a column is missing, double, contradictory or out
        of range, or an entry is not a finite number.
    """
    header, rows = _read(path)
    names = [name.strip().lower() for name in header]
    double = sorted({name for name in names if names.count(name) > 1})
    if double:
        raise DataError(f"{path} has the column {double[0]!r} twice; leave one")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    missing = [] if "utility" in columns else ["utility"]
    if "value" not in columns and "reward" not in columns:
        missing.append("value (or reward)")
    if missing:
        raise DataError(f"{path} has no column {' and no '.join(missing)}; it has {', '.join(names) or 'none'}")
    clash = [name for name in PARTS_OF_VALUE if name in columns] if "value" in columns else []
    if clash:
        raise DataError(f"{path} has both value and {clash[0]}: give the value, or the parts it is made of")
    if not rows:
        raise DataError(f"{path} holds no requests; give one row per request")
    numbers = {name: _numbers(path, name, columns[name]) for name in KNOWN[1:] if name in columns}
    zero = np.zeros(len(rows))
    penalty, expires = numbers.get("penalty", zero), numbers.get("expires", zero)
    _demand(path, "penalty", penalty, penalty <= 0, "is positive; write a cost of expiry as a number <= 0")
    _demand(path, "expires", expires, (expires == 0) | (expires == 1), "is neither 0 nor 1")
    value = numbers.get("value")
    if value is None:
        value = numbers["reward"] - penalty * expires - numbers.get("opportunity_cost", zero)
    return RequestTable(
        names=[str(name) for name in columns.get("request", range(len(rows)))],
        value=value,
        utility=numbers["utility"],
        compensation=numbers.get("compensation"),
        ignored=[name for name in names if name not in KNOWN],
    )


def _read(path: Path) -> tuple[list[str], list[list[Any]]]:
    try:
        if path.suffix.lower() == ".json":
            return _from_json(path, json.loads(path.read_bytes()))
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file, strict=True) if line]
    except FileNotFoundError:
        raise DataError(f"there is no file {path}") from None
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        why = (str(error) or type(error).__name__).splitlines()[0]
        raise DataError(f"cannot read {path} ({why}); give a CSV or a JSON list with one row per request") from error
    if not lines:
        raise DataError(f"cannot read {path} (it is empty); give a CSV or a JSON list with one row per request")
    for number, line in enumerate(lines[1:], 1):
        if len(line) != len(lines[0]):
            raise DataError(f"{path}: row {number} has {len(line)} entries for {len(lines[0])} columns")
    return lines[0], lines[1:]


def _from_json(path: Path, content: Any) -> tuple[list[str], list[list[Any]]]:
    if isinstance(content, dict):
        others = [key for key in content if key != "requests"]
        if "requests" not in content or others:
            found = ", ".join(map(str, content)) or "nothing"
            raise DataError(f"{path} is an object with {found}; it takes requests alone (mu and the like are options)")
        content = content["requests"]
    if not isinstance(content, list) or not all(isinstance(row, dict) for row in content):
        raise DataError(f"cannot read {path} (no list of objects); give a CSV or a JSON list with one row per request")
    header = list(content[0]) if content else []
    for number, row in enumerate(content, 1):
        if set(row) != set(header):
            raise DataError(f"{path}: row {number} has other columns than the first: {', '.join(map(str, row))}")
    return [str(name) for name in header], [[row[name] for name in header] for row in content]


def _numbers(path: Path, name: str, entries: list[Any]) -> Floats:
    numbers = np.empty(len(entries))
    for i, entry in enumerate(entries):
        try:
            numbers[i] = float(entry)
        except (TypeError, ValueError):
            numbers[i] = np.nan
        if not np.isfinite(numbers[i]):
            raise DataError(f"{path}: {name} in row {i + 1} is {entry!r}, not a finite number")
    return numbers


def _demand(path: Path, name: str, column: Floats, good: Any, why: str) -> None:
    if not good.all():
        i = int((~good).argmax())
        raise DataError(f"{path}: {name} in row {i + 1} = {column[i]:g} {why}")
