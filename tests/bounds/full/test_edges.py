"""The graph of an instance."""

from dataclasses import replace

import numpy as np
import pytest

from optkit.basics.errors import InstanceError
from optkit.bounds.full.edges import edges, pair_values


def test_a_value_is_what_the_definition_says_for_every_group(random_instance):
    day = random_instance(np.random.default_rng(0), groups=3)
    for j, i, value in zip(*pair_values(day), strict=True):
        d = day.worker_group[j]
        least = max(0, day.outside_utility[d] + day.outside_noise[j] - day.utility[d, i] - day.noise[j, i])
        assert value == pytest.approx(day.reward[i] - day.penalty[i] - least, rel=1e-14)  # the same sum, another order


def test_dense_and_sparse_noise_give_the_same_graph(random_instance):
    dense, sparse = (edges(random_instance(np.random.default_rng(1), groups=2, sparse_noise=s)) for s in (False, True))
    for part in ("worker", "request", "value"):
        assert np.array_equal(getattr(dense, part), getattr(sparse, part))


def test_only_pairs_worth_serving_are_kept_in_order(random_instance):
    day = random_instance(np.random.default_rng(2), reward=-20.0, requests=30, workers=12)
    graph, pairs = edges(day), pair_values(day)
    assert 0 < graph.size < pairs.value.size
    assert (graph.value > 0).all()
    assert (np.diff(graph.worker * day.n_requests + graph.request) > 0).all()


def test_both_groupings_list_every_edge_once(random_instance):
    graph = edges(random_instance(np.random.default_rng(3), requests=20))
    starts, order = graph.by_request
    for i in range(graph.n_requests):
        assert (graph.request[order[starts[i] : starts[i + 1]]] == i).all()
    assert sorted(order) == list(range(graph.size))
    assert (np.repeat(np.arange(graph.n_workers), np.diff(graph.starts)) == graph.worker).all()
    assert graph.dense().sum() == pytest.approx(graph.value.sum(), rel=1e-14)  # the same numbers, another order


def test_noise_that_is_not_realised_is_refused(random_instance):
    day = replace(random_instance(np.random.default_rng(4)), noise=None, outside_noise=None)
    with pytest.raises(InstanceError, match="with_noise"):
        edges(day)
