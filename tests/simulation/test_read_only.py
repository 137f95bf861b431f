"""A policy, a value function, an observer and a fit look at the world; none of them changes it for anybody."""

import dataclasses

import numpy as np
import pytest
from scipy import sparse

from optkit import scenario, simulate
from optkit.basics.errors import PolicyError
from optkit.learning.beliefs import BelievedValue
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.models.value.request_sets import ZeroSetValue
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.batch import Batch
from tests.reachable import arrays_within, scribble

HALF = RewardPercentage(0.5)


@pytest.fixture(params=["dense", "sparse"])
def days(request):
    """Three short days of three groups, with their noise stored either way."""
    drawn = scenario("II", seed=0, horizon=12).sample(3, seed=1)
    if request.param == "dense":
        return drawn
    return [dataclasses.replace(day, noise=sparse.csr_array(day.noise)) for day in drawn]


def same(a, b):
    """Whether two simulations agree in everything."""
    arrays = {name: x for name, x in vars(a).items() if x is not None}
    return all(np.array_equal(x, vars(b)[name], equal_nan=x.dtype.kind == "f") for name, x in arrays.items())


def test_a_policy_that_writes_wherever_it_can(days):
    """What it earns, and what others earn after it, is what they earn without: in the batch, and in its instances."""
    expected, batch, tried = simulate(days, HALF), Batch.of(days), []

    def scribbler(state):
        tried.extend(scribble(state))
        return HALF(state)

    assert same(simulate(batch, scribbler), expected)
    assert same(simulate(batch, HALF), expected)
    assert same(simulate(days, HALF), expected)
    noise = ".batch.noise.flat" if isinstance(days[0].noise, np.ndarray) else ".batch.noise.value"
    assert {".batch.reward", ".batch.arrivals[0]", ".batch.instances[2].utility", ".request", ".busy", noise} <= {
        *tried
    }


def swap_of(field):
    """Policies that put another array in the place of a field of the world, in whatever way they can."""

    def in_an_instance(state):
        for one in state.batch.instances:
            object.__setattr__(one, field, 2 * np.asarray(getattr(one, field)))
        return HALF(state)

    def in_the_batch(state):
        object.__setattr__(state.batch, field, 2 * getattr(state.batch, field))
        return HALF(state)

    def in_its_dict(state):
        vars(state.batch)[field] = None
        return HALF(state)

    def and_away(state):
        vars(state.batch.instances[-1]).pop(field)
        return HALF(state)

    return in_an_instance, in_the_batch, in_its_dict, and_away


@pytest.mark.parametrize("field", ["reward", "utility", "worker_group", "penalty"])
def test_a_policy_that_puts_others_in_their_place(days, field):
    """It is refused by name, and the world is as before for all who come after it."""
    expected, batch = simulate(days, HALF), Batch.of(days)
    for policy in swap_of(field):
        with pytest.raises(PolicyError, match=rf"{policy.__name__} changed the world .*\({field} of "):
            simulate(batch, policy)
        assert same(simulate(batch, HALF), expected)
        assert same(simulate(days, HALF), expected)


def test_a_policy_that_changes_its_state(days):
    """The state that workers choose by is another: what it earns is what its prices earn."""
    expected = simulate(days, HALF)

    def wishful(state):
        vars(state)["utility"] = state.utility + 1000.0
        vars(state)["outside_utility"] = state.outside_utility - 1.0
        offer = HALF(state)
        for name in ("request", "offered", "worker"):
            object.__setattr__(state, name, getattr(state, name)[::-1])
        return offer

    assert same(simulate(days, wishful), expected)


def test_sparse_noise_is_the_world_s():
    """Its arrays are attributes, which a policy may set."""
    drawn = scenario("II", seed=0, horizon=12).sample(3, seed=1)
    days = [dataclasses.replace(day, noise=sparse.csr_array(day.noise)) for day in drawn]
    expected = simulate(days, HALF)

    def calm(state):
        state.batch.instances[0].noise.data = 0.0 * state.batch.instances[0].noise.data
        return HALF(state)

    with pytest.raises(PolicyError, match="calm changed the world"):
        simulate(days, calm)
    assert same(simulate(days, HALF), expected)


def test_nothing_that_a_policy_keeps_can_be_written_into(days):
    """All arrays of a state are read-only, with what they are views of; those that an observer is told, too."""
    told = []
    simulate(days, HALF, observe=lambda *seen: told.append(seen))
    for path, array in arrays_within(tuple(told[-1])):
        fresh = path.endswith(("outside_by_group", "relative_utility", "surplus"))  # made anew for each who asks
        assert fresh or not array.flags.writeable, path


def test_an_observer_that_writes_wherever_it_can(days):
    """Choices and offers are told after the fact, and do not change by being written into."""
    assert same(simulate(days, HALF, observe=lambda *seen: scribble(seen) and None), simulate(days, HALF))


def test_a_value_function_that_writes_wherever_it_can(days):
    """The sets and what is known of the requests are nobody's to change."""

    class Scribbler(ZeroSetValue):
        def opportunity_cost(self, sets):
            assert len(scribble(sets)) > 10
            scribble(sets.without(np.array([0]), np.array([0])))
            return super().opportunity_cost(sets)

    batch = Batch.of(days)
    priced = PostDecisionPricing(value_function=BelievedValue(Scribbler()))
    assert same(simulate(batch, priced), simulate(days, PostDecisionPricing()))
    assert same(simulate(batch, HALF), simulate(days, HALF))


def test_a_fit_that_writes_wherever_it_can():
    """What was met is the same for who looks at it next."""

    class Scribbler(LinearValue):
        def fit(self, experience):
            assert len(scribble(experience)) > 10
            return super().fit(experience)

    days = scenario("I.1", seed=0, horizon=12).sample(8, seed=1)
    wild, tame = (train(days, one, choice="true").value.coef_ for one in (Scribbler(), LinearValue()))
    assert np.array_equal(wild, tame)


def test_who_makes_sets_keeps_what_they_are_made_of():
    """Arrays that are given stay their owner's: read-only is the view that a set shows of them."""
    from optkit.models.value.experience import Workers

    given = np.full((2, 3), 0.5)
    shown = Workers(given, np.ones(1), np.ones(1))
    with pytest.raises(ValueError, match="read-only"):
        shown.presence[0, 0] = 1.0
    given[0, 0] = 1.0
    assert shown.presence[0, 0] == 1.0
