"""Shadow prices of a matching: what one more request, and what one more worker, would be worth.

The matching problem ``max sum v_ij x_ij`` has the dual ``min sum_i y_i + sum_j z_j`` subject to
``y_i + z_j >= v_ij`` and ``y, z >= 0``. A matching and a dual solution are both optimal exactly if they are
complementary: ``y_i + z_j = v_ij`` on matched edges, ``y_i = 0`` for unmatched requests and ``z_j = 0`` for
unmatched workers.

Given a matching, complementarity leaves only z free on matched workers, because y follows as ``v_matched - z``. What
remains are lower limits on z, ``z_j >= v_ij - y_i`` for the edges of j outside the matching. Raising z from 0 until
they all hold,

    ``z_j <- max over the worker's unmatched edges of (v_ij - y_i)+,   y_i <- v_matched - z,``

is monotone: z only rises and y only falls. By induction z never passes any optimal dual solution, so for an optimal
matching the iteration stops at the *least* optimal z, thus the *largest* optimal y, and there unmatched workers have
z = 0 and no y is negative. It is Bellman-Ford on alternating paths, of which an optimal matching has no gaining
cycle, so as many rounds suffice as there are matched workers. If the matching is not optimal, the limits contradict
each other; the iteration is then cut off, and :func:`repair` turns what it left into a valid, if loose, bound.
"""

from __future__ import annotations

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.bounds.full.edges import Edges
from optkit.bounds.rounding import add_up

ROUNDING = 1e-13
"""Rises of z below this part of the largest value are rounding: with ties they would circulate for ever."""


def repair(edges: Edges, request_dual: Floats) -> tuple[Floats, Floats]:
    """Turn any numbers into feasible duals: ``y = max(y, 0)`` and ``z_j = max(0, max_i (v_ij - y_i))``.

    Parameters
    ----------
    edges : Edges
        The graph.
    request_dual : (n,) float
        Proposed y, in money; anything but NaN.

    Returns
    -------
    y, z : (n,) and (J,) float
        Feasible duals, in money, z rounded up. By weak duality ``sum(y) + sum(z)`` is at least the value of every
        matching.
    """
    y = np.maximum(request_dual, 0.0)
    return y, edges.best_per_worker(add_up(edges.value, -y[edges.request]))


def duals_of_matching(edges: Edges, worker: Ints, request: Ints, value: Floats) -> tuple[Floats, Floats]:
    """Feasible duals for a matching; optimal ones, up to rounding, if the matching is optimal.

    Only what changed goes on: a round looks at the edges of those requests whose y fell in the round before.

    Parameters
    ----------
    edges : Edges
        The graph.
    worker, request : (m,) int
        The matching: pairs that are edges, each worker and each request at most once.
    value : (m,) float
        The values of these edges, in money.

    Returns
    -------
    y, z : (n,) and (J,) float
        Duals of requests and workers, in money.
    """
    y = np.zeros(edges.n_requests)
    if not worker.size:
        return repair(edges, y)
    y[request] = value
    mate = np.full(edges.n_workers, -1)
    mate[worker] = request
    earns = np.zeros(edges.n_workers)
    earns[worker] = value
    tiny = ROUNDING * float(edges.value.max())
    starts, order = edges.by_request
    z = edges.best_per_worker(edges.value - y[edges.request])
    risen = np.flatnonzero((z > tiny) & (mate >= 0))
    for _ in range(worker.size):
        if not risen.size:
            break
        fallen = mate[risen]
        y[fallen] = np.maximum(earns[risen] - z[risen], 0.0)
        count = starts[fallen + 1] - starts[fallen]
        shift = np.repeat(starts[fallen] - np.cumsum(count) + count, count)
        edge = order[shift + np.arange(shift.size)]
        limit = edges.value[edge] - np.repeat(y[fallen], count)
        pushed = edges.worker[edge]
        higher = limit > z[pushed] + tiny
        pushed = pushed[higher]
        np.maximum.at(z, pushed, limit[higher])
        risen = np.unique(pushed[mate[pushed] >= 0])
    return repair(edges, y)


def duals_of_dense_matching(matrix: Floats, worker: Ints, request: Ints) -> tuple[Floats, Floats]:
    """Do the same as :func:`duals_of_matching` for a (J, n) matrix of values: quicker on a small instance.

    With y eliminated the iteration is ``z <- max_k (A_jk + z_k)`` over matched workers, where A_jk is what worker j
    gains or loses by taking the request of worker k.

    Examples
    --------
    >>> duals_of_dense_matching(np.array([[5.0, 4.0], [4.0, 1.0]]), np.array([0, 1]), np.array([1, 0]))
    (array([4., 3.]), array([1., 0.]))
    """
    y = np.zeros(matrix.shape[1])
    if worker.size:
        mine = matrix[worker]
        value = mine[np.arange(worker.size), request]
        swap = mine[:, request] - value
        mine[:, request] = 0.0
        z = mine.max(axis=1)
        tiny = ROUNDING * float(value.max())
        for _ in range(worker.size):
            higher = (swap + z).max(axis=1)
            if (higher - z).max() <= tiny:
                break
            z = higher
        y[request] = np.maximum(value - z, 0.0)
    return y, (matrix - y).max(axis=1, initial=0.0)
