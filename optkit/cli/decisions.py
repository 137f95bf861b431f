"""Many decisions in one table, each priced apart and proven: for ``optkit price`` with a column ``decision``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.cli.console import print_table, say
from optkit.cli.request_table import RequestTable

if TYPE_CHECKING:
    import pandas as pd

    from optkit.models.pricing.certificate import PriceCertificate
    from optkit.models.pricing.optimal import Pricing

SHOWN = 200
"""Rows of the table on the terminal."""


@dataclass(frozen=True, eq=False)
class ManyDecisions:
    """Decisions of a table side by side, S of them over up to w requests.

    Attributes
    ----------
    given : RequestTable
        The rows.
    decisions : list of str
        In the order in which they first appear.
    of, place : (n,) int
        Decision of each row, and its place in it.
    prices : Pricing
        Arrays (S, w).
    proof : PriceCertificate
    """

    given: RequestTable
    decisions: list[str]
    of: Ints
    place: Ints
    prices: Pricing
    proof: PriceCertificate

    @classmethod
    def priced(cls, given: RequestTable, mu: float, outside_utility: float, form: Any) -> ManyDecisions:
        """Price all decisions at once; ``form`` is True, False or "clip" as in ``optimal_prices``."""
        from optkit.models.pricing import certify, optimal_prices

        assert given.decision is not None
        number: dict[str, int] = {}
        of = np.array([number.setdefault(name, len(number)) for name in given.decision], dtype=np.int64)
        order = np.argsort(of, kind="stable")
        size = np.bincount(of, minlength=len(number))
        place = np.empty_like(of)
        place[order] = np.arange(of.size) - np.repeat(np.cumsum(size) - size, size)
        shape = (len(number), int(size.max()))

        def side_by_side(column: Any, empty: Any) -> Any:
            table = np.full(shape, empty)
            table[of, place] = column
            return table

        value, utility = side_by_side(given.value, 0.0), side_by_side(given.utility, 0.0)
        facts: dict[str, Any] = {"outside_utility": outside_utility, "offered": side_by_side(given.offered, False)}
        found = optimal_prices(value, utility, mu, nonnegative=form, **facts)
        proof = certify(found.compensation, value, utility, mu, nonnegative=form is not False, **facts)
        return cls(given, list(number), of, place, found, proof)

    def rows(self, array: Floats) -> Floats:
        """Return an array (S, w) row by row of the table."""
        return np.asarray(array[self.of, self.place])

    def to_dict(self) -> list[dict[str, Any]]:
        """Return what is told of each decision."""
        requests: list[list[dict[str, Any]]] = [[] for _ in self.decisions]
        pay, taken = self.rows(self.prices.compensation).tolist(), self.rows(self.prices.acceptance).tolist()
        for d, name, c, p in zip(self.of.tolist(), self.given.names, pay, taken, strict=True):
            requests[d].append({"request": name, "compensation": c, "acceptance": p})
        numbers = {
            "rejection": self.prices.rejection, "markup": self.prices.markup, "profit": self.prices.profit,
            "bound": self.proof.bound, "gap": self.proof.gap,
        }  # fmt: skip
        return [
            {"decision": name, "requests": requests[d], **{key: float(x[d]) for key, x in numbers.items()}}
            | {"optimal": bool(self.proof.optimal[d]), "undecided": bool(self.proof.undecided[d])}
            for d, name in enumerate(self.decisions)
        ]

    def show(self, title: str) -> None:
        """Print the first rows, and how many decisions are proven."""
        pay, taken = self.rows(self.prices.compensation), self.rows(self.prices.acceptance)
        rows = [
            [*map(str, (self.decisions[self.of[i]], self.given.names[i])), f"{pay[i]:.6g}", f"{taken[i]:.4f}"]
            for i in range(min(SHOWN, self.of.size))
        ]
        if self.of.size > SHOWN:
            rows.append([f"and {self.of.size - SHOWN:,} more rows (see --json or --out)", "", "", ""])
        print_table(title, ["decision", "request", "compensation", "acceptance"], rows)
        proven, total = int(np.sum(self.proof.optimal)), len(self.decisions)
        open_ = [name for name, good in zip(self.decisions, self.proof.optimal, strict=True) if not good]
        say(f"{self.of.size:,} requests of {total:,} decisions, each priced apart")
        say(
            f"expected profit of all {np.sum(self.prices.profit):.6g}; {proven:,} of {total:,} decisions proven optimal"
        )
        if open_:
            say(f"not proven: {', '.join(open_[:5])}{' ...' if len(open_) > 5 else ''}")


def price_rows(given: RequestTable, compensation: Floats, acceptance: Floats) -> pd.DataFrame:
    """Return a row per request with its price: what ``--out`` writes."""
    import pandas as pd

    columns: dict[str, Any] = {} if given.decision is None else {"decision": given.decision}
    columns |= {"request": given.names, "compensation": compensation, "acceptance": acceptance}
    return pd.DataFrame(columns | {"value": given.value, "utility": given.utility})
