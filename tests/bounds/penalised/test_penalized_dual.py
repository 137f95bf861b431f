"""Bounds under linear charges: by the formula and in the chain."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import wrightomega

from optkit import Instance, scenario
from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import prove
from optkit.bounds.exact.exact_value import exact_value
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.bounds.penalised.penalized_dual import charged_market, penalized_dual

seeds = st.integers(0, 2**32 - 1)
bounded = settings(derandomize=True, deadline=None, max_examples=25)


def charges_for(day, seed, scale=10.0):
    rng = np.random.default_rng(seed)
    share = rng.dirichlet(np.ones(day.n_groups))
    theta = rng.normal(0, scale, (2, 2, 2))
    return LinearCharges(theta, [20.0, 60.0], [1.0, 5.0], Foresight([0.4, 0.6], share), 0.8)


def by_formula(day, charges, multipliers):
    """D at some multipliers, worker by worker, and by the charge of the run that serves nobody but one."""
    nobody = day.expiry - 1
    paid = charges.along(day, nobody[None])[0]
    total = day.penalty.sum() + multipliers.sum() - paid
    for step, d in zip(day.worker_step, day.worker_group, strict=True):
        score = []
        for i in np.flatnonzero((day.arrival <= step) & (step <= day.expiry)):
            last = nobody.copy()
            last[i] = step - 1
            spared = paid - charges.along(day, last[None])[0]
            advantage = day.reward[i] - day.penalty[i] + day.utility[d, i] - day.outside_by_group[d]
            score.append((advantage + spared - multipliers[i]) / day.mu[d] - 1.0)
        if score:
            total += day.mu[d] * wrightomega(np.logaddexp.reduce(score)).real
    return total


@pytest.mark.parametrize("seed", range(3))
def test_the_dual_is_its_formula_and_optimal(random_instance, seed):
    """At its own multipliers to rounding, and nowhere less at 100 others."""
    rng = np.random.default_rng(seed)
    day = random_instance(rng, requests=10, workers=7, lifetime=4.0, groups=2)
    charges = charges_for(day, seed)
    bound = penalized_dual(day, charges)
    best = bound.certificate.multipliers
    assert bound.value == pytest.approx(by_formula(day, charges, best), abs=1e-9)
    assert abs(prove(bound, day).gap) <= 1e-6  # the tolerance, 1e-9 of the gain, and rounding
    market, paid = charged_market(day, charges)
    for _ in range(100):
        other = np.maximum(best + rng.normal(0, rng.choice([0.1, 5.0]), best.size), 0.0)
        assert market.verdict(other).bound - paid >= bound.value - 1e-6


@pytest.mark.slow
@bounded
@given(seeds, st.integers(0, 9), st.integers(0, 6), st.sampled_from([0.0, 1.0, 30.0]))
def test_the_lattice_under_the_same_charges_lies_below(random_instance, seed, requests, workers, scale):
    """On every path: the dual only relaxes "served at most once"."""
    rng = np.random.default_rng(seed)
    day = random_instance(rng, requests=requests, workers=workers, lifetime=4.0, groups=2)
    charges = charges_for(day, seed, scale)

    def charge(step, waiting):
        masks = np.arange(1 << waiting.size)[:, None] >> np.arange(waiting.size) & 1
        last = np.tile(day.arrival - 1, (len(masks), 1))
        last[:, waiting] = np.where(masks, step, day.arrival[waiting] - 1)
        before = last.copy()
        before[:, waiting] = np.where(masks, step - 1, day.arrival[waiting] - 1)
        return charges.along(day, last) - charges.along(day, np.maximum(before, day.arrival - 1))

    free = np.zeros(day.n_requests, bool)
    program = SubsetProgram(day, stages(day, every_step=True), np.zeros(day.n_requests), free)
    exact = program.constant + program.tables(charge)[0][0]
    bound = penalized_dual(day, charges)
    assert bound.value >= exact - 1e-8
    prove(bound, day)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["I.1", "II"])
def test_without_charges_it_is_the_bound_that_it_penalises(name):
    for day in scenario(name, seed=0).sample(4, seed=1):
        share = np.full(day.n_groups, 1 / day.n_groups)
        free = LinearCharges(np.zeros((1, 2, 2)), [0.0, 9.0], [1.0, 9.0], Foresight(fifo_presence(0.5), share))
        assert penalized_dual(day, free).value == pytest.approx(arrival_dual(day).value, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_its_mean_bounds_the_exact_value_for_any_coefficients(seed):
    """All 216 paths of a small model by enumeration."""
    rng = np.random.default_rng(seed)
    u, outside = rng.uniform(-25, -5, (2, 1)), rng.uniform(-3, 3, 2)
    model = SmallModel(
        horizon=3, reward=[35.0], penalty=[-6.0], lifetime=[2], utility=u, mu=[2.0, 4.0], arrivals=[0.6],
        workers=[0.4, 0.6], share=[0.3, 0.7], outside_utility=outside,
    )  # fmt: skip
    charges = LinearCharges(rng.normal(0, 8, (2, 2, 2)), [5.0, 40.0], [1.0, 2.0], Foresight([0.6], model.share), 0.6)
    exact, mean, sure = exact_value(model).value, 0.0, 0.0
    for groups, comes in product(product((-1, 0, 1), repeat=3), product((0, 1), repeat=3)):
        p = float(np.prod([0.4 if g < 0 else 0.6 * model.share[g] for g in groups]))
        p *= float(np.prod([0.6 if c else 0.4 for c in comes]))
        arrival, seen = np.flatnonzero(comes), np.flatnonzero(np.array(groups) >= 0)
        n = arrival.size
        day = Instance(
            horizon=3, arrival=arrival, expiry=np.full(n, 2), reward=np.full(n, 35.0), penalty=np.full(n, -6.0),
            features=np.zeros((n, 0)), pickup=0 * arrival, dropoff=0 * arrival, worker_step=seen,
            worker_group=np.array(groups)[seen], utility=np.repeat(u, n, axis=1), mu=model.mu, outside_utility=outside,
        )  # fmt: skip
        mean += p * penalized_dual(day, charges).value
        sure += p * charges.shifts(day)[1]
    assert sure == pytest.approx(0.0, abs=1e-11)
    assert mean >= exact - 1e-9


def test_the_noise_plays_no_part(random_instance):
    day = random_instance(np.random.default_rng(0), groups=2)
    charges = charges_for(day, 0)
    silent = replace(day, noise=None, outside_noise=None)
    assert penalized_dual(silent, charges).value == penalized_dual(day, charges).value


@pytest.mark.parametrize("sizes", [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}])
def test_with_nobody_to_serve_or_to_be_served_the_penalties_and_the_charges_are_paid(random_instance, sizes):
    day = random_instance(np.random.default_rng(7), groups=2, **sizes)
    charges = charges_for(day, 1)
    expected = day.penalty.sum() - charges.shifts(day)[1]
    bound = penalized_dual(day, charges)
    assert bound.value == pytest.approx(expected, abs=1e-9)
    assert abs(prove(bound, day).gap) <= 1e-9


def test_a_solver_that_stops_early_gives_a_looser_bound_and_says_so(random_instance):
    day = random_instance(np.random.default_rng(3), requests=12, workers=8, lifetime=6.0, groups=2)
    charges = charges_for(day, 3)
    early, whole = penalized_dual(day, charges, max_iterations=1), penalized_dual(day, charges)
    assert early.value > whole.value
    assert "stopped by the limit" in early.solver.status
    prove(early, day)
    with pytest.raises(InputError, match="tolerance"):
        penalized_dual(day, charges, tolerance=0.0)


def test_forged_certificates_do_not_pass(random_instance):
    day = random_instance(np.random.default_rng(4), requests=10, workers=7, lifetime=4.0, groups=2)
    charges = charges_for(day, 4)
    bound = penalized_dual(day, charges)
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(bound, value=bound.value - 0.01), day)
    other = replace(bound.certificate, charges=charges_for(day, 5))
    assert abs(other.check(day).bound - bound.value) > 0.01
    negative = replace(bound.certificate, multipliers=bound.certificate.multipliers - 50.0)
    with pytest.raises(SolverError, match="breaks a constraint"):
        prove(replace(bound, certificate=negative), day)


def test_charges_of_other_groups_are_refused(random_instance):
    day = random_instance(np.random.default_rng(5), groups=2)
    other = LinearCharges(np.zeros((1, 2, 2)), [0.0, 9.0], [1.0, 9.0], Foresight([0.5], [1.0]))
    with pytest.raises(InputError, match="share"):
        penalized_dual(day, other)


def apart():
    """A day whose two noise scales are 6e6 apart, on which the second-order step is singular to the last digit."""
    likes = [
        [3.76333328330145e-05, -9.868891687118782e-06, 4.5553656592559e-05, 1.2414770977920881e-05,
         -3.733179536860363e-05],
        [-2.3134138781284034e-05, 1.8391918006829415e-05, 8.573590964635638e-06, -1.4351650810726581e-05,
         3.32785791797405e-05],
    ]  # fmt: skip
    return Instance(
        horizon=7, arrival=[1, 2, 4, 6, 6], expiry=[2, 3, 6, 6, 6],
        reward=[4.454193265435456e-05, 4.007196839659572e-05, 2.6466437984783783e-05, 5.5364427431991955e-05,
                1.4142468714724114e-05],
        penalty=[-3.826426574943202e-06, -3.098814321836909e-06, -6.589626320400752e-06, -1.690017061227978e-05,
                 -1.3929394865847796e-05],
        features=np.zeros((5, 0)), pickup=[0] * 5, dropoff=[0] * 5, worker_step=range(7),
        worker_group=[1, 0, 1, 1, 1, 0, 0], utility=likes, mu=[0.006507298218594011, 1.0732444208493258e-09],
        outside_utility=4.575698682941314e-06,
    )  # fmt: skip


@pytest.mark.slow
def test_noise_scales_that_are_millions_apart(random_instance):
    """A bound that its certificate proves, whatever the scales, also where a Newton step has no solution."""
    theta = [[[0.8000765603219446, -0.6252417214807118], [0.37821519414228594, -1.4352061860922274]]]
    charges = LinearCharges(theta, [0.0, 50.0], [1.0, 9.0], Foresight(fifo_presence(0.5, 20), [0.5, 0.5]))
    prove(penalized_dual(apart(), charges), apart())
    rng = np.random.default_rng(0)
    for _ in range(12):
        day = random_instance(rng, requests=5, workers=6, lifetime=3.0, groups=2)
        day = replace(day, mu=day.mu * [1.0, 10.0 ** -rng.uniform(6.0, 12.0)])
        bound = penalized_dual(day, charges_for(day, 1))
        assert np.isfinite(bound.value)
        prove(bound, day)


def test_a_singular_step_is_one_by_the_curvature_alone(monkeypatch):
    """Where the system of a step cannot be solved at all, the bound is looser or later, but there."""
    day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    share = np.full(day.n_groups, 1 / day.n_groups)
    free = LinearCharges(np.zeros((1, 2, 2)), [0.0, 9.0], [1.0, 9.0], Foresight(fifo_presence(0.5), share))
    right = penalized_dual(day, free).value

    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(np.linalg, "solve", singular)
    bound = penalized_dual(day, free)
    assert bound.value >= right - 1e-9 * abs(right)
    prove(bound, day)
