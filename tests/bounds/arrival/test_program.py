"""The arrival-information bound by a conic solver."""

import math

import numpy as np
import pytest

from optkit import scenario
from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.arrival.program import arrival_program
from optkit.bounds.bound import prove


@pytest.fixture(scope="module")
def day():
    return scenario("I.1", seed=0).sample(1, seed=1)[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["I.1", "I.2", "I.3", "II"])
def test_program_and_dual_agree(name):
    """To 1e-6, as the design asks for: Clarabel's tolerance is 1e-8 of a scaled problem."""
    for day in scenario(name, seed=0).sample(4, seed=21):
        program, dual = arrival_program(day), arrival_dual(day)
        assert (program.kind, program.solver.method, program.solver.status) == (
            "arrival information", "program", "optimal",
        )  # fmt: skip
        assert program.value == pytest.approx(dual.value, rel=1e-6)
        assert program.value >= prove(dual, day).attained
        assert prove(program, day).bound == program.value


@pytest.mark.parametrize("seed", range(4))
def test_groups_with_their_own_noise_and_outside_option(random_instance, seed):
    day = random_instance(np.random.default_rng(seed), groups=3, requests=20, workers=12)
    program, dual = arrival_program(day), arrival_dual(day)
    assert program.value == pytest.approx(dual.value, rel=1e-6, abs=1e-5)  # the constant may cancel what is earned


def test_a_solver_that_stops_early_proves_a_looser_bound_and_says_so(day):
    best, early = arrival_program(day), arrival_program(day, max_iter=3)
    assert early.solver.status != "optimal"
    assert early.value > best.value + 1.0
    assert prove(early, day).gap == early.solver.details["gap"]


def test_another_solver_proves_the_same(day):
    pytest.importorskip("scs")
    assert arrival_program(day, solver="SCS").value == pytest.approx(
        arrival_program(day).value, rel=1e-4
    )  # first order


@pytest.mark.parametrize("kind", [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}])
def test_where_nobody_meets_anybody_all_penalties_are_paid(random_instance, kind):
    day = random_instance(np.random.default_rng(7), **kind)
    bound = arrival_program(day)
    total = math.fsum(day.penalty)
    assert 0 <= bound.value - total <= 1e-14 * abs(total)  # a proof rounds up
    assert 0 <= prove(bound, day).gap <= 1e-14 * abs(total)


def test_a_solver_that_is_not_there_is_refused(day):
    with pytest.raises(InputError, match=r"'XX' is not installed; there are .*CLARABEL"):
        arrival_program(day, solver="XX")


def test_an_unknown_option_is_refused(day):
    with pytest.raises(InputError, match="CLARABEL does not take nonsense"):
        arrival_program(day, nonsense=1)


def test_a_solver_without_exponential_cones_is_an_error(day):
    with pytest.raises(SolverError, match="HIGHS failed on the arrival-information program"):
        arrival_program(day, solver="HIGHS")


def test_no_multipliers_no_bound(day, monkeypatch):
    """Should a solver end without duals, nothing is claimed."""
    import cvxpy

    monkeypatch.setattr(cvxpy.Problem, "solve", lambda self, **options: None)
    monkeypatch.setattr(cvxpy.Problem, "status", "user_limit")
    monkeypatch.setattr(cvxpy.Problem, "solver_stats", type("Stats", (), {"num_iters": 0, "solve_time": 0.0}))
    with pytest.raises(SolverError, match=r"user_limit on .* pairs and no multipliers"):
        arrival_program(day)
