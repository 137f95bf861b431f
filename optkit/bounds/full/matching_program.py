"""The same matching as a linear or an integer program, solved by HiGHS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from optkit.basics.arrays import Floats, Ints, Known
from optkit.basics.errors import SolverError
from optkit.bounds.full.edges import Edges


@dataclass(frozen=True, eq=False)
class ProgramSolution(Known):
    """What HiGHS found: pairs (m,), duals of the requests (n,) (none for an integer program), and its own words."""

    worker: Ints
    request: Ints
    request_dual: Floats | None
    status: str
    details: dict[str, Any]


@cache
def _quiet_highs() -> type[Any]:
    """Give HiGHS without a word on standard output, which may be a document for a machine.

    From 1.16 on its constructor prints a banner as it enables callbacks, before a user can set an option.
    """
    import highspy

    class QuietHighs(highspy.Highs):
        def enableCallbacks(self) -> None:  # noqa: N802 (HiGHS's name)
            self.setOptionValue("output_flag", False)
            super().enableCallbacks()  # type: ignore[no-untyped-call]

    return QuietHighs


def solve_matching_program(
    edges: Edges, *, integer: bool, time_limit: float | None = None, presolve: bool = False
) -> ProgramSolution:
    """Maximise ``sum v_ij x_ij`` with every worker and every request used at most once, ``x >= 0``.

    The constraint matrix is that of a bipartite graph, thus totally unimodular: every vertex of the linear program
    is a matching. So it is solved by the simplex method, which ends at a vertex with duals. An interior point, or a
    first-order method, without crossover would give neither, and with presolve on not even feasible duals. Presolve
    takes longer than it saves, at every size from 50 to 100,000 requests, and the integer one's aftermath overlooks the
    time limit, by minutes at 100,000.

    Parameters
    ----------
    edges : Edges
        The graph, with at least one edge.
    integer : bool
        Whether to ask for binary x, as the paper does, with no gap allowed.
    time_limit : float, optional
        Seconds.
    presolve : bool
        Whether HiGHS may reduce the program first.

    Raises
    ------
    SolverError
        If HiGHS ends with any status but optimal, for example at the time limit.
    """
    import highspy

    e, rows = edges.size, edges.n_workers + edges.n_requests
    # HiGHS tolerates 1e-7 in the units it is given; a power of two puts the values near 1000 and rounds nothing.
    unit = float(2.0 ** (np.frexp(edges.value.max())[1] - 10))
    solver = _quiet_highs()()
    options: dict[str, Any] = {"output_flag": False, "presolve": "on" if presolve else "off"}
    if integer:
        options |= {"mip_rel_gap": 0.0, "mip_abs_gap": 0.0}
    else:
        options["solver"] = "simplex"
    if time_limit is not None:
        options["time_limit"] = max(time_limit, 0.0)
    for name, setting in options.items():
        solver.setOptionValue(name, setting)
    ends = np.empty(2 * e, np.int32)
    ends[0::2] = edges.worker
    ends[1::2] = edges.n_workers + edges.request
    model = (
        *(e, rows, 2 * e, int(highspy.MatrixFormat.kColwise), int(highspy.ObjSense.kMinimize), 0.0),
        *(-edges.value / unit, np.zeros(e), np.ones(e) if integer else np.full(e, highspy.kHighsInf)),
        *(np.full(rows, -highspy.kHighsInf), np.ones(rows)),
        *(np.arange(0, 2 * e + 1, 2, dtype=np.int32), ends, np.ones(2 * e)),
        np.full(e, int(integer), dtype=np.int32),
    )
    if solver.passModel(*model) == highspy.HighsStatus.kError:
        raise SolverError(f"HiGHS refuses the model of {e} edges: a value is too large; give money in a larger unit")
    solver.run()
    status = solver.getModelStatus()
    words = solver.modelStatusToString(status)
    if status != highspy.HighsModelStatus.kOptimal:
        raise SolverError(
            f'HiGHS ended with status "{words}" on a matching of {e} edges, which bounds nothing: '
            'raise time_limit or take method="assignment"'
        )
    solution, info = solver.getSolution(), solver.getInfo()
    chosen = np.flatnonzero(np.asarray(solution.col_value) > 0.5)
    duals = None if integer else -unit * np.asarray(solution.row_dual)[edges.n_workers :]
    details = {"simplex_iterations": info.simplex_iteration_count}
    if integer:
        details["nodes"] = int(info.mip_node_count)
    return ProgramSolution(edges.worker[chosen], edges.request[chosen], duals, words, details)
