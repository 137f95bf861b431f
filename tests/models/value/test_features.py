"""Features of a request on its own: hats of surplus and time, and those of a Gaussian kernel."""

import json
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from optkit.basics.errors import InputError
from optkit.models.value.features import HatFeatures, KernelFeatures, coordinates, features_of, surplus_knots
from optkit.models.value.ranked_term import hats
from optkit.models.value.request_sets import KnownRequests, RequestSets

HAT = HatFeatures(None, np.array([0.0, 50.0]), np.array([1.0, 3.0, 10.0]))
KERNEL = KernelFeatures(
    np.array([1.0, 2.0]), np.array([10.0, 0.5]), np.array([[0.0, 0.0], [1.0, 0.5], [-1.0, 2.0]]), 0.4
)


def some(surplus, expiry):
    """One set at step 0 of requests with these surpluses to a group each, (D, n), and last steps."""
    utility = np.asarray(surplus, dtype=float)
    n = utility.shape[1]
    zeros = np.zeros(n, int)
    requests = KnownRequests(
        np.zeros(n), np.zeros(n), zeros, np.asarray(expiry), utility, np.zeros((n, 0)), zeros, zeros
    )
    return RequestSets(requests, 0, np.arange(n)[None], np.ones((1, n), bool))


def test_hats_by_hand():
    """A surplus of 25 is half of each knot, two steps left are half of 1 and half of 3."""
    found = HAT(some([[25.0, 80.0]], [2, 10]))
    assert found.tolist() == [[[0.25, 0.25, 0.0, 0.25, 0.25, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]]
    assert HAT.size == 6


def test_hats_add_up_to_one(random_sets):
    """Every request counts once in all, wherever it lies (rounding)."""
    np.testing.assert_allclose(HAT(random_sets(3, groups=3)).sum(axis=-1), 1.0, atol=1e-12)


def test_hats_of_a_group():
    """With a group it is that group's surplus, without one the mean."""
    sets = some([[0.0], [50.0]], [1])
    by_group = [HatFeatures(group, HAT.surplus_knots, HAT.time_knots)(sets)[0, 0, [0, 3]].tolist() for group in (0, 1)]
    assert by_group == [[1.0, 0.0], [0.0, 1.0]]
    assert HAT(sets)[0, 0, [0, 3]].tolist() == [0.5, 0.5]


def test_coordinates():
    """Surplus by group, then the logarithm of one plus the steps left; what has expired counts as 0 steps."""
    found = coordinates(some([[3.0, 4.0], [5.0, 6.0]], [7, -4]))
    assert found.tolist() == [[[3.0, 5.0, np.log(8.0)], [4.0, 6.0, 0.0]]]


def test_kernel_features_reproduce_the_kernel():
    """Inner products of features are the kernel wherever one of the two is a landmark (Nystroem; rounding: 1e-10)."""
    at_landmarks = KERNEL.landmarks * KERNEL.scale + KERNEL.center
    steps = np.expm1(at_landmarks[:, 1])
    others = np.array([[30.0, 5.0, -8.0], [9.0, 2.0, 1.0]])  # surplus and steps left

    def kernel(x, y):
        """Gaussian kernel of two requests, from its definition."""
        a, b = (([s, np.log1p(t)] - KERNEL.center) / KERNEL.scale for s, t in (x, y))
        return np.exp(-0.4 * ((a - b) ** 2).sum())

    def features(surplus, left):
        requests = some([surplus], np.zeros(len(surplus), int)).requests
        one = RequestSets(requests, 0, np.arange(len(surplus))[None], np.ones((1, len(surplus)), bool))
        object.__setattr__(one, "steps_left", np.asarray(left, dtype=float)[None])  # landmarks lie between whole steps
        return KERNEL(one)[0]

    z = features(at_landmarks[:, 0], steps)
    x = features(others[0], others[1])
    found = x @ z.T
    expected = [[kernel(a, b) for b in zip(at_landmarks[:, 0], steps, strict=True)] for a in others.T]
    np.testing.assert_allclose(found, expected, atol=1e-10)
    np.testing.assert_allclose((z @ z.T).diagonal(), 1.0, atol=1e-10)
    assert KERNEL.size == 3


def test_the_root_of_the_kernel_does_not_depend_on_the_number_of_threads():
    """A file is read where threads are free, after a training that had one (at 300 landmarks: 5e-5 apart, untamed)."""
    landmarks = np.random.default_rng(0).normal(size=(300, 4))

    def root(threads):
        with threadpool_limits(limits=threads):
            return KernelFeatures(np.zeros(4), np.ones(4), landmarks, 0.2)._root

    np.testing.assert_array_equal(root(1), root(2))


def test_features_are_made_one_at_a_time(monkeypatch):
    """Whoever came second would find one thread of BLAS, and put back that one for the whole process."""
    eigh, inside, most = np.linalg.eigh, [], []

    def slow(matrix):
        inside.append(1)
        most.append(len(inside))
        time.sleep(0.02)
        inside.pop()
        return eigh(matrix)

    monkeypatch.setattr(np.linalg, "eigh", slow)
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda _: KernelFeatures(np.zeros(1), np.ones(1), np.array([[0.0], [1.0]]), 0.2), range(6)))
    assert most == [1] * 6


def test_kernel_features_are_finite_for_padding(random_sets):
    """Padding that expired long ago has finite features, and twin landmarks do no harm."""
    twins = KernelFeatures(np.zeros(2), np.ones(2), np.zeros((2, 2)), 1.0)
    assert np.isfinite(twins(random_sets(5, step=40))).all()


def test_knots_lie_between_the_quantiles():
    """Knots are spread evenly from the 3 to the 97 per cent quantile of the known requests, padding left out."""
    sets = some([np.arange(102.0), np.zeros(102)], np.ones(102, int))
    assert surplus_knots(sets.requests, 3, 0, known=101) == pytest.approx([3.0, 50.0, 97.0])
    assert surplus_knots(sets.requests, 3, None, known=101) == pytest.approx([1.5, 25.0, 48.5])
    assert (np.diff(surplus_knots(sets.requests, 4, 1, known=101)) > 0).all()  # equal surpluses still give knots


@pytest.mark.parametrize(
    "features", [HAT, HatFeatures(1, [0.0, 1.5], [1.0, 2.0]), KERNEL], ids=["mean", "group", "kernel"]
)
def test_plain_data_and_back(random_sets, features):
    """Through JSON and back the features are the same, to the last digit."""
    again = features_of(json.loads(json.dumps(features.to_dict())))
    sets = random_sets(1, groups=1 if features is KERNEL else 2)
    np.testing.assert_array_equal(again(sets), features(sets))


@pytest.mark.parametrize(
    "plain",
    [
        {},
        [],
        "hats",
        {"kind": "spline"},
        {"kind": ["hats"]},
        {"kind": "hats", "group": None},
        {**HAT.to_dict(), "more": 1},
        {**HAT.to_dict(), "group": -1},
        {**HAT.to_dict(), "group": True},
        {**HAT.to_dict(), "group": "a"},
        {**HAT.to_dict(), "time_knots": [1.0, None]},
        {**HAT.to_dict(), "time_knots": [1.0, 10**400]},
        {**KERNEL.to_dict(), "gamma": 0.0},
        {**KERNEL.to_dict(), "gamma": float("inf")},
        {**KERNEL.to_dict(), "gamma": "a"},
        {**KERNEL.to_dict(), "scale": [1.0, 0.0]},
        {**KERNEL.to_dict(), "scale": [1.0]},
        {**KERNEL.to_dict(), "center": [float("nan"), 0.0]},
        {**KERNEL.to_dict(), "landmarks": [[0.0, float("inf")]]},
        {**KERNEL.to_dict(), "landmarks": [0.0, 1.0]},
    ],
)
def test_damaged_plain_data(plain):
    """What are no features is an InputError of one line."""
    with pytest.raises(InputError) as caught:
        features_of(plain)
    assert "\n" not in str(caught.value)


def test_groups_that_do_not_fit(random_sets):
    """Features of other groups than the requests have are an InputError that counts them."""
    with pytest.raises(InputError, match="knows 1 worker groups; these requests have 3"):
        KERNEL(random_sets(0, groups=3))
    with pytest.raises(InputError, match="group 4"):
        HatFeatures(4, HAT.surplus_knots, HAT.time_knots)(random_sets(0, groups=3))


def test_hats_of_the_two_files_agree(random_sets):
    """Features are the products of the hat functions, spelled out one by one (rounding)."""
    sets = random_sets(9, ties=False)
    a, t = hats(sets.mean_surplus, HAT.surplus_knots), hats(sets.steps_left, HAT.time_knots)
    product = np.stack([a[..., i] * t[..., j] for i in range(2) for j in range(3)], axis=-1)
    np.testing.assert_allclose(HAT(sets), product, atol=1e-15)
