"""The pricing problem in the space of acceptance probabilities, as a concave program for CVXPY."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InputError, SolverError
from optkit.models.choice import softmax_with_outside
from optkit.models.decision import Decisions, Floats
from optkit.models.pricing import closed_form

if TYPE_CHECKING:
    import cvxpy as cp

NEGLIGIBLE = 30.0
"""Log-odds below the largest at which a request is left out: its probability is below 1e-13 of another's."""

ACCURACY = 1e-6
"""Largest accepted gap between the program's primal and dual values, relative to mu + |profit|."""


@dataclass(frozen=True)
class ProgramSolution:
    """What the solver found, checked.

    Attributes
    ----------
    compensation, acceptance : (n,) float
        Money and probability. The optimum is flat: an objective gap of 1e-8 leaves about 1e-4 in a probability, and the
        price of a request below probability 1e-6 is the first-order condition's ``v_i - m``, not the solver's.
    rejection, markup, profit : float
        Probability of no acceptance, ``m = mu + profit`` and expected profit, in money.
    bound : float
        The solver's dual value, made feasible: no prices earn more, in money.
    multiplier : (n,) float
        The solver's multipliers of ``P_i >= P_0 w_i``, in money; 0 without the sign constraint.
    status, solver : str
        The solver's own word, and its name.
    seconds : float
        Time inside the solver.
    """

    compensation: Floats
    acceptance: Floats
    rejection: float
    markup: float
    profit: float
    bound: float
    multiplier: Floats
    status: str
    solver: str
    seconds: float


@dataclass(frozen=True)
class _Program:
    """A CVXPY problem over k requests and the parts that are set and read."""

    problem: cp.Problem
    linear: cp.Parameter
    outside: cp.Parameter
    entropy: cp.Parameter
    scale: cp.Parameter
    floor: cp.Parameter | None
    P: Any
    Q: Any

    @classmethod
    def build(cls, k: int, nonnegative: bool) -> _Program:
        import cvxpy

        cp: Any = cvxpy  # its operators come without types
        P, Q = cp.Variable(k, nonneg=True, name="P"), cp.Variable(nonneg=True, name="Q")
        linear = cp.Parameter(k, name="linear")
        outside, entropy = cp.Parameter(name="outside"), cp.Parameter(nonneg=True, name="entropy")
        scale = cp.Parameter(nonneg=True, name="scale")
        floor = cp.Parameter(k, nonneg=True, name="floor") if nonnegative else None
        # Q is a variable of its own: with 1 - sum(P) inside rel_entr the solver is hundreds of times slower.
        profit = linear @ P - outside * Q - entropy * cp.sum(cp.rel_entr(P, Q))
        constraints = [cp.sum(P) + scale * Q == 1] + ([] if floor is None else [floor * Q <= P])
        return cls(cp.Problem(cp.Maximize(profit), constraints), linear, outside, entropy, scale, floor, P, Q)


class PricingProgram:
    r"""The concave pricing problem over the simplex, solved by a conic solver.

    .. math:: \max_{P, P_0} \; a^\top P - \mu \sum_i P_i \ln (P_i / P_0)
              \quad \text{s.t.} \quad \sum_i P_i + P_0 = 1, \quad P_i \ge P_0\, e^{(u_i - u_0)/\mu}

    with a_i = v_i + u_i - u_0; the last constraint says c_i >= 0 and is there if ``nonnegative``. Concave by Lemma 2 of
    the paper (section 3.2; its Hessian: ``docs/explanation/corrections.md``), DCP and DPP. The solver is handed this
    problem divided by mu, with P_0 = scale Q and the constant max(a) taken out by sum(P) + P_0 = 1, so that its numbers
    are moderate for any mu; requests that cannot matter in floating point are left out.

    Parameters
    ----------
    n : int
        Number of requests.
    nonnegative : bool
        Whether compensations must be at least 0.

    Attributes
    ----------
    problem : cvxpy.Problem
        The problem last solved (of size n before the first), open to inspection and change.

    See Also
    --------
    optkit.models.pricing.optimal_prices : the closed form, about a thousand times faster.

    Examples
    --------
    >>> program = PricingProgram(2)
    >>> solution = program.solve([5.0, 6.0], [-1.0, -2.0], 1.0)
    >>> round(solution.profit, 4), program.problem.is_dcp(dpp=True)
    (2.6999, True)
    """

    def __init__(self, n: int, nonnegative: bool = True) -> None:
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise InputError(f"n = {n!r} requests; a program needs a whole number of at least 1")
        self.n, self.nonnegative = int(n), bool(nonnegative)
        self._programs: dict[int, _Program] = {}
        self._last = self.n

    @property
    def problem(self) -> cp.Problem:
        """The CVXPY problem last solved."""
        return self._program(self._last).problem

    def _program(self, k: int) -> _Program:
        if k not in self._programs:
            self._programs[k] = _Program.build(k, self.nonnegative)
        return self._programs[k]

    def solve(
        self,
        value: npt.ArrayLike,
        utility: npt.ArrayLike,
        mu: float = 1.0,
        outside_utility: float = 0.0,
        *,
        solver: str = "CLARABEL",
        **options: Any,
    ) -> ProgramSolution:
        """Solve for one decision.

        Parameters
        ----------
        value, utility : (n,) float
            Worth of serving each request and its utility to the worker, in money.
        mu, outside_utility : float
            Noise scale (positive) and utility of rejecting, in money.
        solver : str
            Any installed CVXPY solver with exponential cones.
        **options
            Passed to the solver.

        Raises
        ------
        InputError
            If an argument is out of shape, not finite or out of range, or the solver is not installed.
        SolverError
            If the solver does not end with status "optimal", or its primal and dual values differ by more than
            :data:`ACCURACY`: what is not accurate never becomes a price.
        """
        d = Decisions.of(value, utility, mu, outside_utility, None)
        if d.advantage.shape != (1, self.n) or d.shape not in ((), (1,)):
            raise InputError(
                f"this program is for one decision over {self.n} requests; got {(*d.shape, d.value.shape[1])}"
            )
        keep = np.flatnonzero(self._matter(d))
        if keep.size == 0:
            return self._checked(d, np.full(self.n, -np.inf), 0.0, np.zeros(self.n), "optimal", "none needed", 0.0)
        a, logit = d.advantage[0, keep], d.logit[0, keep]
        self._last = keep.size
        program = self._program(keep.size)
        log_scale = -np.log1p(max(a.max(), 0.0))
        if program.floor is not None:
            log_scale = min(log_scale, -np.logaddexp.reduce(np.append(logit, 0.0)))
            program.floor.value = np.exp(logit + log_scale)
        lifted = a + log_scale
        shift = lifted.max()
        scale = np.exp(log_scale)
        unit = max(1.0, (shift - lifted).max() / NEGLIGIBLE, abs(shift * scale))
        program.linear.value, program.outside.value = (lifted - shift) / unit, shift * scale / unit
        program.entropy.value, program.scale.value = 1.0 / unit, scale
        failure = SolverError(f"no accuracy left to try with {solver}")
        for attempt in _attempts(solver, options):
            try:
                status, seconds = _run(program.problem, solver, attempt)
                return self._read(d, program, keep, log_scale, shift, unit, status, solver, seconds)
            except SolverError as error:
                failure = error
        raise failure

    def _read(
        self,
        d: Decisions,
        program: _Program,
        keep: npt.NDArray[np.intp],
        log_scale: float,
        shift: float,
        unit: float,
        status: str,
        solver: str,
        seconds: float,
    ) -> ProgramSolution:
        """Undo the scaling, and check."""
        probability = np.zeros(self.n)
        probability[keep] = np.maximum(program.P.value, 0.0)
        simplex, *floor = program.problem.constraints
        seen = probability >= 1e-6
        log_odds = np.full(self.n, -np.inf)
        log_odds[seen] = np.log(probability[seen]) - np.log(max(program.Q.value, 1e-300)) - log_scale
        ratio = float(shift + unit * simplex.dual_value)
        mu = float(d.mu[0, 0])
        multiplier = np.zeros(self.n)
        if floor:
            # Requests that were left out get what stationarity asks of them.
            multiplier = np.maximum(mu * (1.0 + ratio) - d.value[0], 0.0)
            multiplier[keep] = mu * unit * floor[0].dual_value
        return self._checked(d, log_odds, ratio, multiplier, status, solver, seconds)

    def _matter(self, d: Decisions) -> npt.NDArray[np.bool_]:
        """Requests whose probability can exceed about 1e-13, free or held at compensation 0."""
        a, logit = d.advantage[0], d.logit[0]
        if not self.nonnegative:
            return np.asarray(a >= max(a.max(), 0.0) - NEGLIGIBLE)
        # P_i / P_0 = exp(a_i/mu - 1 - R/mu) for a free request, and the profit R is at least that of paying nothing,
        # which is negative where workers love what ruins the platform.
        for_nothing, _ = softmax_with_outside(d.logit)
        least = min(0.0, float((for_nothing * d.value).sum() / d.mu[0, 0]))
        loved = logit >= max(logit.max(), 0.0) - NEGLIGIBLE
        return np.asarray((a >= max(a.max(), least) - NEGLIGIBLE) | loved)

    def _checked(
        self,
        d: Decisions,
        log_odds: Floats,
        ratio: float,
        multiplier: Floats,
        status: str,
        solver: str,
        seconds: float,
    ) -> ProgramSolution:
        """Turn log-odds ln(P_i / P_0) into prices, and hold their profit against the dual value."""
        mu = float(d.mu[0, 0])
        by_markup = d.value[0] - mu * (1.0 + ratio)
        known = np.isfinite(log_odds)
        compensation = np.where(known, mu * (np.where(known, log_odds, 0.0) - d.logit[0]), by_markup)
        if self.nonnegative:
            compensation = np.maximum(compensation, 0.0)
        logit = d.logit + compensation / mu
        top = max(logit.max(), 0.0)
        weight, outside = np.exp(logit[0] - top), np.exp(-top)
        acceptance, rejection = weight / (weight.sum() + outside), float(outside / (weight.sum() + outside))
        profit = float(acceptance @ (d.value[0] - compensation))
        size = 1.0 + abs(ratio)
        for step in np.concatenate([[0.0], 1e-12 * 1.5 ** np.arange(36) * size]):
            bound = np.array([[ratio + step]])
            if (closed_form.dual_slack(d, bound, self.nonnegative) >= 0).all():
                break
        else:
            raise SolverError(
                f"{solver} ended {status} but its dual value {mu * ratio:.6g} proves no bound; try another solver"
            )
        gap = mu * bound.item() - profit
        if gap > ACCURACY * (mu + abs(profit)):
            raise SolverError(
                f"{solver} ended {status} with a gap of {gap:.2g} between profit {profit:.6g} and its bound: not "
                f"accurate enough to price with; use optimal_prices, or tighter solver options"
            )
        return ProgramSolution(
            compensation,
            acceptance,
            rejection,
            mu + profit,
            profit,
            mu * bound.item(),
            multiplier,
            status,
            solver,
            seconds,
        )


@cache
def _installed_solvers() -> tuple[str, ...]:
    import cvxpy

    cp: Any = cvxpy
    return tuple(cp.installed_solvers())


def _attempts(solver: str, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Options to try in turn. Clarabel stops now and then short of a tight tolerance that it mostly reaches."""
    if solver != "CLARABEL":
        return [options]
    names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    cautious = {"max_step_fraction": 0.95}
    tries: list[dict[str, Any]] = [dict.fromkeys(names, tolerance) for tolerance in (1e-9, 1e-8)]
    return [attempt | options for attempt in (*tries, tries[-1] | cautious)]


def _run(problem: Any, solver: str, options: dict[str, Any]) -> tuple[str, float]:
    import cvxpy

    cp: Any = cvxpy
    if solver not in _installed_solvers():
        raise InputError(f"solver {solver!r} is not installed; there are {', '.join(_installed_solvers())}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate end is raised below, not whispered
            # A warm start would keep a Clarabel solver's old settings from one solve to the next.
            problem.solve(solver=solver, warm_start=False, **options)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{solver} does not take {', '.join(options) or 'this'}: {str(error).splitlines()[0]}"
        ) from error
    except cp.error.SolverError as error:
        raise SolverError(f"{solver} failed on the pricing program: {str(error).splitlines()[0]}") from error
    if problem.status != cp.OPTIMAL:
        raise SolverError(f"{solver} ended with status {problem.status} on the pricing program; no price is returned")
    return problem.status, float(problem.solver_stats.solve_time or 0.0)
