"""The exact value function of a small model, wherever value functions of sets are asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats
from optkit.bounds.exact.exact_value import ExactSolution
from optkit.models.value.request_sets import RequestSets


@dataclass(frozen=True, eq=False)
class ExactTable:
    """Post-decision values looked up in a solution (:class:`optkit.models.value.request_sets.SetValue`).

    Requests are told apart by type, which instances of :class:`~optkit.bounds.exact.small_model.SmallModel` give as
    their pick-up place. With it a pricing policy is optimal, and a penalised bound exact.

    Parameters
    ----------
    solution : ExactSolution
        Of a model without a queue: whoever prices does not see how many workers wait.

    Examples
    --------
    >>> from optkit import simulate
    >>> from optkit.learning.beliefs import BelievedValue
    >>> from optkit.bounds.exact.exact_value import solve_exactly
    >>> from optkit.bounds.exact.small_model import SmallModel
    >>> from optkit.policies import PostDecisionPricing
    >>> model = SmallModel(horizon=6, reward=[30.0, 50.0], penalty=[-5.0, -5.0], lifetime=[2, 2],
    ...                    utility=[[-10.0, -12.0]], mu=[8.0], arrivals=[0.4, 0.2], workers=[0.5, 0.5])
    >>> solution = solve_exactly(model)
    >>> optimal = PostDecisionPricing(value_function=BelievedValue(ExactTable(solution)))
    >>> earned = simulate(model.sample(500, seed=0), optimal).reward
    >>> bool(abs(earned.mean() - solution.value) < 4 * earned.std() / 500**0.5)
    True
    """

    solution: ExactSolution

    def value(self, sets: RequestSets) -> Floats:
        """Value of each set, (b,), money."""
        kind, left = self._kinds(sets)
        return self.solution.post_decision_value(sets.step, kind, left, sets.member)

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """Value lost by removing each member, (b, w), money; 0 for padding."""
        kind, left = self._kinds(sets)
        return self.solution.opportunity_cost(sets.step, kind, left, sets.member)

    @staticmethod
    def _kinds(sets: RequestSets) -> tuple[np.ndarray, np.ndarray]:
        # Padding may have any type and time left: the mask leaves it out, but both must be whole numbers.
        return sets.requests.pickup[sets.index], sets.steps_left.astype(np.int64)
