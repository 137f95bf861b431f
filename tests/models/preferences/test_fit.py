"""From offers to preferences: recovery, coverage, groups, penalties, the paper's way, and data that cannot tell."""

import warnings
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.models.estimation import ConditionalLogit, EstimationWarning, NotIdentifiedError
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.fit import fit_preferences, utility_errors
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences, from_index

W, MU = np.array([-2.0, 1.0, -3.0]), 1.5  # two features and the constant


def simulated(seed, n=1000, *, w=W, mu=MU, sets=(1, 5), pay=(0.0, 9.0), group=0, start=0):
    """n fresh workers, each before 1 to 4 offers (``sets``) with pay uniform in a range, choosing as the model says."""
    rng = np.random.default_rng(seed)
    size = rng.integers(*sets, n)
    situation = np.repeat(np.arange(n), size)
    features = rng.normal(size=(situation.size, len(w) - 1))
    c = rng.uniform(*pay, situation.size)
    # Gumbel noise of scale mu; a common shift of all alternatives changes no choice.
    u = features @ w[:-1] + w[-1] + c + rng.gumbel(0, mu, situation.size)
    best = np.maximum.reduceat(u, np.cumsum(size) - size)
    chosen = (u == best[situation]) & (best > rng.gumbel(0, mu, n))[situation]
    zero = np.zeros(situation.size, int)
    return Offers(situation + start, zero + group, features, zero, zero, c, chosen)


def estimate(found, model=0):
    """(w, mu) and standard errors of one model."""
    return np.array([*found.weights[model], found.scale[model]]), np.sqrt(np.diag(found.covariance[model]))


def log_likelihood(offers, w, mu):
    """Recomputed from the definition, one situation at a time."""
    total = 0.0
    for s in np.unique(offers.situation):
        own = offers.situation == s
        index = np.append((offers.features[own] @ w[:-1] + w[-1] + offers.compensation[own]) / mu, 0.0)
        taken = np.flatnonzero(np.append(offers.chosen[own], 1 - offers.chosen[own].sum()))[0]
        total += index[taken] - np.log(np.exp(index).sum())
    return total


def test_recovers_weights_and_scale():
    """With 5,000 workers, w and mu lie within 4 standard errors of the truth, and these are small."""
    found, error = estimate(fit_preferences(simulated(0, 5000)))
    assert (error < 0.12).all()
    assert (np.abs(found - [*W, MU]) < 4 * error).all()


def test_is_the_maximum_of_the_likelihood_by_hand():
    """The likelihood, recomputed situation by situation, is the fit's own, and any step away lowers it."""
    offers = simulated(1, 150)
    fitted = fit_preferences(offers)
    w, mu = fitted.weights[0], fitted.scale[0]
    best = log_likelihood(offers, w, mu)
    assert best == pytest.approx(fitted.results[0].llf, abs=1e-9)
    for step in 0.02 * np.vstack([np.eye(4), -np.eye(4)]):
        assert log_likelihood(offers, w + step[:-1], mu + step[-1]) < best


@pytest.mark.slow
def test_standard_errors_cover():
    """Over 200 draws of fresh workers, (estimate - truth) / standard error has mean near 0 and deviation near 1.

    The deviation of 200 normal draws has a standard error of 0.05, the mean one of 0.07; four of each, and 0.05 more
    for the mean, because mu = 1/b is a little skewed at 600 workers. Robust ones are the sandwich carried over, below,
    and the sandwich covers by the test of the conditional logit.
    """
    z = []
    for seed in range(200):
        found, error = estimate(fit_preferences(simulated([7, seed], 600)))
        z.append((found - [*W, MU]) / error)
    assert np.abs(np.std(z, axis=0) - 1).max() < 0.2
    assert np.abs(np.mean(z, axis=0)).max() < 0.33


def test_robust_is_the_sandwich_carried_over_by_the_delta_method():
    """robust=True: H^-1 (sum of s s') H^-1 of theta, from the model's own scores, then the Jacobian of (w, mu).

    n / (n - 1) and the like would differ by 1 / 300; 1e-8 excludes them. Without robust it is H^-1 alone.
    """
    offers = simulated(12, 300)
    for robust in (False, True):
        found = fit_preferences(offers, robust=robust)
        theta = np.asarray(found.results[0].params)
        model = found.results[0].model
        bread, scores = np.linalg.inv(model.information(theta)), model.score_obs(theta)
        C = bread @ scores.T @ scores @ bread if robust else bread
        np.testing.assert_allclose(found.covariance[0], from_index(theta[:-1], theta[-1], C)[2], rtol=1e-8, atol=1e-12)


def two_groups():
    """Group 1 is twice as noisy and likes the second feature less."""
    return Offers.join([simulated(2, 4000), simulated(3, 4000, w=np.array([-2.0, -1.0, -3.0]), mu=3.0, group=1)])


def test_two_groups_have_their_own_scale():
    """Each group's w and mu are within 4 standard errors of its own truth, and equal to a fit on its rows alone."""
    offers = two_groups()
    found = fit_preferences(offers)
    for g, truth in enumerate(([-2, 1, -3, 1.5], [-2, -1, -3, 3.0])):
        value, error = estimate(found, g)
        assert (np.abs(value - truth) < 4 * error).all()
        own = offers.take(offers.group == g)
        alone = fit_preferences(replace(own, group=np.zeros(len(own), int)))
        np.testing.assert_allclose(found.weights[g], alone.weights[0], rtol=1e-8)
    assert not found.pooled


def test_pooled_is_one_model_for_all():
    """pooled=True fits all rows as if they were of one group; the noisier group pulls mu between the two."""
    offers = two_groups()
    pooled = fit_preferences(offers, pooled=True)
    assert pooled.pooled
    assert pooled.weights.shape == (1, 3)
    assert 1.5 < pooled.scale[0] < 3.0
    blind = fit_preferences(replace(offers, group=np.zeros(len(offers), int)))
    np.testing.assert_array_equal(pooled.weights, blind.weights)
    np.testing.assert_array_equal(pooled.model_of(np.array([0, 1, 5])), 0)


def test_rows_may_come_in_any_order():
    """Shuffled rows and other numbers for situations give the same estimate, up to the order of sums."""
    offers = simulated(4, 500)
    order = np.random.default_rng(0).permutation(len(offers))
    mixed = replace(offers, situation=1000 - 3 * offers.situation).take(order)
    np.testing.assert_allclose(fit_preferences(mixed).weights, fit_preferences(offers).weights, rtol=1e-7)


def test_ridge_shrinks_the_index():
    """A larger L2 penalty of every coefficient makes theta = (w/mu, 1/mu) shorter, and 0 leaves the fit alone."""
    offers = simulated(5)
    lengths = [np.linalg.norm(fit_preferences(offers, ridge=r).results[0].params) for r in (0.0, 1.0, 100.0, 1e4)]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[-1] < 0.5 * lengths[0]


def test_scale_penalty_shrinks_the_compensations_coefficient_alone():
    """The penalty of 1/mu raises mu, and its gradient at the optimum is found in no other coefficient."""
    offers = simulated(5)
    plain, held = fit_preferences(offers), fit_preferences(offers, scale_penalty=100.0)
    assert held.scale[0] > 1.05 * plain.scale[0]
    model = plain.results[0].model
    slope = model.score(np.asarray(held.results[0].params))
    assert np.abs(slope[:-1]).max() < 1e-6 * abs(slope[-1])
    assert slope[-1] > 0


@pytest.mark.slow
def test_accept_reject_is_biased_however_large_the_data():
    """Before several attractive offers the paper's logistic regression misses mu = 1.5 by tens of standard errors.

    A worker who takes one offer has not rejected the others; treated so, choices look noisier than they are. Choice
    sets have no such bias. More data make it worse in standard errors, not better in money.
    """
    far = []
    for n in (5_000, 20_000):
        offers = simulated(6, n, sets=(3, 7), pay=(2.0, 9.0))
        right, right_error = estimate(fit_preferences(offers))
        wrong, wrong_error = estimate(fit_preferences(offers, method="accept-reject"))
        assert abs(right[-1] - MU) < 4 * right_error[-1]
        assert wrong[-1] - MU > 0.2
        far.append((wrong[-1] - MU) / wrong_error[-1])
    assert far[0] > 5
    assert far[1] > 1.5 * far[0]


def test_accept_reject_is_right_for_single_offers():
    """With one offer per situation the two methods are the same regression."""
    offers = simulated(8, 500, sets=(1, 2))
    one, other = fit_preferences(offers), fit_preferences(offers, method="accept-reject")
    np.testing.assert_allclose(one.weights, other.weights, rtol=1e-9)


def test_no_rejections_name_the_group_and_rest_on_the_ridge():
    """If group 1 rejected nothing its level is not identified: an error with its name; with a ridge, a warning."""
    generous = simulated(9, 300, pay=(40.0, 49.0), group=1)
    assert generous.n_choices == generous.n_situations
    offers = Offers.join([simulated(10, 300), generous])
    with pytest.raises(NotIdentifiedError, match=r"^group 1: .*outside option") as caught:
        fit_preferences(offers)
    assert isinstance(caught.value, DataError)
    assert "\n" not in str(caught.value)
    with pytest.warns(EstimationWarning, match=r"^group 1: .*penalty"):
        found = fit_preferences(offers, ridge=1e-3)
    assert np.isfinite(found.covariance[1]).all()
    assert estimate(found, 1)[1][2] > 5 * estimate(found, 0)[1][2]  # the level's standard error says so too


def test_good_data_raise_no_warning():
    """A well identified fit is silent."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit_preferences(simulated(0))


def flipped(offers):
    """Workers who dislike pay: the log says 9 - c where c was paid."""
    return replace(offers, compensation=9.0 - offers.compensation)


BAD = {
    "compensation never varies": (lambda o: replace(o, compensation=np.ones(len(o))), "group 0: .*compensation"),
    "a feature never varies": (
        lambda o: replace(o, features=np.column_stack([o.features[:, 0], np.ones(len(o))])),
        "group 0: .*feature_1",
    ),
    "collinear features": (lambda o: replace(o, features=o.features[:, [0, 0]]), "group 0: .*feature_0.*feature_1"),
    "workers dislike pay": (flipped, r"group 0: a higher compensation makes acceptance less likely \(1/mu = -"),
    "everybody rejects": (lambda o: replace(o, chosen=np.zeros(len(o))), "group 0: .*every situation.*outside option"),
    "a group is missing": (lambda o: replace(o, group=np.full(len(o), 1)), "group 0 was offered nothing"),
    "no rows": (lambda o: o.take(np.zeros(len(o), bool)), "no offers"),
    "a location nobody visits": (lambda o: replace(o, pickup=2 * (o.situation % 2)), "group 0: .*pickup_1"),
    "one situation": (lambda o: o.take(o.situation == 0), "group 0: "),
}


@pytest.mark.parametrize("spoil", BAD, ids=str)
def test_data_that_cannot_tell_are_one_line(spoil):
    """Every way to spoil the data is a DataError of one line that names the group and the column."""
    change, words = BAD[spoil]
    with pytest.raises(DataError, match=words) as caught:
        fit_preferences(change(simulated(11, 400)))
    assert "\n" not in str(caught.value)


def test_pooled_errors_speak_of_all_groups():
    """With one model for all there is no group to blame."""
    with pytest.raises(DataError, match=r"^all groups: a higher compensation"):
        fit_preferences(flipped(simulated(11, 400)), pooled=True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"ridge": -1.0}, "ridge = -1.0"),
        ({"scale_penalty": np.nan}, "scale_penalty = nan"),
        ({"method": "probit"}, "'probit' is unknown"),
        ({"attributes": Attributes(("a",))}, "2 features; the preferences know 1"),
    ],
)
def test_bad_arguments(arguments, words):
    """Arguments out of range are InputErrors that say what was given."""
    with pytest.raises(InputError, match=words):
        fit_preferences(simulated(11, 50), **arguments)


def test_huge_numbers_are_an_error_of_our_tree():
    """Compensations of 1e200 are refused or fitted, never a foreign error."""
    offers = simulated(11, 50)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        with suppress(OptkitError):
            fit_preferences(replace(offers, compensation=offers.compensation * 1e200))


def test_utility_errors_by_hand():
    """RMSE and MBE per group; a positive bias means that utilities are believed lower than they are (appendix B.4)."""
    belief = Preferences(Attributes(("a",)), np.array([[1.0, -2.0], [1.0, 1.0]]), np.ones(2))
    features, place = np.array([[0.0], [2.0]]), np.zeros(2, int)  # believed: (-2, 0) and (1, 3)
    table = utility_errors(belief, features, place, place, np.array([[-1.0, 3.0], [1.0, 2.0]]))
    assert table["group"].tolist() == [0, 1]
    np.testing.assert_allclose(table["mbe"], [2.0, -0.5])
    np.testing.assert_allclose(table["rmse"], [np.sqrt(5.0), np.sqrt(0.5)])


@pytest.mark.parametrize("method", ["choice", "accept-reject"])
def test_clusters_of_the_offers_widen_the_standard_errors(method):
    """Workers answer ten times each, by a taste of their own: the errors are those of a clustered conditional logit."""
    offers, workers = simulated(7, 600), 60
    taste = np.random.default_rng(0).normal(0, 2.0, workers)[offers.situation % workers]
    moved = offers.compensation - taste  # what they see; the log holds what was paid
    log = replace(offers, compensation=moved - moved.min(), cluster=offers.situation % workers)
    plain, found = (fit_preferences(one, method=method) for one in (replace(log, cluster=None), log))
    assert (found.weights == plain.weights).all()
    one = found.results[0]
    assert one.cov_type == "cluster"
    assert one.cov_kwds["n_groups"] == workers
    design = np.column_stack([log.features, np.ones(len(log)), log.compensation])
    groups = log.situation if method == "choice" else np.arange(len(log))
    model = ConditionalLogit(log.chosen, design, groups, outside_option=True)
    direct = model.fit(cov_type="cluster", cov_kwds={"groups": log.cluster})
    _, _, C = from_index(direct.params[:-1], direct.params[-1], direct.cov_params())
    assert found.covariance[0] == pytest.approx(C, rel=1e-6)
    assert estimate(found)[1][-2] > 1.15 * estimate(plain)[1][-2]  # the constant's, which taste moves
