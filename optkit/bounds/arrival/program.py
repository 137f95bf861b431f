"""The arrival-information bound as an exponential-cone program, for a solver that knows nothing of Lambert's W."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy import sparse

from optkit.basics.errors import SolverError
from optkit.bounds.arrival.market import MultiplierCertificate, OpenPairs
from optkit.bounds.bound import Bound, SolverRecord
from optkit.instances.instance import Instance
from optkit.models.convex_solver import run


def arrival_program(instance: Instance, *, solver: str = "CLARABEL", **options: Any) -> Bound:
    r"""Bound from above what any policy earns, in the mean over the noise, by letting it know all arrivals.

    The concave program itself, over the acceptance P_ti of each pair of a worker and a request open at his step:

    .. math:: \max \sum_{t,i} a_{ti} P_{ti} - \mu_t P_{ti} \ln (P_{ti} / P_{t0}) \quad \text{s.t.} \quad
              \sum_t P_{ti} \le 1, \quad \sum_i P_{ti} + P_{t0} = 1, \qquad a_{ti} = r_i - \beta_i + u_{ti} - u_{0t}.

    Parameters
    ----------
    instance : Instance
        Its noise, if realised, is not looked at.
    solver : str
        Any installed CVXPY solver with exponential cones and dual values.
    **options
        Passed to the solver.

    Returns
    -------
    Bound
        The solver's multipliers of ``sum_t P_ti <= 1`` are the certificate, a
        :class:`~optkit.bounds.arrival.market.MultiplierCertificate`, and ``value`` (money) is what they prove, whatever
        the solver says of itself; ``solver.details`` has the certified gap in money.

    Raises
    ------
    InputError
        If the solver is not installed or does not take an option.
    SolverError
        If the solver ends without multipliers.

    See Also
    --------
    optkit.bounds.arrival.dual : the same bound from the dual in closed form, at least ten times faster.

    Notes
    -----
    ``docs/explanation/bounds.md``, "Arrival information". Money is handed over in units of the mean mu.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.arrival.dual import arrival_dual
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> program, dual = arrival_program(day), arrival_dual(day)
    >>> abs(program.value - dual.value) <= 1e-6 * dual.value
    True
    """
    started = time.perf_counter()
    market = OpenPairs.of(instance)
    multipliers, status = np.zeros(instance.n_requests), "nobody meets anybody"
    details: dict[str, Any] = {}
    if market.size:
        problem, once, met, unit = _problem(market)
        run(problem, solver, options, "the arrival-information program")
        status, stats = problem.status, problem.solver_stats
        details = {"solver": solver, "iterations": stats.num_iters, "solve_seconds": stats.solve_time}
        if once.dual_value is None:
            raise SolverError(
                f"{solver} ended with status {problem.status} on {market.size} pairs and no multipliers, which bounds "
                'nothing: take method="lagrangian"'
            )
        multipliers[met] = np.maximum(unit * once.dual_value, 0.0)
    verdict = market.verdict(multipliers)
    details |= {"pairs": market.size, "gap": verdict.gap}
    record = SolverRecord("program", status, time.perf_counter() - started, details)
    return Bound(verdict.bound, "arrival information", MultiplierCertificate(multipliers), record)


def _problem(market: OpenPairs) -> tuple[Any, Any, Any, float]:
    """The CVXPY problem, its constraint on the requests that meet a worker, these requests, and the unit of money."""
    import cvxpy

    cp: Any = cvxpy  # its operators come without types
    unit = float(market.mu.mean())
    _, met, _ = market.by_request
    pair, mu = np.arange(market.size), (market.mu / unit)[market.worker]
    ones = np.ones(market.size)
    serves = sparse.csr_array((ones, (market.request, pair)), shape=(market.count.size, market.size))[met]
    takes = sparse.csr_array((ones, (market.worker, pair)), shape=(market.mu.size, market.size))
    # The outside option is a variable of its own: rel_entr of sums makes the solver far slower.
    P, P0 = cp.Variable(market.size, name="P"), cp.Variable(market.mu.size, name="P0")
    earned = (market.advantage / unit) @ P - mu @ cp.rel_entr(P, P0[market.worker])
    once = serves @ P <= 1
    return cp.Problem(cp.Maximize(earned), [once, takes @ P + P0 == 1]), once, met, unit
