"""Window by window, and proven as a whole."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.basics.errors import SolverError
from optkit.bounds.full import windows
from optkit.bounds.full.edges import edges
from optkit.bounds.full.matching import dense_matching
from optkit.bounds.full.windows import solve_by_windows

SIZES = {"requests": 300, "workers": 150, "horizon": 300}


@pytest.mark.slow
@pytest.mark.parametrize(("core", "overlap"), [(1, 1), (1, 10), (3, 1), (10, 2), (40, 20), (149, 1), (999, 1)])
@pytest.mark.parametrize(("ties", "lifetime"), [(False, 2.0), (True, 10.0), (False, 100.0), (True, 100.0)])
def test_windows_of_any_size_end_at_the_proven_optimum(random_instance, core, overlap, ties, lifetime):
    graph = edges(random_instance(np.random.default_rng(7), ties=ties, lifetime=lifetime, **SIZES))
    solved = solve_by_windows(graph, core, overlap)
    matrix = graph.dense()
    best = matrix[dense_matching(matrix)].sum()
    attained = matrix[solved.worker, solved.request].sum()
    # 1e-9 is what the windows promise.
    assert attained == pytest.approx(best, rel=1e-9)
    assert solved.request_dual.sum() + solved.worker_dual.sum() == pytest.approx(attained, rel=1e-9)
    assert np.unique(solved.request).size == np.unique(solved.worker).size == solved.worker.size


@pytest.mark.slow
@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(0, 4), st.booleans())
def test_windows_of_random_instances_end_at_the_proven_optimum(random_instance, seed, core, overlap, ties):
    graph = edges(random_instance(np.random.default_rng(seed), requests=25, workers=20, horizon=30, ties=ties))
    solved = solve_by_windows(graph, core, overlap)
    matrix = graph.dense()
    assert matrix[solved.worker, solved.request].sum() == pytest.approx(matrix[dense_matching(matrix)].sum(), rel=1e-9)


def test_several_windows_are_used_where_they_can(random_instance):
    solved = solve_by_windows(edges(random_instance(np.random.default_rng(8), **SIZES)), core=20, overlap=20)
    assert solved.windows > 1


def test_equal_values_everywhere_do_not_force_a_single_window(random_instance):
    """Every edge is worth the same: where SciPy breaks ties alike in overlapping windows, these need not grow."""
    graph = edges(random_instance(np.random.default_rng(9), ties=True, lifetime=2.0, **SIZES))
    graph.value[:] = 10.0
    assert solve_by_windows(graph, core=30, overlap=30).windows > 1


def test_a_lost_window_widens_them(random_instance, monkeypatch):
    """Windows that lose every pair but in the last attempt, with one window, do not get away with it."""
    graph = edges(random_instance(np.random.default_rng(10), **SIZES))
    whole = windows.sparse_matching

    def lossy(worker, request, value, n_workers, n_requests):
        pairs = whole(worker, request, value, n_workers, n_requests)
        return pairs if n_workers == graph.n_workers else (pairs[0][1:], pairs[1][1:])

    monkeypatch.setattr(windows, "sparse_matching", lossy)
    assert solve_by_windows(graph, core=10, overlap=5).windows == 1


def test_a_matching_that_is_never_proven_is_an_error(random_instance, monkeypatch):
    graph = edges(random_instance(np.random.default_rng(11), **SIZES))
    whole = windows.sparse_matching
    monkeypatch.setattr(windows, "sparse_matching", lambda *graph: tuple(side[1:] for side in whole(*graph)))
    with pytest.raises(SolverError, match="not proven optimal"):
        solve_by_windows(graph)


def test_the_clock_stops_the_windows(random_instance):
    graph = edges(random_instance(np.random.default_rng(12), **SIZES))
    with pytest.raises(SolverError, match="raise time_limit"):
        solve_by_windows(graph, stop_at=time.perf_counter() - 1)
