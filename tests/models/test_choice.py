"""Multinomial logit choice."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.basics.errors import InputError
from optkit.models.choice import acceptance_probabilities

pytestmark = pytest.mark.filterwarnings("error")

bounded = settings(derandomize=True, deadline=None, max_examples=30)
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 12)


def draw(seed, n, scale=10.0):
    """Compensation, utility, mu and outside utility of one decision, all of the order of ``scale``."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, scale, n), rng.uniform(-scale, scale, n), rng.uniform(0.5, 5.0), rng.uniform(-scale, scale)


@bounded
@given(seeds, sizes)
def test_probabilities_are_the_softmax_with_the_outside_option_counted_once(seed, n):
    c, u, mu, outside = draw(seed, n)
    weight, idle = np.exp((u + c) / mu), np.exp(outside / mu)
    acceptance, rejection = acceptance_probabilities(c, u, mu, outside_utility=outside)
    # 1e-13: exponents up to 60 round by 1e-14, and enter the probability relatively.
    assert acceptance == pytest.approx(weight / (idle + weight.sum()), rel=1e-13)
    assert rejection == pytest.approx(idle / (idle + weight.sum()), rel=1e-13)


def test_probabilities_are_the_frequencies_of_the_best_option_under_gumbel_noise():
    c, u, mu, outside, draws = np.array([3.0, 5.0, 4.0]), np.array([-2.0, -5.0, -3.0]), 2.0, 0.5, 200_000
    noise = np.random.default_rng(0).gumbel(0, mu, (draws, 4))
    best = np.argmax(np.append(u + c, outside) + noise, axis=1)
    frequency = np.bincount(best, minlength=4) / draws
    acceptance, rejection = acceptance_probabilities(c, u, mu, outside_utility=outside)
    # Five standard deviations of a frequency, at most sqrt(1/4 / 200,000) = 0.0011 each.
    assert frequency == pytest.approx(np.append(acceptance, rejection), abs=5 * 0.0011)


def test_without_noise_the_best_offer_wins_and_equal_offers_share():
    """mu -> 0: the logit turns into the argmax; ties split evenly."""
    for offer, expected in (
        ([2.0, 3.0, 1.0], [0, 1, 0]),
        ([3.0, 3.0, 1.0], [0.5, 0.5, 0]),
        ([-1.0, -2.0, -3.0], [0, 0, 0]),
    ):
        acceptance, rejection = acceptance_probabilities(offer, np.zeros(3), 1e-3)
        assert acceptance == pytest.approx(expected, abs=1e-300)  # exp(-1000) is 0
        assert rejection == pytest.approx(1 - sum(expected), abs=1e-300)


def test_with_noise_alone_every_option_is_as_likely_as_rejection():
    """mu -> infinity: 1 / (n + 1); utilities of 100 against mu = 1e9 move it by 1e-7 at most."""
    acceptance, rejection = acceptance_probabilities(np.arange(5.0), np.linspace(-100, 100, 5), 1e9)
    assert acceptance == pytest.approx(np.full(5, 1 / 6), abs=1e-7)
    assert rejection == pytest.approx(1 / 6, abs=1e-7)


@bounded
@given(seeds, sizes, st.floats(-50, 50), st.floats(1e-3, 1e3))
def test_only_differences_of_utility_and_ratios_to_mu_matter(seed, n, shift, scale):
    c, u, mu, outside = draw(seed, n)
    here, rejected = acceptance_probabilities(c, u, mu, outside_utility=outside)
    shifted = acceptance_probabilities(c, u + shift, mu, outside_utility=outside + shift)
    scaled = acceptance_probabilities(scale * c, scale * u, scale * mu, outside_utility=scale * outside)
    for acceptance, rejection in (shifted, scaled):
        # 1e-12: adding a shift of 50 rounds the exponents by 1e-14.
        assert acceptance == pytest.approx(here, rel=1e-12)
        assert rejection == pytest.approx(rejected, rel=1e-12)


@bounded
@given(seeds, sizes)
def test_paying_one_request_more_draws_workers_to_it_from_everything_else(seed, n):
    c, u, mu, outside = draw(seed, n)
    before, idle_before = acceptance_probabilities(c, u, mu, outside_utility=outside)
    c[0] += 1.0
    after, idle_after = acceptance_probabilities(c, u, mu, outside_utility=outside)
    assert after[0] > before[0]
    assert (after[1:] < before[1:]).all()
    assert idle_after < idle_before


@bounded
@given(seeds, sizes)
def test_a_masked_request_is_a_deleted_one(seed, n):
    c, u, mu, outside = draw(seed, n)
    offered = np.random.default_rng(seed).random(n) < 0.5
    acceptance, rejection = acceptance_probabilities(c, u, mu, outside_utility=outside, offered=offered)
    kept, idle = acceptance_probabilities(c[offered], u[offered], mu, outside_utility=outside)
    assert (acceptance[~offered] == 0).all()
    # 1e-14: sums over other zeros may be added in another order.
    assert acceptance[offered] == pytest.approx(kept, rel=1e-14)
    assert rejection == pytest.approx(idle, rel=1e-14)


def test_many_decisions_at_once_are_each_alone():
    rng = np.random.default_rng(1)
    c, u = rng.uniform(0, 9, (3, 1, 4)), rng.uniform(-9, 0, (5, 4))
    mu, outside, offered = rng.uniform(0.5, 2, (3, 1)), rng.uniform(-1, 1, 5), rng.random((3, 5, 4)) < 0.7
    acceptance, rejection = acceptance_probabilities(c, u, mu, outside_utility=outside, offered=offered)
    assert acceptance.shape == (3, 5, 4)
    assert rejection.shape == (3, 5)
    for i, j in np.ndindex(3, 5):
        alone = acceptance_probabilities(c[i, 0], u[j], mu[i, 0], outside_utility=outside[j], offered=offered[i, j])
        assert (acceptance[i, j] == alone[0]).all()
        assert rejection[i, j] == alone[1]


@bounded
@given(seeds, st.sampled_from([1, 2, 30, 1000]), st.floats(-3, 3), st.floats(-3, 6))
def test_probabilities_add_up_to_one_at_any_scale_without_a_warning(seed, n, log_mu, log_scale):
    c, u, _, outside = draw(seed, n, 10.0**log_scale)
    acceptance, rejection = acceptance_probabilities(c, u, 10.0**log_mu, outside_utility=outside)
    assert (acceptance >= 0).all()
    assert acceptance.sum() + rejection == pytest.approx(1, abs=1e-12)  # a sum of 1000 terms rounds by 1e-13


def test_a_request_that_cannot_be_served_is_a_deleted_one():
    acceptance, rejection = acceptance_probabilities([1.0, 1e300, 2.0], [-1.0, -np.inf, -2.0])
    kept, idle = acceptance_probabilities([1.0, 2.0], [-1.0, -2.0])
    assert acceptance == pytest.approx([kept[0], 0.0, kept[1]], rel=1e-15)
    assert rejection == pytest.approx(idle, rel=1e-15)


def test_with_nothing_to_take_the_worker_takes_nothing():
    for acceptance, rejection in (
        acceptance_probabilities([], []),
        acceptance_probabilities([9.0, 9.0], [1.0, 1.0], offered=[False, False]),
    ):
        assert (acceptance == 0).all()
        assert rejection == 1


def test_no_decisions_have_no_probabilities():
    acceptance, rejection = acceptance_probabilities(np.zeros((0, 2)), np.zeros((0, 2)))
    assert acceptance.shape == (0, 2)
    assert rejection.shape == (0,)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"compensation": [1.0, np.nan]}, r"compensation\[1\] is nan"),
        ({"utility": [np.inf, 0.0]}, r"utility\[0\] is inf"),
        ({"mu": 0.0}, "mu = 0.0 is not positive"),
        ({"mu": -1.0}, "mu = -1.0 is not positive"),
        ({"mu": np.nan}, "mu is nan"),
        ({"outside_utility": -np.inf}, "outside_utility is -inf"),
        ({"compensation": 3.0}, "compensation is a single number"),
        ({"utility": [1.0, 2.0, 3.0]}, "shapes do not fit"),
        ({"offered": [True, True, True]}, "shapes do not fit"),
        ({"utility": ["a", "b"]}, "utility holds text"),
    ],
)
def test_bad_input_is_named_in_one_line(change, words):
    arguments = {"compensation": [1.0, 2.0], "utility": [0.0, 0.0], "mu": 1.0} | change
    with pytest.raises(InputError, match=words) as caught:
        acceptance_probabilities(**arguments)
    assert "\n" not in str(caught.value)
