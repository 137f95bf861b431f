"""The ranked value function."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.errors import InputError
from optkit.models.ranked_value import RankedValue, hats

KNOTS = (np.array([0.0, 50.0]), np.array([1.0, 3.0, 10.0]), np.array([0.0, 1.0, 4.0]))


def drawn(seed, steps=3):
    """A value function with random coefficients."""
    return RankedValue(*KNOTS, np.random.default_rng(seed).normal(size=(steps, 18)))


def sets(seed, b, w):
    """Random sets as padded rows; members anywhere, ties in surplus included."""
    rng = np.random.default_rng(seed)
    surplus = rng.integers(-20, 80, (b, w)).astype(float)
    return surplus, rng.integers(1, 15, (b, w)).astype(float), rng.random((b, w)) < 0.6


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 9))
def test_opportunity_costs_are_differences_of_values(seed, b, w):
    """All removals at once equal the value with less the value without, request by request (rounding: 1e-10)."""
    value, (surplus, left, member) = drawn(seed), sets(seed, b, w)
    cost = value.opportunity_cost(1, surplus, left, member)
    whole = value.value(1, surplus, left, member)
    for i in range(w):
        without = member.copy()
        without[:, i] = False
        expected = np.where(member[:, i], whole - value.value(1, surplus, left, without), 0.0)
        # Equal surpluses rank by place, with and without the removed one alike.
        np.testing.assert_allclose(cost[:, i], expected, atol=1e-10)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 9))
def test_costs_are_linear_in_the_coefficients(seed, b, w):
    """The regressors of a difference times the coefficients are the opportunity cost."""
    value, (surplus, left, member) = drawn(seed), sets(seed, b, w)
    regressors = value.basis_differences(surplus, left, member)
    cost = value.opportunity_cost(2, surplus, left, member)
    np.testing.assert_allclose(regressors @ value.coefficients[2], cost, atol=1e-10)


def test_value_by_hand():
    """Two requests on knots: the better has rank 0, the other rank 1, each takes one coefficient."""
    coefficients = np.arange(18.0)[None, :]
    value = RankedValue(*KNOTS, coefficients)
    table = coefficients.reshape(2, 3, 3)
    found = value.value(0, np.array([[0.0, 50.0]]), np.array([[3.0, 10.0]]), np.array([[True, True]]))
    assert found == pytest.approx([table[1, 2, 0] + table[0, 1, 1]])


def test_order_of_the_columns_does_not_matter():
    """A set has no order: permuted columns give the same value and permuted costs."""
    rng = np.random.default_rng(4)
    value, surplus, left = drawn(4), rng.normal(30, 20, (5, 7)), rng.integers(1, 12, (5, 7)).astype(float)
    member = rng.random((5, 7)) < 0.7
    p = rng.permutation(7)
    shuffled = [x[:, p] for x in (surplus, left, member)]
    np.testing.assert_allclose(value.value(0, surplus, left, member), value.value(0, *shuffled))
    cost = value.opportunity_cost(0, surplus, left, member)
    np.testing.assert_allclose(value.opportunity_cost(0, *shuffled), cost[:, p])


def test_empty_sets_are_worth_nothing():
    """Nothing waiting has no value, and nothing to lose."""
    none = np.zeros((3, 4), bool)
    assert drawn(0).value(0, np.ones((3, 4)), np.ones((3, 4)), none).tolist() == [0.0, 0.0, 0.0]
    assert not drawn(0).opportunity_cost(0, np.ones((3, 4)), np.ones((3, 4)), none).any()


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.floats(-100, 100))
def test_hats_are_a_partition(x):
    """Hat functions lie in [0, 1], add up to 1, and reproduce x between the outer knots (rounding: 1e-12)."""
    knots = np.array([-3.0, 0.0, 1.0, 7.0])
    h = hats(np.array(x), knots)
    assert h.min() >= 0
    assert h.sum() == pytest.approx(1.0, abs=1e-12)
    assert h @ knots == pytest.approx(np.clip(x, -3, 7), abs=1e-12)


@pytest.mark.parametrize(
    ("knots", "coefficients"),
    [
        (([0.0], KNOTS[1], KNOTS[2]), np.zeros((2, 9))),
        (([5.0, 1.0], KNOTS[1], KNOTS[2]), np.zeros((2, 18))),
        (KNOTS, np.zeros((2, 17))),
        (KNOTS, np.zeros(18)),
    ],
)
def test_what_does_not_fit_is_refused(knots, coefficients):
    """Knots increase, at least two each; coefficients have one column per combination."""
    with pytest.raises(InputError):
        RankedValue(*knots, coefficients)
