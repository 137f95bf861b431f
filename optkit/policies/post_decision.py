"""Pricing by the closed form, with opportunity costs from a value function and utilities from a choice model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from optkit.basics.arrays import MOST_MONEY, Bools, Floats, check_shape, real
from optkit.basics.errors import InputError, PolicyError
from optkit.basics.users_code import name_of, users_code
from optkit.models.pricing import optimal_prices
from optkit.simulation.state import State


@runtime_checkable
class ChoiceModel(Protocol):
    """What a policy believes of the workers' preferences."""

    def utility(self, state: State) -> Floats:
        """Mean utility of each open request to the worker, (b, w), money."""
        ...

    def mu(self, state: State) -> Floats:
        """Noise scale of the worker, (b,), money."""
        ...

    def outside_utility(self, state: State) -> Floats:
        """Mean utility of rejecting, (b,), money."""
        ...


@runtime_checkable
class ValueFunction(Protocol):
    """What a policy believes an open request is worth to the future."""

    def opportunity_cost(self, state: State) -> Floats:
        """Delta_i = V(R') - V(R' without i), (b, w), money; R' are the open requests that do not expire now.

        It is 0 for requests that do expire now: they are not in R'.
        """
        ...


@dataclass(frozen=True)
class TrueChoice:
    """The workers' true preferences, as in the paper's Pert(0).

    Examples
    --------
    >>> PostDecisionPricing().choice == TrueChoice()
    True
    """

    def utility(self, state: State) -> Floats:
        """True mean utilities, (b, w), money."""
        return state.utility

    def mu(self, state: State) -> Floats:
        """True noise scales, (b,), money."""
        return state.mu

    def outside_utility(self, state: State) -> Floats:
        """True outside utilities, (b,), money."""
        return state.outside_utility


@dataclass(frozen=True)
class ZeroValue:
    """The value function that is 0: the future is worth nothing, which makes the policy myopic.

    Examples
    --------
    >>> PostDecisionPricing().value_function == ZeroValue()
    True
    """

    def opportunity_cost(self, state: State) -> Floats:
        """Zeros, (b, w)."""
        return np.zeros(state.offered.shape)


@dataclass(frozen=True)
class PostDecisionPricing:
    """Optimal compensations for post-decision values (paper sections 3.1 and 3.2, Lemmas 1 and 3).

    A request is worth ``v = reward - penalty [expires now] - opportunity cost``; prices follow from
    :func:`optkit.models.pricing.optimal_prices`.

    Parameters
    ----------
    choice : ChoiceModel
        Beliefs about the workers; the truth by default.
    value_function : ValueFunction
        Beliefs about the future; zero by default, the myopic policy.
    nonnegative : True or "clip"
        Exact prices c >= 0, or the paper's clipped ones.

    Raises
    ------
    InputError
        If ``nonnegative`` is anything else: the simulator takes no negative prices.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> simulate(scenario("I.1", seed=0).sample(2, seed=1), PostDecisionPricing()).reward.shape
    (2,)
    """

    choice: ChoiceModel = field(default_factory=TrueChoice)
    value_function: ValueFunction = field(default_factory=ZeroValue)
    nonnegative: Literal[True, "clip"] = True

    def __post_init__(self) -> None:
        if self.nonnegative is not True and self.nonnegative != "clip":
            raise InputError(f"nonnegative = {self.nonnegative!r}: prices must be feasible, so it is True or 'clip'")

    def value(self, state: State) -> Floats:
        """What serving each request now is worth before paying for it, (b, w), money (Lemma 1)."""
        spared = np.where(state.expiring, state.penalty, 0.0)
        shape = state.offered.shape
        cost = _believed(self.value_function, "opportunity_cost", state, shape, open_=state.offered)
        return np.asarray(state.reward - spared - cost)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money."""
        return optimal_prices(
            self.value(state),
            _believed(self.choice, "utility", state, state.offered.shape, open_=state.offered),
            _believed(self.choice, "mu", state, state.worker.shape, above=0.0),
            outside_utility=_believed(self.choice, "outside_utility", state, state.worker.shape),
            nonnegative=self.nonnegative,
            offered=state.offered,
        ).compensation


def _believed(
    model: object,
    method: str,
    state: State,
    shape: tuple[int, ...],
    *,
    open_: Bools | bool = True,
    above: float = -np.inf,
) -> Floats:
    """Ask a model, which may be the user's own, for finite numbers of a shape; in padding it may say anything."""
    what = f"the {method} of {name_of(model)}, at step {state.step},"
    with users_code(what):
        found = real(what, getattr(model, method)(state), accept="any", error=PolicyError)
    check_shape(what, found, shape, error=PolicyError)
    wrong = open_ & ~((np.abs(found) <= MOST_MONEY) & (found > above))
    if method == "utility":  # who cannot serve a request says so
        wrong &= ~np.isneginf(found)
    if wrong.any():
        need = f"finite numbers above {above:g}" if above > -np.inf else "finite numbers"
        raise PolicyError(
            f"{what} is {found[wrong][0]}: it needs {need}, of moderate size, wherever there is a request"
        )
    return found
