"""Performance ratios and confidence intervals, by hand and against SciPy."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import ttest_rel

from optkit.basics.errors import InputError
from optkit.simulation.metrics import mean_interval, performance_ratio

MONEY = st.floats(-1e6, 1e6)


def test_ratio_by_hand():
    """The ratio is 100 (1 - (opt - alg) / (opt - sum of penalties)), instance by instance."""
    ratio = performance_ratio([80.0, 10.0, -40.0], [100.0, 50.0, 60.0], [-20.0, -30.0, -30.0])
    assert ratio == pytest.approx([100 * (1 - 20 / 120), 100 * (1 - 40 / 80), 100 * (1 - 100 / 90)])


@pytest.mark.slow
@given(st.lists(st.tuples(st.floats(-1e6, 0), st.floats(1e-3, 1e6)), min_size=1, max_size=5))
def test_ratio_of_the_extremes(pairs):
    """The full-information solution has ratio 100 and letting everything expire has ratio 0.

    The difference opt - penalties is exact to rounding of numbers up to 2e6, against a room of at least 1e-3: 1e-5.
    """
    least = np.array([a for a, _ in pairs])
    best = least + [room for _, room in pairs]
    assert performance_ratio(best, best, least) == pytest.approx(np.full(least.size, 100.0))
    assert performance_ratio(least, best, least) == pytest.approx(np.zeros(least.size), abs=1e-5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([5.0], [10.0], [4.0]), "positive; write costs of expiry"),
        (([-1e308], [1e-5], [0.0]), "beyond any float"),
        (([1e308], [1e-5], [0.0]), "lies above full_information"),
    ],
)
def test_ratios_that_say_nothing(given, message):
    """Costs of expiry with the wrong sign, and money of sizes that no ratio can tell."""
    with pytest.raises(InputError, match=message):
        performance_ratio(*given)


def test_ratio_of_a_policy_that_loses_money():
    """A policy that earns less than letting everything expire has a negative ratio."""
    assert performance_ratio(-30.0, 10.0, -20.0) == pytest.approx([-100 / 3])


def test_ratio_where_nothing_can_be_gained():
    """Where the bound equals the penalties, a policy that gets as much has 100 and one that gets less -inf."""
    assert performance_ratio([-20.0, -25.0, 0.0], [-20.0, -20.0, 0.0], [-20.0, -20.0, 0.0]).tolist() == [
        100,
        -np.inf,
        100,
    ]


def test_ratio_where_nothing_but_rounding_can_be_gained():
    """A bound above the penalties by rounding alone leaves nothing to gain: the ratio is 100, not 0 or -100."""
    least = -20.0
    best = np.nextafter(least, 0.0)
    assert performance_ratio([least, np.nextafter(least, -100)], [best, best], [least, least]).tolist() == [100, 100]


def test_ratio_of_rounding_where_nothing_can_be_gained():
    """A reward that misses an equal bound by rounding alone still has ratio 100."""
    assert performance_ratio([np.nextafter(-20.0, -100)], [-20.0], [-20.0]).tolist() == [100.0]


def test_ratio_of_nobody():
    """No instances give no ratios."""
    assert performance_ratio([], [], []).shape == (0,)


@pytest.mark.parametrize(
    ("reward", "best", "least", "words"),
    [
        ([1.0, 2.0], [3.0], [0.0], "lengths differ"),
        ([1.0], [3.0], 0.0, None),
        ([np.nan], [3.0], [0.0], "finite"),
        ([1.0], [np.inf], [0.0], "finite"),
        ([1.0], [3.0], [-np.inf], "finite"),
    ],
)
def test_bad_arguments_of_the_ratio(reward, best, least, words):
    """Lengths that differ and numbers that are not finite are errors; plain numbers are one instance."""
    if words is None:
        assert performance_ratio(reward, best, least).shape == (1,)
    else:
        with pytest.raises(InputError, match=words):
            performance_ratio(reward, best, least)


def test_ratio_of_a_bound_below_the_penalties():
    """No valid bound lies below the penalties of everything: such arguments were mixed up, and that is an error."""
    with pytest.raises(InputError):
        performance_ratio([-15.0], [-30.0], [-20.0])


@pytest.mark.parametrize("penalty", [-1e6, -1e9, -1e12])
def test_one_huge_penalty_softens_nothing(penalty):
    """A reward above the bound by more than the rounding of a sum with the penalties is refused."""
    assert performance_ratio([50.0], [50.0], [penalty]).tolist() == [100.0]
    with pytest.raises(InputError, match="lies above full_information"):
        performance_ratio([50.0 + 1e-6 + 1e-11 * abs(penalty)], [50.0], [penalty])


def test_mean_interval_by_hand():
    """The interval is mean +- t s / sqrt(B) with B - 1 degrees of freedom; for B = 4 and 95 %, t = 3.182446."""
    found = mean_interval([1.0, 2.0, 4.0, 5.0])
    s = np.sqrt((4 + 1 + 1 + 4) / 3)
    assert (found.mean, found.count) == (3.0, 4)
    assert found.std == pytest.approx(s)
    assert (found.low, found.high) == pytest.approx((3 - 3.182446 * s / 2, 3 + 3.182446 * s / 2), abs=1e-5)


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.99])
def test_mean_interval_against_scipy(confidence):
    """Plain and paired intervals are those of SciPy's t tests (1e-12 relative)."""
    rng = np.random.default_rng(0)
    one, other = rng.normal(5, 2, 40), rng.normal(4, 3, 40)
    plain = stats.ttest_1samp(one, 0).confidence_interval(confidence)
    paired = stats.ttest_rel(one, other).confidence_interval(confidence)
    for found, expected in (
        (mean_interval(one, confidence=confidence), plain),
        (mean_interval(one, other, confidence=confidence), paired),
    ):
        assert (found.low, found.high) == pytest.approx((expected.low, expected.high), rel=1e-12)


def test_pairing_narrows_the_interval():
    """What two policies have in common per instance does not widen the interval of their difference."""
    rng = np.random.default_rng(1)
    common = rng.normal(0, 100, 50)
    one, other = common + rng.normal(1, 1, 50), common
    paired = mean_interval(one, other)
    assert 0.5 < paired.low < paired.high < 1.5
    assert mean_interval(one).high - mean_interval(one).low > 10


@pytest.mark.slow
def test_interval_covers_as_often_as_it_says():
    """A 90 % interval covers the true mean in 90 % of 4,000 samples, up to 5 standard errors of that share."""
    drawn = np.random.default_rng(2).normal(3.0, 2.0, (4000, 6))
    found = [mean_interval(sample, confidence=0.9) for sample in drawn]
    covered = np.mean([f.low <= 3.0 <= f.high for f in found])
    assert abs(covered - 0.9) < 5 * np.sqrt(0.09 / 4000)


def test_one_value_has_no_spread():
    """One instance gives its mean, and NaN for what one instance cannot tell."""
    found = mean_interval([7.0])
    assert (found.mean, found.count) == (7.0, 1)
    assert np.isnan([found.std, found.low, found.high]).all()


def test_equal_values():
    """Without spread the interval is the mean itself."""
    found = mean_interval([2.0, 2.0, 2.0])
    assert (found.low, found.mean, found.high, found.std) == (2.0, 2.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("values", "baseline", "confidence", "words"),
    [
        ([], None, 0.95, "at least one"),
        ([[1.0, 2.0]], None, 0.95, "one value per instance"),
        (3.0, None, 0.95, "one value per instance"),
        ([1.0, 2.0], [1.0], 0.95, "same instances"),
        ([1.0, 2.0], None, 1.0, "confidence"),
        ([1.0, 2.0], None, 0.0, "confidence"),
        ([1.0, 2.0], None, 95, "confidence"),
    ],
)
def test_bad_arguments_of_the_interval(values, baseline, confidence, words):
    """No values, tables, other instances and impossible confidences are errors that say so."""
    with pytest.raises(InputError, match=words):
        mean_interval(values, baseline, confidence=confidence)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_interval_of_something_not_finite(value):
    """A value that is not finite, such as a ratio of -inf, is an error, never a silent NaN."""
    with pytest.raises(InputError):
        mean_interval([1.0, value, 3.0])


def test_the_largest_floats_have_the_ratio_of_small_ones():
    """Differences of the largest floats are beyond any float; the unit of money changes nothing, to the last digit."""
    for unit in (2.0**-1000, 1.0, 2.0**1023):
        shares = [np.array([x]) * unit for x in ([-1.0, 0.0, 0.4], [1.0, 1.0, 0.9], [-1.0, -1.0, -0.9])]
        assert (
            performance_ratio(*(x[0] for x in shares)).tolist()
            == performance_ratio([-1.0, 0.0, 0.4], [1.0, 1.0, 0.9], [-1.0, -1.0, -0.9]).tolist()
        )


@pytest.mark.parametrize("unit", [1e-300, 1e-170, 1e-12, 1.0, 1e150, 1e300])
def test_an_interval_in_any_unit(unit):
    """Squares neither vanish nor overflow: the interval is that of the same numbers in another unit."""
    one, other = mean_interval([1.0, 5.0, 9.0, 2.0]), mean_interval(np.array([1.0, 5.0, 9.0, 2.0]) * unit)
    for name in ("mean", "std", "low", "high"):
        assert getattr(other, name) / unit == pytest.approx(getattr(one, name), rel=1e-12)


def test_an_interval_beyond_floats_is_refused():
    for values, confidence in (([1.7e308, -1.7e308, 1.0], 0.95), ([1.0, 2.0], 1 - 2**-53)):
        with pytest.raises(InputError, match="too large"):
            mean_interval(values, confidence=confidence)


def test_labels_in_another_order_are_no_instances():
    """Rewards and bounds of other labels are refused, not taken by place."""
    reward, bound = pd.Series({"mon": 10.0, "tue": 50.0}), pd.Series({"tue": 60.0, "mon": 80.0})
    with pytest.raises(InputError, match="different labels"):
        performance_ratio(reward, bound, [0.0, 0.0])
    assert performance_ratio(reward, bound[["mon", "tue"]], [0.0, 0.0]).round(1).tolist() == [12.5, 83.3]


@pytest.mark.parametrize("seed", range(3))
def test_p_values_are_scipys(seed):
    """Of the paired t-test."""
    first, second = np.random.default_rng(seed).normal(size=(2, 12)) + 0.5 * seed
    assert mean_interval(first, second).p_value == pytest.approx(ttest_rel(first, second).pvalue, rel=1e-9)
    assert np.isnan(mean_interval([3.0]).p_value)
    assert mean_interval([2.0, 2.0]).p_value == 0.0
