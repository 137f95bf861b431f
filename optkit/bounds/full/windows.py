"""Best matchings of long horizons, window by window, and proven as a whole.

A request is open for a short while, so an edge joins only what is close in time: a change far away reaches a worker
only along an alternating path, link by link, and with continuous noise such paths end soon. So the workers are cut
into cores, each core is solved together with an overlap on both sides, and only the core's pairs are kept. Nothing of
this is trusted: the stitched pairs must be a matching, and its duals must prove it optimal. If not, cores and overlaps
are doubled, until one window holds everything. The work is linear in the horizon, where SciPy's sparse matching alone
is nearly quadratic.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.basics.errors import SolverError
from optkit.bounds.full.edges import Edges
from optkit.bounds.full.matching import sparse_matching
from optkit.bounds.full.shadow_prices import duals_of_matching

GAP = 1e-9
"""Proven gap, as a part of the matching's value, up to which stitched windows count as optimal."""

SPANS_OF_OVERLAP = 12
"""First overlap, in mean spans of a request (workers seen while it is open): less saves little and fails more often."""

OVERLAPS_OF_CORE = 6
"""First core, in overlaps: half or twice as many were not faster."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A matching with its duals: pairs (m,), duals of requests (n,) and of workers (J,), and how it was cut."""

    worker: Ints
    request: Ints
    request_dual: Floats
    worker_dual: Floats
    windows: int
    overlap: int


def solve_by_windows(
    edges: Edges, core: int | None = None, overlap: int | None = None, stop_at: float | None = None
) -> Solved:
    """Best matching of any graph whose edges join what is close in time, with optimal duals.

    Parameters
    ----------
    edges : Edges
        The graph, its workers numbered in order of their steps.
    core, overlap : int, optional
        Workers per window to begin with, and workers added on either side; chosen from the graph unless given.
    stop_at : float, optional
        Reading of :func:`time.perf_counter` after which to give up.

    Raises
    ------
    SolverError
        If time is up, or if the duals do not prove the matching of the last, single window.
    """
    overlap = max(1, overlap if overlap is not None else round(SPANS_OF_OVERLAP * _mean_span(edges)))
    core = max(1, core if core is not None else OVERLAPS_OF_CORE * overlap)
    while True:
        whole = core + overlap >= edges.n_workers
        worker, request = _stitch(edges, edges.n_workers if whole else core, overlap, stop_at)
        if np.unique(request).size == request.size:
            value = value_of_pairs(edges, worker, request)
            y, z = duals_of_matching(edges, worker, request, value)
            gain = value.sum()
            if y.sum() + z.sum() - gain <= GAP * gain:
                return Solved(worker, request, y, z, 1 if whole else -(-edges.n_workers // core), overlap)
        if whole:
            raise SolverError(
                f"the matching of {edges.n_workers} workers and {edges.n_requests} requests is not proven optimal: "
                'their values may differ by too many orders of magnitude; try method="lp"'
            )
        core, overlap = 2 * core, 2 * overlap


def value_of_pairs(edges: Edges, worker: Ints, request: Ints) -> Floats:
    """Values of pairs that are edges, (m,), in money."""
    key = edges.worker * edges.n_requests + edges.request
    return edges.value[np.searchsorted(key, worker * edges.n_requests + request)]


def _mean_span(edges: Edges) -> float:
    starts, order = edges.by_request
    some = starts[1:] > starts[:-1]
    if not some.any():
        return 0.0
    first, last = order[starts[:-1][some]], order[starts[1:][some] - 1]
    return float((edges.worker[last] - edges.worker[first] + 1).mean())


def _stitch(edges: Edges, core: int, overlap: int, stop_at: float | None) -> tuple[Ints, Ints]:
    """Solve all windows and put the pairs of their cores together; a request may come out twice."""
    seen = np.zeros(edges.n_requests, bool)
    local = np.zeros(edges.n_requests, np.int64)
    workers, requests = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for begin in range(0, edges.n_workers, core):
        if stop_at is not None and time.perf_counter() > stop_at:
            raise SolverError(
                f"the matching hit its time limit at worker {begin} of {edges.n_workers}: raise time_limit; "
                "no bound comes out of half a matching"
            )
        low, high = max(0, begin - overlap), min(edges.n_workers, begin + core + overlap)
        part = slice(edges.starts[low], edges.starts[high])
        seen[edges.request[part]] = True
        members = np.flatnonzero(seen)
        seen[members] = False
        local[members] = np.arange(members.size)
        row, column = sparse_matching(
            edges.worker[part] - low, local[edges.request[part]], edges.value[part], high - low, members.size
        )
        kept = (row >= begin - low) & (row < begin - low + core)
        workers.append(row[kept] + low)
        requests.append(members[column[kept]])
    return np.concatenate(workers), np.concatenate(requests)
