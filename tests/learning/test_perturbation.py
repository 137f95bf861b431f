"""Pert(epsilon): vectors between two spheres, uniform, per group, and seeded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from optkit import scenario
from optkit.basics.errors import InputError
from optkit.learning.perturbation import perturb, true_preferences
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.preferences import Preferences

TRUE = {name: true_preferences(scenario(name, seed=0)) for name in ("I.1", "II")}


def moves(before, after):
    """Vectors (dw, dmu) per group."""
    return np.column_stack([after.weights - before.weights, after.scale - before.scale])


def far_from_zero(p=2):
    """One group whose mu is so large that its sign never matters."""
    return Preferences(Attributes(tuple(f"f{i}" for i in range(p - 1))), np.zeros((1, p)), np.array([100.0]))


def test_true_preferences_are_the_worlds_utilities():
    """On every sampled request, w'x is the instance's mean utility of each group, and mu is the scenario's."""
    world = scenario("II", seed=2, mu=1.7)
    true = true_preferences(world)
    for one in world.sample(5, seed=0):
        for d in range(one.n_groups):
            believed = true.utility_of(one.features, one.pickup, one.dropoff, np.array(d))
            np.testing.assert_allclose(believed, one.utility[d] - one.outside_by_group[d], atol=1e-10)
        np.testing.assert_array_equal(true.scale, one.mu)


@settings(max_examples=30, deadline=None)
@given(epsilon=st.floats(0, 6), seed=st.integers(0, 2**32))
def test_lengths_lie_between_the_spheres(epsilon, seed):
    """For any epsilon every group moves by max(0, epsilon - 1) to epsilon, and mu stays positive.

    1e-9 allows for adding the vector to weights near 100 and taking them off again.
    """
    moved = perturb(TRUE["II"], epsilon, seed)
    length = np.linalg.norm(moves(TRUE["II"], moved), axis=1)
    assert (length >= max(0.0, epsilon - 1) - 1e-9).all()
    assert (length <= epsilon + 1e-9).all()
    assert (moved.scale > 0).all()


def test_epsilon_zero_changes_nothing():
    """Pert(0) is the truth."""
    same = perturb(TRUE["II"], 0.0, 0)
    np.testing.assert_array_equal(same.weights, TRUE["II"].weights)
    np.testing.assert_array_equal(same.scale, TRUE["II"].scale)


@pytest.mark.slow
@pytest.mark.parametrize("epsilon", [0.5, 1.0, 2.5])
def test_uniform_in_the_shell(epsilon):
    """radius^d is uniform between its ends (Kolmogorov-Smirnov, p > 0.001); directions have mean 0 and no favourite.

    Each coordinate of a direction has variance 1/d; means and cross products are tested at 5 standard errors.
    """
    base, n = far_from_zero(), 3000
    rng = np.random.default_rng(0)
    delta = np.concatenate([moves(base, perturb(base, epsilon, rng)) for _ in range(n)])
    d = delta.shape[1]
    radius = np.linalg.norm(delta, axis=1)
    low = max(0.0, epsilon - 1) ** d
    assert stats.kstest(radius**d, stats.uniform(low, epsilon**d - low).cdf).pvalue > 0.001
    direction = delta / radius[:, None]
    assert np.abs(direction.mean(axis=0)).max() < 5 / np.sqrt(n * d)
    assert np.abs(direction.T @ direction / n - np.eye(d) / d).max() < 5 / np.sqrt(n) / d
    assert abs(np.corrcoef(radius, direction[:, 0])[0, 1]) < 5 / np.sqrt(n)


def test_only_the_chosen_groups_move():
    """groups= leaves the others as they are, bit by bit; none chosen changes nothing."""
    true = TRUE["II"]
    moved = perturb(true, 3.0, 0, groups=[1])
    length = np.linalg.norm(moves(true, moved), axis=1)
    assert length[1] >= 2.0 - 1e-9
    assert length[[0, 2]].tolist() == [0.0, 0.0]
    assert not moves(true, perturb(true, 3.0, 0, groups=())).any()


def test_mu_stays_positive():
    """A mu of 0.01 moved by up to 6 stays above 0, though half of all directions would end below."""
    base = Preferences(Attributes(()), np.zeros((50, 1)), np.full(50, 0.01))
    moved = perturb(base, 6.0, 0)
    assert (moved.scale > 0).all()
    assert (np.linalg.norm(moves(base, moved), axis=1) >= 5 - 1e-9).all()


def test_seeded_and_pure():
    """The same seed gives the same, another another; the truth is not written to and a generator moves on."""
    true = TRUE["II"]
    before = true.weights.copy()
    one, again, other = (perturb(true, 2.0, s) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.weights, again.weights)
    assert (one.weights != other.weights).all()
    np.testing.assert_array_equal(true.weights, before)
    rng = np.random.default_rng(1)
    first, second = perturb(true, 2.0, rng), perturb(true, 2.0, rng)
    np.testing.assert_array_equal(first.weights, one.weights)
    assert (second.weights != first.weights).all()


def test_groups_move_apart():
    """Groups get vectors of their own."""
    delta = moves(TRUE["II"], perturb(TRUE["II"], 2.0, 0))
    assert np.abs(np.corrcoef(delta) - np.eye(3)).max() < 0.95


def test_perturbed_preferences_are_no_estimates():
    """Standard errors do not survive a perturbation; pooled does."""
    base = Preferences(Attributes(()), np.zeros((1, 1)), np.ones(1), (np.eye(2),), pooled=True)
    moved = perturb(base, 0.5, 0)
    assert moved.covariance == ()
    assert moved.pooled


@pytest.mark.parametrize(
    ("epsilon", "groups", "words"),
    [
        (-0.1, None, "epsilon = -0.1"),
        (np.nan, None, "epsilon = nan"),
        (np.inf, None, "epsilon = inf"),
        (1.0, [3], r"group 3 is unknown; there are 0\.\.2"),
        (1.0, [0, -1], "group -1 is unknown"),
    ],
)
def test_bad_arguments(epsilon, groups, words):
    """A radius out of range or an unknown group is an InputError that names it."""
    with pytest.raises(InputError, match=words):
        perturb(TRUE["II"], epsilon, 0, groups=groups)


def test_a_group_listed_twice_moves_once():
    """groups is a set of groups: [0, 0] is [0]."""
    moved = perturb(TRUE["I.1"], 0.5, 0, groups=[0, 0])
    assert np.linalg.norm(moves(TRUE["I.1"], moved)) <= 0.5 + 1e-9
