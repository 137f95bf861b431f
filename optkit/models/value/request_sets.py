"""Sets of requests that wait after a decision, in many instances at once: what a value function is a function of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Ints, Known, ReadOnlyArrays, locked, real
from optkit.basics.errors import InputError, TrainingError


@dataclass(frozen=True, eq=False)
class KnownRequests(Known, ReadOnlyArrays):
    """What a platform knows or believes of N requests and of the workers it may send to them.

    Attributes
    ----------
    reward, penalty : (N,) float
        Money, as in :class:`optkit.Instance`.
    arrival, expiry : (N,) int
        First and last step at which each can be served.
    utility : (D, N) float
        Believed mean utility to each group less that of rejecting, in money.
    features : (N, k) float
        Characteristics.
    pickup, dropoff : (N,) int
        Places.
    """

    reward: Floats
    penalty: Floats
    arrival: Ints
    expiry: Ints
    utility: Floats
    features: Floats
    pickup: Ints
    dropoff: Ints

    @cached_property
    def surplus(self) -> Floats:
        """Reward less penalty plus utility, by group, (N, D), money: what serving gains if rejecting is the rule."""
        return locked(np.ascontiguousarray((self.reward - self.penalty + self.utility).T))

    @cached_property
    def mean_surplus(self) -> Floats:
        """Mean surplus over the groups, (N,), money."""
        return locked(np.asarray(self.surplus.mean(axis=1)))


@dataclass(frozen=True, eq=False)
class RequestSets(ReadOnlyArrays):
    """b sets of requests after the decision at one step, as padded rows of width w.

    Every member has at least one step left. All arrays are read-only.

    Attributes
    ----------
    requests : KnownRequests
        What is known of all requests.
    step : int
        The step of the decision that has just been made.
    index : (b, w) int
        The requests of each row, numbers into ``requests``.
    member : (b, w) bool
        Which of them belong to the set; the rest is padding.
    busy : (b,) int or None
        For how many steps in a row, up to and with this one, a worker has been seen; None if nobody asks.
    """

    requests: KnownRequests
    step: int
    index: Ints
    member: Bools
    busy: Ints | None = None

    def __len__(self) -> int:
        return len(self.member)

    @cached_property
    def penalty(self) -> Floats:
        """Penalties, (b, w), money, at most 0."""
        return locked(np.asarray(self.requests.penalty[self.index]))

    @cached_property
    def steps_left(self) -> Floats:
        """Steps after this one in which each request can be served, (b, w)."""
        return locked(np.asarray(self.requests.expiry[self.index] - float(self.step)))

    @cached_property
    def mean_surplus(self) -> Floats:
        """Mean surplus over the groups, (b, w), money."""
        return locked(np.asarray(self.requests.mean_surplus[self.index]))

    @cached_property
    def surplus(self) -> Floats:
        """Surplus by group, (b, w, D), money."""
        return locked(np.asarray(self.requests.surplus[self.index]))

    def surplus_to(self, group: int | None) -> Floats:
        """Surplus to one group, or its mean over the groups for None, (b, w), money.

        Raises
        ------
        InputError
            If there is no such group.
        """
        if group is None:
            return self.mean_surplus
        groups = self.requests.surplus.shape[1]
        if group >= groups:
            raise InputError(f"the value function knows worker group {group}; the requests have 0..{groups - 1}")
        return np.asarray(self.surplus[..., group])

    def rows(self, row: Ints) -> RequestSets:
        """Some of the sets."""
        return self._some(row, self.member[row])

    def without(self, row: Ints, column: Ints) -> RequestSets:
        """Some of the sets, (r,), each without one of its requests, (r,)."""
        member = self.member[row]
        member[np.arange(len(row)), column] = False
        return self._some(row, member)

    def _some(self, row: Ints, member: Bools) -> RequestSets:
        busy = None if self.busy is None else self.busy[row]
        return RequestSets(self.requests, self.step, *locked((self.index[row], member, busy)))


@runtime_checkable
class SetValue(Protocol):
    """A post-decision value function (paper section 3.3).

    Prices, and training on differences, ask for opportunity costs alone; bounds and training on levels, for values too.
    One that has an attribute ``sees_busy`` which is true is also told for how long workers have come without a break.
    """

    def value(self, sets: RequestSets) -> Floats:
        """Value of each set, (b,), money."""
        ...

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """V(S) - V(S without i) for every member i, (b, w), money; 0 for padding."""
        ...


class ZeroSetValue:
    """The value function that is 0.

    Examples
    --------
    >>> from optkit.learning.beliefs import BelievedValue
    >>> BelievedValue(ZeroSetValue()).preferences is None  # a policy's value function, with the true preferences
    True
    """

    def value(self, sets: RequestSets) -> Floats:
        """Zeros, (b,)."""
        return np.zeros(len(sets))

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """Zeros, (b, w)."""
        return np.zeros(sets.member.shape)


def values_of(value: SetValue, sets: RequestSets) -> Floats:
    """Values of b sets by a function that may be the user's own, (b,), money.

    Parameters
    ----------
    value : SetValue
        The function.
    sets : RequestSets
        The sets.

    Returns
    -------
    (b,) float
        Money, finite.

    Raises
    ------
    InputError
        If it does not return a number for each set.
    TrainingError
        If it returns NaN or infinity.

    Examples
    --------
    >>> none = np.zeros(0, int)
    >>> nothing = KnownRequests(none + 0.0, none + 0.0, none, none, np.zeros((1, 0)), np.zeros((0, 0)), none, none)
    >>> values_of(ZeroSetValue(), RequestSets(nothing, 0, np.zeros((2, 0), int), np.zeros((2, 0), bool)))
    array([0., 0.])
    """
    return _told(value, "values", value.value(sets), sets, (len(sets),))


def costs_of(value: SetValue, sets: RequestSets) -> Floats:
    """Opportunity costs of b sets by a function that may be the user's own, (b, w), money.

    Parameters
    ----------
    value : SetValue
        The function.
    sets : RequestSets
        The sets.

    Returns
    -------
    (b, w) float
        Money, finite.

    Raises
    ------
    InputError
        If it does not return a number for each entry.
    TrainingError
        If it returns NaN or infinity.

    Examples
    --------
    >>> none = np.zeros(0, int)
    >>> nothing = KnownRequests(none + 0.0, none + 0.0, none, none, np.zeros((1, 0)), np.zeros((0, 0)), none, none)
    >>> costs_of(ZeroSetValue(), RequestSets(nothing, 0, np.zeros((2, 0), int), np.zeros((2, 0), bool))).shape
    (2, 0)
    """
    return _told(value, "opportunity costs", value.opportunity_cost(sets), sets, sets.member.shape)


def _told(value: SetValue, what: str, found: object, sets: RequestSets, shape: tuple[int, ...]) -> Floats:
    name = type(value).__name__
    numbers = real(f"what {name} returns as {what}", found, accept="any")
    if numbers.shape != shape:
        raise InputError(f"{name} returns {what} of shape {numbers.shape} for sets of shape {sets.member.shape}")
    if not np.isfinite(numbers).all():
        raise TrainingError(f"{name} returns {what} that are no numbers at step {sets.step}")
    return numbers


def removal_differences(value: Callable[[RequestSets], Floats], sets: RequestSets) -> Floats:
    """Opportunity costs by evaluating every set once more without each of its members, (b, w), money.

    For value functions without anything quicker, and to check those that have.

    Parameters
    ----------
    value : callable
        From b sets to their values (b,), money.
    sets : RequestSets
        Up to w requests each.

    Returns
    -------
    (b, w) float
        V(S) - V(S without i) for every member i, money; 0 for padding.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> from optkit.learning.beliefs import BelievedValue
    >>> from optkit.policies import PostDecisionPricing
    >>> class Penalties(ZeroSetValue):
    ...     def value(self, sets):
    ...         return np.where(sets.member, sets.penalty, 0.0).sum(axis=1)
    ...     def opportunity_cost(self, sets):
    ...         cost = removal_differences(self.value, sets)
    ...         assert np.allclose(cost, np.where(sets.member, sets.penalty, 0.0))
    ...         return cost
    >>> policy = PostDecisionPricing(value_function=BelievedValue(Penalties()))
    >>> simulate(scenario("I.2", seed=0).sample(2, seed=1), policy).reward.shape
    (2,)
    """
    b, i = np.nonzero(sets.member)
    cost = np.zeros(sets.member.shape)
    cost[b, i] = value(sets)[b] - value(sets.without(b, i))
    return cost


def costs_without(
    value: Any, sets: RequestSets, row: Ints, column: Ints, theta: Floats | None = None
) -> npt.NDArray[np.float64]:
    """Opportunity costs in sets that lack one request, (r, w), money.

    Parameters
    ----------
    value : SetValue or Term
        Its ``opportunity_cost_without(sets, row, column)`` is asked, unless it has none, or one that a class inherits
        from before its ``opportunity_cost``; then the smaller sets are evaluated.
    sets : RequestSets
        Up to w requests each.
    row, column : (r,) int
        The sets, and the request that each lacks. To lack padding changes nothing.
    theta : (size,) float, optional
        Coefficients of a term, its last argument.

    Returns
    -------
    (r, w) float
        Money; 0 for padding and for the request that is lacking.

    Examples
    --------
    >>> class Square(ZeroSetValue):  # a set is worth the square of its size
    ...     def opportunity_cost(self, sets):
    ...         return np.where(sets.member, 2.0 * sets.member.sum(axis=1, keepdims=True) - 1.0, 0.0)
    >>> zero = np.zeros(3, int)
    >>> alike = KnownRequests(zero + 30.0, zero - 5.0, zero, zero + 9, np.zeros((1, 3)), np.zeros((3, 0)), zero, zero)
    >>> sets = RequestSets(alike, 0, np.array([[0, 1, 2]]), np.ones((1, 3), bool))
    >>> costs_without(Square(), sets, row=np.array([0]), column=np.array([1]))
    array([[3., 0., 3.]])
    """
    extra = () if theta is None else (theta,)
    for kind in type(value).__mro__:
        if "opportunity_cost_without" in vars(kind):
            return np.asarray(value.opportunity_cost_without(sets, row, column, *extra))
        if "opportunity_cost" in vars(kind):
            break
    return np.asarray(value.opportunity_cost(sets.without(row, column), *extra))
