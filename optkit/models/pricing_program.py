"""The pricing problem in the space of acceptance probabilities, as a concave program for CVXPY."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Known, flag
from optkit.basics.errors import InputError, SolverError
from optkit.models.choice import softmax_with_outside
from optkit.models.convex_solver import run
from optkit.models.decision import Given
from optkit.models.pricing import enclosure
from optkit.models.pricing.compensated import compensated_sum

if TYPE_CHECKING:
    import cvxpy as cp

NEGLIGIBLE = 30.0
"""Log-odds below the largest at which a request is left out: its probability is below 1e-13 of another's."""

ACCURACY = 1e-6
"""Largest accepted gap between the program's primal and dual values, rounding included, relative to mu + |profit|."""

LARGEST = 5_000
"""Most requests of a program: CVXPY keeps about 32 n^2 bytes for its parameters, 0.8 GB at this size."""


@dataclass(frozen=True)
class ProgramSolution(Known):
    """What the solver found, checked.

    Attributes
    ----------
    compensation, acceptance : (n,) float
        Money and probability. The optimum is flat: an objective gap of 1e-8 leaves about 1e-4 in a probability, and the
        price of a request below probability 1e-6 is the first-order condition's ``v_i - m``, not the solver's.
    rejection, markup, profit : float
        Probability of no acceptance, ``m = mu + profit`` and expected profit, in money.
    bound : float
        The solver's dual value, raised until it is proven, rounding included: no prices earn more, in money.
    multiplier : (n,) float
        The solver's multipliers of ``P_i >= P_0 w_i``, in money; 0 without the sign constraint and where not offered.
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
        if n > LARGEST:
            raise InputError(
                f"a program over {n:,} requests takes about {32e-9 * n * n:,.1f} GB; at most {LARGEST:,} are taken: "
                "optimal_prices prices any number"
            )
        self.n, self.nonnegative = int(n), flag("nonnegative", nonnegative)
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
        offered: npt.ArrayLike | None = None,
        solver: str = "CLARABEL",
        **options: Any,
    ) -> ProgramSolution:
        """Solve for one decision.

        Parameters
        ----------
        value, utility : (n,) float
            Worth of serving each request and its utility to the worker, in money; utility ``-inf`` where the worker
            cannot serve it.
        mu, outside_utility : float
            Noise scale (positive) and utility of rejecting, in money.
        offered : (n,) bool, optional
            Which requests are on offer; all by default.
        solver : str
            Any installed CVXPY solver with exponential cones.
        **options
            Passed to the solver.

        Raises
        ------
        InputError
            If an argument is out of shape, not finite or out of range, labels differ, or the solver is not installed.
        SolverError
            If the solver does not end with status "optimal", or its primal and dual values differ by more than
            :data:`ACCURACY`: what is not accurate never becomes a price.
        """
        given = Given.of("value", value, utility, mu, outside_utility, offered)
        if given.money.shape != (1, self.n) or given.shape not in ((), (1,)):
            raise InputError(
                f"this program is for one decision over {self.n} requests; got {(*given.shape, given.money.shape[1])}"
            )
        keep = np.flatnonzero(self._matter(given))
        if keep.size == 0:
            return self._checked(given, np.full(self.n, np.nan), 0.0, np.zeros(self.n), "optimal", "none needed", 0.0)
        self._last = keep.size
        program = self._program(keep.size)
        noise = given.mu[0, 0]
        log_scale = -np.log1p(max(given.log_odds[0, keep].max(), 0.0))
        if self.nonnegative:
            log_scale = min(log_scale, -np.logaddexp.reduce(np.append(given.logit[0, keep], 0.0)))
        # Utilities far from the outside option's are small against P_0 / scale, and as exact as they were given.
        raised = np.array([noise * log_scale])
        relative = given.utility[0, keep], -given.outside_utility[0], raised
        liked = compensated_sum(*relative)[0]
        if program.floor is not None:
            program.floor.value = np.exp(np.minimum(liked / noise, 0.0))
        lifted = compensated_sum(*relative, given.money[0, keep])[0] / noise
        shift = lifted.max()
        scale = np.exp(raised[0] / noise)
        unit = max(1.0, (shift - lifted).max() / NEGLIGIBLE, abs(shift * scale))
        program.linear.value, program.outside.value = (lifted - shift) / unit, shift * scale / unit
        program.entropy.value, program.scale.value = 1.0 / unit, scale
        failure = SolverError(f"no accuracy left to try with {solver}")
        for attempt in _attempts(solver, options):
            try:
                status, seconds = _solved(program.problem, solver, attempt)
                return self._read(given, program, keep, liked, shift, unit, status, solver, seconds)
            except SolverError as error:
                failure = error
        raise failure

    def _read(
        self,
        given: Given,
        program: _Program,
        keep: npt.NDArray[np.intp],
        liked: Floats,
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
        mu = float(given.mu[0, 0])
        with np.errstate(divide="ignore"):
            log_odds = np.log(probability[keep]) - np.log(max(program.Q.value, 1e-300))
        paid = np.full(self.n, np.nan)
        paid[keep] = np.where(probability[keep] >= 1e-6, mu * log_odds - liked, np.nan)
        ratio = float(shift + unit * simplex.dual_value)
        multiplier = np.zeros(self.n)
        if floor:
            # Requests that were left out get what stationarity asks of them.
            multiplier = np.maximum(mu * (1.0 + ratio) - given.money[0], 0.0)
            multiplier[keep] = mu * unit * floor[0].dual_value
        return self._checked(given, paid, ratio, multiplier, status, solver, seconds)

    def _matter(self, given: Given) -> npt.NDArray[np.bool_]:
        """Requests whose probability can exceed about 1e-13, free or held at compensation 0."""
        a, served = given.log_odds[0], np.isfinite(given.log_odds[0])
        if not self.nonnegative or not served.any():
            return np.asarray(served & (a >= max(a.max(), 0.0) - NEGLIGIBLE))
        # P_i / P_0 = exp(a_i/mu - 1 - R/mu) for a free request, and the profit R is at least that of paying nothing,
        # which is negative where workers love what ruins the platform.
        logit = np.where(served, given.logit[0], -np.inf)
        for_nothing, _ = softmax_with_outside(logit[None])
        least = min(0.0, float((for_nothing * given.money).sum() / given.mu[0, 0]))
        loved = logit >= max(logit.max(), 0.0) - NEGLIGIBLE
        return np.asarray(served & ((a >= max(a.max(), least) - NEGLIGIBLE) | loved))

    def _checked(
        self,
        given: Given,
        paid: Floats,
        ratio: float,
        multiplier: Floats,
        status: str,
        solver: str,
        seconds: float,
    ) -> ProgramSolution:
        """Price by the markup what has no price (NaN), and hold the prices' profit against the dual value."""
        mu, served = given.mu[0, 0], np.isfinite(given.log_odds[0])
        compensation = np.where(np.isnan(paid), given.money[0] - mu * (1.0 + ratio), paid)
        compensation = np.where(served, np.maximum(compensation, 0.0) if self.nonnegative else compensation, 0.0)
        multiplier = np.where(served, multiplier, 0.0)
        if not np.isfinite(ratio + compensation.sum() + multiplier.sum()):
            raise SolverError(f"{solver} ended {status} with numbers that are not finite; use optimal_prices")
        earned, taken = enclosure.earned(given, compensation[None])
        profit, error = (float(x.item()) for x in earned)
        bound = float(enclosure.optimum(given, np.array([[mu * ratio]]), self.nonnegative).value.item())
        gap = bound - profit + error
        if not gap <= ACCURACY * (mu + abs(profit)):
            raise SolverError(
                f"{solver} ended {status} with a gap of {gap:.2g} between profit {profit:.6g} and its bound: not "
                f"accurate enough to price with; use optimal_prices, or tighter solver options"
            )
        return ProgramSolution(
            compensation=compensation,
            acceptance=taken[0, :-1],
            rejection=float(taken[0, -1]),
            markup=float(mu + profit),
            profit=profit,
            bound=bound,
            multiplier=multiplier,
            status=status,
            solver=solver,
            seconds=seconds,
        )


def _attempts(solver: str, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Options to try in turn. Clarabel stops now and then short of a tight tolerance that it mostly reaches."""
    if solver != "CLARABEL":
        return [options]
    names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    cautious = {"max_step_fraction": 0.95}
    tries: list[dict[str, Any]] = [dict.fromkeys(names, tolerance) for tolerance in (1e-9, 1e-8)]
    return [attempt | options for attempt in (*tries, tries[-1] | cautious)]


def _solved(problem: Any, solver: str, options: dict[str, Any]) -> tuple[str, float]:
    """Solve to the status "optimal", or not at all; return it and the solver's seconds."""
    # A warm start would keep a Clarabel solver's old settings from one solve to the next.
    run(problem, solver, options | {"warm_start": False}, "the pricing program")
    if problem.status != "optimal":
        raise SolverError(f"{solver} ended with status {problem.status} on the pricing program; no price is returned")
    return problem.status, float(problem.solver_stats.solve_time or 0.0)
