"""PP: pay the same share of the reward for every request."""

from __future__ import annotations

from dataclasses import dataclass

from optkit.basics.arrays import Floats, number
from optkit.simulation.state import State


@dataclass(frozen=True)
class RewardPercentage:
    """Reward-percentage compensation, ``share * reward`` (paper section 4.3, PP).

    Parameters
    ----------
    share : float
        At least 0; 0.5 pays half of the reward. :func:`optkit.policies.tuning.tune_reward_percentage` finds a good one.

    Raises
    ------
    InputError
        If the share is negative or not a finite number.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> simulate(scenario("I.1", seed=0).sample(2, seed=1), RewardPercentage(0.5)).reward.shape
    (2,)
    """

    share: float

    def __post_init__(self) -> None:
        number("share", self.share, least=0.0)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money; rewards below 0 are paid nothing."""
        return (self.share * state.reward).clip(min=0.0)
