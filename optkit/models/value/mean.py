"""The mean of several value functions: what each gets wrong in its own way cancels in part."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from optkit.basics.arrays import Floats
from optkit.basics.errors import InputError
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.experience import Estimator, Experience
from optkit.models.value.parameters import Parameters
from optkit.models.value.request_sets import RequestSets


class MeanValue(Parameters):
    """The mean of value functions that are fitted to the same experience, each with targets of its own.

    Opportunity costs are linear in the value function, so theirs are averaged too. The default averages light forms
    that err differently: hat functions that know the busy stretch, a kernel, and a kernel that knows the busy stretch
    or, with several groups of workers, hat functions by group, of two kinds. It wants many instances, some 75,000
    requests.

    Parameters
    ----------
    values : sequence of value functions, optional
        They are copied, and keep their seeds: networks need one each. Their deviations and discounts do not count, only
        those of :func:`~optkit.learning.training.train`.

    Attributes
    ----------
    values_ : list
        The fitted copies.
    residual_ : float
        Root mean square of the members' residuals, money; NaN if a member has none.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.learning.training import train
    >>> trained = train(scenario("I.2", seed=0, horizon=10).sample(20, seed=1), MeanValue(), choice="true")
    >>> [type(value).__name__ for value in trained.value.values_]
    ['LinearValue', 'KernelValue', 'KernelValue']
    """

    values_: list[Estimator]
    residual_: float
    _fitted_from: Sequence[Estimator] | None

    deviations: ClassVar[tuple[float, ...]] = (6.0, 1.0)
    """Exploration noise of each round, money, unless :func:`~optkit.learning.training.train` is told another."""

    def __init__(self, values: Sequence[Estimator] | None = None) -> None:
        self.values = values

    def fit(self, experience: Experience, y: None = None) -> Self:
        """Fit every member; after an error all is as it was.

        Parameters
        ----------
        experience : Experience
            Visited sets and their targets.
        y : None
            Targets come with the experience.

        Raises
        ------
        InputError
            If there are no members, or a setting of one is out of range.
        TrainingError
            If a member diverges.
        """
        # A member that learns from round to round goes on from its last one, unless there are others now.
        goes_on = hasattr(self, "values_") and self._fitted_from is self.values
        fitted = copy.deepcopy(self.values_ if goes_on else self.members(experience.requests.surplus.shape[1]))
        for one in fitted:
            one.fit(experience)
        self.values_, self._fitted_from = fitted, self.values
        self.residual_ = float(np.sqrt(np.mean([getattr(one, "residual_", np.nan) ** 2 for one in fitted])))
        return self

    def members(self, groups: int) -> list[Estimator]:
        """Return what is fitted, before it is, for so many groups of workers.

        Raises
        ------
        InputError
            If there are no members, or one is no value function.
        """
        if self.values is None:
            return _default(groups)
        if not isinstance(self.values, Sequence) or not self.values:
            raise InputError(f"values = {self.values!r} must be a list of at least one value function")
        for i, one in enumerate(self.values):
            wanted = ("fit", "value", "opportunity_cost")
            if isinstance(one, type) or not all(callable(getattr(one, name, None)) for name in wanted):
                raise InputError(f"values[{i}] = {one!r} is no value function: it needs {', '.join(wanted)}")
        return list(self.values)

    @property
    def sees_busy(self) -> bool:
        """Whether sets must say for how long workers have come without a break."""
        return any(getattr(one, "sees_busy", False) for one in getattr(self, "values_", ()))

    def value(self, sets: RequestSets) -> Floats:
        """Value of each set, (b,), money."""
        return np.asarray(np.mean([one.value(sets) for one in self._fitted()], axis=0))

    def predict(self, sets: RequestSets) -> Floats:
        """Return :meth:`value`, under scikit-learn's name."""
        return self.value(sets)

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """V(S) - V(S without i) for every member i, (b, w), money; 0 for padding."""
        return np.asarray(np.mean([one.opportunity_cost(sets) for one in self._fitted()], axis=0))

    def to_dict(self) -> dict[str, Any]:
        """Fitted members as plain data.

        Raises
        ------
        InputError
            If nothing has been fitted, or a member cannot be written.
        """
        for one in (members := self._fitted()):
            if not callable(getattr(one, "to_dict", None)) or isinstance(one, MeanValue):
                raise InputError(f"a mean with a {type(one).__name__} in it cannot be written to a file")
        return {"kind": "MeanValue", "values": [one.to_dict() for one in members]}  # type: ignore[attr-defined]

    @classmethod
    def from_dict(cls, plain: dict[str, Any], read: Callable[[dict[str, Any]], Any]) -> Self:
        """Make a fitted mean again from its plain data.

        Parameters
        ----------
        plain : dict
            What :meth:`to_dict` returned.
        read : callable
            Makes a member again from its own plain data.

        Raises
        ------
        InputError
            If the data are incomplete.
        """
        written = plain.get("values")
        if not isinstance(written, list) or not written or not all(isinstance(one, dict) for one in written):
            raise InputError("the mean of value functions cannot be read: it has no members")
        if any(one.get("kind") == "MeanValue" for one in written):
            raise InputError("the mean of value functions cannot be read: one of its members is a mean")
        made = cls([read(one) for one in written])
        made.values_, made._fitted_from = list(made.values or ()), made.values
        return made

    def _fitted(self) -> list[Estimator]:
        if not hasattr(self, "values_"):
            raise InputError("this MeanValue is not fitted: call fit first")
        return self.values_


def _default(groups: int) -> list[Estimator]:
    rank, busy = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0), (0.0, 1.0, 3.0, 8.0)
    hats = LinearValue(rank_knots=rank, busy_knots=busy)
    if groups == 1:
        return [hats, KernelValue(landmarks=20, rank_knots=rank), KernelValue(rank_knots=rank, busy_knots=busy)]
    return [
        hats,
        KernelValue(landmarks=60, gamma=0.2, rank_knots=rank),
        LinearValue(rank_knots=rank, busy_knots=busy, by_group=True, ridge=10.0),
        LinearValue(surplus_knots=3, time_knots=(1.0, 2.0, 5.0, 10.0, 20.0), by_group=True),
    ]
