"""The fluid bound of a scenario."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from optkit import scenario
from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.bound import prove
from optkit.bounds.exact.exact_value import exact_value
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.fluid.bound import FluidCertificate, FluidModel, fluid_bound

seeds = st.integers(0, 2**32 - 1)


def random_model(rng, *, horizon=6, classes=8, groups=2):
    arrival = rng.integers(0, horizon, classes)
    presence = rng.random((horizon, groups)) * (rng.random((horizon, 1)) < 0.8)
    return FluidModel(
        horizon, arrival, np.minimum(arrival + rng.integers(0, 4, classes), horizon - 1), 30 + 10 * rng.random(classes),
        -5 * rng.random(classes), -20 * rng.random((groups, classes)), 0.1 + rng.random(classes), presence / groups,
        1.0 + rng.random(groups), rng.random(groups),
    )  # fmt: skip


def test_one_class_and_one_worker_by_hand():
    """Maximise q P (a + mu ln n - mu ln P + mu ln P_0) over q P <= n: each unit earns more in company."""
    q, n, mu, a = 0.8, 0.5, 2.0, 24.0
    model = FluidModel(2, [0], [1], [30.0], [-5.0], [[-10.0]], [n], [[0.0], [q]], [mu], 1.0)
    best = minimize_scalar(
        lambda P: -q * P * (a + mu * np.log(n * (1 - P) / P)), bounds=(1e-9, n / q), method="bounded",
        options={"xatol": 1e-12},
    )  # fmt: skip
    assert fluid_bound(model).value == pytest.approx(-n * 5.0 - best.fun, rel=1e-7)  # its flat maximum


def test_one_instance_is_the_fluid_model_of_itself():
    """With every count and presence 1 nothing is random, and the bound is the arrival-information bound."""
    for day in scenario("II", seed=0).sample(2, seed=4):
        fluid = fluid_bound(FluidModel.from_instances([day]))
        assert fluid.value == pytest.approx(arrival_dual(day).value, rel=1e-8)  # the tolerances of both


@pytest.mark.slow
@given(seeds)
@settings(max_examples=20, deadline=None)
def test_above_the_mean_of_independent_requests_and_workers(random_instance, seed):
    """Exactly, over all pairings of the requests of one instance with the workers of another: Jensen's inequality."""
    rng = np.random.default_rng(seed)
    days = [random_instance(rng, groups=2, workers=int(rng.integers(0, 8))) for _ in range(4)]
    days = [replace(day, mu=days[0].mu, outside_utility=days[0].outside_utility) for day in days]
    pairings = [
        replace(one, worker_step=other.worker_step, worker_group=other.worker_group, noise=None, outside_noise=None)
        for one in days
        for other in days
    ]
    mean = np.mean([prove(arrival_dual(day), day).attained for day in pairings])
    assert fluid_bound(FluidModel.from_instances(days)).value >= mean


def test_above_the_exact_value_of_a_small_model():
    """Rates and presences are known here, so that the bound is proven, not estimated."""
    T, arrivals, lifetime, share, seen = 10, [0.35, 0.25], [3, 2], [0.4, 0.6], 0.4
    money = {"reward": [30.0, 45.0], "penalty": [-4.0, -10.0]}
    groups = {"mu": [2.0, 4.0], "outside_utility": [0.0, 1.0], "utility": [[-10.0, -18.0], [-20.0, -9.0]]}
    small = SmallModel(
        horizon=T, lifetime=lifetime, share=share, arrivals=arrivals, workers=[1 - seen, seen], **money, **groups
    )
    kind, arrival = (x.ravel() for x in np.meshgrid([0, 1], np.arange(T)))
    model = FluidModel(
        T, arrival, np.minimum(arrival + np.take(lifetime, kind), T - 1), np.take(money["reward"], kind),
        np.take(money["penalty"], kind), np.array(groups["utility"])[:, kind], np.take(arrivals, kind),
        np.tile(seen * np.array(share), (T, 1)), groups["mu"], groups["outside_utility"],
    )  # fmt: skip
    assert fluid_bound(model).value > exact_value(small).value


def test_more_of_anything_good_never_lowers_the_bound():
    """A class split in two is the same class; a likelier worker, or a larger advantage, can only help."""
    model = random_model(np.random.default_rng(1))
    value = fluid_bound(model).value
    twice = {name: np.repeat(getattr(model, name), 2, axis=-1) for name in ("arrival", "expiry", "reward", "penalty",
             "utility", "count")}  # fmt: skip
    twice["count"] = twice["count"] / 2
    assert fluid_bound(replace(model, **twice)).value == pytest.approx(value, rel=1e-8)  # the tolerance
    assert fluid_bound(replace(model, presence=0.9 * model.presence)).value < value
    assert fluid_bound(replace(model, utility=model.utility + 1.0)).value > value


def test_a_class_may_gather_requests_that_are_no_better():
    """The largest advantage and the mean penalty bound a mixture; the mean advantage does not."""
    mixture = FluidModel(1, [0, 0], [0, 0], [20.0, 40.0], [0.0, -4.0], [[-10.0, -10.0]], [0.5, 0.5], [[1.0]], [1.0])
    gathered = FluidModel(1, [0], [0], [42.0], [-2.0], [[-10.0]], [1.0], [[1.0]], [1.0])
    averaged = replace(gathered, reward=[30.0])
    assert fluid_bound(averaged).value < fluid_bound(mixture).value < fluid_bound(gathered).value


def test_the_certificate_is_checked_against_the_model():
    model = random_model(np.random.default_rng(2))
    bound = fluid_bound(model)
    assert (bound.kind, bound.solver.method, bound.solver.status) == ("fluid", "lagrangian", "optimal")
    assert prove(bound, model).gap == bound.solver.details["gap"]
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(bound, value=bound.value - 0.1), model)
    with pytest.raises(SolverError, match="breaks a constraint"):
        prove(replace(bound, certificate=FluidCertificate(bound.certificate.multipliers - 100.0)), model)
    with pytest.raises(InputError, match=r"multipliers has shape \(3,\); it needs \(8,\)"):
        FluidCertificate(np.zeros(3)).check(model)


def test_a_bound_that_stops_early_is_valid_and_says_so():
    model = FluidModel.from_instances(scenario("I.1", seed=0).sample(20, seed=1))
    best, early = fluid_bound(model), fluid_bound(model, max_iterations=3)
    assert "limit of 3 steps" in early.solver.status
    assert early.value > best.value


def test_nobody_comes():
    model = replace(random_model(np.random.default_rng(3)), presence=np.zeros((6, 2)))
    bound = fluid_bound(model)
    total = model.count @ model.penalty
    assert -1e-15 <= (bound.value - total) / abs(total) <= 1e-14  # a proof rounds up
    assert 0 <= prove(bound, model).gap <= 1e-14 * abs(total)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"count": np.zeros(8)}, r"count\[0\] = 0.0 is not positive"),
        ({"presence": np.full((6, 2), 0.6)}, r"presence\[0\]"),
        ({"presence": np.full((6, 2), -0.1)}, r"presence\[0\]"),
        ({"presence": np.zeros((5, 2))}, "presence has shape"),
        ({"penalty": np.ones(8)}, "penalty"),
        ({"mu": [1.0, -1.0]}, "mu"),
        ({"utility": np.zeros((1, 8))}, "utility has shape"),
    ],
)
def test_a_model_that_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        replace(random_model(np.random.default_rng(9)), **wrong)


def test_instances_of_different_scenarios_are_refused():
    days = [scenario("I.1", seed=0, horizon=T).sample(1, seed=1)[0] for T in (50, 60)]
    with pytest.raises(InputError, match=r"instances\[1\] differs from the first in horizon"):
        FluidModel.from_instances(days)
    with pytest.raises(InputError, match="no instances"):
        FluidModel.from_instances([])
