"""The concave pricing program: a solver that knows no Lambert W finds the closed form's profit, prices and duals."""

from contextlib import suppress

import numpy as np
import pytest

from optkit.basics.errors import InputError, SolverError
from optkit.models.choice import acceptance_probabilities
from optkit.models.pricing import certify, optimal_prices
from optkit.models.pricing_program import LARGEST, PricingProgram, _Program

cp = pytest.importorskip("cvxpy")

programs: dict[tuple[int, bool], PricingProgram] = {}


def program(n, nonnegative):
    """One program per size and form, as a user keeps it: building one takes longer than solving it."""
    return programs.setdefault((n, nonnegative), PricingProgram(n, nonnegative))


def draw(seed, n, mu):
    """Four kinds of decisions: gig work, some of it a loss, of the order of mu, and whole numbers with ties."""
    rng = np.random.default_rng([seed, n])
    kind = seed % 4
    if kind == 0:
        return rng.uniform(20, 120, n), -rng.uniform(5, 60, n)
    if kind == 1:
        return rng.uniform(-50, 50, n), rng.uniform(-50, 0, n)
    if kind == 2:
        return mu * rng.uniform(-5, 10, n), mu * rng.uniform(-5, 5, n)
    return np.round(rng.uniform(-2, 5, n)), np.round(rng.uniform(-2, 5, n))


def check_agreement(solution, v, u, mu, outside, nonnegative):
    best = optimal_prices(v, u, mu, outside_utility=outside, nonnegative=nonnegative)
    proof = certify(best.compensation, v, u, mu, outside_utility=outside, nonnegative=nonnegative)
    money = mu + abs(best.profit)
    # The solver stops at gaps of 1e-10 to 1e-8 of its scaled problem; 13,000 random cases stayed below 2e-7 in the
    # profit, and 3,000 in the bound. A profit above the optimum, or a bound below it, may only be rounding.
    assert -1e-6 * money <= solution.profit - best.profit <= 1e-12 * (money + np.abs(v).max())
    assert solution.bound == pytest.approx(best.profit, abs=1e-6 * money)
    assert solution.bound >= best.profit - 1e-12 * (money + np.abs(v).max())
    # The optimum is flat: a gap g leaves sqrt(g / mu) in a probability, measured at most 9e-5.
    assert solution.acceptance == pytest.approx(best.acceptance, abs=1e-4)
    assert solution.rejection == pytest.approx(best.rejection, abs=1e-4)
    # The gap is at least the variance of the price errors over the worker's options, P_i P_0 error_i^2 / 2 mu; this
    # product was at most 3e-5 mu. Where a probability is negligible the price means nothing.
    seen = best.acceptance > 1e-6
    error = np.abs(solution.compensation - best.compensation) * np.sqrt(best.acceptance * best.rejection)
    assert (error[seen] <= 1e-4 * mu).all()
    assert (solution.compensation >= 0).all() or not nonnegative
    # Multipliers price the constraint of a request; they are as uncertain as its probability is small. Measured 6e-5.
    assert np.abs((solution.multiplier - proof.multiplier) * best.acceptance).max() <= 1e-4 * money


@pytest.mark.slow
@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize("mu", [1e-3, 0.1, 1.0, 10.0, 1e3])
@pytest.mark.parametrize("n", [1, 2, 3, 8, 50])
def test_profit_probabilities_prices_and_duals_are_those_of_the_closed_form(n, mu, nonnegative):
    for seed in range(4):
        v, u = draw(seed, n, mu)
        outside = 0.0 if seed % 3 else 2.0
        solution = program(n, nonnegative).solve(v, u, mu, outside)
        check_agreement(solution, v, u, mu, outside, nonnegative)


@pytest.mark.slow
@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize("mu", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("n", [1000])
def test_many_requests_agree_too(n, mu, nonnegative):
    for seed in (0, 1):
        v, u = draw(seed, n, mu)
        check_agreement(program(n, nonnegative).solve(v, u, mu), v, u, mu, 0.0, nonnegative)


@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize("scale", [1e-3, 1e3, 1e6])
def test_the_currency_does_not_matter(scale, nonnegative):
    v, u = scale * np.array([5.0, 6.0, -2.0]), scale * np.array([-1.0, -2.0, 1.0])
    check_agreement(program(3, nonnegative).solve(v, u, scale), v, u, scale, 0.0, nonnegative)


def test_the_solution_is_consistent_with_itself():
    v, u = np.array([8.0, 8.0, -4.0]), np.array([1.0, -4.0, 6.0])
    s = program(3, True).solve(v, u)
    acceptance, rejection = acceptance_probabilities(s.compensation, u)
    # Rounding only: the probabilities are those of the prices, and the profit is theirs.
    assert s.acceptance == pytest.approx(acceptance, abs=1e-14)
    assert s.rejection == pytest.approx(rejection, abs=1e-14)
    assert s.profit == pytest.approx(acceptance @ (v - s.compensation), abs=1e-13)
    assert s.markup == pytest.approx(1 + s.profit, abs=1e-13)
    assert s.profit <= s.bound
    assert (s.status, s.solver) == ("optimal", "CLARABEL")
    assert s.seconds >= 0
    assert s.multiplier[2] > 1 > 1e-6 > s.multiplier[0]


def test_no_request_worth_the_noise_is_priced_without_a_solver():
    """Every log-odds is below -30: the profit is 0 to 1e-13 mu."""
    s = program(2, True).solve([1.0, 2.0], [-500.0, -400.0])
    assert s.rejection == pytest.approx(1, abs=1e-13)
    assert s.profit == pytest.approx(0, abs=1e-13)


@pytest.mark.parametrize("nonnegative", [True, False])
def test_the_problem_is_dcp_and_dpp_and_stays_open(nonnegative):
    fresh = PricingProgram(3, nonnegative)
    assert fresh.problem.is_dcp(dpp=True)
    assert len(fresh.problem.constraints) == 1 + nonnegative
    best = fresh.solve([5.0, 6.0, 7.0], [-1.0, -2.0, -3.0])
    assert fresh.problem.status == cp.OPTIMAL
    (P,) = [x for x in fresh.problem.variables() if x.name() == "P"]
    tighter = cp.Problem(fresh.problem.objective, [*fresh.problem.constraints, P[0] <= 0.1])
    tighter.solve(solver="CLARABEL")
    assert P.value[0] == pytest.approx(0.1, abs=1e-6)  # the solver's feasibility is 1e-8
    assert best.acceptance[0] > 0.1


def test_another_solver_finds_the_same():
    v, u = np.array([5.0, 6.0, -1.0]), np.array([-1.0, -2.0, 1.0])
    s = program(3, True).solve(v, u, solver="SCS", eps=1e-9)
    assert s.solver == "SCS"
    check_agreement(s, v, u, 1.0, 0.0, True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"max_iter": 1}, "status user_limit"),
        ({"max_iter": 7}, "status optimal_inaccurate"),  # close to the optimum, and still not a price
        ({"solver": "SCS", "max_iters": 3}, "status optimal_inaccurate"),
        ({"solver": "SCS", "eps": 1e-1}, "gap of|proves no bound"),
    ],
)
def test_an_inaccurate_end_never_becomes_a_price(options, words):
    v, u = np.array([5.0, 6.0, -1.0]), np.array([-1.0, -2.0, 1.0])
    with pytest.raises(SolverError, match=words) as caught:
        PricingProgram(3).solve(v, u, **options)
    assert "\n" not in str(caught.value)


def test_loose_tolerances_of_one_solve_do_not_stay_for_the_next():
    one = PricingProgram(3)
    v, u = np.array([5.0, 6.0, -1.0]), np.array([-1.0, -2.0, 1.0])
    loose = {"tol_gap_abs": 1e-4, "tol_gap_rel": 1e-4, "tol_feas": 1e-4}
    with suppress(SolverError):  # it may be too loose to price with; what counts is the solve after it
        one.solve(v, u, **loose)
    again, fresh = one.solve(v, u), PricingProgram(3).solve(v, u)
    assert again.acceptance == pytest.approx(fresh.acceptance, abs=1e-12)  # the same iterations on the same data


def test_a_smaller_active_set_between_two_solves_changes_nothing():
    """Requests that cannot matter are left out, so one object holds problems of several sizes."""
    one = PricingProgram(3)
    first = one.solve([5.0, 6.0, 7.0], [-1.0, -2.0, -3.0])
    one.solve([5.0, 6.0, 7.0], [-1.0, -2.0, -300.0])
    assert one.problem.variables()[0].size < 3 or one.problem.variables()[1].size < 3
    again = one.solve([5.0, 6.0, 7.0], [-1.0, -2.0, -3.0])
    assert again.compensation == pytest.approx(first.compensation, abs=1e-9)  # a warm start at most


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"value": [1.0, np.nan]}, r"value\[1\] is nan"),
        ({"mu": 0.0}, "mu = 0.0 is not positive"),
        ({"mu": [1.0, 2.0]}, "one decision over 2 requests"),
        ({"value": [[1.0, 2.0]] * 3}, "one decision over 2 requests"),
        ({"value": [1.0, 2.0, 3.0], "utility": [0.0, 0.0, 0.0]}, "one decision over 2 requests"),
        ({"value": [1.0, 2.0, 3.0]}, "shapes do not fit"),
        ({"value": 1.0}, "value is a single number"),
        ({"solver": "ABACUS"}, "solver 'ABACUS' is not installed"),
    ],
)
def test_bad_input_is_named_in_one_line(change, words):
    arguments = {"value": [1.0, 2.0], "utility": [0.0, 0.0]} | change
    with pytest.raises(InputError, match=words) as caught:
        program(2, True).solve(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("nonnegative", [True, False])
def test_what_is_not_offered_or_cannot_be_served_is_not_there(nonnegative):
    v, u = [5.0, 6.0, 7.0, 1e9], [-1.0, -2.0, 5.0, -np.inf]
    s = program(4, nonnegative).solve(v, u, offered=[True, True, False, True])
    kept = optimal_prices(v[:2], u[:2], nonnegative=nonnegative)
    assert (s.acceptance[2:] == 0).all()
    assert (s.compensation[2:] == 0).all()
    assert (s.multiplier[2:] == 0).all()
    assert s.profit == pytest.approx(kept.profit, abs=1e-8)  # the solver's gap
    nothing = program(4, nonnegative).solve(v, u, offered=[False] * 4)
    assert (nothing.profit, nothing.rejection) == (0, 1)
    with pytest.raises(InputError, match="a mask is made of True and False"):
        program(4, nonnegative).solve(v, u, offered=[1, 1, 0, 1])


def test_the_bound_holds_where_utilities_are_far_from_the_outside_option():
    """u - u_0 is 2e13 mu: its float is known to 4e-3 mu, and the bound must not be wrong by that."""
    v, u = np.array([1.7879968359184579e-06, -9.281318444792057e-07]), [-4.341674989241303e-07, 2.3127026078377303e-07]
    s = program(2, True).solve(v, u, 1e-6, -19112794.887060955)
    # Nobody rejects: only the difference of the two prices matters, and the lower is 0.
    c = np.maximum(v - s.markup + 1e-9 * np.arange(-4000, 4001)[:, None], 0.0)
    weight = np.exp((u + c - (u + c).max(axis=1, keepdims=True)) / 1e-6)
    profit = (weight * (v - c)).sum(axis=1) / weight.sum(axis=1)
    assert 0 <= s.bound - profit.max() <= 1e-12


def test_a_program_too_large_for_memory_is_refused_before_it_is_built():
    with pytest.raises(InputError, match=r"10,000,000 requests takes about 3,200,000.0 GB; at most") as caught:
        PricingProgram(10_000_000)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("n", [LARGEST + 1, 20_000])
def test_a_program_of_many_requests_is_refused_before_there_is_one(monkeypatch, n):
    """CVXPY is not asked for what it would take gigabytes for; one that large is not built to find out."""
    monkeypatch.setattr(_Program, "build", lambda *_: pytest.fail("a program was built"))
    with pytest.raises(InputError, match=rf"a program over {n:,} requests takes about .* GB; at most 5,000 are taken"):
        PricingProgram(n)
    PricingProgram(LARGEST)


@pytest.mark.parametrize("n", [0, -1, 2.5])
def test_a_program_needs_a_number_of_requests(n):
    with pytest.raises(InputError, match="whole number of at least 1"):
        PricingProgram(n)


@pytest.mark.parametrize("n", ["two", np.nan, None])
def test_what_is_not_a_number_of_requests_is_refused_as_ours(n):
    with pytest.raises(InputError):
        PricingProgram(n)


def test_any_setting_of_one_solve_is_gone_in_the_next():
    one = PricingProgram(2)
    one.solve([5.0, 6.0], [-1.0, -2.0])
    with pytest.raises(SolverError):
        one.solve([5.0, 6.0], [-1.0, -2.0], max_iter=1)
    assert one.solve([5.0, 6.0], [-1.0, -2.0]).status == "optimal"


def test_an_unknown_setting_is_an_error_of_ours():
    with pytest.raises((InputError, SolverError)):
        PricingProgram(2).solve([5.0, 6.0], [-1.0, -2.0], patience=3)


@pytest.mark.parametrize(
    ("value", "utility", "mu"),
    [
        ([-68.3, -82.0], [-1.4, 5.2], 0.139),
        ([-92.1, -20.6], [7.0, -6.6], 0.083),
        ([-58.7, -73.8, -95.6], [-4.3, 3.0, 3.9], 0.038),
        ([-88.5, -100.0], [-7.1, 0.7], 0.148),
        ([-48.59313612, -36.33917994, -4.40453911], [41.2013, 33.6821, -39.394], 0.01),
    ],
)
def test_a_request_that_only_draws_workers_from_a_worse_one_still_matters(value, utility, mu):
    """The optimum pays for a loss to avoid a larger one; its a_i / mu is far below 0, the outside option's."""
    v, u = np.array(value), np.array(utility)
    check_agreement(PricingProgram(len(v)).solve(v, u, mu), v, u, mu, 0.0, True)


@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 3, 8])
def test_losses_that_workers_love_are_priced_like_anything_else(n):
    for seed in range(40):
        rng = np.random.default_rng([seed, n])
        v, u, mu = rng.uniform(-50, 10, n), rng.uniform(-20, 20, n), 10.0 ** rng.uniform(-2, 1)
        check_agreement(program(n, True).solve(v, u, mu), v, u, mu, 0.0, True)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "nonnegative"), [(12, True), (95, True), (28, False)])
def test_two_hundred_gig_requests_that_the_default_step_length_fails_on(seed, nonnegative):
    rng = np.random.default_rng(seed)
    v, u = rng.uniform(20, 120, 200), -rng.uniform(5, 60, 200)
    check_agreement(PricingProgram(200, nonnegative).solve(v, u, 7.5), v, u, 7.5, 0.0, nonnegative)
