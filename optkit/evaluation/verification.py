"""Check the prices of a policy where it really decides: by certificate at every decision, by a solver at some."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from optkit.basics.arrays import Floats, Ints, check_finite
from optkit.basics.errors import InputError, SolverError
from optkit.instances.instance import Instance
from optkit.models.pricing import certify, optimal_prices
from optkit.models.pricing_program import PricingProgram
from optkit.policies import PostDecisionPricing
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import simulate
from optkit.simulation.state import State

PROFIT_TOLERANCE = 1e-6
"""Largest difference of expected profits, relative to mu + |profit|, at which closed form and solver agree."""

PROBABILITY_TOLERANCE = 1e-3
"""Largest difference of acceptance probabilities. The optimum is flat: a profit within 1e-8 leaves 1e-4 in them."""


@dataclass(frozen=True)
class Verification:
    """What was checked, and how well it held.

    Attributes
    ----------
    decisions, certified : int
        Pricing decisions visited, and those whose prices a dual certificate proves optimal.
    worst_gap : float
        Largest gap between profit and dual bound, relative to ``mu + abs(bound)``.
    solved, agreed : int
        Decisions solved again as a concave program, and those whose profit and probabilities agree.
    worst_profit, worst_probability : float
        Largest differences to the solver: of profits relative to ``mu + abs(profit)``, and of probabilities.
    failures : list of str
        What the solver said where it gave up; such decisions count as solved but not as agreed.
    """

    decisions: int
    certified: int
    worst_gap: float
    solved: int
    agreed: int
    worst_profit: float
    worst_probability: float
    failures: list[str]

    def __post_init__(self) -> None:
        import pandas as pd

        check_finite("verification", pd.DataFrame([asdict(self)]))

    @property
    def holds(self) -> bool:
        """Whether everything that was checked held."""
        return self.certified == self.decisions and self.agreed == self.solved

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain data."""
        return {**asdict(self), "holds": self.holds}

    def summary(self) -> str:
        """Return two lines for a person."""
        if not self.decisions:
            return "no pricing decision was visited: there is nothing to verify"
        return (
            f"{self.certified} of {self.decisions} pricing decisions certified optimal "
            f"(largest gap {self.worst_gap:.1e} relative)\n"
            f"{self.agreed} of {self.solved} of them solved again by CVXPY and Clarabel agree "
            f"(largest difference in profit {self.worst_profit:.1e} relative, "
            f"in probability {self.worst_probability:.1e})"
        )


class _Decision(NamedTuple):
    value: Floats
    utility: Floats
    mu: float
    outside_utility: float


def verify_pricing(
    instances: Sequence[Instance],
    policy: PostDecisionPricing | Sequence[PostDecisionPricing] | None = None,
    *,
    sample: int = 60,
    seed: int = 0,
    progress: Callable[[int, int], object] | None = None,
) -> Verification:
    """Run pricing policies, certify every decision they take, and solve a random sample of them again with CVXPY.

    Parameters
    ----------
    instances : sequence of Instance
        Where the policies are run; their noise must be realised.
    policy : PostDecisionPricing or sequence of them, optional
        The myopic policy with the true choice model by default. Optimality is that of each one's own beliefs.
    sample : int
        Number of decisions to solve again (a few milliseconds each); fewer if there are fewer.
    seed : int
        Chooses the sample.
    progress : callable, optional
        Called with the number of decisions solved and their total.

    Returns
    -------
    Verification
        What was checked, and how well it held.

    Raises
    ------
    InputError
        If ``sample`` is negative.

    Examples
    --------
    >>> from optkit import scenario
    >>> verify_pricing(scenario("I.1", seed=0).sample(3, seed=1), sample=5).holds
    True
    """
    if sample < 0:
        raise InputError(f"sample = {sample} is negative; ask for 0 or more decisions to solve again")
    policies = [PostDecisionPricing()] if policy is None else [policy] if callable(policy) else policy
    visited: list[_Decision] = []
    certified, worst_gap = 0, 0.0

    def look(pricing: PostDecisionPricing, state: State, offer: Floats, _: Ints) -> None:
        nonlocal certified, worst_gap
        value, utility = pricing.value(state), pricing.choice.utility(state)
        mu, outside = pricing.choice.mu(state), pricing.choice.outside_utility(state)
        proof = certify(offer, value, utility, mu, outside_utility=outside, offered=state.offered)
        certified += int(proof.optimal.sum())
        worst_gap = float(np.maximum(worst_gap, (proof.gap / (mu + np.abs(proof.bound))).max()))  # keeps NaN
        for b, shown in enumerate(state.offered):
            visited.append(_Decision(value[b, shown], utility[b, shown], float(mu[b]), float(outside[b])))

    batch = Batch.of(instances)
    for one in policies:
        simulate(batch, one, observe=partial(look, one))
    chosen = np.random.default_rng(seed).permutation(len(visited))[:sample]
    profit, probability, failures = _solve_again([visited[i] for i in chosen], progress)
    agreed = int(((profit <= PROFIT_TOLERANCE) & (probability <= PROBABILITY_TOLERANCE)).sum())
    return Verification(
        decisions=len(visited),
        certified=certified,
        worst_gap=worst_gap,
        solved=len(chosen),
        agreed=agreed,
        worst_profit=float(profit.max(initial=0.0)),
        worst_probability=float(probability.max(initial=0.0)),
        failures=failures,
    )


def _solve_again(
    decisions: list[_Decision], progress: Callable[[int, int], object] | None
) -> tuple[Floats, Floats, list[str]]:
    """Differences of profit and of probabilities between closed form and program; not there where the solver failed."""
    programs: dict[int, PricingProgram] = {}
    profit, probability, failures = [], [], []
    for done, d in enumerate(decisions, 1):
        n = d.value.size
        closed = optimal_prices(d.value, d.utility, d.mu, outside_utility=d.outside_utility)
        try:
            solved = programs.setdefault(n, PricingProgram(n)).solve(d.value, d.utility, d.mu, d.outside_utility)
        except SolverError as error:
            failures.append(str(error))
        else:
            profit.append(abs(solved.profit - closed.profit) / (d.mu + abs(closed.profit)))
            probability.append(np.abs(solved.acceptance - closed.acceptance).max())
        if progress is not None:
            progress(done, len(decisions))
    return np.array(profit), np.array(probability), failures
