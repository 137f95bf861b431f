"""Shadow prices of a matching."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.bounds.full.edges import edges
from optkit.bounds.full.matching import dense_matching
from optkit.bounds.full.shadow_prices import duals_of_dense_matching, duals_of_matching, repair
from optkit.bounds.full.windows import value_of_pairs

seeds = st.integers(0, 2**32 - 1)
shapes = st.fixed_dictionaries(
    {"requests": st.integers(1, 25), "workers": st.integers(1, 12), "groups": st.integers(1, 3), "ties": st.booleans()}
)


def both(graph):
    matrix = graph.dense()
    worker, request = dense_matching(matrix)
    value = value_of_pairs(graph, worker, request)
    sparse, dense = duals_of_matching(graph, worker, request, value), duals_of_dense_matching(matrix, worker, request)
    return worker, request, value, (sparse, dense)


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, shapes)
def test_duals_of_an_optimal_matching_are_feasible_and_complementary(random_instance, seed, shape):
    graph = edges(random_instance(np.random.default_rng(seed), **shape))
    worker, request, value, found = both(graph)
    for y, z in found:
        # 1e-10: sums and differences of at most 100 money units round to about 1e-13, over at most 12 rounds.
        assert (y >= 0).all()
        assert (z >= 0).all()
        assert (y[graph.request] + z[graph.worker] >= graph.value - 1e-10).all()
        assert np.allclose(y[request] + z[worker], value, rtol=0, atol=1e-10)
        assert np.allclose(np.delete(y, request), 0, atol=1e-10)
        assert np.allclose(np.delete(z, worker), 0, atol=1e-10)


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, shapes)
def test_the_request_duals_are_what_a_request_is_worth(random_instance, seed, shape):
    """The largest optimal y_i is the loss when request i is taken away: the marginal value of a best matching."""
    graph = edges(random_instance(np.random.default_rng(seed), **shape))
    _, _, value, found = both(graph)
    matrix = graph.dense()
    for i in range(min(3, graph.n_requests)):
        without = np.delete(matrix, i, axis=1)
        loss = value.sum() - without[dense_matching(without)].sum()
        for y, _ in found:
            assert y[i] == pytest.approx(loss, abs=1e-10)  # sums of up to 12 values below 100: rounding only


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, shapes)
def test_any_matching_gets_duals_that_bound_the_best_one(random_instance, seed, shape):
    rng = np.random.default_rng(seed)
    graph = edges(random_instance(rng, **shape))
    worker, request, best, _ = both(graph)
    keep = rng.random(worker.size) < 0.5
    worker, request = worker[keep], request[keep]
    y, z = duals_of_matching(graph, worker, request, value_of_pairs(graph, worker, request))
    assert y.sum() + z.sum() >= best.sum() - 1e-10  # rounding of sums below 1200


@pytest.mark.slow
@given(seeds, st.floats(-1e3, 1e3))
def test_repair_makes_any_prices_feasible(random_instance, seed, level):
    rng = np.random.default_rng(seed)
    graph = edges(random_instance(rng))
    y, z = repair(graph, level * rng.standard_normal(graph.n_requests))
    assert min(y.min(), z.min()) >= 0
    assert (y[graph.request] + z[graph.worker] >= graph.value - 1e-12).all()  # v - y + y rounds by 1e-13 at 1e3
