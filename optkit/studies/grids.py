"""The named studies: which cells each of them consists of."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

from optkit.basics.arrays import flag, whole_number
from optkit.basics.errors import DataError, InputError
from optkit.instances.new_york.trip_files import find_files
from optkit.instances.new_york.trip_scenario import check_selection
from optkit.instances.settings import TABLE_1, adjust
from optkit.studies.cells import Cell, Place
from optkit.studies.policies import POLICIES

STUDIES = ("homogeneous", "heterogeneous", "sensitivity", "nyc")
"""Sections 5.1, 5.2, both with fig:sens_syn and fig:sens_syn_2, and 5.3 of the paper."""

MOST = 10_000
"""Worlds, training seeds, and draws of a belief, of a study."""

MOST_CELLS = 200_000
"""Of a study: months of work on any machine."""

EPSILONS = (2.0, 4.0, 6.0)
DRAWS = 10
"""Of each wrong belief, the paper's."""

_HOMOGENEOUS = (
    "Myopic, true MNL",
    "Linear, true MNL",
    "Kernel, true MNL",
    "Attention, true MNL",
    "Linear, paper's data",
    "Attention, paper's data",
    "Linear, re-estimated",
    "FP",
    "PP",
)
_HETEROGENEOUS = (
    *_HOMOGENEOUS[:-2],
    "Linear, single MNL, paper's data",
    "Attention, single MNL, paper's data",
    "Linear, single MNL",
    "FP",
    "PP",
)


@dataclass(frozen=True)
class Study:
    """A study's grid.

    Attributes
    ----------
    name : str
        One of :data:`STUDIES`.
    worlds : tuple of int
        World seeds; with more than one, conclusions carry an interval over worlds too.
    seeds : int
        Training seeds, of which validation chooses one (the paper's five).
    settings : dict
        Changed settings of the scenarios, for example a smaller ``split``.
    trips : tuple of str
        Files of trip records, for ``nyc``.
    gap : bool
        Whether to certify the gap to optimality, the dearest cell of a scenario.
    mode, fraction : str, float, optional
        How trips become instances, for ``nyc``, see :func:`optkit.instances.new_york.trip_scenario.trip_scenario`.
        ``mondays`` is the paper's way.
    draws : int
        Draws of each wrong belief, for ``sensitivity`` (the paper's ten).
    """

    name: str
    worlds: tuple[int, ...] = (0,)
    seeds: int = 5
    settings: Mapping[str, Any] = field(default_factory=dict)
    trips: tuple[str, ...] = ()
    gap: bool = True
    mode: str = "folded"
    fraction: float | None = None
    draws: int = DRAWS

    def __post_init__(self) -> None:
        if self.name not in STUDIES:
            raise InputError(f"no study {self.name!r}; there are {', '.join(STUDIES)}, and all")
        flag("gap", self.gap)
        if not self.worlds:
            raise InputError("worlds is empty; give the number of at least one")
        worlds = tuple(whole_number(f"worlds[{k}]", world, least=0) for k, world in enumerate(self.worlds))
        object.__setattr__(self, "worlds", worlds)
        object.__setattr__(self, "seeds", whole_number("seeds", self.seeds, least=1, most=MOST))
        object.__setattr__(self, "draws", whole_number("draws", self.draws, least=1, most=MOST))
        if len(self.worlds) > MOST:
            raise InputError(f"{len(self.worlds):,} worlds are too many: take {MOST:,} at most")
        cells = len(self.worlds) * sum(1 for name in self.scenarios for _ in self._of({"scenario": name}))
        if cells > MOST_CELLS:
            raise InputError(
                f"the study would have {cells:,} cells: take fewer worlds, seeds or draws ({MOST_CELLS:,} at most)"
            )
        if self.name == "nyc" and not self.trips:
            raise InputError("the study nyc needs trip records: give --trips, a TLC file (parquet or CSV) or a folder")
        if self.name != "nyc" and (self.mode, self.fraction) != ("folded", None):
            raise InputError(f"mode and fraction say how trips become instances: the study {self.name} has none")
        check_selection(self.mode, self.fraction)
        # Checked before there are cells that all fail of it; and 12.0 is the same setting as 12.
        adjusted = {name: adjust(TABLE_1[name], dict(self.settings)) for name in self.scenarios}
        told = {name: getattr(adjusted[self.scenarios[0]], name) for name in self.settings}
        object.__setattr__(self, "settings", told)

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Scenarios of the study, by name."""
        return {
            "homogeneous": ("I.1", "I.2", "I.3"),
            "heterogeneous": ("II",),
            "sensitivity": ("I.1", "II"),
            "nyc": ("nyc-weak", "nyc-strong"),
        }[self.name]

    def cells(self) -> list[Cell]:
        """All cells, in the order of the tables.

        Examples
        --------
        >>> cells = Study("sensitivity").cells()
        >>> len(cells), str(cells[2])
        (154, 'I.1, world 0: perturbed, epsilon 2.0, draw 0, value linear, seed 0')
        """
        return [cell for place in self._places() for cell in self._of(place)]

    @property
    def selection(self) -> dict[str, Any]:
        """Mode and fraction where they are not the usual ones."""
        mode = {} if self.mode == "folded" else {"mode": self.mode}
        return mode if self.fraction is None else {**mode, "fraction": float(self.fraction)}

    def _places(self) -> Iterator[Place]:
        digest = {"trips": digest_of(self.trips)} if self.trips and self.name == "nyc" else {}
        settings = {k: list(v) if isinstance(v, tuple) else v for k, v in sorted(self.settings.items())}
        for scenario in self.scenarios:
            for world in self.worlds:
                yield {"scenario": scenario, "world": world, "set": settings, **digest, **self.selection}

    def _of(self, place: Place) -> Iterator[Cell]:
        yield Cell("bounds", place, {})
        if self.name == "sensitivity":
            yield from self._perturbed(place)
            return
        if self.name != "homogeneous":
            yield Cell("utilities", place, {})
        names = _HETEROGENEOUS if self.name == "heterogeneous" else _HOMOGENEOUS
        for name in installed(names):
            for seed in range(self.seeds if POLICIES[name].random else 1):
                detail = {"detail": True} if self.name == "nyc" else {}
                yield Cell("policy", place, {"policy": name, "seed": seed, **detail})
        singles = ("single-paper", "single") if self.name == "heterogeneous" else ()
        for choice in ("paper", "learned", *singles):
            yield Cell("estimate", place, {"choice": choice, "seed": 0})
        if self.gap:
            yield Cell("gap", place, {})

    def _perturbed(self, place: Place) -> Iterator[Cell]:
        base = {"value": "linear", "seed": 0}
        yield Cell("perturbed", place, {"epsilon": 0.0, "draw": 0, **base})
        for groups in (None, [0], [1], [2]) if place["scenario"] == "II" else (None,):
            for epsilon in EPSILONS:
                for draw in range(self.draws):
                    who = {} if groups is None else {"groups": groups}
                    yield Cell("perturbed", place, {"epsilon": epsilon, "draw": draw, **who, **base})


def installed(names: Sequence[str]) -> list[str]:
    """Return the policies that can be made here: those with the attention network need the extra."""
    torch = find_spec("torch") is not None
    return [name for name in names if torch or not str(POLICIES[name].value).startswith("attention")]


def digest_of(trips: Sequence[str]) -> str:
    """Digest of the contents of trip files, whatever they are called and wherever they are.

    Parameters
    ----------
    trips : sequence of str
        Files, or folders of them.

    Returns
    -------
    str
        Sixteen hexadecimal digits.

    Raises
    ------
    DataError
        If there are none, or one cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "yellow_tripdata.csv").write_text("a,b")
    ...     digest_of([folder])
    'fd97daabcebe4451'
    """
    found = []
    for path in find_files(trips):
        try:
            with open(path, "rb") as file:
                found.append(hashlib.file_digest(file, "sha256").hexdigest())
        except OSError as error:
            raise DataError(f"{path} cannot be read ({error.strerror or error})") from error
    return hashlib.sha256("".join(sorted(found)).encode()).hexdigest()[:16]
