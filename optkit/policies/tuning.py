"""Grid search for the two benchmark policies, many parameter settings and instances in one lockstep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import MOST_MONEY, Bools, Floats, Known, floats, locked, real
from optkit.basics.errors import InputError, PolicyError
from optkit.instances.instance import Instance
from optkit.policies.formula import Formula, formula
from optkit.policies.reward_percentage import RewardPercentage
from optkit.simulation.batch import Batch
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
"""Simulated runs per lockstep, of all settings in a few instances; their arrays then stay in the processor's cache."""

P = TypeVar("P", RewardPercentage, Formula)
Progress = Callable[[int, int], object]
"""Called with the number of instances done and their total."""


@dataclass(frozen=True)
class Tuned(Known, Generic[P]):
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
        Called with the number of instances done and their total.

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
        offer: Floats = (setting[0] * state.reward).clip(min=0.0)
        return offer

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
        Called with the number of instances done and their total.

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
        return formula(state, *setting)

    best, table = _search(instances, names, settings, pay, progress)
    return Tuned(Formula(*best), float(table["mean_reward"].max()), table)


def _search(
    instances: Sequence[Instance],
    names: list[str],
    settings: Floats,
    pay: Callable[[State, Floats], Floats],
    progress: Progress | None,
) -> tuple[list[float], pd.DataFrame]:
    """Mean reward of every setting: all settings through a few instances, in one lockstep, then through the next."""
    import pandas as pd

    batch = Batch.of(instances)
    if len(batch) == 0:
        raise InputError("tuning needs at least one instance")
    if settings.size == 0 or (names == ["share"] and settings.min() < 0):
        raise InputError(f"the grid for {', '.join(names)} must hold at least one number, and shares of at least 0")
    together = max(1, RUNS_AT_ONCE // len(settings))
    reward = np.empty((len(settings), len(batch)))
    for first in range(0, len(batch), together):
        last = min(first + together, len(batch))
        reward[:, first:last] = _rewards(batch, first, last, settings, pay).T
        if progress is not None:
            progress(last, len(batch))
    mean = reward.mean(axis=1)
    table = pd.DataFrame(settings, columns=names).assign(mean_reward=mean)
    return [float(x) for x in settings[int(mean.argmax())]], table


def _rewards(batch: Batch, first: int, last: int, settings: Floats, pay: Callable[[State, Floats], Floats]) -> Floats:
    """Rewards of G settings in instances ``first`` to ``last - 1``, (b, G), as the simulator would give them.

    A setting changes which requests are still open, and what is paid; all else is the same for all settings. So arrays
    have a row for each request that has arrived and not expired, and a column for each setting.
    """
    begin, end = batch.request_start[first], batch.request_start[last]
    order = batch.arrivals[0][begin:end]
    owner = np.repeat(np.arange(first, last), np.diff(batch.request_start[first : last + 1]))
    arrival, expiry, columns = batch.arrival[order], batch.expiry[order], settings.T[:, None]
    open_ = np.ones((order.size, len(settings)), dtype=bool)
    margin, penalty = np.zeros((2, last - first, len(settings)))
    for step in range(batch.horizon):
        present = (arrival <= step) & (expiry >= step)
        worker = batch.worker_at[step, owner]
        live = np.flatnonzero(present & (worker >= 0))
        if live.size:
            # One decision for each request, though the worker is the same: their rows are put together below.
            one = live, owner[live], worker[live], order[live, None], np.ones((live.size, 1), dtype=bool)
            state = State(batch, step, *locked(one))
            still = open_[live]
            offer = _offers(pay, state, columns, still)
            total = state.utility + offer
            np.putmask(total, ~still, -np.inf)
            total += batch.noise(state.worker, state.request)
            top = np.flatnonzero(np.diff(state.instance, prepend=-1))
            best = np.maximum.reduceat(total, top, axis=0)
            outside = state.outside_utility + batch.outside_noise[state.worker]
            takes = (best >= outside[top, None]) & (best > -np.inf)
            size = np.diff(top, append=live.size)
            taken = total == np.repeat(np.where(takes, best, np.nan), size, axis=0)
            taken &= still
            if np.count_nonzero(taken) > np.count_nonzero(takes):
                for rows in np.split(taken, top[1:]):  # of requests that a worker likes as much, the first
                    rows &= rows.cumsum(axis=0) == 1
            row, column = np.divmod(np.flatnonzero(taken), len(settings))
            margin[state.instance[row] - first, column] += state.reward[row, 0] - offer[row, column]
            open_[live] = still ^ taken
        over = np.flatnonzero(expiry == step)
        if over.size:
            lost = np.zeros_like(penalty)
            for i in over:  # one after the other, as the simulator adds them: the same to the last digit
                lost[owner[i] - first] += batch.penalty[order[i]] * open_[i]
            penalty += lost
    return margin + penalty


def _offers(pay: Callable[[State, Floats], Floats], state: State, settings: Floats, open_: Bools) -> Floats:
    """Compensations (w, G) of settings (k, 1, G), which are feasible where a request is open."""
    with np.errstate(all="ignore"):
        offer = pay(state, settings)
    if not (offer.min() >= 0 and offer.max() <= MOST_MONEY):  # NaN fails the comparison too
        wrong = open_ & ~((offer >= 0) & (offer <= MOST_MONEY))
        if wrong.any():
            w, g = np.argwhere(wrong)[0]
            weights = ", ".join(f"{float(weight):g}" for weight in settings[:, 0, g])
            raise PolicyError(
                f"the setting {weights} of the grid offers {offer[w, g]} at step {state.step}; "
                "a compensation is a finite number >= 0, of moderate size"
            )
        offer = np.where(open_, offer, 0.0)
    return offer
