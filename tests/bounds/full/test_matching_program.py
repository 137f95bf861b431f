"""The matching as a program for HiGHS."""

import numpy as np
import pytest

from optkit.basics.errors import SolverError
from optkit.bounds.full.edges import Edges, edges
from optkit.bounds.full.matching import dense_matching
from optkit.bounds.full.matching_program import solve_matching_program


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_the_program_is_exact_in_any_unit_of_money(random_instance, unit):
    """HiGHS has absolute tolerances: without scaling, values of 1e-9 would all look alike to it."""
    graph = edges(random_instance(np.random.default_rng(0), requests=40, workers=12))
    scaled = Edges(graph.worker, graph.request, unit * graph.value, graph.n_workers, graph.n_requests, 0.0)
    matrix = scaled.dense()
    best = matrix[dense_matching(matrix)].sum()
    for integer in (False, True):
        solved = solve_matching_program(scaled, integer=integer)
        # 1e-12: the right vertex is found, and only the order of the sum differs.
        assert matrix[solved.worker, solved.request].sum() == pytest.approx(best, rel=1e-12)


def test_only_the_linear_program_has_duals(random_instance):
    graph = edges(random_instance(np.random.default_rng(1)))
    linear, integer = (solve_matching_program(graph, integer=i) for i in (False, True))
    assert linear.request_dual.shape == (graph.n_requests,)
    assert linear.request_dual.min() >= -1e-9  # HiGHS's tolerance of 1e-7 at values scaled to 1000, back in money
    assert integer.request_dual is None


@pytest.mark.parametrize("integer", [False, True])
def test_a_time_limit_is_an_error_and_no_answer(random_instance, integer):
    graph = edges(random_instance(np.random.default_rng(2), requests=3000, workers=1500, horizon=3000))
    with pytest.raises(SolverError, match="raise time_limit"):
        solve_matching_program(graph, integer=integer, time_limit=1e-9)
