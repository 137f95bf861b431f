"""Ratios of means and their intervals."""

import numpy as np
import pytest

from optkit.gap.tables import ratio_of_means


def test_ratio_of_means_by_hand():
    """The ratio of sums, not the mean of ratios; its interval shrinks to nothing if both are proportional."""
    assert ratio_of_means([1.0, 3.0], [10.0, 10.0]).mean == pytest.approx(0.2)
    assert ratio_of_means([1.0, 3.0], [10.0, 30.0]).mean == pytest.approx(0.1)
    exact = ratio_of_means([1.0, 2.0, 4.0], [10.0, 20.0, 40.0])
    assert (exact.low, exact.high) == (pytest.approx(0.1), pytest.approx(0.1))


def test_with_a_constant_below_it_is_the_interval_of_a_mean():
    """Student's interval, as optkit.simulation.metrics has it."""
    from optkit.simulation.metrics import mean_interval

    x = np.random.default_rng(0).normal(3.0, 2.0, 20)
    found, known = ratio_of_means(x, np.full(20, 2.0)), mean_interval(x / 2.0)
    for name in ("mean", "std", "low", "high"):
        assert getattr(found, name) == pytest.approx(getattr(known, name), rel=1e-12)


def test_intervals_cover():
    """Of 2,000 intervals of 95 %, 93 to 97 % hold the true ratio, with a denominator that varies by a quarter."""
    rng = np.random.default_rng(1)
    below = 100.0 * rng.gamma(16.0, 1 / 16, (2000, 40))
    above = 0.02 * below + rng.normal(0.0, 1.0, below.shape)
    found = [ratio_of_means(a, b) for a, b in zip(above, below, strict=True)]
    # Four standard errors of the share are 2 %.
    assert 0.93 < np.mean([one.low < 0.02 < one.high for one in found]) < 0.97


def test_without_a_measure_there_is_no_ratio():
    """A mean of zero below, and a single instance, leave NaN."""
    assert np.isnan(ratio_of_means([1.0, 2.0], [0.0, 0.0]).mean)
    one = ratio_of_means([1.0], [2.0])
    assert one.mean == 0.5
    assert np.isnan(one.low)
