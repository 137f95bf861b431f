"""The markup in closed form, against seventy-digit arithmetic and against every set of held requests."""

import decimal
from decimal import Decimal
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import lambertw

from optkit.models.decision import Decisions
from optkit.models.pricing import closed_form

pytestmark = pytest.mark.filterwarnings("error")

bounded = settings(derandomize=True, deadline=None, max_examples=40)
seeds = st.integers(0, 2**32 - 1)
EPS = np.finfo(float).eps


def decision(value, utility, mu=1.0, outside=0.0):
    return Decisions.of(value, utility, mu, outside, None)


def exact(value, utility, mu, outside, nonnegative, start):
    """Profit and probabilities in 70 digits: Newton on R - sum_i max_c w_i e^(c/mu) (v_i - c - R) = 0.

    Money is divided by mu. The left-hand side increases in R and is concave, so the root is
    unique, and where Newton started does not matter.
    """
    wide = decimal.Context(prec=70, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN)
    with decimal.localcontext(wide):
        scale = Decimal(float(mu))
        v = [Decimal(float(x)) / scale for x in value]
        log_odds = [(Decimal(float(x)) - Decimal(float(outside))) / scale for x in utility]
        R = Decimal(float(start)) / scale
        for _ in range(100):
            price = [vi - 1 - R if not nonnegative or vi > 1 + R else Decimal(0) for vi in v]
            weight = [(li + ci).exp() for li, ci in zip(log_odds, price, strict=True)]
            left = R - sum(w * (vi - ci - R) for w, vi, ci in zip(weight, v, price, strict=True))
            step = left / (1 + sum(weight))
            R -= step
            if abs(step) <= abs(R) * Decimal("1e-40") + Decimal("1e-50"):
                break
        else:
            raise AssertionError(f"the reference did not converge from {start}")
        total = 1 + sum(weight)
        return float(R * scale), np.array([float(w / total) for w in weight]), float(1 / total)


def check_against_exact(value, utility, mu, outside, nonnegative):
    solve = closed_form.nonnegative if nonnegative else closed_form.unconstrained
    found = solve(decision(value, utility, mu, outside))
    profit = mu * found.ratio[0, 0]
    true_profit, true_acceptance, true_rejection = exact(value, utility, mu, outside, nonnegative, profit)
    # Half a unit in the last place of the largest input cannot be told apart; 3,000 random cases stayed below 1.1.
    unit = EPS * (mu + abs(true_profit) + np.abs(value).max() + np.abs(utility).max() + abs(outside))
    assert abs(profit - true_profit) <= 4 * unit
    assert np.abs(found.acceptance[0] - true_acceptance).max() <= 4 * unit / mu
    assert abs(found.rejection[0, 0] - true_rejection) <= 4 * unit / mu


@bounded
@given(seeds, st.integers(1, 10))
def test_the_markup_satisfies_lamberts_equation(seed, n):
    """(m/mu - 1) exp(m/mu - 1) = sum_i exp((a_i - mu)/mu), Lemma 3 of the paper."""
    rng = np.random.default_rng(seed)
    v, u, mu, outside = rng.uniform(-5, 20, n), rng.uniform(-20, 5, n), rng.uniform(0.5, 5), rng.uniform(-3, 3)
    y = closed_form.unconstrained(decision(v, u, mu, outside)).ratio[0, 0]
    # 1e-12: exponents up to 50 round by 1e-14.
    assert y * np.exp(y) == pytest.approx(np.exp((v + u - outside - mu) / mu).sum(), rel=1e-12)


@bounded
@given(seeds, st.integers(1, 10))
def test_probabilities_have_the_form_printed_in_lemma_3(seed, n):
    rng = np.random.default_rng(seed)
    v, u, mu = rng.uniform(-5, 20, n), rng.uniform(-20, 5, n), rng.uniform(0.5, 5)
    found = closed_form.unconstrained(decision(v, u, mu))
    m = mu * (1 + found.ratio[0, 0])
    # 1e-12: the printed form subtracts two numbers of up to 40 in the exponent.
    assert found.rejection[0, 0] == pytest.approx(mu / m, rel=1e-14)
    assert found.acceptance[0] == pytest.approx(mu / m * np.exp((v + u - m) / mu), rel=1e-12)


@pytest.mark.slow
@bounded
@given(
    seeds,
    st.sampled_from([1, 2, 3, 8, 40]),
    st.floats(-3, 3),
    st.floats(-2, 6),
    st.floats(-2, 6),
    st.sampled_from(["any", "cancelling", "tied", "gig", "worthless"]),
    st.booleans(),
)
def test_profit_and_probabilities_are_exact_to_the_rounding_of_the_input_at_any_scale(
    seed, n, log_mu, log_value, log_utility, kind, nonnegative
):
    rng = np.random.default_rng(seed)
    mu, high, wide = 10.0**log_mu, 10.0**log_value, 10.0**log_utility
    v, u = high * rng.uniform(-1, 1, n), wide * rng.uniform(-1, 1, n)
    if kind == "cancelling":
        u = -v + 3 * mu * rng.standard_normal(n)
    elif kind == "tied":
        v, u = high * np.round(2 * rng.uniform(-1, 1, n)) / 2, wide * np.round(2 * rng.uniform(-1, 1, n)) / 2
    elif kind == "gig":
        v, u = np.abs(v), -np.abs(u)
    elif kind == "worthless":
        v = -np.abs(v)
    check_against_exact(v, u, mu, rng.choice([0.0, wide * rng.uniform(-1, 1)]), nonnegative)


@pytest.mark.slow
@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize(("scale", "mu"), [(1.0, 1.0), (1e3, 1e-3), (1e6, 1e-3), (1e6, 1e3)])
def test_a_thousand_requests_are_exact_too(scale, mu, nonnegative):
    rng = np.random.default_rng(2)
    check_against_exact(scale * rng.uniform(-1, 1, 1000), scale * rng.uniform(-1, 1, 1000), mu, 0.0, nonnegative)


@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize(
    ("value", "utility", "mu"),
    [
        ([1e6], [1e6], 1e-3),
        ([1e6], [-1e6], 1e-3),
        ([-1e6], [1e6], 1e-3),
        ([-1e6], [-1e6], 1e-3),
        ([1e6, -1e6], [-1e6, 1e6], 1e-3),
        ([1e6, -1e6, 1e6], [1e6, 1e6, -1e6], 1e3),
        ([1e-6, 2e-6], [1e6, 1e6], 1e-3),
        ([0.0, 0.0], [0.0, 0.0], 1e-3),
        ([-1e-3, 1e-3], [1e6, 1e6 - 1e-3], 1e-3),
    ],
)
def test_the_corners_of_the_range_are_exact(value, utility, mu, nonnegative):
    check_against_exact(np.array(value), np.array(utility), mu, 0.0, nonnegative)


def best_of_all_holdings(v, u, mu):
    """Profit of the best k requests of lowest value held at 0, over every k whose free prices are not negative."""
    order = np.argsort(v)
    v, logit = v[order], u[order] / mu
    w, free = np.exp(logit), np.exp(v / mu + logit - 1)
    held = np.append(0.0, np.cumsum(w))
    s = np.append(0.0, np.cumsum(w * v)) / (mu * (1 + held))
    total = np.append(np.cumsum(free[::-1])[::-1], 0.0)
    ratio = s + lambertw(total * np.exp(-s) / (1 + held)).real
    feasible = np.append(v, np.inf) >= mu * (1 + ratio) - 1e-9
    return mu * ratio[feasible].max()


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 3, 8, 40, 1000])
def test_every_number_of_held_requests_occurs_and_is_the_best(n):
    """Sliding all values from high to low moves the number of held requests from 0 to n."""
    rng = np.random.default_rng(n)
    base, u, mu = 0.1 * rng.permutation(n) / max(1, n // 40), rng.uniform(-1, 1, n) - np.log(n), 1.0
    shifts = np.linspace(-10, 60, 20_001 if n <= 40 else 401)
    d = decision(base + shifts[:, None], u, mu)
    found = closed_form.nonnegative(d)
    number = found.held.sum(axis=1)
    assert set(range(n + 1)) <= set(number) if n <= 40 else len(set(number)) > 50
    assert (np.diff(number) <= 0).all()
    for row in range(0, len(shifts), 1 + len(shifts) // 400):
        # 1e-8: a price may be negative by 1e-9 in the reference, which lets it earn about that much more.
        assert mu * found.ratio[row, 0] == pytest.approx(best_of_all_holdings(base + shifts[row], u, mu), abs=1e-8)


@pytest.mark.slow
@bounded
@given(seeds, st.integers(1, 6))
def test_no_other_set_of_held_requests_earns_more(seed, n):
    """All 2^n sets, not only those of lowest value; where the free prices come out negative the set is not allowed."""
    rng = np.random.default_rng(seed)
    v, w = rng.uniform(-3, 6, n), np.exp(rng.uniform(-3, 3, n))
    best = -np.inf
    for held in (list(chosen) for k in range(n + 1) for chosen in combinations(range(n), k)):
        free = np.setdiff1d(np.arange(n), held)
        s = (w[held] * v[held]).sum() / (1 + w[held].sum())
        ratio = s + lambertw((w[free] * np.exp(v[free] - 1 - s)).sum() / (1 + w[held].sum())).real
        if (v[free] >= 1 + ratio).all():
            best = max(best, ratio)
    # 1e-12: profits of at most 10, rounded.
    assert closed_form.nonnegative(decision(v, np.log(w))).ratio[0, 0] == pytest.approx(best, abs=1e-12)


@bounded
@given(seeds, st.integers(1, 30), st.booleans())
def test_the_dual_constraint_holds_above_the_optimum_and_fails_below(seed, n, nonnegative):
    rng = np.random.default_rng(seed)
    d = decision(rng.uniform(-30, 60, n), rng.uniform(-40, 20, n), rng.uniform(0.1, 10))
    ratio = (closed_form.nonnegative if nonnegative else closed_form.unconstrained)(d).ratio
    # A profit near 0 has slack in its logarithm at any distance; 1e-10 relative to 1000 = values over the smallest mu.
    step = 1e-10 * (1000 + np.abs(ratio))
    assert closed_form.dual_slack(d, ratio + step, nonnegative) > 0
    assert closed_form.dual_slack(d, ratio - step, nonnegative) < 0


@pytest.mark.slow
def test_held_sets_found_for_a_batch_are_those_found_alone():
    """The search drops finished rows as it goes; the others must not notice."""
    rng = np.random.default_rng(3)
    v, u, mu = rng.uniform(-20, 30, (300, 7)), rng.uniform(-10, 10, (300, 7)), 10.0 ** rng.uniform(-2, 2, 300)
    together = closed_form.nonnegative(decision(v, u, mu))
    for i in range(300):
        alone = closed_form.nonnegative(decision(v[i], u[i], mu[i]))
        held = np.zeros(7, bool) if alone.held is None else alone.held[0]
        assert (together.held[i] == held).all()
        assert together.ratio[i, 0] == alone.ratio[0, 0]
