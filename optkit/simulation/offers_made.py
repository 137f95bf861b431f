"""All offers of a simulation, one row each: to whom, for which request, how much, and whether it was accepted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.simulation.state import State

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("run", "step", "worker", "group", "request", "reward", "compensation", "accepted")


class OffersMade:
    """An observer of :func:`optkit.simulate` that keeps every offer.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> made = OffersMade()
    >>> done = simulate(scenario("I.1", seed=0).sample(2, seed=1), lambda state: 0.6 * state.reward, observe=made)
    >>> bool(made.to_frame()["accepted"].sum() == done.served.sum())
    True
    """

    def __init__(self) -> None:
        self._parts: list[dict[str, Any]] = []

    def __call__(self, state: State, offer: Floats, taken: Ints) -> None:
        """Keep the offers of a step."""
        row, column = np.nonzero(state.offered)
        instance, batch = state.instance[row], state.batch
        self._parts.append(
            {
                "run": state.row[row],
                "step": np.full(row.size, state.step),
                "worker": state.worker[row] - batch.worker_start[instance],
                "group": state.group[row],
                "request": state.request[row, column] - batch.request_start[instance],
                "reward": state.reward[row, column],
                "compensation": offer[row, column],
                "accepted": taken[row] == column,
            }
        )

    def to_frame(self) -> pd.DataFrame:
        """One row per offer, by run, step and request: :data:`COLUMNS`; numbers are those of each instance."""
        import pandas as pd

        columns = {name: np.concatenate([part[name] for part in self._parts] or [np.zeros(0)]) for name in COLUMNS}
        found = pd.DataFrame(columns).astype({"accepted": bool})
        return found.sort_values(["run", "step", "request"], ignore_index=True)
