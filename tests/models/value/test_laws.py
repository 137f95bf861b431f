"""Laws of every value function: what is found at once, for all forms alike; what is special is tested with its form."""

import copy
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone

from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.catalogue import value_of
from optkit.models.value.mean import MeanValue
from optkit.models.value.request_sets import ZeroSetValue, costs_without, removal_differences

FITTED = {
    "linear": LinearValue(),
    "linear, settings of numpy": LinearValue(surplus_knots=np.int64(3), time_knots=np.array([1.0, 4.0])),
    "linear by group": LinearValue(by_group=True),
    "linear busy": LinearValue(busy_knots=(0.0, 3.0, 10.0)),
    "kernel": KernelValue(landmarks=5),
    "kernel, gamma given": KernelValue(landmarks=5, gamma=0.3),
    "kernel busy": KernelValue(landmarks=5, busy_knots=(0.0, 3.0, 10.0)),
    "mean": MeanValue([LinearValue(), KernelValue(landmarks=5)]),
}
"""Value functions that are fitted, and have files; the network's laws, in single precision, are with the network."""


@pytest.fixture(scope="module", params=[1, 3], ids=["1 group", "3 groups"])
def groups(request):
    """Number of worker groups."""
    return request.param


@pytest.fixture(scope="module", params=[*FITTED, "zero"])
def value(request, drawn, groups):
    """Each value function, fitted to drawn experience."""
    if request.param == "zero":
        return ZeroSetValue()
    return copy.deepcopy(FITTED[request.param]).fit(drawn(groups=groups))


@pytest.fixture
def sets(random_sets, groups):
    """Draw sets with and without ties."""
    return [random_sets(seed, 7, 8, groups, ties=bool(seed % 2)) for seed in range(4)]


@pytest.mark.slow
def test_opportunity_costs_are_removal_differences(value, sets):
    """All removals at once are the differences of values of sets evaluated one by one (rounding: 1e-8 money)."""
    for one in sets:
        cost = value.opportunity_cost(one)
        np.testing.assert_allclose(cost, removal_differences(value.value, one), atol=1e-8)
        assert isinstance(value, ZeroSetValue) or np.abs(cost).max() > 0.1
        assert not cost[~one.member].any()


def test_what_is_left_costs_what_it_does_as_a_set_of_its_own(value, sets):
    """Costs in sets that lack a request, the quick way and by evaluating the smaller sets (rounding: 1e-8 money)."""
    for one in sets:
        row, column = (x.ravel() for x in np.indices(one.member.shape))  # to lack padding changes nothing
        slow = value.opportunity_cost(one.without(row, column))
        np.testing.assert_allclose(costs_without(value, one, row, column), slow, atol=1e-8)


@pytest.mark.slow
def test_the_order_of_the_columns_does_not_matter(value, sets):
    """Prices do not depend on how a set is written down, ties or not (rounding: 1e-8 money)."""
    for one in sets:
        p = np.random.default_rng(0).permutation(8)
        shuffled = replace(one, index=one.index[:, p], member=one.member[:, p])
        np.testing.assert_allclose(value.value(shuffled), value.value(one), atol=1e-8)
        np.testing.assert_allclose(value.opportunity_cost(shuffled), value.opportunity_cost(one)[:, p], atol=1e-8)


def test_padding_is_ignored(value, sets):
    """Whatever stands where nothing is a member, values and costs are the same to the bit."""
    for one in sets:
        other = replace(one, index=np.where(one.member, one.index, 0))
        np.testing.assert_array_equal(value.value(other), value.value(one))
        np.testing.assert_array_equal(value.opportunity_cost(other), value.opportunity_cost(one))


def test_empty_sets_are_worth_nothing(value, sets):
    """A value counts from that of the empty set."""
    nobody = replace(sets[0], member=np.zeros_like(sets[0].member))
    assert not value.value(nobody).any()
    assert not value.opportunity_cost(nobody).any()


@pytest.mark.slow
def test_copies_and_files_price_as_it_did(value, sets):
    """Through pickle, copy and JSON, settings, values and costs are the same to the last digit."""
    again = [pickle.loads(pickle.dumps(value)), copy.deepcopy(value)]
    if not isinstance(value, ZeroSetValue):
        again.append(value_of(json.loads(json.dumps(value.to_dict()))))
        for one in again:
            assert one.to_dict() == value.to_dict()
        assert not hasattr(clone(value), "coef_")
    for one in again:
        for some in sets:
            np.testing.assert_array_equal(one.value(some), value.value(some))
            np.testing.assert_array_equal(one.opportunity_cost(some), value.opportunity_cost(some))
