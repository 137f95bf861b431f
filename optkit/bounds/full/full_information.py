"""The full-information bound: what one earns who knows every arrival and every worker's noise in advance."""

from __future__ import annotations

import math
import time
from typing import Any, Literal

import numpy as np

from optkit.basics.errors import InputError, SolverError
from optkit.bounds.bound import Bound, SolverRecord
from optkit.bounds.full.assignment import AssignmentCertificate
from optkit.bounds.full.edges import Edges, edges
from optkit.bounds.full.matching import dense_matching
from optkit.bounds.full.matching_program import solve_matching_program
from optkit.bounds.full.shadow_prices import duals_of_dense_matching, duals_of_matching, repair
from optkit.bounds.full.windows import solve_by_windows, value_of_pairs
from optkit.bounds.rounding import sum_up
from optkit.instances.instance import Instance

Method = Literal["lp", "milp", "assignment"]

DENSE_PAIRS = 32_000
"""Workers times requests up to which a dense matching is the quickest."""

AGREEMENT = 1e-7
"""Gap, as a part of the money in play, beyond which a solver's answer is not believed."""

_Found = tuple[AssignmentCertificate, str, dict[str, Any]]


def full_information(instance: Instance, method: Method | None = None, *, time_limit: float | None = None) -> Bound:
    """Bound from above what any policy can earn on an instance, by letting it know the future.

    Who knows the noise pays worker j exactly the least compensation that he accepts for request i,
    ``c_ij = max(0, u_0 + e_0j - u_ij - e_ij)``. What remains is to choose who serves what:

        ``sum_i beta_i + max sum_ij (r_i - beta_i - c_ij) x_ij``

    over matchings of workers with the requests open when they come.

    Parameters
    ----------
    instance : Instance
        With its noise realised.
    method : {None, "assignment", "lp", "milp"}
        ``"assignment"``, the default, takes SciPy's dense matching on small instances and sparse matchings of
        overlapping windows on all others. ``"lp"`` and ``"milp"`` take HiGHS: the linear program is integral, so the
        integer one, which the paper solves, is only slower.
    time_limit : float, optional
        Seconds, building included. ``"assignment"`` looks at the clock between windows, not within one.

    Returns
    -------
    Bound
        Its ``value`` (money) is the one that the certificate's prices prove, whatever the solver claims; its
        certificate is an :class:`~optkit.bounds.full.assignment.AssignmentCertificate`.

    Raises
    ------
    InstanceError
        If the noise is not realised.
    InputError
        If the method is unknown or the time limit is not positive.
    SolverError
        If the solver hits the time limit or fails, or if its answer does not hold when checked: never a bound then.

    Notes
    -----
    Paper, the full-information bound, corrected as in ``docs/explanation/bounds.md``: the sign of the utility, the
    constant, and one noise per worker *and* request.

    Examples
    --------
    >>> day = Instance(horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[1.0], noise=np.zeros((2, 2)),
    ...                outside_noise=np.zeros(2))
    >>> full_information(day).value  # both are served: 30 - 10 + 40 - 12
    48.0
    """
    started = time.perf_counter()
    if method not in (None, "assignment", "lp", "milp"):
        raise InputError(f'method = {method!r} is unknown: take "assignment", "lp" or "milp"')
    if time_limit is not None and not time_limit > 0:
        raise InputError(f"time_limit = {time_limit!r} is not a positive number of seconds; None means no limit")
    stop_at = None if time_limit is None else started + time_limit
    graph = edges(instance)
    if not graph.size:
        proof, status, details = _nobody_to_match(graph)
    elif method in ("lp", "milp"):
        proof, status, details = _by_program(graph, method == "milp", stop_at)
    elif graph.n_workers * graph.n_requests <= DENSE_PAIRS:
        proof, status, details = _by_dense_matching(graph)
    else:
        proof, status, details = _by_windows(graph, stop_at)
    y, z = repair(graph, proof.request_dual)
    value = sum_up([*instance.penalty.tolist(), *y.tolist(), *z.tolist()])
    details["edges"] = graph.size
    record = SolverRecord(method or "assignment", status, time.perf_counter() - started, details)
    return Bound(value, "full information", proof, record)


def _nobody_to_match(graph: Edges) -> _Found:
    nobody = np.zeros(0, np.int64)
    free = AssignmentCertificate(nobody, nobody, np.zeros(graph.n_requests), np.zeros(graph.n_workers))
    return free, "nobody to match", {}


def _by_dense_matching(graph: Edges) -> _Found:
    matrix = graph.dense()
    worker, request = dense_matching(matrix)
    y, z = duals_of_dense_matching(matrix, worker, request)
    _believe(graph, float(matrix[worker, request].sum()), float(y.sum() + z.sum()), "SciPy's dense matching")
    return AssignmentCertificate(worker, request, y, z), "certified", {"algorithm": "dense"}


def _by_windows(graph: Edges, stop_at: float | None) -> _Found:
    solved = solve_by_windows(graph, stop_at=stop_at)
    proof = AssignmentCertificate(solved.worker, solved.request, solved.request_dual, solved.worker_dual)
    return proof, "certified", {"algorithm": "windows", "windows": solved.windows, "overlap": solved.overlap}


def _by_program(graph: Edges, integer: bool, stop_at: float | None) -> _Found:
    left = None if stop_at is None else stop_at - time.perf_counter()
    if left is not None and left <= 0:
        raise SolverError("the time limit passed while the model was built: raise time_limit; there is no bound yet")
    solved = solve_matching_program(graph, integer=integer, time_limit=left)
    worker, request = solved.worker, solved.request
    value = value_of_pairs(graph, worker, request)
    if solved.request_dual is not None:
        y, z = repair(graph, solved.request_dual)
    else:
        y, z = duals_of_matching(graph, worker, request, value)
    _believe(graph, float(value.sum()), float(y.sum() + z.sum()), "HiGHS")
    return AssignmentCertificate(worker, request, y, z), solved.status, solved.details


def _believe(graph: Edges, attained: float, bound: float, who: str) -> None:
    scale = max(abs(attained), abs(bound))
    if not math.isfinite(bound) or bound - attained > AGREEMENT * scale:
        raise SolverError(
            f"{who} gave a matching worth {attained:.9g}, but prices that prove only {bound:.9g}, on {graph.size} "
            "edges: their values may differ by too many orders of magnitude; try another method"
        )
