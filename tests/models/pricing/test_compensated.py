"""Sums that keep what floating point drops, against fractions."""

from fractions import Fraction

import numpy as np
import pytest

from optkit.models.pricing.compensated import EPS, compensated_sum


@pytest.mark.parametrize("seed", range(20))
def test_a_sum_is_within_its_error_of_the_exact_one(seed):
    rng = np.random.default_rng(seed)
    terms = [rng.choice([-1.0, 1.0], 50) * 10.0 ** rng.uniform(-20, 20, 50) for _ in range(3)]
    terms += [-terms[0], 10.0 ** rng.uniform(-40, 0, 50)]
    total, error = compensated_sum(*terms)
    for i in range(50):
        exact = sum(Fraction(float(x[i])) for x in terms)
        assert abs(Fraction(float(total[i])) - exact) <= Fraction(float(error[i]))
        assert error[i] <= 8 * EPS * (abs(total[i]) + EPS * max(abs(x[i]) for x in terms))


def test_what_cancels_without_a_rounding_has_none():
    total, error = compensated_sum(np.array([1e300, 3.0]), np.array([-1e300, -3.0]))
    assert (total == 0).all()
    assert (error == 0).all()
