"""A cell: one piece of a study, described so completely that its description is its name."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

SCHEMA = 2
"""Raised when cells come to mean something else, so that results of before are not taken for results of now."""

DRAWN_ANEW = {"perturbed": 3, "gap": 3}
"""Kinds of cells whose random streams have moved since, and what they have in place of :data:`SCHEMA`: the results of
all others still count."""

Kind = Literal["bounds", "utilities", "policy", "estimate", "perturbed", "gap"]
CELL_KINDS: tuple[Kind, ...] = get_args(Kind)

Place = dict[str, Any]
"""Where a cell plays: ``scenario``, ``world`` (seed), ``set`` (changed settings), ``trips`` (digest of the files),
``mode`` and ``fraction`` (how trips become instances, where it is not the usual way)."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One computation of a study. It is pure: the same cell gives the same result, anywhere.

    Attributes
    ----------
    kind : str
        What is computed, see :mod:`optkit.studies.run_cell`.
    place : dict
        Scenario and world, see :data:`Place`.
    settings : dict
        What else it depends on, as plain data.

    Examples
    --------
    >>> one = Cell("policy", {"scenario": "I.1", "world": 0}, {"policy": "PP", "seed": 0})
    >>> str(one), one.key == Cell("policy", {"world": 0, "scenario": "I.1"}, {"seed": 0, "policy": "PP"}).key
    ('I.1, world 0: policy PP, seed 0', True)
    """

    kind: Kind
    place: Place
    settings: dict[str, Any]

    @cached_property
    def key(self) -> str:
        """Digest of everything that the cell depends on, and of :data:`SCHEMA`."""
        return hashlib.sha256(
            json.dumps([DRAWN_ANEW.get(self.kind, SCHEMA), self.describe()], sort_keys=True).encode()
        ).hexdigest()[:24]

    def describe(self) -> dict[str, Any]:
        """Kind, place and settings, as plain data."""
        return {"kind": self.kind, "place": self.place, "settings": self.settings}

    def __str__(self) -> str:
        told = {name: value for name, value in self.settings.items() if value is not None and value is not False}
        what = [f"policy {told.pop('policy')}" if self.kind == "policy" else self.kind]
        what += [f"{name} {value}" for name, value in told.items()]
        return f"{self.place['scenario']}, world {self.place['world']}: {', '.join(what)}"
