"""A registry of all bounds of the kit: how to make one, and what nobody can earn more than, in 60 digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import mpmath as mp
import numpy as np

from optkit import Instance
from optkit.bounds import Bound, arrival_information, exact_value, full_information, penalized
from optkit.bounds.arrival.arrival_information import arrival_hybrid
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.fluid.bound import FluidModel, fluid_bound
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.bounds.penalised.penalized_dual import penalized_dual
from optkit.models.value.request_sets import ZeroSetValue
from tests.bounds.judge import Market, arrival_optimum, dual_value, full_optimum, model_optimum

UNITS = (1.0, 1e-12, 1e12)
"""Units of money."""


@dataclass(frozen=True)
class Kind:
    """A kind of bounds.

    Attributes
    ----------
    subject : callable
        Draws what is to be bounded from a generator.
    bound : callable
        Bounds it.
    optimum : callable
        What somebody does earn, exactly, or what the certificate says in 60 digits, whichever is more; a function of
        the subject that gives a function of the certificate.
    one_program : bool
        Whether what a certificate attains is attained in the same program whatever its arrays: then it is at most the
        honest bound.
    """

    subject: Callable[[np.random.Generator], Any]
    bound: Callable[[Any], Bound]
    optimum: Callable[[Any], Callable[[Any], Any]]
    one_program: bool = True


def small_day(rng: np.random.Generator) -> Instance:
    """A few requests and workers, in any unit; some requests are hated, some liked, and some noise is small."""
    n, T, D = int(rng.integers(2, 5)), 5, int(rng.integers(1, 3))
    unit, arrival = rng.choice(UNITS), np.sort(rng.integers(0, T, n))
    utility = rng.uniform(-40, 5, (D, n))
    utility[rng.random((D, n)) < 0.1] = rng.choice([-1e10, -1e15, 25.0])
    penalty, mu, outside = rng.uniform(0, 10, n), 10.0 ** rng.uniform(-1.5, 1, D), rng.uniform(-3, 3, D)
    # Where floats are strained: one penalty beyond all rewards, noise of another size, an outside option out of reach.
    if rng.random() < 0.2:
        penalty[rng.integers(n)] = 10.0 ** rng.uniform(3, 12)
    if rng.random() < 0.2:
        mu[rng.integers(D)] = 10.0 ** rng.uniform(-10, 3)
    if rng.random() < 0.2:
        outside[rng.integers(D)] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(1, 7)
    return Instance(
        horizon=T, arrival=arrival, expiry=np.minimum(arrival + rng.integers(0, 4, n), T - 1),
        reward=unit * rng.uniform(5, 60, n), penalty=-unit * penalty, features=np.zeros((n, 0)),
        pickup=np.zeros(n, int), dropoff=np.zeros(n, int), worker_step=np.sort(rng.permutation(T)[:3]),
        worker_group=rng.integers(0, D, 3), utility=unit * utility, mu=unit * mu,
        outside_utility=unit * outside,
    ).with_noise(rng)  # fmt: skip


def small_model(rng: np.random.Generator) -> SmallModel:
    """One or two types, over two or three steps, in any unit."""
    K, D, unit = int(rng.integers(1, 3)), int(rng.integers(1, 3)), rng.choice(UNITS)
    return SmallModel(
        horizon=int(rng.integers(2, 4)), reward=unit * rng.uniform(5, 60, K), penalty=-unit * rng.uniform(0, 10, K),
        lifetime=rng.integers(0, 3, K), utility=unit * rng.uniform(-40, 5, (D, K)),
        mu=unit * 10.0 ** rng.uniform(-1, 1, D), workers=rng.dirichlet(np.ones(2)), arrivals=rng.uniform(0.1, 0.9, K),
        outside_utility=unit * rng.uniform(-3, 3, D), share=rng.dirichlet(np.ones(D)), queue=int(rng.integers(0, 2)),
    )  # fmt: skip


def small_fluid(rng: np.random.Generator) -> FluidModel:
    """The same requests as :func:`small_day`, in expected numbers."""
    day = small_day(rng)
    presence = rng.uniform(0, 1, (day.horizon, 1)) * rng.dirichlet(np.ones(day.n_groups), day.horizon)
    presence[rng.random(day.horizon) < 0.3] = 0.0
    return FluidModel(
        day.horizon, day.arrival, day.expiry, day.reward, day.penalty, day.utility, rng.uniform(0.2, 3, day.n_requests),
        presence, day.mu, day.outside_by_group,
    )  # fmt: skip


def small_penalized(day: Instance, limit: int = 2) -> Bound:
    """Workers are charged for, by the myopic value; so many waiting requests are told apart."""
    foresight = Foresight(np.array([0.5, 0.7]), np.full(day.n_groups, 1.0 / day.n_groups))
    return penalized(day, ZeroSetValue(), foresight, limit=limit, charged=limit)


def small_linear_charges(day: Instance) -> LinearCharges:
    """Coefficients that nobody fitted, in the day's unit of money."""
    rng, unit = np.random.default_rng(day.n_requests), float(day.reward.mean())
    foresight = Foresight(np.array([0.5, 0.7]), np.full(day.n_groups, 1.0 / day.n_groups))
    return LinearCharges(unit * rng.normal(0, 0.3, (2, 2, 2)), [0.0, unit], [1.0, 3.0], foresight, 0.6)


def _linear_optimum(day: Instance) -> Callable[[Any], Any]:
    charges = small_linear_charges(day)
    terms, start, _ = charges._terms(day)  # what is charged a unit, in floats: the sums are the judge's own
    theta = [mp.mpf(float(x)) for x in charges.theta.ravel()]

    def charge(step: int, waiting: frozenset[int]) -> Any:
        rows = [start[i] + step - day.arrival[i] for i in waiting]
        return mp.fsum(mp.mpf(float(x)) * t for row in rows for x, t in zip(terms[row], theta, strict=True))

    best = arrival_optimum(day, charge)
    return lambda certificate: best


def _penalised_optimum(day: Instance) -> Callable[[Any], Any]:
    proof = small_penalized(day).certificate
    tracked = proof.tracked

    def charge(step: int, waiting: frozenset[int]) -> float:
        if step == day.horizon - 1:
            return 0.0
        there = np.flatnonzero(tracked & (day.arrival <= step) & (day.expiry > step))
        table = proof.charges(step, there)
        return float(table[sum(1 << p for p, i in enumerate(there) if i in waiting)])

    best = arrival_optimum(day, charge)
    return lambda certificate: best


def _constant(solve: Callable[[Any], Any], subject: Any) -> Callable[[Any], Any]:
    best = solve(subject)
    return lambda certificate: best


def _dual_optimum(subject: Any) -> Callable[[Any], Any]:
    market = Market(subject)
    least = arrival_optimum(subject) if isinstance(subject, Instance) else mp.mpf("-inf")
    return lambda certificate: max(least, dual_value(market, certificate.multipliers))


KINDS: dict[str, Kind] = {
    **{
        f"full, {method}": Kind(small_day, partial(full_information, method=method), partial(_constant, full_optimum))
        for method in ("lp", "milp", "assignment")
    },
    "arrival, exact": Kind(
        small_day, partial(arrival_information, method="exact"), partial(_constant, arrival_optimum), one_program=False
    ),
    "arrival, hybrid": Kind(small_day, partial(arrival_hybrid, limit=1), partial(_constant, arrival_optimum), False),
    "arrival, lagrangian": Kind(small_day, partial(arrival_information, method="lagrangian"), _dual_optimum),
    "arrival, program": Kind(small_day, partial(arrival_information, method="program"), _dual_optimum),
    "penalised": Kind(small_day, small_penalized, _penalised_optimum, False),
    "penalised, lagrangian": Kind(
        small_day, lambda day: penalized_dual(day, small_linear_charges(day)), _linear_optimum
    ),
    "fluid": Kind(small_fluid, fluid_bound, _dual_optimum),
    "exact": Kind(small_model, exact_value, partial(_constant, model_optimum)),
}
"""Every bound of the kit."""
