"""Sets of waiting requests: what is known of them, and opportunity costs by evaluating every set again."""

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.request_sets import KnownRequests, RequestSets, SetValue, removal_differences

REQUESTS = KnownRequests(
    reward=np.array([30.0, 40.0, 0.0]),
    penalty=np.array([-5.0, -6.0, 0.0]),
    arrival=np.array([0, 1, 0]),
    expiry=np.array([4, 9, 0]),
    utility=np.array([[-10.0, -12.0, 0.0], [-20.0, -2.0, 0.0]]),
    features=np.zeros((3, 0)),
    pickup=np.zeros(3, int),
    dropoff=np.zeros(3, int),
)
"""Two requests, two groups, and the padding."""

SETS = RequestSets(REQUESTS, 3, np.array([[0, 1], [1, 2]]), np.array([[True, True], [True, False]]))


def test_what_is_known_of_each_request():
    """Surplus is reward less penalty plus utility, by group or in the mean; steps left count from the step."""
    assert REQUESTS.surplus.tolist() == [[25.0, 15.0], [34.0, 44.0], [0.0, 0.0]]
    assert SETS.surplus.tolist() == [[[25.0, 15.0], [34.0, 44.0]], [[34.0, 44.0], [0.0, 0.0]]]
    assert SETS.mean_surplus.tolist() == [[20.0, 39.0], [39.0, 0.0]]
    assert SETS.steps_left[SETS.member].tolist() == [1.0, 6.0, 6.0]
    assert len(SETS) == 2


def test_surplus_to_a_group():
    """A group's surplus, or the mean; a group that the requests do not have is an InputError that names both."""
    assert SETS.surplus_to(1).tolist() == [[15.0, 44.0], [44.0, 0.0]]
    assert SETS.surplus_to(None).tolist() == SETS.mean_surplus.tolist()
    with pytest.raises(InputError, match=r"group 2.*0\.\.1"):
        SETS.surplus_to(2)


def test_rows():
    """Some of the sets, as often as wanted, with their busy stretches; nobody writes into them."""
    twice = SETS.rows(np.array([0, 0, 1]))
    assert twice.member.tolist() == [[True, True], [True, True], [True, False]]
    with pytest.raises(ValueError, match="read-only"):
        twice.member[0, 0] = False
    told = RequestSets(REQUESTS, 3, SETS.index, SETS.member, np.array([4, 0])).rows(np.array([1, 1, 0]))
    assert told.busy.tolist() == [0, 0, 4]
    assert twice.steps_left.tolist() == [[1.0, 6.0], [1.0, 6.0], [6.0, -3.0]]


def test_sets_without_a_request():
    """The original keeps all; to lack padding changes nothing."""
    fewer = SETS.without(np.array([0, 0, 1]), np.array([1, 0, 1]))
    assert fewer.member.tolist() == [[True, False], [False, True], [True, False]]
    assert SETS.member.sum() == 3


def test_removals_by_hand():
    """If a set is worth the square of its size, removing one of n costs 2 n - 1; padding costs nothing."""
    cost = removal_differences(lambda sets: sets.member.sum(axis=1) ** 2.0, SETS)
    assert cost.tolist() == [[3.0, 3.0], [1.0, 0.0]]
    assert SETS.member.sum() == 3


def test_removals_of_an_additive_value(random_sets):
    """If requests do not matter to each other, a request costs what it is worth (rounding of sums near 500)."""
    sets = random_sets(1, b=5, w=8)
    worth = np.where(sets.member, sets.mean_surplus * sets.steps_left, 0.0)
    cost = removal_differences(lambda s: np.where(s.member, s.mean_surplus * s.steps_left, 0.0).sum(axis=1), sets)
    np.testing.assert_allclose(cost, worth, atol=1e-10)


def test_nothing_to_remove():
    """Empty sets have no costs."""
    empty = RequestSets(REQUESTS, 3, SETS.index, np.zeros((2, 2), bool))
    assert removal_differences(lambda sets: sets.member.sum(axis=1) * 1.0, empty).tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_the_light_functions_are_set_values():
    """The estimators satisfy the protocol that a user's own value function has to satisfy, and others do not."""
    assert isinstance(LinearValue(), SetValue)
    assert isinstance(KernelValue(), SetValue)
    assert not isinstance(object(), SetValue)
