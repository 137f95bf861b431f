"""One term of a value function: requests count by rank, and all removals at once follow from one sum."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.basics.errors import InputError
from optkit.models.value.features import HatFeatures, KernelFeatures
from optkit.models.value.ranked_term import RankedTerm, hats
from optkit.models.value.request_sets import KnownRequests, RequestSets, removal_differences

SURPLUS, TIME, RANK = np.array([0.0, 50.0]), np.array([1.0, 3.0, 10.0]), np.array([0.0, 1.0, 4.0])
BUSY = np.array([0.0, 2.0, 9.0])


def term(kind, groups):
    """A term of each kind that the estimators use."""
    if kind == "kernel":
        landmarks = np.random.default_rng(0).normal(size=(4, groups + 1))
        return RankedTerm(
            KernelFeatures(np.full(groups + 1, 2.0), np.full(groups + 1, 9.0), landmarks, 0.3), "surplus", RANK
        )
    group, order = {"group": (groups - 1, groups - 1), "urgency": (None, "urgency")}.get(kind, (None, "surplus"))
    return RankedTerm(HatFeatures(group, SURPLUS, TIME), order, RANK, BUSY if kind == "busy" else None)


LIGHT = ["surplus", "group", "urgency", "busy"]
KINDS = st.sampled_from([*LIGHT, "kernel"])


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(KINDS, st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 9), st.sampled_from([1, 3]), st.booleans())
def test_opportunity_costs_are_differences_of_values(random_sets, kind, seed, b, w, groups, ties):
    """All removals at once equal the value with less the value without, request by request (rounding: 1e-10)."""
    one, sets = term(kind, groups), random_sets(seed, b, w, groups, ties=ties)
    theta = np.random.default_rng(seed).normal(size=one.size)
    expected = removal_differences(lambda s: one.value(s, theta), sets)
    np.testing.assert_allclose(one.opportunity_cost(sets, theta), expected, atol=1e-10)


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(KINDS, st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 9), st.sampled_from([1, 3]), st.booleans())
def test_opportunity_costs_without_each_request(random_sets, kind, seed, b, w, groups, ties):
    """What is left of a set costs what it does as a set of its own; padding leaves nothing less (rounding: 1e-10)."""
    one, sets = term(kind, groups), random_sets(seed, b, w, groups, ties=ties)
    theta = np.random.default_rng(seed).normal(size=one.size)
    row, column = (x.ravel() for x in np.indices(sets.member.shape))
    cost = one.opportunity_cost_without(sets, row, column, theta)
    np.testing.assert_allclose(cost, one.opportunity_cost(sets.without(row, column), theta), atol=1e-10)


@pytest.mark.slow
@settings(max_examples=30, deadline=None, derandomize=True)
@given(KINDS, st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 9), st.sampled_from([1, 3]))
def test_all_is_linear_in_the_coefficients(random_sets, kind, seed, b, w, groups):
    """Regressors times coefficients are the value and the opportunity cost (rounding: 1e-10)."""
    one, sets = term(kind, groups), random_sets(seed, b, w, groups)
    theta = np.random.default_rng(seed).normal(size=one.size)
    np.testing.assert_allclose(one.basis(sets) @ theta, one.value(sets, theta), atol=1e-10)
    np.testing.assert_allclose(one.differences(sets) @ theta, one.opportunity_cost(sets, theta), atol=1e-10)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.sampled_from(LIGHT), st.integers(0, 10**6), st.sampled_from([1, 3]), st.booleans())
def test_order_of_the_columns_does_not_matter(random_sets, kind, seed, groups, ties):
    """A set has no order: permuted columns give the same value and permuted costs, with ties too (rounding: 1e-10)."""
    one, sets = term(kind, groups), random_sets(seed, 4, 8, groups, ties=ties)
    theta = np.random.default_rng(seed).normal(size=one.size)
    p = np.random.default_rng(seed + 1).permutation(8)
    shuffled = replace(sets, index=sets.index[:, p], member=sets.member[:, p])
    np.testing.assert_allclose(one.value(shuffled, theta), one.value(sets, theta), atol=1e-10)
    cost = one.opportunity_cost(sets, theta)
    np.testing.assert_allclose(one.opportunity_cost(shuffled, theta), cost[:, p], atol=1e-10)


@pytest.mark.parametrize("kind", [*LIGHT, "kernel"])
def test_padding_is_ignored(random_sets, kind):
    """Whatever stands in the padding, values and costs stay the same, and padding costs nothing."""
    one, sets = term(kind, 3), random_sets(7, 4, 8, 3)
    theta = np.random.default_rng(7).normal(size=one.size)
    other = np.where(sets.member, sets.index, np.random.default_rng(8).integers(0, 32, sets.index.shape))
    assert (other != sets.index).any()
    changed = replace(sets, index=other)
    np.testing.assert_array_equal(one.value(changed, theta), one.value(sets, theta))
    cost = one.opportunity_cost(sets, theta)
    np.testing.assert_array_equal(one.opportunity_cost(changed, theta), cost)
    assert not cost[~sets.member].any()
    assert not one.differences(sets)[~sets.member].any()


def two_requests():
    """A better request with 10 steps left at surplus 50, and one with 3 at surplus 0: all on knots."""
    zeros = np.zeros(3, int)
    requests = KnownRequests(
        reward=np.array([0.0, 50.0, 0.0]),
        penalty=np.zeros(3),
        arrival=zeros,
        expiry=np.array([3, 10, 0]),
        utility=np.zeros((1, 3)),
        features=np.zeros((3, 0)),
        pickup=zeros,
        dropoff=zeros,
    )
    return RequestSets(requests, 0, np.array([[0, 1]]), np.array([[True, True]]))


def test_value_by_hand():
    """Two requests on knots: the better has rank 0, the other rank 1, each takes one coefficient."""
    theta = np.arange(18.0) ** 2
    table = theta.reshape(2, 3, 3)  # surplus, steps left, rank
    one, sets = term("surplus", 1), two_requests()
    assert one.value(sets, theta).tolist() == [table[1, 2, 0] + table[0, 1, 1]]
    # Without the better one the other moves up to rank 0.
    costs = [table[0, 1, 1], table[1, 2, 0] + table[0, 1, 1] - table[0, 1, 0]]
    assert one.opportunity_cost(sets, theta).tolist() == [costs]
    basis = np.zeros((2, 3, 3))
    basis[1, 2, 0] = basis[0, 1, 1] = 1.0
    assert one.basis(sets).tolist() == [basis.ravel().tolist()]


def test_urgency_turns_the_ranks_around():
    """By urgency the request with fewer steps left comes first."""
    theta = np.arange(18.0) ** 2
    table = theta.reshape(2, 3, 3)
    assert term("urgency", 1).value(two_requests(), theta).tolist() == [table[1, 2, 1] + table[0, 1, 0]]


def test_a_group_ranks_by_its_own_surplus():
    """What group 1 likes comes first in the order of group 1, whatever the mean says."""
    sets = two_requests()
    liked = replace(sets.requests, utility=np.array([[0.0, 0.0, 0.0], [50.0, -50.0, 0.0]]))
    theta = np.arange(18.0) ** 2
    table = theta.reshape(2, 3, 3)
    one = RankedTerm(HatFeatures(1, SURPLUS, TIME), 1, RANK)
    assert one.value(replace(sets, requests=liked), theta).tolist() == [table[1, 1, 0] + table[0, 2, 1]]


def test_busy_stretches_mix_the_coefficients():
    """Theta is interpolated in the busy stretch: at knots 0, 2 and 9 stand tables of their own."""
    one, theta = term("busy", 1), np.random.default_rng(0).normal(size=54)
    plain, tables = term("surplus", 1), theta.reshape(3, 18)
    for busy, mixed in ((0, tables[0]), (1, (tables[0] + tables[1]) / 2), (2, tables[1]), (30, tables[2])):
        sets = replace(two_requests(), busy=np.array([busy]))
        np.testing.assert_allclose(one.value(sets, theta), plain.value(sets, mixed), atol=1e-12)
        np.testing.assert_allclose(one.opportunity_cost(sets, theta), plain.opportunity_cost(sets, mixed), atol=1e-12)


def test_a_busy_stretch_that_nobody_tells():
    """A term that needs the busy stretch says so if it is not given one."""
    with pytest.raises(InputError, match="pass busy"):
        term("busy", 1).value(two_requests(), np.zeros(54))


def test_empty_sets_are_worth_nothing(random_sets):
    """Nothing waiting has no value, and nothing to lose."""
    sets = random_sets(0)
    none = replace(sets, member=np.zeros_like(sets.member))
    one, theta = term("surplus", 1), np.ones(18)
    assert one.value(none, theta).tolist() == [0.0, 0.0, 0.0]
    assert not one.opportunity_cost(none, theta).any()
    assert not one.differences(none).any()
    assert not one.basis(none).any()


def test_sets_wider_than_any_knot():
    """Three hundred requests: those far down the ranks count like the last knot, at any width of the row."""
    N = 300
    zeros = np.zeros(N + 1, int)
    requests = KnownRequests(
        np.arange(N + 1.0), np.zeros(N + 1), zeros, zeros + 5, np.zeros((1, N + 1)), np.zeros((N + 1, 0)), zeros, zeros
    )
    one = RankedTerm(HatFeatures(None, SURPLUS, TIME), "surplus", np.array([0.0, 260.0, 280.0]))
    sets = RequestSets(requests, 0, np.arange(N)[None], np.ones((1, N), bool))
    theta = np.zeros((6, 3))
    theta[:, 2] = 1.0  # counts only those behind 260 others
    expected = np.interp(np.arange(N), [0, 260, 280], [0, 0, 1]).sum()
    assert one.value(sets, theta.ravel())[0] == pytest.approx(expected, abs=1e-10)
    few = RequestSets(requests, 0, np.arange(9)[None], np.ones((1, 9), bool))
    assert one.value(few, theta.ravel())[0] == 0.0


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.floats(-100, 100))
def test_hats_are_a_partition(x):
    """Hat functions lie in [0, 1], add up to 1, and reproduce x between the outer knots (rounding: 1e-12)."""
    knots = np.array([-3.0, 0.0, 1.0, 7.0])
    h = hats(np.array(x), knots)
    assert h.min() >= 0
    assert h.sum() == pytest.approx(1.0, abs=1e-12)
    assert h @ knots == pytest.approx(np.clip(x, -3, 7), abs=1e-12)


def test_hats_are_one_at_their_knots():
    """At a knot its own hat function is 1 and all others are 0."""
    knots = np.array([-3.0, 0.0, 1.0, 7.0])
    np.testing.assert_array_equal(hats(knots, knots), np.eye(4))


@pytest.mark.parametrize("rank_knots", [[0.0], [4.0, 1.0], [0.0, 0.0, 1.0], [0.0, np.nan], [[0.0, 1.0]], [0.0, np.inf]])
def test_knots_increase(rank_knots):
    """Knots are at least two finite numbers, each larger than the one before."""
    with pytest.raises(InputError, match=r"rank_knots.* (must be at least two increasing|finite|has shape)"):
        RankedTerm(HatFeatures(None, SURPLUS, TIME), "surplus", rank_knots)
    with pytest.raises(InputError, match=r"busy_knots.* (must be at least two increasing|finite|has shape)"):
        RankedTerm(HatFeatures(None, SURPLUS, TIME), "surplus", RANK, rank_knots)


@pytest.mark.parametrize("order", ["reward", -1, True, None, 0.0])
def test_unknown_orders_are_refused(order):
    """An order is "surplus", "urgency" or the number of a group."""
    with pytest.raises(InputError, match="order"):
        RankedTerm(HatFeatures(None, SURPLUS, TIME), order, RANK)


def test_a_group_that_is_not_there(random_sets):
    """Requests without the group that ranks them are an InputError, not an IndexError."""
    one = RankedTerm(HatFeatures(None, SURPLUS, TIME), 2, RANK)
    with pytest.raises(InputError, match="group 2"):
        one.value(random_sets(0), np.zeros(18))
