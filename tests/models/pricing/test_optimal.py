"""Optimal compensations: optimality against independent searches, and the laws that prices obey."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import lambertw

from optkit.basics.errors import InputError
from optkit.models.choice import acceptance_probabilities
from optkit.models.pricing import Pricing, certify, optimal_prices

pytestmark = pytest.mark.filterwarnings("error")

bounded = settings(derandomize=True, deadline=None, max_examples=30)
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 10)
forms = st.sampled_from([True, False])
every_form = st.sampled_from([True, False, "clip"])


def draw(seed, n):
    """Value, utility, mu and outside utility of one decision in which some requests are held at 0, mostly."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 8, n), rng.uniform(-5, 4, n), rng.uniform(0.5, 3), rng.uniform(-2, 2)


def earned(compensation, v, u, mu, outside=0.0):
    """Expected profit from the definition."""
    weight = np.exp((u + compensation - outside) / mu)
    return ((v - compensation) * weight).sum(axis=-1) / (1 + weight.sum(axis=-1))


def same(found: Pricing, expected: Pricing, tolerance: float, mu: float = 1.0):
    """Both price alike: probabilities to the tolerance, money to the tolerance times mu."""
    for name in ("acceptance", "rejection"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=tolerance)
    for name in ("compensation", "markup", "profit"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=tolerance * mu)


# Optimality ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(bounded, max_examples=25)
@given(seeds, st.integers(1, 5), forms)
def test_a_general_optimiser_started_anywhere_finds_no_more(seed, n, nonnegative):
    v, u, mu, outside = draw(seed, n)
    best = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=nonnegative)
    rng, limits = np.random.default_rng(seed), [(0 if nonnegative else None, None)] * n
    found = max(
        -minimize(lambda c: -earned(c, v, u, mu, outside), start, bounds=limits, method="L-BFGS-B").fun
        for start in np.maximum(v - mu * rng.uniform(0.2, 3, (6, 1)), 0)
    )
    assert found <= best.profit + 1e-12  # rounding of profits of at most 10
    assert found == pytest.approx(best.profit, abs=1e-6)  # it stops at gradients of 1e-5 from finite differences


@settings(bounded, max_examples=15)
@given(seeds, st.integers(1, 2), forms)
def test_no_point_of_a_grid_of_prices_earns_more_and_the_nearest_earns_as_much(seed, n, nonnegative):
    v, u, mu, outside = draw(seed, n)
    best = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=nonnegative)
    step = 0.05
    axis = np.arange(0.0 if nonnegative else -20.0, 8.0 + step, step)
    grid = np.stack(np.meshgrid(*[axis] * n), axis=-1)
    found = earned(grid, v, u, mu, outside).max()
    assert found <= best.profit + 1e-12  # rounding of profits of at most 10
    # Half a step off in every price, at a curvature of at most P_i / mu: sum_i P_i (step/2)^2 / mu / 2.
    assert found >= best.profit - step**2 / 8 / mu * 1.1


@bounded
@given(seeds, sizes, every_form)
def test_the_reported_numbers_are_what_the_reported_prices_lead_to(seed, n, form):
    v, u, mu, outside = draw(seed, n)
    p = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form)
    acceptance, rejection = acceptance_probabilities(p.compensation, u, mu, outside_utility=outside)
    # 1e-12: numbers of at most 30, over mu of at least 0.5.
    assert p.acceptance == pytest.approx(acceptance, abs=1e-12)
    assert p.rejection == pytest.approx(rejection, abs=1e-12)
    assert p.profit == pytest.approx(earned(p.compensation, v, u, mu, outside), abs=1e-12)


@bounded
@given(seeds, sizes, forms)
def test_every_freely_priced_request_has_the_markup_mu_plus_profit_and_the_others_less(seed, n, form):
    v, u, mu, outside = draw(seed, n)
    p = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form)
    assert p.markup == pytest.approx(mu + p.profit, abs=1e-12)  # one addition of numbers of at most 10
    held = (p.compensation == 0) & form
    assert (v - p.compensation)[~held] == pytest.approx(np.full((~held).sum(), p.markup), abs=1e-12)
    assert (v[held] <= p.markup + 1e-12).all()


# The forms ----------------------------------------------------------------------------------------------------------


@bounded
@given(seeds, sizes)
def test_clipping_is_lemma_3_cut_at_zero_and_never_beats_the_exact_form(seed, n):
    v, u, mu, outside = draw(seed, n)
    free, clip, exact = (
        optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form) for form in (False, "clip", True)
    )
    assert (clip.compensation == np.maximum(free.compensation, 0)).all()
    assert (exact.compensation >= 0).all()
    assert clip.profit <= exact.profit + 1e-12  # rounding of profits of at most 10
    assert exact.profit <= free.profit + 1e-12
    if (free.compensation >= 0).all():
        same(exact, free, 1e-14)
        same(clip, free, 1e-12)  # the clipped form evaluates the probabilities anew from the prices


def test_clipping_can_turn_a_profit_into_a_loss():
    """A worker who loves a ruinous request must be paid away from it; clipping ignores that it will be taken."""
    v, u = [8.0, 8.0, -4.0], [1.0, -4.0, 6.0]
    exact, clip = optimal_prices(v, u), optimal_prices(v, u, nonnegative="clip")
    # 1e-6: the digits given; both agree with the definition above to rounding.
    assert exact.profit == pytest.approx(0.501932, abs=1e-6)
    assert clip.profit == pytest.approx(-3.821914, abs=1e-6)


# Laws ---------------------------------------------------------------------------------------------------------------


@bounded
@given(seeds, sizes, every_form, st.sampled_from([1e-3, 0.01, 100.0, 1024.0]))
def test_prices_do_not_depend_on_the_currency(seed, n, form, scale):
    v, u, mu, outside = draw(seed, n)
    here = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form)
    there = optimal_prices(scale * v, scale * u, scale * mu, outside_utility=scale * outside, nonnegative=form)
    for name, factor in (("compensation", scale), ("markup", scale), ("profit", scale), ("acceptance", 1.0)):
        # 1e-12: the scaled inputs are rounded, at exponents of at most 30.
        assert getattr(there, name) / factor == pytest.approx(getattr(here, name), abs=1e-12)


@bounded
@given(seeds, sizes, every_form, st.floats(-100, 100))
def test_only_the_difference_to_the_outside_utility_matters(seed, n, form, shift):
    v, u, mu, outside = draw(seed, n)
    here = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form)
    there = optimal_prices(v, u + shift, mu, outside_utility=outside + shift, nonnegative=form)
    same(there, here, 1e-11, mu)  # utilities of 100 are rounded by 1e-14


@bounded
@given(seeds, sizes, every_form)
def test_the_order_of_requests_does_not_matter(seed, n, form):
    v, u, mu, outside = draw(seed, n)
    turn = np.random.default_rng(seed).permutation(n)
    here = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form)
    there = optimal_prices(v[turn], u[turn], mu, outside_utility=outside, nonnegative=form)
    assert there.profit == pytest.approx(here.profit, abs=1e-13)  # sums in another order
    assert there.compensation == pytest.approx(here.compensation[turn], abs=1e-13)
    assert there.acceptance == pytest.approx(here.acceptance[turn], abs=1e-13)


@bounded
@given(seeds, sizes, st.integers(2, 5), every_form)
def test_identical_requests_are_one_that_the_worker_likes_more_by_mu_times_the_log_of_their_number(
    seed, n, copies, form
):
    v, u, mu, outside = draw(seed, n)
    many = optimal_prices(np.repeat(v, copies), np.repeat(u, copies), mu, outside_utility=outside, nonnegative=form)
    one = optimal_prices(v, u + mu * np.log(copies), mu, outside_utility=outside, nonnegative=form)
    assert many.profit == pytest.approx(one.profit, abs=1e-12)  # one logarithm, rounded
    assert many.compensation == pytest.approx(np.repeat(one.compensation, copies), abs=1e-12)
    assert many.acceptance.reshape(n, copies).sum(axis=1) == pytest.approx(one.acceptance, abs=1e-12)


@bounded
@given(seeds, sizes, forms)
def test_worth_more_never_earns_less_and_nor_do_free_requests_that_workers_like_more(seed, n, form):
    v, u, mu, outside = draw(seed, n)
    here = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form).profit
    up = np.eye(n)[0]
    assert optimal_prices(v + up, u, mu, outside_utility=outside, nonnegative=form).profit > here
    assert optimal_prices(v, u + up, mu, outside_utility=outside, nonnegative=False).profit > (
        optimal_prices(v, u, mu, outside_utility=outside, nonnegative=False).profit
    )


@bounded
@given(seeds, sizes, forms)
def test_a_request_worth_less_and_liked_less_is_taken_less(seed, n, form):
    v, u, mu, outside = draw(seed, n)
    p = optimal_prices(np.append(v, v[0] - 1), np.append(u, u[0] - 1), mu, outside_utility=outside, nonnegative=form)
    assert p.acceptance[-1] < p.acceptance[0]
    assert p.compensation[-1] <= p.compensation[0]


@pytest.mark.parametrize(("value", "utility", "mu"), [(10.0, -5.0, 1.0), (4.0, 1.0, 2.0), (30.0, -29.0, 0.5)])
def test_one_request_is_the_textbook_monopolist(value, utility, mu):
    """c = v - mu (1 + W0(exp((v + u)/mu - 1)))."""
    m = mu * (1 + lambertw(np.exp((value + utility) / mu - 1)).real)
    p = optimal_prices([value], [utility], mu, nonnegative=False)
    assert p.compensation[0] == pytest.approx(value - m, abs=1e-13)  # one Lambert W, rounded
    assert p.acceptance[0] == pytest.approx(1 - mu / m, abs=1e-14)


def test_a_value_equal_to_the_markup_is_priced_at_zero_either_way():
    """The request is on the edge of being held: both branches give compensation 0 and the same profit."""
    free = optimal_prices([5.0, 6.0], [-1.0, -2.0])
    for nudge in (-1e-15, 0.0, 1e-15):
        v = free.markup + nudge
        # A request worth exactly m earns what the free optimum earns on each worker, so m moves by its share at c = 0.
        p = optimal_prices([5.0, 6.0, v], [-1.0, -2.0, -800.0])
        assert p.compensation[2] == pytest.approx(0, abs=1e-14)
        assert p.markup == pytest.approx(free.markup, abs=1e-14)
    tied = optimal_prices([3.0, 3.0, 3.0], [0.0, 1.0, -1.0])
    assert np.ptp(tied.compensation) == 0


def test_without_noise_the_worker_is_paid_just_enough():
    """mu -> 0, u < u_0: c_i = u_0 - u_i and the best v_i + u_i - u_0 is earned, or nothing is worth it."""
    v, u, mu = np.array([30.0, 40.0, 25.0]), np.array([-10.0, -25.0, -3.0]), 1e-3
    for outside, profit in ((0.0, 22.0), (23.0, 0.0)):
        p = optimal_prices(v, u, mu, outside_utility=outside)
        # The distance to the limit is mu ln(profit / mu), 0.01.
        assert p.profit == pytest.approx(profit, abs=0.02)
        if profit:
            assert p.compensation[2] == pytest.approx(outside - u[2], abs=0.02)
            assert p.acceptance[2] == pytest.approx(1, abs=1e-3)


def test_with_noise_alone_nothing_is_paid_and_every_option_is_as_likely():
    """mu -> infinity: m exceeds every value, so all are held at 0; Lemma 3's own limit is P_0 = 1 / (1 + W0(n / e))."""
    v, u = np.arange(1.0, 6.0), -np.arange(5.0)
    p = optimal_prices(v, u, 1e9)
    assert (p.compensation == 0).all()
    assert p.acceptance == pytest.approx(np.full(5, 1 / 6), abs=1e-8)  # utilities of 5 against mu = 1e9
    free = optimal_prices(v, u, 1e9, nonnegative=False)
    assert free.rejection == pytest.approx(1 / (1 + lambertw(5 / np.e).real), abs=1e-8)


@bounded
@given(seeds, sizes)
def test_worthless_requests_cost_least_at_no_pay_or_at_a_pay_that_draws_workers_from_worse(seed, n):
    v, u, mu, outside = draw(seed, n)
    v = -np.abs(v) - 0.1
    p = optimal_prices(v, u, mu, outside_utility=outside)
    assert earned(np.zeros(n), v, u, mu, outside) - 1e-12 <= p.profit <= 0
    assert optimal_prices(v, u, mu, outside_utility=outside, nonnegative=False).profit > 0


# Masks, shapes, emptiness -------------------------------------------------------------------------------------------


@bounded
@given(seeds, sizes, every_form)
def test_a_masked_request_is_a_deleted_one(seed, n, form):
    v, u, mu, outside = draw(seed, n)
    offered = np.random.default_rng(seed).random(n) < 0.6
    p = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form, offered=offered)
    kept = optimal_prices(v[offered], u[offered], mu, outside_utility=outside, nonnegative=form)
    assert (p.compensation[~offered] == 0).all()
    assert (p.acceptance[~offered] == 0).all()
    # 1e-13: sums over zeros may be added in another order.
    assert p.compensation[offered] == pytest.approx(kept.compensation, abs=1e-13)
    assert p.acceptance[offered] == pytest.approx(kept.acceptance, abs=1e-13)
    assert (p.rejection, p.markup, p.profit) == pytest.approx((kept.rejection, kept.markup, kept.profit), abs=1e-13)


@pytest.mark.parametrize("form", [True, False, "clip"])
def test_many_decisions_at_once_are_each_alone(form):
    rng = np.random.default_rng(1)
    v, u, offered = rng.uniform(-5, 9, (3, 1, 4)), rng.uniform(-6, 4, (5, 4)), rng.random((3, 5, 4)) < 0.7
    mu, outside = rng.uniform(0.2, 3, (3, 1)), rng.uniform(-1, 1, 5)
    together = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=form, offered=offered)
    assert together.compensation.shape == together.acceptance.shape == (3, 5, 4)
    assert together.rejection.shape == together.markup.shape == together.profit.shape == (3, 5)
    for i, j in np.ndindex(3, 5):
        alone = optimal_prices(
            v[i, 0], u[j], mu[i, 0], outside_utility=outside[j], nonnegative=form, offered=offered[i, j]
        )
        for name in ("compensation", "acceptance", "rejection", "markup", "profit"):
            assert (getattr(together, name)[i, j] == getattr(alone, name)).all()


@pytest.mark.parametrize("form", [True, False, "clip"])
def test_with_nothing_on_offer_nothing_happens(form):
    for p in (
        optimal_prices([], [], 2.0, nonnegative=form),
        optimal_prices([9.0, -9.0], [1.0, 1.0], 2.0, nonnegative=form, offered=[False, False]),
    ):
        assert (p.compensation == 0).all()
        assert (p.acceptance == 0).all()
        assert (p.rejection, p.markup, p.profit) == (1, 2, 0)
    assert optimal_prices(np.zeros((0, 3)), np.zeros((0, 3)), nonnegative=form).acceptance.shape == (0, 3)
    assert optimal_prices(np.zeros((4, 0)), np.zeros((4, 0)), nonnegative=form).profit.shape == (4,)


def test_the_caller_keeps_the_arrays():
    v, u, offered = np.array([[5.0, -6.0]]), np.array([[1.0, 2.0]]), np.array([[True, True]])
    before = v.copy(), u.copy(), offered.copy()
    optimal_prices(v, u, offered=offered)
    assert all((x == y).all() for x, y in zip((v, u, offered), before, strict=True))


# The whole range ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(bounded, max_examples=75)
@given(
    seeds,
    st.sampled_from([1, 2, 5, 30, 1000]),
    st.floats(-3, 3),
    st.floats(-3, 6),
    st.floats(-3, 6),
    st.booleans(),
    every_form,
)
def test_any_scale_gives_probabilities_and_prices_that_certify_without_a_warning(
    seed, n, log_mu, log_value, log_utility, cancel, form
):
    rng = np.random.default_rng(seed)
    v, u, mu = 10.0**log_value * rng.uniform(-1, 1, n), 10.0**log_utility * rng.uniform(-1, 1, n), 10.0**log_mu
    if cancel:
        u = mu * rng.standard_normal(n) - v
    p = optimal_prices(v, u, mu, nonnegative=form)
    for name in ("compensation", "acceptance", "rejection", "markup", "profit"):
        assert np.isfinite(getattr(p, name)).all()
    assert (p.acceptance >= 0).all()
    assert p.acceptance.sum() + p.rejection == pytest.approx(1, abs=1e-12)  # a sum of 1000 terms rounds by 1e-13
    proof = certify(p.compensation, v, u, mu, nonnegative=form is not False)
    if form == "clip":
        assert proof.infeasibility == 0
    else:
        assert proof.optimal


@pytest.mark.parametrize("form", [True, False, "clip"])
def test_a_request_that_cannot_be_served_is_a_deleted_one(form):
    v, u = [5.0, 1e300, 6.0], [-1.0, -np.inf, -2.0]
    p, kept = optimal_prices(v, u, nonnegative=form), optimal_prices([5.0, 6.0], [-1.0, -2.0], nonnegative=form)
    assert (p.compensation[1], p.acceptance[1]) == (0, 0)
    assert p.compensation[[0, 2]] == pytest.approx(kept.compensation, abs=1e-14)
    assert (p.rejection, p.markup, p.profit) == pytest.approx((kept.rejection, kept.markup, kept.profit), abs=1e-14)
    masked = optimal_prices(v, [-1.0, 1e308, -2.0], nonnegative=form, offered=[True, False, True])
    assert masked.profit == pytest.approx(kept.profit, abs=1e-14)


@pytest.mark.parametrize("ruin", [-1e6, -1e12, -1e16, -1e30, -1e200])
def test_workers_are_paid_away_from_a_request_that_must_not_be_taken(ruin):
    """Paying c makes the ruin e^-c as likely: the least of ruin e^-c - c is at c = log(-ruin)."""
    v, u = [ruin, 30.0], [0.0, 0.0]
    p = optimal_prices(v, u)
    # The worker may also reject, as rarely: that costs the 30, little against the ruin.
    assert p.compensation[1] == pytest.approx(np.log(-ruin), rel=1e-3 if ruin == -1e6 else 1e-6)
    assert certify(p.compensation, v, u).optimal
    assert p.profit == pytest.approx(certify(p.compensation, v, u).profit, rel=1e-9)


# Errors -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"value": [1.0, np.nan]}, r"value\[1\] is nan"),
        ({"value": [[1.0, 2.0], [3.0, np.inf]]}, r"value\[1, 1\] is inf"),
        ({"utility": [np.inf, 0.0]}, r"utility\[0\] is inf"),
        ({"value": [-np.inf, 0.0]}, r"value\[0\] is -inf"),
        ({"mu": 0.0}, "mu = 0.0 is not positive"),
        ({"mu": [1.0, -2.0]}, "mu = -2.0 is not positive"),
        ({"mu": np.nan}, "mu is nan"),
        ({"mu": "one"}, "mu holds text"),
        ({"outside_utility": np.nan}, "outside_utility is nan"),
        ({"value": 3.0}, "value is a single number"),
        ({"utility": 3.0}, "utility is a single number"),
        ({"utility": [1.0, 2.0, 3.0]}, "shapes do not fit"),
        ({"value": [[1.0, 2.0]] * 3, "mu": [1.0, 1.0]}, "shapes do not fit"),
        ({"offered": [True, True, True]}, "shapes do not fit"),
        ({"offered": True}, "offered is a single number"),
        ({"nonnegative": "round"}, "nonnegative = 'round' is unknown"),
        ({"nonnegative": None}, "nonnegative = None is unknown"),
        ({"value": [[1.0, 2.0], [3.0]]}, "value is ragged"),
        ({"value": [1e17, 2.0]}, "leave no room for one that fine"),
        ({"utility": [1e17, 2.0], "nonnegative": False}, "leave no room for one that fine"),
        ({"value": [1e308, 2.0], "utility": [1e308, 0.0]}, "are beyond any float"),
        ({"utility": [-1e300, 0.0], "mu": 1e-12}, "are beyond any float .request 0.; .* utility -inf"),
        ({"utility": [1.0, 0.0], "mu": 1e-310}, "mu = 1e-310 is too near an end"),
        ({"mu": 1e305}, r"mu = 1e\+305 is too near an end"),
    ],
)
def test_bad_input_is_named_in_one_line(change, words):
    arguments = {"value": [1.0, 2.0], "utility": [0.0, 0.0], "mu": 1.0} | change
    with pytest.raises(InputError, match=words) as caught:
        optimal_prices(**arguments)
    assert "\n" not in str(caught.value)


def test_prices_as_a_table():
    """A row per request of each decision, and on one screen of a notebook, however many there are."""
    one, many = optimal_prices([5.0, 6.0], [-1.0, -2.0]), optimal_prices(np.full((300, 3), 5.0), [-1.0] * 3)
    assert one.to_frame()["compensation"].tolist() == one.compensation.tolist()
    assert many.to_frame()["decision"].tolist() == np.repeat(np.arange(300), 3).tolist()
    assert 11 <= many._repr_html_().count("<tr") <= 13
    assert "300 decisions" in many._repr_html_()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("far", [1e3, 1e6, 1e9, 1e12])
@pytest.mark.parametrize("mu", [1.0, 30.0])
def test_who_must_take_something(seed, far, mu):
    """However unwelcome rejecting is, what is said of prices is what their certificate says, not above its bound."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    value, utility = rng.uniform(-20, 100, n), rng.uniform(-5, 5, n)
    found = optimal_prices(value, utility, mu, outside_utility=-far)
    proof = certify(found.compensation, value, utility, mu, outside_utility=-far)
    assert proof.optimal
    assert found.profit == pytest.approx(proof.profit, rel=1e-10, abs=1e-10)
    assert found.profit <= proof.bound + 1e-10 * (mu + abs(proof.bound))
    assert found.acceptance.sum() + found.rejection == pytest.approx(1.0, abs=1e-12)
    many = optimal_prices(np.tile(value, (3, 1)), utility, mu, outside_utility=[-far, 0.0, -far])
    assert many.profit[[0, 2]] == pytest.approx(float(found.profit), rel=1e-12)
    assert many.profit[1] == pytest.approx(float(optimal_prices(value, utility, mu).profit), rel=1e-12)


@pytest.mark.parametrize("size", [1e6, 1e8, 1e10, 3e11, 1e12])
def test_large_amounts_that_cancel(size):
    """Value, utility and outside option as large as that: profit and acceptance are those of the prices, to the digit.

    The references are differences of the very floats, in 60 digits.
    """
    rng = np.random.default_rng(int(size))
    for _ in range(12):
        n = int(rng.integers(1, 4))
        value = size * rng.uniform(0.3, 1.0) + rng.uniform(0, 10, n)
        utility = rng.uniform(-5, 15, n) - value
        outside = size * float(rng.choice([0.0, 0.7, -0.7]))
        found = optimal_prices(value, utility + outside, 1.0, outside_utility=outside)
        with mpmath.workdps(60):
            paid, worth = (list(map(mpmath.mpf, x)) for x in (found.compensation, value))
            liked = [mpmath.mpf(u) + c - mpmath.mpf(outside) for u, c in zip(utility + outside, paid, strict=True)]
            weight = [mpmath.exp(x - max(*liked, 0)) for x in [*liked, mpmath.mpf(0)]]
            share = [w / sum(weight) for w in weight[:-1]]
            profit = sum(p * (v - c) for p, v, c in zip(share, worth, paid, strict=True))
        assert float(found.profit) == pytest.approx(float(profit), rel=1e-9, abs=1e-9)
        assert found.acceptance == pytest.approx([float(p) for p in share], rel=1e-9, abs=1e-12)
        proof = certify(found.compensation, value, utility + outside, 1.0, outside_utility=outside)
        assert found.profit <= proof.bound + 1e-12 * (1.0 + abs(proof.bound))


@pytest.mark.parametrize("far", [1e13, 1e17, 1e20])
def test_utilities_without_digits_are_refused(far):
    """Where differences among requests are lost, but not for a request that nobody takes."""
    with pytest.raises(InputError, match="away from the outside utility"):
        optimal_prices([100.0, 90.0], [-5.0, 3.0], 1.0, outside_utility=-far)
    assert optimal_prices([100.0, 90.0], [-5.0, -far], 1.0).acceptance[1] == 0.0
