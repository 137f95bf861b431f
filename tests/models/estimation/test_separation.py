"""Separation: a direction is found where there is one, and only there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from optkit.models.estimation.choices import ChoiceSets
from optkit.models.estimation.likelihood import Likelihood
from optkit.models.estimation.separation import separating_direction

pytestmark = pytest.mark.filterwarnings("error")


def likelihood_of(rivals):
    """Each row is the difference of one rival from its choice, one rival per situation."""
    rivals = np.asarray(rivals, dtype=float)
    return Likelihood(ChoiceSets.of_sizes([1] * len(rivals)), rivals, None, None, np.ones(rivals.shape[1]), 0)


def separated_by_hand(rivals):
    """Maximise the sum of all margins under the whole linear program, without a working set."""
    k = rivals.shape[1]
    solved = linprog(rivals.sum(axis=0), A_ub=rivals, b_ub=np.zeros(len(rivals)), bounds=[(-1, 1)] * k, method="highs")
    return -solved.fun > 1e-7


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.integers(1, 40), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_it_agrees_with_the_whole_linear_program(n, k, seed):
    # Small integers, so that ties, and with them quasi-complete separation, are common.
    rivals = np.random.default_rng(seed).integers(-2, 2, (n, k)).astype(float)
    found = separating_direction(likelihood_of(rivals), np.ones(k), np.ones(k, bool))
    assert (found is not None) == separated_by_hand(rivals)
    if found is not None:
        assert (rivals @ found).max() <= 1e-6
        assert (rivals @ found).min() < -1e-6


def test_it_finds_the_one_row_that_decides_among_many():
    rng = np.random.default_rng(0)
    rivals = np.column_stack([rng.normal(size=(20_000, 3)), np.zeros(20_000)])
    rivals[12_345, 3] = -1.0
    mixed = rivals @ (np.eye(4) + 0.3 * rng.normal(size=(4, 4)))
    found = separating_direction(likelihood_of(mixed), np.ones(4), np.ones(4, bool))
    margin = -(mixed @ found)
    assert margin.argmax() == 12_345
    # 1e-6: the linear program is solved to 1e-7.
    assert np.abs(np.delete(margin, 12_345)).max() < 1e-6 * margin.max()


def test_rows_outside_the_working_set_have_their_say():
    """A direction that suits the first 500 rows must suit all 20,000; and one dissenter among them is enough."""
    rng = np.random.default_rng(1)
    rivals = rng.normal(size=(20_000, 4))
    rivals[rivals @ [1.0, -0.5, 0.2, 0.1] > 0] *= -1.0
    found = separating_direction(likelihood_of(rivals), np.ones(4), np.ones(4, bool))
    # 1e-6: the linear program is solved to 1e-7.
    assert (rivals @ found).max() <= 1e-6 * -(rivals @ found).min()
    rivals[7_777] = [1.0, -0.5, 0.2, 0.1]
    assert separating_direction(likelihood_of(rivals), np.ones(4), np.ones(4, bool)) is None


def test_a_penalised_column_cannot_run_away():
    rivals = np.array([[-1.0, 1.0], [-1.0, -1.0], [-2.0, 0.5]])
    assert separating_direction(likelihood_of(rivals), np.ones(2), np.array([True, True])) == pytest.approx([1, 0])
    assert separating_direction(likelihood_of(rivals), np.ones(2), np.array([False, True])) is None
    assert separating_direction(likelihood_of(rivals), np.ones(2), np.array([False, False])) is None


def test_the_direction_is_in_the_units_of_the_columns():
    rivals = np.array([[-1.0, 1.0], [-1.0, -1.0]]) * [1e6, 1.0]
    assert separating_direction(likelihood_of(rivals), np.array([1e6, 1.0]), np.ones(2, bool)) == pytest.approx(
        [1e-6, 0]
    )
