"""Grid search for the two benchmark policies, many parameter settings and instances in one lockstep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, floats, real
from optkit.basics.errors import InputError
from optkit.instances.instance import Instance
from optkit.policies.formula import Formula, formula
from optkit.policies.reward_percentage import RewardPercentage
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import run
from optkit.simulation.state import State

if TYPE_CHECKING:
    import pandas as pd

PERCENTAGES = np.arange(40, 101) / 100
"""Shares of the reward that PP chooses from: 40 to 100 per cent (paper section 4.3)."""

FORMULA_GRID: dict[str, tuple[float, ...]] = {
    "reward": (0.0, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95),
    "distance": (0.0, 5.0, 10.0, 15.0, 20.0),
    "penalty": (-0.1, -0.05, 0.0, 0.05, 0.1),
    "expiry_boost": (0.0, 0.1, 0.2, 0.3),
}
"""Weights that FP chooses from: 1,100 combinations (paper appendix B.2)."""

RUNS_AT_ONCE = 6_000
"""Simulated runs per lockstep; their arrays then stay in the processor's cache."""

P = TypeVar("P", RewardPercentage, Formula)
Progress = Callable[[int, int], object]
"""Called with the number of settings done and their total."""


@dataclass(frozen=True)
class Tuned(Generic[P]):
    """The best policy of a grid, and the whole grid.

    Attributes
    ----------
    policy : RewardPercentage or Formula
        The setting with the largest mean reward; the first of equals.
    mean_reward : float
        Its mean reward over the instances, in money.
    table : DataFrame
        One row per setting: its parameters and ``mean_reward``.
    """

    policy: P
    mean_reward: float
    table: pd.DataFrame


def tune_reward_percentage(
    instances: Sequence[Instance], grid: npt.ArrayLike = PERCENTAGES, *, progress: Progress | None = None
) -> Tuned[RewardPercentage]:
    """Choose PP's share by its mean reward over instances.

    Parameters
    ----------
    instances : sequence of Instance
        Training instances.
    grid : (G,) float
        Shares to try; by default the paper's.
    progress : callable, optional
        Called with the number of settings done and their total.

    Returns
    -------
    Tuned
        The best policy, and the whole grid.

    Raises
    ------
    InputError
        If there are no instances, or the grid is empty or holds a negative share.

    Examples
    --------
    >>> from optkit import scenario
    >>> tune_reward_percentage(scenario("I.1", seed=0).sample(20, seed=1)).policy
    RewardPercentage(share=0.58)
    """
    settings = real("the grid for share", grid).reshape(-1, 1)

    def pay(state: State, setting: Floats) -> Floats:
        return (setting[:, :1] * state.reward).clip(min=0.0)

    best, table = _search(instances, ["share"], settings, pay, progress)
    return Tuned(RewardPercentage(*best), float(table["mean_reward"].max()), table)


def tune_formula(
    instances: Sequence[Instance],
    grid: dict[str, tuple[float, ...]] | None = None,
    *,
    progress: Progress | None = None,
) -> Tuned[Formula]:
    """Choose FP's weights by their mean reward over instances.

    Parameters
    ----------
    instances : sequence of Instance
        Training instances.
    grid : dict, optional
        Values for ``reward``, ``distance``, ``penalty`` and ``expiry_boost``; by default the paper's 1,100.
    progress : callable, optional
        Called with the number of settings done and their total.

    Returns
    -------
    Tuned
        The best policy, and the whole grid.

    Raises
    ------
    InputError
        If there are no instances, or the grid is empty or names other weights.

    Examples
    --------
    >>> from optkit import scenario
    >>> few = {"reward": (0.6, 0.8), "distance": (0.0, 10.0), "penalty": (0.0,), "expiry_boost": (0.0,)}
    >>> tune_formula(scenario("I.1", seed=0).sample(20, seed=1), few).policy
    Formula(reward=0.6, distance=0.0, penalty=0.0, expiry_boost=0.0)
    """
    chosen = FORMULA_GRID if grid is None else grid
    if set(chosen) != set(FORMULA_GRID):
        raise InputError(f"the grid names {', '.join(chosen)}; a Formula has {', '.join(FORMULA_GRID)}")
    names = list(FORMULA_GRID)
    columns = [floats(f"the grid for {name}", chosen[name], (None,)) for name in names]
    settings = np.array(list(product(*columns))).reshape(-1, len(names))

    def pay(state: State, setting: Floats) -> Floats:
        return formula(state, *(setting[:, k : k + 1] for k in range(4)))

    best, table = _search(instances, names, settings, pay, progress)
    return Tuned(Formula(*best), float(table["mean_reward"].max()), table)


def _pay_by_row(pay: Callable[[State, Floats], Floats], settings: Floats, state: State) -> Floats:
    return pay(state, settings[state.row])


def _search(
    instances: Sequence[Instance],
    names: list[str],
    settings: Floats,
    pay: Callable[[State, Floats], Floats],
    progress: Progress | None,
) -> tuple[list[float], pd.DataFrame]:
    """Mean reward of every setting: runs of several settings through all instances, in one lockstep."""
    import pandas as pd

    batch = Batch.of(instances)
    if len(batch) == 0:
        raise InputError("tuning needs at least one instance")
    if settings.size == 0 or (names == ["share"] and settings.min() < 0):
        raise InputError(f"the grid for {', '.join(names)} must hold at least one number, and shares of at least 0")
    together = max(1, RUNS_AT_ONCE // len(batch))
    mean = np.empty(len(settings))
    for first in range(0, len(settings), together):
        part = settings[first : first + together]
        which = np.repeat(np.arange(len(part)), len(batch))
        runs = np.tile(np.arange(len(batch)), len(part))
        outcome = run(batch, partial(_pay_by_row, pay, part[which]), runs)
        mean[first : first + together] = outcome.reward.reshape(len(part), -1).mean(axis=1)
        if progress is not None:
            progress(min(first + together, len(settings)), len(settings))
    table = pd.DataFrame(settings, columns=names).assign(mean_reward=mean)
    return [float(x) for x in settings[int(mean.argmax())]], table
