"""Checks of a policy's prices where it decides."""

import numpy as np
import pytest

from optkit.basics.errors import InputError, SolverError
from optkit.evaluation.verification import verify_pricing
from optkit.instances.catalogue import scenario
from optkit.models.pricing_program import PricingProgram
from optkit.policies import PostDecisionPricing
from optkit.simulation.simulator import simulate


@pytest.fixture(scope="module")
def days():
    """Instances of the scenario with three groups."""
    return scenario("II", seed=0).sample(5, seed=1)


def test_optimal_prices_are_certified_at_every_decision(days):
    """Every decision of the myopic policy is counted and certified, and the solver agrees on a sample."""
    seen = []
    simulate(days, PostDecisionPricing(), observe=lambda state, *_: seen.append(len(state.worker)))
    found = verify_pricing(days, sample=8)
    assert found.holds
    assert found.decisions == found.certified == sum(seen)
    assert found.solved == found.agreed == 8
    assert found.worst_gap < 1e-9


class Generous(PostDecisionPricing):
    """Optimal prices and a tenth more: wrong on purpose."""

    def __call__(self, state):
        """Prices that are too high."""
        return 0.1 + super().__call__(state)


def test_wrong_prices_are_noticed(days):
    """A policy that pays a tenth of a money unit too much is certified nowhere that it matters."""
    found = verify_pricing(days, Generous(), sample=0)
    assert not found.holds
    assert found.certified < 0.1 * found.decisions


@pytest.mark.slow
def test_sample_is_fixed_by_its_seed(days):
    """The same seed solves the same decisions."""
    one, two = (verify_pricing(days, sample=4, seed=3) for _ in range(2))
    assert one == two


def test_solver_that_gives_up_is_reported(days, monkeypatch):
    """Where the solver fails, the verdict does not hold and its words are kept."""

    def give_up(*_, **__):
        raise SolverError("gave up")

    monkeypatch.setattr(PricingProgram, "solve", give_up)
    found = verify_pricing(days, sample=3)
    assert not found.holds
    assert found.failures == ["gave up"] * 3
    assert np.isfinite(found.worst_profit)


def test_negative_sample_is_refused(days):
    """A negative number of decisions is an error."""
    with pytest.raises(InputError):
        verify_pricing(days, sample=-1)
