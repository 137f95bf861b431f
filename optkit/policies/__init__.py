"""Compensation policies: callables from a :class:`optkit.simulation.state.State` to compensations (b, w)."""

from optkit.policies.formula import Formula
from optkit.policies.post_decision import ChoiceModel, PostDecisionPricing, TrueChoice, ValueFunction, ZeroValue
from optkit.policies.reward_percentage import RewardPercentage

__all__ = [
    "ChoiceModel",
    "Formula",
    "PostDecisionPricing",
    "RewardPercentage",
    "TrueChoice",
    "ValueFunction",
    "ZeroValue",
]


def __dir__() -> list[str]:
    return sorted(__all__)
