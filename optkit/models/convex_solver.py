"""Solvers behind CVXPY, with errors in one line."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

from optkit.basics.errors import InputError, SolverError


def run(problem: Any, solver: str, options: dict[str, Any], name: str) -> None:
    """Solve a CVXPY problem in place, to whatever status the solver ends with.

    Parameters
    ----------
    problem : cvxpy.Problem
        Its status and values are set.
    solver : str
        Any installed CVXPY solver.
    options : dict
        Passed to the solver.
    name : str
        What the errors call the problem.

    Raises
    ------
    InputError
        If the solver is not installed, or does not take the options.
    SolverError
        If the solver fails.
    """
    import cvxpy

    cp: Any = cvxpy  # it comes without types
    if solver not in _installed():
        raise InputError(f"solver {solver!r} is not installed; there are {', '.join(_installed())}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate end shows in the status, which the caller looks at
            problem.solve(solver=solver, **options)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{solver} does not take {', '.join(options) or 'this'}: {str(error).splitlines()[0]}"
        ) from error
    except cp.error.SolverError as error:
        raise SolverError(f"{solver} failed on {name}: {str(error).splitlines()[0]}") from error


@cache
def _installed() -> tuple[str, ...]:
    import cvxpy

    cp: Any = cvxpy
    return tuple(cp.installed_solvers())
