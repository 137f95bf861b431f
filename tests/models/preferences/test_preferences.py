"""Beliefs about workers: the delta method, standard errors, and the choice model's protocol."""

from types import SimpleNamespace

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError
from optkit.learning.perturbation import true_preferences
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.preferences import Preferences, from_index
from optkit.policies import PostDecisionPricing, RewardPercentage


def believed(**changes):
    """Two groups, one feature, two pick-ups."""
    given = {
        "attributes": Attributes(("size",), 2, 1),
        "weights": np.array([[-2.0, -1.0, -3.0], [-4.0, 0.0, 1.0]]),
        "scale": np.array([1.0, 2.0]),
        "covariance": (np.diag([0.04, 0.01, 0.09, 1.0]), np.full((4, 4), 0.01)),
    }
    return Preferences(**{**given, **changes})


def states(instances):
    """Every state of a run."""
    seen = []
    simulate(instances, RewardPercentage(0.6), observe=lambda state, offer, taken: seen.append(state))
    return seen


def test_delta_method_by_numerical_differentiation():
    """The covariance is J C J' with the Jacobian taken by central differences (h^2 = 1e-12, so 1e-7 is generous)."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4))
    C, theta = root @ root.T, np.array([-4.0, 1.5, 0.0, 0.7])

    def money(t):
        return np.array([*(t[:-1] / t[-1]), 1 / t[-1]])

    h = 1e-6
    J = np.stack([(money(theta + h * e) - money(theta - h * e)) / (2 * h) for e in np.eye(4)], axis=1)
    w, mu, found = from_index(theta[:-1], theta[-1], C)
    np.testing.assert_allclose([*w, mu], money(theta), rtol=1e-14)
    np.testing.assert_allclose(found, J @ C @ J.T, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(found, found.T, rtol=1e-12)


def test_delta_method_by_simulation():
    """For small errors (1 to 2 %) the covariance is that of 200,000 transformed normal draws, within 3 %.

    The sampling error of a covariance is about sqrt(2 / 2e5) = 0.3 %, what the delta method leaves out about 0.1 %.
    """
    rng = np.random.default_rng(1)
    theta, root = np.array([-4.0, 2.0, 1.5]), 0.02 * np.array([[1.0, 0, 0], [0.5, 1, 0], [-0.3, 0.2, 0.7]])
    drawn = theta + rng.normal(size=(200_000, 3)) @ root.T
    money = np.column_stack([drawn[:, :2] / drawn[:, 2:], 1 / drawn[:, 2]])
    _, _, C = from_index(theta[:2], theta[2], root @ root.T)
    sd = np.sqrt(np.diag(C))
    np.testing.assert_allclose(np.cov(money.T) / np.outer(sd, sd), C / np.outer(sd, sd), atol=0.03)


def test_standard_error_by_hand():
    """x = (size, pick-up 0, pick-up 1): a diagonal covariance adds up by squares, and mu has no part in it."""
    features, pickup = np.array([[3.0], [0.0]]), np.array([0, 1])
    found = believed().standard_error(features, pickup, np.zeros(2, int), 0)
    np.testing.assert_allclose(found, [np.sqrt(9 * 0.04 + 0.01), 0.3])
    found = believed().standard_error(features, pickup, np.zeros(2, int), 1)
    np.testing.assert_allclose(found, [0.1 * (3 + 1), 0.1])


def test_utility_by_hand():
    """Utilities are w'x of the worker's group; pooled preferences give every group the one model."""
    features, pickup, group = np.array([[3.0], [2.0]]), np.array([0, 1]), np.array([0, 1])
    at = (features, pickup, np.zeros(2, int))
    np.testing.assert_allclose(believed().utility_of(*at, group), [-7.0, -7.0])
    one = believed(weights=np.array([[-2.0, -1.0, -3.0]]), scale=np.ones(1), covariance=(), pooled=True)
    np.testing.assert_allclose(one.utility_of(*at, np.array([4, 9])), [-7.0, -7.0])
    np.testing.assert_allclose(one.model_of(np.array([4, 9])), [0, 0])


def test_table_by_hand():
    """One row per model and parameter, mu last; without covariance the standard errors are NaN."""
    table = believed().table()
    assert table["parameter"].tolist() == 2 * ["size", "pickup_0", "pickup_1", "mu"]
    assert table["group"].tolist() == 4 * [0] + 4 * [1]
    np.testing.assert_allclose(table["estimate"], [-2, -1, -3, 1, -4, 0, 1, 2])
    np.testing.assert_allclose(table["standard_error"], [0.2, 0.1, 0.3, 1, 0.1, 0.1, 0.1, 0.1])
    assert believed(covariance=()).table()["standard_error"].isna().all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"weights": np.ones((2, 2))}, "do not fit 3 columns"),
        ({"scale": np.ones(3)}, "do not fit"),
        ({"scale": np.array([1.0, 0.0])}, "every mu positive"),
        ({"weights": np.full((2, 3), np.nan)}, "finite"),
        ({"group_names": ("x", "x")}, "'x' is there twice"),
        ({"group_names": (None, "x")}, "is no name"),
        ({"covariance": (np.diag([1.0, 1.0, 1.0, -1.0]),) * 2}, "negative variance"),
        ({"covariance": (np.eye(4) + 5 * np.eye(4)[::-1],) * 2}, "negative variance"),  # in a direction between two
        ({"covariance": (np.eye(4) + 0.1 * np.eye(4, k=1),) * 2}, "transpose"),
    ],
)
def test_what_preferences_refuse(changes, words):
    """Weights of another width, a mu that is not positive and NaN are InputErrors."""
    with pytest.raises(InputError, match=words):
        believed(**changes)


def test_unknown_group_and_missing_covariance():
    """A group beyond the models is named; preferences that are no estimates have no standard errors."""
    with pytest.raises(InputError, match=r"group 2 is unknown; there are 0\.\.1"):
        believed().model_of(np.array([0, 2]))
    with pytest.raises(InputError, match="no estimates"):
        believed(covariance=()).standard_error(np.ones((1, 1)), np.zeros(1, int), np.zeros(1, int), 0)


def test_a_negative_group_is_unknown():
    """Group -1 is no group."""
    with pytest.raises(InputError, match="-1 is unknown"):
        believed().model_of(np.array([-1]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["I.1", "II"])
def test_true_weights_price_as_the_truth_does(name):
    """On every state of a run, padding included, preferences built from the true weights give the true prices.

    Both sides add up the same 14 products in another order: 1e-9 of amounts near 100 allows for that.
    """
    world = scenario(name, seed=3)
    truth, belief = PostDecisionPricing(), PostDecisionPricing(choice=true_preferences(world))
    padded = 0
    for state in states(world.sample(12, seed=0)):
        c, d = truth(state), belief(state)
        np.testing.assert_allclose(d[state.offered], c[state.offered], rtol=0, atol=1e-9)
        assert np.isfinite(d).all()
        padded += int((~state.offered).sum())
    assert padded > 50  # otherwise the claim about padding is empty
    runs = [simulate(world.sample(12, seed=1), policy) for policy in (truth, belief)]
    np.testing.assert_array_equal(runs[0].accepted, runs[1].accepted)
    np.testing.assert_allclose(runs[0].reward, runs[1].reward, atol=1e-7)


def test_pooled_preferences_price_all_groups_alike():
    """One model for all: a state's prices do not depend on the worker's group, nor on how many groups there are."""
    world = scenario("II", seed=3)
    own = true_preferences(world)
    pooled = Preferences(own.attributes, own.weights[:1], own.scale[:1], pooled=True)
    for state in states(world.sample(4, seed=0)):
        first = SimpleNamespace(**{n: getattr(state, n) for n in ("offered", "features", "pickup", "dropoff")})
        first.group = np.zeros_like(state.group)
        np.testing.assert_array_equal(pooled.utility(state), own.utility(first))
        np.testing.assert_array_equal(pooled.mu(state), own.mu(first))
        assert not pooled.outside_utility(state).any()


def test_padding_may_hold_anything():
    """Locations that the preferences do not know do no harm where nothing is offered."""
    state = SimpleNamespace(
        offered=np.array([[True, False]]),
        features=np.array([[[3.0], [0.0]]]),
        pickup=np.array([[1, 77]]),
        dropoff=np.array([[0, -5]]),
        group=np.array([1]),
    )
    np.testing.assert_allclose(believed().utility(state)[0, 0], -4 * 3 + 1)


def test_features_called_by_numbers_go_by_name():
    """feature_0, feature_1, ... in this order are no names; in another they are."""
    swapped = Preferences(Attributes(("feature_1", "feature_0")), np.array([[-1.0, -5.0, 0.0]]), np.array([1.0]))
    assert swapped.called(None, ("feature_0", "feature_1")).weights.tolist() == [[-5.0, -1.0, 0.0]]
    plain = Preferences(Attributes(("feature_0", "feature_1")), np.array([[-1.0, -5.0, 0.0]]), np.array([1.0]))
    assert plain.called(None, ("km", "size")) is plain
    with pytest.raises(InputError, match="'a' is there twice"):
        Attributes(("a", "a"))
