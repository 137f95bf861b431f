"""Policies that explore."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats, number
from optkit.basics.seeds import check_seed, step_generator
from optkit.simulation.simulator import Policy, offers
from optkit.simulation.state import State


@dataclass(frozen=True)
class RandomOffers:
    """Pay a random share of the reward, drawn anew for every offer (paper section 3.4: 40 to 85 per cent).

    Parameters
    ----------
    low, high : float
        Range of the share, ``0 <= low <= high``.
    seed : int
        Source of the randomness: the same seed pays the same on the same instances.

    Raises
    ------
    InputError
        If the range is empty or negative.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.learning.offer_log import collect
    >>> log = collect(scenario("I.2", seed=0).sample(5, seed=1), RandomOffers(0.3, 0.5, seed=0)).to_frame()
    >>> bool(log["compensation"].gt(0).all())
    True
    """

    low: float = 0.4
    high: float = 0.85
    seed: int = 0

    def __post_init__(self) -> None:
        number("high", self.high, least=number("low", self.low, least=0.0))
        check_seed(self.seed)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money."""
        rng = step_generator(self.seed, state.step)
        return np.maximum(rng.uniform(self.low, self.high, state.offered.shape) * state.reward, 0.0)


@dataclass(frozen=True)
class Explore:
    """Another policy's compensations plus Gaussian noise, cut off at 0.

    Parameters
    ----------
    policy : callable
        The policy to explore around.
    deviation : float
        Standard deviation of the noise, in money.
    seed : int
        Source of the randomness.

    Raises
    ------
    InputError
        If the deviation is negative.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> from optkit.policies import RewardPercentage
    >>> days = scenario("I.2", seed=0).sample(5, seed=1)
    >>> half, around_half = RewardPercentage(0.5), Explore(RewardPercentage(0.5), deviation=2.0)
    >>> bool((simulate(days, half).reward != simulate(days, around_half).reward).any())
    True
    """

    policy: Policy
    deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        number("deviation", self.deviation, least=0.0)
        check_seed(self.seed)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money."""
        rng = step_generator(self.seed, state.step)
        offer = offers(self.policy, state)
        return np.maximum(offer + rng.normal(0.0, self.deviation, offer.shape), 0.0)
