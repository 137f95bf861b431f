"""Conditional logit: published figures, the likelihood by hand, other programs, limit cases, simulated truth."""

import math
from contextlib import nullcontext

import numpy as np
import pytest
import statsmodels.api as sm
from scipy.optimize import minimize
from scipy.stats import binom
from statsmodels.discrete.conditional_models import ConditionalLogit as Reference
from statsmodels.tools.numdiff import approx_fprime_cs, approx_hess

from optkit.basics.errors import InputError
from optkit.models.estimation import ConditionalLogit

pytestmark = pytest.mark.filterwarnings("error")

TRUTH = np.array([1.0, -0.5, 0.3])


def simulate(situations=300, truth=TRUTH, outside=False, seed=0, smallest=None, largest=6):
    """Utility-maximising choices with Gumbel noise from sets of random size: choice, features, situation."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(smallest or (1 if outside else 2), largest + 1, situations)
    groups = np.repeat(np.arange(situations), sizes)
    x = rng.normal(size=(len(groups), len(truth)))
    utility = x @ truth + rng.gumbel(size=len(groups))
    best = np.full(situations, -np.inf)
    np.maximum.at(best, groups, utility)
    idle = rng.gumbel(size=situations) if outside else np.full(situations, -np.inf)
    return ((utility == best[groups]) & (best > idle)[groups]).astype(float), x, groups


def loglike_by_hand(params, choice, x, groups, outside=False):
    """Sum over the situations of the log of the softmax probability of the choice, one situation at a time."""
    total = 0.0
    for s in sorted(set(groups)):
        rows = [i for i in range(len(groups)) if groups[i] == s]
        weight = [math.exp(sum(b * v for b, v in zip(params, x[i], strict=True))) for i in rows]
        taken = [w for w, i in zip(weight, rows, strict=True) if choice[i]]
        total += math.log((taken[0] if taken else 1.0) / (sum(weight) + outside))
    return total


@pytest.fixture(scope="module")
def travel():
    """Greene's travel mode choice as a table: 210 travellers, air, train, bus and car."""
    data = sm.datasets.modechoice.load_pandas().data
    for code, mode in enumerate(("air", "train", "bus"), start=1):
        data[mode] = (data["mode"] == code).astype(float)
    data["hinc_air"] = data["hinc"] * data["air"]
    return data


MODES = ["gc", "ttme", "air", "hinc_air", "train", "bus"]
PUBLISHED = [-0.0155015, -0.0961246, 5.207433, 0.0132870, 3.869036, 3.163190]
PUBLISHED_ERRORS = [0.0044080, 0.0104398, 0.779055, 0.0102624, 0.443127, 0.450266]


def test_greene_travel_mode_choice(travel):
    """W. H. Greene, Econometric Analysis, the conditional logit of travel mode choice (CLOGIT data)."""
    results = ConditionalLogit(travel["choice"], travel[MODES], travel["individual"]).fit()
    # The published search ended 2e-5 standard errors short of the maximum, which moves the constants by up to 1.1e-5;
    # the other tolerances are half a unit of the last digit printed.
    assert results.params.to_numpy() == pytest.approx(PUBLISHED, abs=1.2e-5, rel=1e-5)
    assert np.abs((results.params - PUBLISHED) / results.bse).max() < 2e-5
    assert results.llf > results.model.loglike(PUBLISHED)
    assert results.bse[["gc", "ttme", "hinc_air"]].to_numpy() == pytest.approx(
        [0.0044080, 0.0104398, 0.0102624], abs=5e-8
    )
    assert results.bse.to_numpy() == pytest.approx(PUBLISHED_ERRORS, abs=5.5e-7)
    assert results.llf == pytest.approx(-199.1284, abs=5e-5)
    # LL(0) is that of equal shares of the four modes, not of a model with constants.
    assert results.llnull == pytest.approx(-291.1218, abs=5e-5)
    assert results.llnull == pytest.approx(-210 * math.log(4), rel=1e-14)


@pytest.mark.parametrize("outside", [False, True])
def test_the_likelihood_is_the_sum_of_log_probabilities_by_hand(outside):
    choice, x, groups = simulate(40, outside=outside)
    model = ConditionalLogit(choice, x, groups, outside_option=outside)
    for params in (np.zeros(3), TRUTH, np.array([3.0, 2.0, -4.0])):
        # 1e-13 relative: 40 terms of order 1.
        assert model.loglike(params) == pytest.approx(loglike_by_hand(params, choice, x, groups, outside), rel=1e-13)


@pytest.mark.parametrize("outside", [False, True])
def test_gradient_and_hessian_are_those_of_finite_differences(outside):
    choice, x, groups = simulate(50, outside=outside)
    model = ConditionalLogit(choice, x, groups, outside_option=outside, weights=np.arange(1.0, 51.0))
    for params in (np.zeros(3), TRUTH):
        step = 1e-6  # central differences: step^2 times third derivatives of order 1e3, and rounding of 1e-12 / step
        slope = [(model.loglike(params + d) - model.loglike(params - d)) / (2 * step) for d in step * np.eye(3)]
        assert model.score(params) == pytest.approx(slope, abs=1e-5)
        curve = [(model.score(params + d) - model.score(params - d)) / (2 * step) for d in step * np.eye(3)]
        assert model.hessian(params) == pytest.approx(np.array(curve), abs=1e-5)
        assert (model.information(params) == -model.hessian(params)).all()
        assert np.arange(1.0, 51.0) @ model.score_obs(params) == pytest.approx(model.score(params), rel=1e-10)


def test_the_gradient_vanishes_at_the_estimate():
    choice, x, groups = simulate()
    results = ConditionalLogit(choice, x, groups).fit()
    # In standard errors: the tolerance of the search is 1e-10, and its last step was quadratic.
    assert np.abs(results.model.score(results.params) * results.bse).max() < 1e-9
    assert results.converged
    assert results.mle_retvals["decrement"] < 1e-9


@pytest.mark.slow
def test_statsmodels_fits_the_same(travel):
    ours = ConditionalLogit(travel["choice"], travel[MODES], travel["individual"]).fit()
    reference = Reference(travel["choice"], travel[MODES], groups=travel["individual"])
    theirs = reference.fit(maxiter=500)
    # 1e-10: the same sum of 210 terms by another recursion.
    assert ours.model.loglike(theirs.params) == pytest.approx(reference.loglike(theirs.params.to_numpy()), rel=1e-10)
    assert ours.model.score(PUBLISHED) == pytest.approx(reference.score(np.array(PUBLISHED)), abs=1e-6)
    # BFGS stops at a gradient of 1e-5 per coefficient: with these standard errors, 1e-5 of one. Allow ten times that.
    assert ours.llf >= theirs.llf - 1e-10
    assert np.abs((ours.params - theirs.params) / ours.bse).max() < 1e-4
    # Its Hessian is a forward difference, good to half the digits.
    assert ours.bse.to_numpy() == pytest.approx(theirs.bse.to_numpy(), rel=1e-5)


def test_pairs_are_a_logistic_regression_on_differences():
    """Train, section 3.1: with two alternatives, P = 1 / (1 + exp(-(x_1 - x_2) b))."""
    choice, x, groups = simulate(400, smallest=2, largest=2)
    ours = ConditionalLogit(choice, x, groups).fit()
    logit = sm.Logit(choice[::2], x[::2] - x[1::2]).fit(method="newton", tol=1e-14, disp=0)
    assert ours.params == pytest.approx(logit.params, rel=1e-9)
    assert ours.bse == pytest.approx(logit.bse, rel=1e-9)
    assert ours.llf == pytest.approx(logit.llf, rel=1e-12)
    robust = ConditionalLogit(choice, x, groups).fit(cov_type="HC0")
    theirs = sm.Logit(choice[::2], x[::2] - x[1::2]).fit(method="newton", tol=1e-14, disp=0, cov_type="HC0")
    assert robust.bse == pytest.approx(theirs.bse, rel=1e-9)


def test_one_offer_and_the_outside_option_is_a_logistic_regression():
    choice, x, groups = simulate(400, outside=True, largest=1)
    ours = ConditionalLogit(choice, sm.add_constant(x), groups, outside_option=True).fit()
    logit = sm.Logit(choice, sm.add_constant(x)).fit(method="newton", tol=1e-14, disp=0)
    assert ours.params == pytest.approx(logit.params, rel=1e-9)
    assert ours.bse == pytest.approx(logit.bse, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("outside", "cov_type"), [(False, "nonrobust"), (True, "robust")])
def test_intervals_cover_the_truth_as_often_as_they_say(outside, cov_type):
    """200 data sets of 300 situations; each coefficient's interval misses at the rate of a fair 5 % coin.

    That either kind of error goes with either kind of choice is what the sandwich by hand is for.
    """
    sets, covered = 200, np.zeros(3)
    for seed in range(sets):
        results = ConditionalLogit(*simulate(outside=outside, seed=seed), outside_option=outside).fit(cov_type=cov_type)
        low, high = results.conf_int().T
        covered += (low <= TRUTH) & (high >= TRUTH)
    # Binomial(200, 0.95) lies within these bounds but for 1 case in 1,000, and there are 3 coefficients.
    low, high = binom.ppf([0.0005, 0.9995], sets, 0.95)
    assert (low <= covered).all()
    assert (covered <= high).all()


def test_the_estimate_nears_the_truth_as_data_grow():
    small, large = (ConditionalLogit(*simulate(n, outside=True), outside_option=True).fit() for n in (500, 50_000))
    assert np.abs((large.params - TRUTH) / large.bse).max() < 4
    # Standard errors fall with the root of 100; their own sampling error at 500 situations is a few per cent.
    assert small.bse / large.bse == pytest.approx(10.0, rel=0.15)


@pytest.mark.parametrize("outside", [False, True])
def test_neither_the_order_of_rows_nor_the_kind_of_labels_matters(outside):
    choice, x, groups = simulate(outside=outside)
    first = ConditionalLogit(choice, x, groups, outside_option=outside).fit()
    order = np.random.default_rng(1).permutation(len(choice))
    labels = [f"trip {g}" for g in groups[order]]
    second = ConditionalLogit(choice[order], x[order], labels, outside_option=outside).fit()
    assert second.params == pytest.approx(first.params, rel=1e-10)
    assert second.bse == pytest.approx(first.bse, rel=1e-10)
    assert second.llf == pytest.approx(first.llf, rel=1e-12)
    assert second.predict() == pytest.approx(first.predict()[order], rel=1e-9)


@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("cov_type", ["nonrobust", "HC0"])
def test_weights_are_replications(outside, cov_type):
    choice, x, groups = simulate(120, outside=outside)
    times = np.random.default_rng(2).integers(0, 4, 120)
    again = np.repeat(np.arange(len(groups)), times[groups])
    copy = np.concatenate([np.arange(times[g]) for g in groups])
    labels = list(zip(groups[again], copy, strict=True))
    weighted = ConditionalLogit(choice, x, groups, outside, weights=times).fit(cov_type=cov_type)
    repeated = ConditionalLogit(choice[again], x[again], labels, outside).fit(cov_type=cov_type)
    by_row = ConditionalLogit(choice, x, groups, outside, weights=times[groups]).fit(cov_type=cov_type)
    for field in ("params", "bse", "llf", "llnull", "aic", "bic", "nobs", "prsquared", "llr_pvalue"):
        assert getattr(weighted, field) == pytest.approx(getattr(repeated, field), rel=1e-9)
        assert getattr(weighted, field) == pytest.approx(getattr(by_row, field), rel=1e-14)


@pytest.mark.parametrize("outside", [False, True])
def test_unavailable_rows_are_dropped_rows_whatever_they_hold(outside):
    choice, x, groups = simulate(200, outside=outside, smallest=3)
    available = (np.random.default_rng(3).random(len(choice)) < 0.7) | (choice == 1)
    if not outside:
        available[np.unique(groups, return_index=True)[1]] = True
    messy = np.where(available[:, None], x, np.nan)
    masked = ConditionalLogit(choice, messy, groups, outside, available=available)
    kept = ConditionalLogit(choice[available], x[available], groups[available], outside)
    # Some sets are left with their choice alone.
    with pytest.warns(UserWarning, match="nothing but what was chosen") if masked.likelihood.dropped else nullcontext():
        first, second = masked.fit(), kept.fit()
    assert first.params == pytest.approx(second.params, rel=1e-12)
    assert first.llf == pytest.approx(second.llf, rel=1e-14)
    assert first.predict()[available] == pytest.approx(second.predict(), rel=1e-12)
    assert (first.predict()[~available] == 0).all()


def test_a_known_part_of_the_index_is_an_offset():
    choice, x, groups = simulate()
    full = ConditionalLogit(choice, x, groups).fit()
    part = ConditionalLogit(choice, x[:, :2], groups, offset=x[:, 2] * full.params[2]).fit()
    assert part.params == pytest.approx(full.params[:2], rel=1e-8)
    assert part.llf == pytest.approx(full.llf, rel=1e-12)
    assert part.predict() == pytest.approx(full.predict(), rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("penalty", [2.0, [0.0, 5.0, 0.5], {"x2": 100.0}])
def test_a_penalty_maximises_the_penalised_likelihood_by_hand(penalty):
    choice, x, groups = simulate(60, outside=True)
    each = {2.0: np.full(3, 2.0)}.get(penalty) if isinstance(penalty, float) else None
    each = np.array([0.0, 100.0, 0.0]) if isinstance(penalty, dict) else np.array(penalty) if each is None else each

    def objective(b):
        return 0.5 * sum(each * b**2) - loglike_by_hand(b, choice, x, groups, True)

    found = minimize(objective, np.zeros(3), method="BFGS", options={"gtol": 1e-6})
    results = ConditionalLogit(choice, x, groups, True, penalty=penalty).fit()
    # The curvature is above 1, so a gradient of 1e-6 is at most 1e-6 from the minimum; finite differences add as much.
    assert results.params == pytest.approx(found.x, abs=1e-5)
    # The reported log-likelihood leaves the penalty out, and so do score and hessian.
    assert results.llf == pytest.approx(loglike_by_hand(results.params, choice, x, groups, True), rel=1e-12)
    assert results.model.score(results.params) == pytest.approx(each * results.params, abs=1e-8)
    precision = results.model.information(results.params) + np.diag(each)
    assert results.cov_params() == pytest.approx(np.linalg.inv(precision), rel=1e-9)


def test_the_sandwich_by_hand_and_close_to_the_classical_errors_under_the_true_model():
    choice, x, groups = simulate(2000)
    classical, robust = (ConditionalLogit(choice, x, groups).fit(cov_type=c) for c in ("nonrobust", "robust"))
    meat, p = np.zeros((3, 3)), classical.predict()
    for s in range(2000):
        rows = groups == s
        score = (choice[rows] - p[rows]) @ x[rows]
        meat += np.outer(score, score)
    bread = np.linalg.inv(classical.model.information(classical.params))
    assert robust.cov_params() == pytest.approx(bread @ meat @ bread, rel=1e-8)
    # Information matrix equality; with 2,000 situations the two variances differ by about 1/sqrt(2000) = 2 %.
    assert robust.bse == pytest.approx(classical.bse, rel=0.08)
    assert (robust.params == classical.params).all()
    assert robust.cov_type == "HC0"


def test_predictions_are_probabilities():
    choice, x, groups = simulate()
    inside = ConditionalLogit(choice, x, groups).fit()
    assert np.bincount(groups, inside.predict()) == pytest.approx(1.0, abs=1e-14)
    choice, x, groups = simulate(outside=True)
    outside = ConditionalLogit(choice, sm.add_constant(x), groups, outside_option=True).fit()
    total = np.bincount(groups, outside.predict())
    assert (total < 1).all()
    # The first-order condition of the constant: predicted and observed acceptances agree.
    assert total.sum() == pytest.approx(choice.sum(), rel=1e-9)


def test_units_and_levels_of_the_columns_do_not_matter():
    choice, x, groups = simulate()
    plain = ConditionalLogit(choice, x, groups).fit()
    scaled = ConditionalLogit(choice, x * [1e6, 1e-9, 1.0] + [0.0, 0.0, 1e6], groups).fit()
    # A level of 1e6 costs six of sixteen digits.
    assert scaled.params * [1e6, 1e-9, 1.0] == pytest.approx(plain.params, rel=1e-8)
    assert scaled.bse * [1e6, 1e-9, 1.0] == pytest.approx(plain.bse, rel=1e-8)
    # Something known of a whole situation cancels: income, weather, the day.
    shifted = ConditionalLogit(choice, x + np.random.default_rng(4).normal(size=(300, 3))[groups], groups).fit()
    assert shifted.params == pytest.approx(plain.params, rel=1e-10)


def test_indices_of_a_million_neither_overflow_nor_lose_the_small_ones():
    choice, x, groups = simulate(50)
    model = ConditionalLogit(choice, x, groups)
    params = 1e6 * TRUTH
    index = x @ params
    best = np.full(50, -np.inf)
    np.maximum.at(best, groups, index)
    # With such indices the log-sum-exp is the maximum, to one part in 1e6 of a unit.
    assert model.loglike(params) == pytest.approx((index[choice == 1] - best).sum(), rel=1e-12)
    assert np.isfinite(model.score(params)).all()
    assert np.isfinite(model.hessian(params)).all()
    probability = model.predict(params)
    assert np.bincount(groups, probability) == pytest.approx(1.0, abs=1e-14)
    assert (probability[index == best[groups]] > 0.999).all()
    shifted = ConditionalLogit(choice, x, groups, offset=1e6 * np.sin(groups)).fit()
    assert shifted.params == pytest.approx(model.fit().params, rel=1e-7)


def test_any_start_leads_to_the_same_place():
    model = ConditionalLogit(*simulate())
    expected = model.fit().params
    for start in ([5.0, 5.0, -5.0], [1e6, -1e6, 1e6], expected):
        # 1e-8: the search ends within 1e-10 standard errors.
        assert model.fit(start_params=start).params == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("shift", [5.0, 50.0, 1000.0, 1e5])
def test_a_start_where_every_choice_is_certain_is_left(shift):
    """At 0 the offset drowns everything: the information is e^-shift, and a full Newton step overshoots wildly."""
    choice, x, groups = simulate(400, smallest=2, largest=2)
    first = np.tile([1.0, 0.0], 400)
    plain = ConditionalLogit(choice, np.column_stack([x, first]), groups).fit()
    drowned = ConditionalLogit(choice, np.column_stack([x, first]), groups, offset=shift * first).fit()
    assert drowned.params + np.array([0.0, 0.0, 0.0, shift]) == pytest.approx(plain.params, rel=1e-7)
    assert drowned.llf == pytest.approx(plain.llf, rel=1e-9)


def test_situations_are_listed_as_they_appear():
    choice, x, groups = simulate(5)
    model = ConditionalLogit(choice, x, [f"s{g}" for g in groups[::-1]][::-1])
    assert list(model.situations) == ["s0", "s1", "s2", "s3", "s4"]


def test_derivatives_by_complex_and_by_numerical_steps_of_statsmodels():
    """The tools that statsmodels users check models with accept this one."""
    choice, x, groups = simulate(80)
    model = ConditionalLogit(choice, x, groups)
    assert approx_hess(TRUTH, model.loglike) == pytest.approx(model.hessian(TRUTH), abs=1e-2)

    def by_hand(params):
        index = x @ params
        total = np.zeros(80, dtype=complex)
        np.add.at(total, groups, np.exp(index))
        return index[choice == 1].sum() - np.log(total).sum()

    # A complex step has no cancellation: sixteen digits.
    assert approx_fprime_cs(TRUTH, by_hand) == pytest.approx(model.score(TRUTH), rel=1e-10)


@pytest.mark.parametrize(
    ("arguments", "ask"),
    [
        ({}, lambda model: model.loglike([1e308, 1e308, 0.0])),
        ({}, lambda model: model.predict([1e308, 1e308, 0.0])),
        ({"penalty": 1e308}, lambda model: model.fit()),
        ({"weights": np.full(80, 1e308)}, lambda model: model.fit()),
        ({}, lambda model: model.fit().conf_int(alpha=2)),
    ],
    ids=["loglike", "predict", "penalty", "weights", "alpha"],
)
def test_what_no_float_could_hold_is_refused(arguments, ask):
    """And levels that are none; nothing is NaN or infinite instead."""
    choice, x, groups = simulate(80)
    with pytest.raises(InputError, match=r"below 1e\+100|not between 0 and 1"):
        ask(ConditionalLogit(choice, x, groups, **arguments))
