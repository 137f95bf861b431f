"""What became of the rows and columns of two tables: who is left out, and why."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass, field


class LeftOutWarning(UserWarning):
    """Rows or columns of a table have no part in the instance that was made of it; how many, and why."""


@dataclass
class Account:
    """What became of the rows and columns of two tables.

    Attributes
    ----------
    rows : dict of str to int
        Rows of each table.
    left_out : dict of str to Counter
        Rows of each table that are in no instance, by reason.
    cut : int
        Requests that are open when the day ends, and expire then.
    unused : dict of str to list of str
        Columns of each table that play no part.
    notes : list of str
        What else is to be told.
    """

    rows: dict[str, int]
    left_out: dict[str, Counter[str]] = field(default_factory=lambda: {"requests": Counter(), "workers": Counter()})
    cut: int = 0
    unused: dict[str, list[str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Return what was left out, a line each; none if nothing was."""
        told = []
        for table, reasons in self.left_out.items():
            if reasons.total():
                why = " and ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
                told.append(f"{reasons.total()} of {self.rows[table]} {table} are left out: {why}")
        if self.cut:
            told.append(f"{self.cut} of {self.rows['requests']} requests are open when the day ends, and expire there")
        for table, columns in self.unused.items():
            if columns:
                told.append(f"the {table} table has columns that play no part: {', '.join(columns)}")
        return [*told, *self.notes]

    def forget(self) -> None:
        """Begin to count anew."""
        self.cut, self.left_out = 0, {table: Counter() for table in self.left_out}

    def warn(self, stacklevel: int) -> None:
        """Warn of all that was left out."""
        if self.lines():
            warnings.warn("; ".join(self.lines()), LeftOutWarning, stacklevel=stacklevel + 1)
