"""FP: pay by a formula of reward, distance, penalty and urgency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats, number
from optkit.basics.errors import InputError
from optkit.simulation.state import State


@dataclass(frozen=True)
class Formula:
    """Formula-based compensation ``v1 r + v2 td + v3 beta + v4 r [expires now]``, at least 0 (paper section 4.3, FP).

    The travel distance td is the last feature of a request.

    Parameters
    ----------
    reward, distance, penalty, expiry_boost : float
        The weights v1 to v4. :func:`optkit.policies.tuning.tune_formula` finds good ones on the paper's grid.

    Raises
    ------
    InputError
        If a weight is not a finite number.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> simulate(scenario("I.1", seed=0).sample(2, seed=1), Formula(0.6, 5.0, -0.1, 0.2)).reward.shape
    (2,)
    """

    reward: float
    distance: float = 0.0
    penalty: float = 0.0
    expiry_boost: float = 0.0

    def __post_init__(self) -> None:
        for name, weight in vars(self).items():
            number(f"the weight {name}", weight)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money."""
        return formula(state, self.reward, self.distance, self.penalty, self.expiry_boost)


def formula(
    state: State, reward: float | Floats, distance: float | Floats, penalty: float | Floats, boost: float | Floats
) -> Floats:
    """FP compensations (b, w) with weights that are numbers or, for G settings at once and w = 1, (1, G)."""
    if state.features.shape[-1] == 0:
        travel: Floats | float = 0.0
        if np.any(distance):
            raise InputError("Formula weighs the travel distance, the last feature; these instances have no features")
    else:
        travel = state.features[..., -1]
    # In place: with many settings these arrays are large, and to make them anew takes longer than to add them up.
    pay: Floats = (reward + boost * state.expiring) * state.reward
    pay += distance * travel
    pay += penalty * state.penalty
    return np.maximum(pay, 0.0, out=pay)
