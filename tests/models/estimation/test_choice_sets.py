"""Ragged choice sets: sums, shares, and the reading of labels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.models.estimation.choices import ChoiceSets, sort_rows
from optkit.models.estimation.situations import situation_of
from optkit.models.rows import Rows

pytestmark = pytest.mark.filterwarnings("error")

bounded = settings(derandomize=True, deadline=None, max_examples=30)
ragged = st.lists(st.integers(1, 8), min_size=1, max_size=20)


@bounded
@given(ragged, st.integers(0, 2**32 - 1))
def test_sums_and_maxima_are_those_of_a_loop_over_the_situations(sizes, seed):
    sets = ChoiceSets.of_sizes(sizes)
    x = np.random.default_rng(seed).normal(size=(sum(sizes), 3))
    parts = np.split(x, np.cumsum(sizes)[:-1])
    # 1e-14: sums of at most eight numbers of order 1, perhaps in another order.
    assert sets.sum(x) == pytest.approx(np.array([part.sum(axis=0) for part in parts]), abs=1e-14)
    assert (sets.max(x[:, 0]) == [part[:, 0].max() for part in parts]).all()
    assert (sets.situation == np.repeat(np.arange(len(sizes)), sizes)).all()
    assert len(sets) == len(sizes)


@bounded
@given(ragged, st.booleans(), st.floats(-5, 6), st.integers(0, 2**32 - 1))
def test_shares_are_a_softmax_at_any_scale(sizes, outside, log_scale, seed):
    sets = ChoiceSets.of_sizes(sizes)
    index = np.random.default_rng(seed).normal(size=sum(sizes)) * 10.0**log_scale
    share, inclusive = sets.shares(index, outside)
    for s, part in enumerate(np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])):
        every = np.append(index[part], 0.0) if outside else index[part]
        weight = np.exp(every - every.max())
        # 1e-13 and 1e-15 relative: the exponents round alike, up to one operation on numbers of order 1.
        assert share[part] == pytest.approx((weight / weight.sum())[: len(part)], rel=1e-13)
        assert inclusive[s] == pytest.approx(every.max() + np.log(weight.sum()), rel=1e-14, abs=1e-15)
    assert (sets.sum(share) <= 1 + 1e-14).all()


def test_a_small_share_beside_the_outside_option_keeps_its_digits():
    """log(1 + e^-40) is 4e-18, which a plain log of 1 + 4e-18 would round to 0."""
    share, inclusive = ChoiceSets.of_sizes([1]).shares(np.array([-40.0]), outside=True)
    assert inclusive[0] == pytest.approx(np.exp(-40), rel=1e-14)
    assert share[0] == pytest.approx(np.exp(-40), rel=1e-14)


def test_rows_of_a_situation_are_brought_together_in_their_own_order():
    codes, labels = situation_of(["b", "a", "b", "c", "a"], Rows(5))
    assert list(labels) == ["b", "a", "c"]
    rows, sets, kept = sort_rows(codes, 3, np.array([True, True, True, False, True]))
    assert rows.tolist() == [0, 2, 1, 4]
    assert sets.sizes.tolist() == [2, 2]
    assert kept.tolist() == [True, True, False]


@pytest.mark.parametrize("form", [list, tuple, np.array])
def test_labels_may_be_anything_hashable(form):
    for labels in ([3, 1, 3], ["x", "y", "x"], [2.5, 1.0, 2.5]):
        codes, _ = situation_of(form(labels), Rows(3))
        assert codes.tolist() == [0, 1, 0]
    codes, found = situation_of([(1, "a"), (1, "b"), (1, "a")], Rows(3))
    assert codes.tolist() == [0, 1, 0]
    assert list(found) == [(1, "a"), (1, "b")]
