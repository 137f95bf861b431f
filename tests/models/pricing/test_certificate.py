"""The certificate of prices: bounds that hold, verdicts that tell right from wrong."""

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from scipy.special import wrightomega

from optkit.basics.errors import InputError
from optkit.models.decision import Given
from optkit.models.pricing import optimal_prices
from optkit.models.pricing.certificate import certify, dual_bound

pytestmark = pytest.mark.filterwarnings("error")

bounded = settings(derandomize=True, deadline=None, max_examples=30)
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 10)
forms = st.booleans()


def draw(seed, n):
    """Value, utility and the keyword arguments mu and outside_utility of one decision."""
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-3, 8, n),
        rng.uniform(-5, 4, n),
        {"mu": rng.uniform(0.5, 3), "outside_utility": rng.uniform(-2, 2)},
    )


def earned(c, v, u, mu, outside_utility):
    """Expected profit from the definition."""
    weight = np.exp((u + c - outside_utility) / mu)
    return ((v - c) * weight).sum(axis=-1) / (1 + weight.sum(axis=-1))


@pytest.mark.slow
@bounded
@given(seeds, sizes, forms)
def test_optimal_prices_are_certified_without_a_gap(seed, n, nonnegative):
    v, u, choice = draw(seed, n)
    p = optimal_prices(v, u, nonnegative=nonnegative, **choice)
    proof = certify(p.compensation, v, u, nonnegative=nonnegative, **choice)
    assert proof.optimal
    assert proof.infeasibility == 0
    assert proof.profit == pytest.approx(p.profit, abs=1e-12)  # profits of at most 10, evaluated from the prices
    # 1e-12: the bound allows 16 roundings of inputs of at most 10 over mu of at least 0.5.
    assert 0 <= proof.gap + 1e-15 <= 1e-12
    assert proof.stationarity <= 1e-12


@pytest.mark.slow
@bounded
@given(seeds, sizes, forms, st.floats(0.01, 10), st.booleans())
def test_one_price_off_is_caught(seed, n, nonnegative, change, down):
    """Off by x, a request of probability P loses about P (1 - P) x^2 / 2 mu: over 1e-7, the tolerance is 1e-8."""
    v, u, choice = draw(seed, n)
    prices = optimal_prices(v, u, nonnegative=nonnegative, **choice)
    i = int(np.argmax(prices.acceptance * (1 - prices.acceptance)))
    if prices.acceptance[i] * (1 - prices.acceptance[i]) < 0.02:
        reject()
    c = prices.compensation.copy()
    c[i] += -change if down else change
    proof = certify(c, v, u, nonnegative=nonnegative, **choice)
    assert not proof.optimal
    if c[i] >= 0 or not nonnegative:
        assert proof.gap > 1e-8
        assert proof.stationarity > 1e-5
    else:
        assert proof.infeasibility == pytest.approx(-c[i], rel=1e-15)


def test_a_negative_price_is_infeasible_even_where_it_earns_more():
    v, u = [8.0, 8.0, -4.0], [1.0, -4.0, 6.0]
    free = optimal_prices(v, u, nonnegative=False)
    proof = certify(free.compensation, v, u)
    assert proof.infeasibility == pytest.approx(-free.compensation.min(), rel=1e-15)
    assert proof.gap < 0
    assert not proof.optimal
    assert certify(free.compensation, v, u, nonnegative=False).optimal
    assert certify(free.compensation, v, u, nonnegative=False).infeasibility == 0


def test_clipped_prices_are_feasible_and_not_optimal():
    v, u = [8.0, 8.0, -4.0], [1.0, -4.0, 6.0]
    proof = certify(optimal_prices(v, u, nonnegative="clip").compensation, v, u)
    assert proof.infeasibility == 0
    assert not proof.optimal
    # The two profits of the example in the tests of pricing, to the digits given there.
    assert proof.gap == pytest.approx(0.501932 + 3.821914, abs=2e-6)


@pytest.mark.slow
@bounded
@given(seeds, sizes, forms, st.floats(0, 30))
def test_no_feasible_prices_earn_more_than_the_bound_which_does_not_depend_on_them(seed, n, nonnegative, spread):
    v, u, choice = draw(seed, n)
    rng = np.random.default_rng(seed)
    proposals = rng.uniform(0 if nonnegative else -1, 1, (200, n)) * spread
    bound = certify(np.zeros(n), v, u, nonnegative=nonnegative, **choice).bound
    assert (earned(proposals, v, u, **choice) <= bound).all()
    wide = np.broadcast_to(v, (200, n))
    proof = certify(proposals, wide, u, nonnegative=nonnegative, **choice)
    assert (proof.bound == bound).all()
    assert (proof.gap >= 0).all()
    assert proof.profit == pytest.approx(earned(proposals, v, u, **choice), abs=1e-11)  # profits of at most 40


@pytest.mark.slow
@bounded
@given(seeds, sizes)
def test_multipliers_and_prices_satisfy_the_optimality_conditions(seed, n):
    """c_i = v_i - mu - R + multiplier_i, both factors at least 0 and never both positive."""
    v, u, choice = draw(seed, n)
    p = optimal_prices(v, u, **choice)
    proof = certify(p.compensation, v, u, **choice)
    assert (proof.multiplier >= 0).all()
    # 1e-11: the bound is 1e-13 above the profit, and prices are at most 10.
    assert np.abs(proof.multiplier * p.compensation).max() <= 1e-11
    assert p.compensation == pytest.approx(v - choice["mu"] - proof.bound + proof.multiplier, abs=1e-11)
    assert (certify(p.compensation, v, u, nonnegative=False, **choice).multiplier == 0).all()


@bounded
@given(seeds, sizes, forms)
def test_stationarity_is_the_largest_derivative_of_the_profit_along_a_feasible_change(seed, n, nonnegative):
    v, u, choice = draw(seed, n)
    rng = np.random.default_rng(seed)
    c = np.maximum(rng.uniform(-3, 6, n), 0)
    h = 1e-5
    slope = np.array(
        [(earned(c + h * e, v, u, **choice) - earned(c - h * e, v, u, **choice)) / (2 * h) for e in np.eye(n)]
    )
    if nonnegative:
        slope = np.where(c == 0, np.maximum(slope, 0), slope)
    found = certify(c, v, u, nonnegative=nonnegative, **choice).stationarity
    # 1e-7: rounding 1e-15 over h, and third derivatives of at most 100 times h^2.
    assert found == pytest.approx(np.abs(slope).max(), abs=1e-7)


def test_the_tolerance_is_a_gap_relative_to_mu_plus_the_bound():
    v, u = [5.0, 6.0], [-1.0, -2.0]
    c = optimal_prices(v, u).compensation + np.array([0.01, 0.0])
    proof = certify(c, v, u)
    relative = proof.gap / (1 + proof.bound)
    assert proof.tolerance == 1e-9
    assert not certify(c, v, u, tolerance=0.99 * relative).optimal
    assert certify(c, v, u, tolerance=1.01 * relative).optimal


def test_tiny_negative_prices_are_rounding():
    v, u = [5.0, -6.0], [-1.0, -2.0]
    c = optimal_prices(v, u).compensation
    assert certify(c - [0, 1e-12], v, u).optimal
    assert not certify(c - [0, 1e-6], v, u).optimal


@pytest.mark.parametrize("nonnegative", [True, False])
def test_many_proposals_at_once_are_each_alone(nonnegative):
    rng = np.random.default_rng(1)
    v, u, offered = rng.uniform(-5, 9, (2, 3, 4)), rng.uniform(-6, 4, (2, 3, 4)), rng.random((2, 3, 4)) < 0.7
    c, mu, outside = rng.uniform(0, 5, (2, 3, 4)), rng.uniform(0.2, 3, (2, 3)), rng.uniform(-1, 1, 3)
    together = certify(c, v, u, mu, outside_utility=outside, nonnegative=nonnegative, offered=offered)
    assert together.multiplier.shape == (2, 3, 4)
    for i, j in np.ndindex(2, 3):
        at = (c[i, j], v[i, j], u[i, j], mu[i, j])
        alone = certify(*at, outside_utility=outside[j], nonnegative=nonnegative, offered=offered[i, j])
        for name in ("profit", "gap", "stationarity", "infeasibility", "optimal", "multiplier"):
            assert (getattr(together, name)[i, j] == getattr(alone, name)).all()
        # The repair of a bound goes on while any decision needs it, and changes only those: equal to the last digit.
        assert together.bound[i, j] == alone.bound


@pytest.mark.slow
@bounded
@given(seeds, sizes, forms)
def test_what_is_not_offered_does_not_count(seed, n, nonnegative):
    v, u, choice = draw(seed, n)
    rng = np.random.default_rng(seed)
    offered, c = rng.random(n) < 0.6, rng.uniform(0, 5, n)
    proof = certify(np.where(offered, c, -7), v, u, nonnegative=nonnegative, offered=offered, **choice)
    kept = certify(c[offered], v[offered], u[offered], nonnegative=nonnegative, **choice)
    assert (proof.multiplier[~offered] == 0).all()
    for name in ("profit", "bound", "stationarity", "infeasibility"):
        assert getattr(proof, name) == pytest.approx(getattr(kept, name), abs=1e-12)  # sums in another order


def test_with_nothing_on_offer_nothing_is_optimal():
    for proof in (certify([], [], []), certify([3.0], [5.0], [1.0], offered=[False])):
        assert proof.optimal
        assert proof.profit == 0
        assert proof.bound == pytest.approx(0, abs=1e-12)  # the rounding that a bound allows for


@pytest.mark.slow
@settings(bounded, max_examples=50)
@given(seeds, st.sampled_from([1, 3, 30, 1000]), st.floats(-3, 3), st.floats(-3, 6), st.floats(-3, 6), forms)
def test_the_bound_is_above_the_profit_of_any_prices_at_any_scale(seed, n, log_mu, log_value, log_utility, nonnegative):
    rng = np.random.default_rng(seed)
    v, u, mu = 10.0**log_value * rng.uniform(-1, 1, n), 10.0**log_utility * rng.uniform(-1, 1, n), 10.0**log_mu
    c = np.abs(v) * rng.uniform(0, 1, n)
    proof = certify(c, v, u, mu, nonnegative=nonnegative)
    assert np.isfinite([proof.profit, proof.bound, proof.gap, proof.stationarity]).all()
    # The profit itself is rounded: a sum of n terms as large as the values.
    assert proof.gap >= -4 * np.finfo(float).eps * np.abs(v).max() * (1 + np.log2(n))


def test_the_summary_says_what_a_person_asks_first():
    v, u = [5.0, 6.0], [-1.0, -2.0]
    c = optimal_prices(v, u).compensation
    dear = c + np.array([0.1, 0.0])
    good, bad = certify(c, v, u).summary(), certify(dear, v, u).summary()
    assert good.splitlines()[0].split() == ["verdict", "optimal"]
    assert bad.splitlines()[0].split() == ["verdict", "NOT", "optimal"]
    names = ["verdict", "profit", "upper bound", "gap", "stationarity", "infeasibility"]
    assert [line[:14].strip() for line in good.splitlines()] == names
    assert "2.699923676" in good.splitlines()[1]
    assert "tolerance 1e-09 relative" in good
    many = certify([c, dear], [v, v], u).summary()
    assert "NOT optimal (1 of 2 decisions)" in many
    assert "in total" in many


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"compensation": [1.0, np.nan]}, r"compensation\[1\] is nan"),
        ({"compensation": 1.0}, "compensation is a single number"),
        ({"compensation": [1.0, 2.0, 3.0]}, "shapes do not fit|compensation has shape"),
        ({"compensation": [[1.0, 2.0]] * 3}, "compensation has shape"),
        ({"value": [np.inf, 1.0]}, r"value\[0\] is inf"),
        ({"mu": 0}, "mu = 0.0 is not positive"),
        ({"tolerance": 0.0}, "tolerance = 0.0 is not a finite number above 0"),
        ({"tolerance": np.nan}, "tolerance = nan is not a finite number above 0"),
    ],
)
def test_bad_input_is_named_in_one_line(change, words):
    arguments = {"compensation": [1.0, 2.0], "value": [3.0, 4.0], "utility": [0.0, 0.0]} | change
    with pytest.raises(InputError, match=words) as caught:
        certify(**arguments)
    assert "\n" not in str(caught.value)


def test_no_decisions_need_no_certificate():
    assert certify(*[np.zeros((0, 2))] * 3).multiplier.shape == (0, 2)


def test_prices_of_another_leading_shape_are_refused_even_if_there_are_as_many():
    with pytest.raises(InputError, match="compensation has shape"):
        certify(np.ones((3, 2, 4)), np.ones((2, 3, 4)), np.zeros(4))


def test_a_request_that_cannot_matter_does_not_soften_the_verdict():
    """The first request alone: W0(exp(20 - 1)) is the optimum, and a price of 5 earns 25 e^-5 / (1 + e^-5) of it."""
    best = wrightomega(19.0)
    for never in (-1e4, -1e16, -1e300, -np.inf):
        proof = certify([5.0, 0.0], [30.0, 0.0], [-10.0, never])
        assert proof.profit == pytest.approx(25 * np.exp(-5) / (1 + np.exp(-5)), rel=1e-12)
        assert 0 <= proof.bound - best <= 1e-12 * best
        assert not proof.optimal
        assert not proof.undecided
        prices = optimal_prices([30.0, 0.0], [-10.0, never]).compensation
        assert certify(prices, [30.0, 0.0], [-10.0, never]).optimal
    assert not certify([2e-6, 0.0], [2e-6, 0.0], [0.0, -1e8], 1e-6).optimal


@pytest.mark.slow
@bounded
@given(seeds, sizes, forms, st.sampled_from([1e-12, 1e12]), st.floats(-5, 0))
def test_verdicts_do_not_depend_on_the_unit_of_money(seed, n, nonnegative, unit, log_change):
    v, u, choice = draw(seed, n)
    scaled = {name: unit * x for name, x in choice.items()}
    best = optimal_prices(v, u, nonnegative=nonnegative, **choice)
    off = best.compensation + 10.0**log_change * np.eye(n)[np.argmax(best.acceptance)]
    for prices in (best.compensation, off, np.zeros(n)):
        here = certify(prices, v, u, nonnegative=nonnegative, **choice)
        there = certify(unit * prices, unit * v, unit * u, nonnegative=nonnegative, **scaled)
        if here.gap < 0.9e-9 * (choice["mu"] + abs(here.bound)) or here.gap > 1.1e-9 * (choice["mu"] + abs(here.bound)):
            assert (there.optimal, there.undecided) == (here.optimal, here.undecided)


def test_a_tolerance_finer_than_rounding_leaves_the_verdict_undecided():
    v, u = [5.0, 6.0], [-1.0, -2.0]
    c = optimal_prices(v, u).compensation
    proof, dear = (certify(prices, v, u, tolerance=1e-17) for prices in (c, c + 0.1))
    assert proof.undecided
    assert not proof.optimal
    assert proof.summary().startswith("verdict        undecided")
    assert not dear.undecided


def test_padding_behind_the_mask_does_not_soften_the_verdict():
    assert not certify([3.0, 0.0], [5.0, 1e15], [-1.0, 0.0], offered=[True, False]).optimal


def test_an_unknown_sign_constraint_is_refused():
    with pytest.raises(InputError, match="nonnegative"):
        certify([1.0], [1.0], [1.0], nonnegative="clip")


@bounded
@given(seeds, sizes, forms)
def test_the_dual_bound_of_logarithms_lies_just_above_the_profit(seed, n, nonnegative):
    v, u, choice = draw(seed, n)
    d = Given.of("value", v[None], u[None], choice["mu"], choice["outside_utility"], None).decisions()
    bound, rounding = dual_bound(d, nonnegative)
    profit = optimal_prices(v, u, nonnegative=nonnegative, **choice).profit
    # Profits of at most 10, rounded.
    assert -1e-13 <= bound.item() - profit <= rounding.item() + 1e-13 <= 2e-12
