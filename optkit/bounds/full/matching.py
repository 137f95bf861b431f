"""Best matchings of a small graph, by SciPy; each worker and each request may stay alone."""

from __future__ import annotations

import numpy as np

from optkit.basics.arrays import Floats, Ints


def dense_matching(matrix: Floats) -> tuple[Ints, Ints]:
    """Best matching of a (J, n) matrix of values; pairs worth 0 are no pairs.

    SciPy is imported on first use, because :mod:`scipy.optimize` takes a while to load.

    Parameters
    ----------
    matrix : (J, n) float
        Values, in money, at least 0.

    Returns
    -------
    worker, request : (m,) int
        The pairs, sorted by worker.

    Examples
    --------
    >>> dense_matching(np.array([[5.0, 4.0], [3.0, 0.0]]))
    (array([0, 1]), array([1, 0]))
    """
    from scipy.optimize import linear_sum_assignment

    worker, request = linear_sum_assignment(matrix, maximize=True)
    paired = matrix[worker, request] > 0
    return worker[paired], request[paired]


def sparse_matching(worker: Ints, request: Ints, value: Floats, n_workers: int, n_requests: int) -> tuple[Ints, Ints]:
    """Best matching of a sparse graph.

    SciPy's matching must give every worker a partner and takes a stored 0 for a missing edge. So each worker gets a
    dummy request of his own, and one constant is taken off all costs: every worker pays it exactly once.

    Parameters
    ----------
    worker, request : (e,) int
        The edges, sorted by worker.
    value : (e,) float
        Their values, in money, positive.
    n_workers, n_requests : int
        Sizes of the two sides.

    Returns
    -------
    worker, request : (m,) int
        The pairs, sorted by worker.

    Examples
    --------
    >>> sparse_matching(np.array([0, 0, 1]), np.array([0, 1, 0]), np.array([5.0, 4.0, 3.0]), 2, 2)
    (array([0, 1]), array([1, 0]))
    """
    from scipy import sparse
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    if not value.size:
        return worker, request
    ends = np.cumsum(np.bincount(worker, minlength=n_workers) + 1)
    dummy = ends - 1
    real = np.ones(ends[-1], bool)
    real[dummy] = False
    column = np.empty(ends[-1], np.int32)
    column[real] = request
    column[dummy] = n_requests + np.arange(n_workers)
    constant = float(value.max())
    cost = np.full(ends[-1], -constant)
    cost[real] -= value
    indptr = np.concatenate([[0], ends]).astype(np.int32)
    graph = sparse.csr_array((cost, column, indptr), shape=(n_workers, n_requests + n_workers))
    row, partner = min_weight_full_bipartite_matching(graph)
    paired = partner < n_requests
    return row[paired].astype(np.int64), partner[paired].astype(np.int64)
