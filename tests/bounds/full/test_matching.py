"""SciPy's matchings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.bounds.full.edges import edges
from optkit.bounds.full.matching import dense_matching, sparse_matching


@pytest.mark.slow
@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 20), st.integers(0, 12), st.booleans())
def test_dense_and_sparse_matchings_are_worth_the_same(random_instance, seed, requests, workers, ties):
    day = random_instance(np.random.default_rng(seed), requests=requests, workers=workers, ties=ties)
    graph = edges(day)
    matrix = graph.dense()
    dense = dense_matching(matrix)
    sparse = sparse_matching(graph.worker, graph.request, graph.value, graph.n_workers, graph.n_requests)
    assert matrix[dense].sum() == pytest.approx(matrix[sparse].sum(), abs=1e-10)  # sums of up to 12 values below 100
    for side in sparse:
        assert np.unique(side).size == side.size


def test_a_worker_stays_alone_rather_than_spoil_the_best_pair():
    worker, request = sparse_matching(np.array([0, 1]), np.array([0, 0]), np.array([1.0, 2.0]), 2, 1)
    assert (worker.tolist(), request.tolist()) == ([1], [0])
