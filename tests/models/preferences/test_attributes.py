"""The columns of the regressor: by hand, at the edges, and what they refuse."""

import numpy as np
import pytest

from optkit.basics.errors import InputError, OptkitError
from optkit.models.preferences.attributes import Attributes


def test_columns_and_matrix_by_hand():
    """Two features, three pick-ups and two drop-offs make the matrix that one writes down, drop-off 0 left out."""
    attributes = Attributes(("size", "time"), pickups=3, dropoffs=2)
    assert attributes.columns == ("size", "time", "pickup_0", "pickup_1", "pickup_2", "dropoff_1")
    x = attributes.matrix(np.array([[0.5, 2.0], [0.1, 7.0], [0.0, 1.0]]), np.array([2, 0, 1]), np.array([0, 1, 1]))
    np.testing.assert_array_equal(x, [[0.5, 2, 0, 0, 1, 0], [0.1, 7, 1, 0, 0, 1], [0.0, 1, 0, 1, 0, 1]])


def test_without_a_reference_every_dropoff_has_a_column():
    """The true weights of a world know all drop-offs, so both kinds of indicator add up to 1."""
    attributes = Attributes((), pickups=2, dropoffs=2, reference=False)
    assert attributes.columns == ("pickup_0", "pickup_1", "dropoff_0", "dropoff_1")
    x = attributes.matrix(np.empty((2, 0)), np.array([1, 0]), np.array([0, 1]))
    np.testing.assert_array_equal(x, [[0, 1, 1, 0], [1, 0, 0, 1]])


def test_one_location_is_the_constant():
    """With one pick-up and one drop-off there is a constant and nothing else beside the features."""
    attributes = Attributes(("a",))
    assert attributes.columns == ("a", "constant")
    x = attributes.matrix(np.array([[3.0], [4.0]]), np.zeros(2, int), np.zeros(2, int))
    np.testing.assert_array_equal(x, [[3, 1], [4, 1]])


@pytest.mark.parametrize("reference", [True, False])
def test_any_leading_shape_and_the_count_of_columns(reference):
    """A (2, 3) array of requests gives the rows of the flat one, and the last axis is as long as the columns."""
    rng = np.random.default_rng(0)
    attributes = Attributes(("a", "b"), 4, 5, reference)
    features, pickup, dropoff = rng.normal(size=(2, 3, 2)), rng.integers(4, size=(2, 3)), rng.integers(5, size=(2, 3))
    x = attributes.matrix(features, pickup, dropoff)
    assert x.shape == (2, 3, len(attributes.columns))
    flat = attributes.matrix(features.reshape(6, 2), pickup.ravel(), dropoff.ravel())
    np.testing.assert_array_equal(x.reshape(6, -1), flat)
    np.testing.assert_array_equal(x[..., 2:6].sum(-1), 1)
    np.testing.assert_array_equal(x[..., 6:].sum(-1), (dropoff > 0) if reference else np.ones((2, 3)))


def test_no_requests_at_all():
    """Zero requests give zero rows."""
    assert Attributes(("a",), 2, 2).matrix(np.empty((0, 1)), np.zeros(0, int), np.zeros(0, int)).shape == (0, 4)


@pytest.mark.parametrize(
    ("features", "pickup", "dropoff", "words"),
    [
        (np.ones((1, 2)), [0], [0], "2 features; the preferences know 1"),
        (np.ones((1, 1)), [3], [0], "pickup 3 is unknown; the preferences know 0..2"),
        (np.ones((1, 1)), [0], [2], "dropoff 2 is unknown; the preferences know 0..1"),
        (np.ones((1, 1)), [-1], [0], "pickup -1 is unknown"),
    ],
)
def test_what_is_unknown_is_named(features, pickup, dropoff, words):
    """A location or a number of features that the attributes do not know is one line of our tree that names it."""
    with pytest.raises(InputError, match=words) as caught:
        Attributes(("a",), 3, 2).matrix(features, np.array(pickup), np.array(dropoff))
    assert isinstance(caught.value, OptkitError)
    assert "\n" not in str(caught.value)


def test_a_negative_location_among_good_ones_is_the_one_named():
    """The message names the location that is unknown, not the largest."""
    with pytest.raises(InputError, match="pickup -1 is unknown"):
        Attributes((), 3, 1).matrix(np.empty((2, 0)), np.array([-1, 2]), np.zeros(2, int))
