"""Fitting linear charges: the gradient, the optimum, and what it gains on instances that it has not seen."""

from functools import cache

import numpy as np
import pytest

from optkit import Instance, scenario
from optkit.basics.errors import InputError
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.penalised.charge_fit import _MeanDual, fit_linear_charges
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.bounds.penalised.penalized_dual import penalized_dual

SOURCE = scenario("II", seed=0, horizon=30)
TRAIN, FRESH = SOURCE.sample(80, seed=1), SOURCE.sample(80, seed=2)


@cache
def workers():
    """Whom to expect; worked out when a test wants it, not whenever tests are looked for."""
    return Foresight(fifo_presence(0.5), np.full(3, 1 / 3))


@pytest.fixture(scope="module")
def fitted():
    return fit_linear_charges(TRAIN, workers(), 0.5)


def mean_dual(days, charges):
    return _MeanDual(days, charges)


@pytest.mark.slow
def test_the_mean_is_that_of_the_bounds_one_by_one(fitted):
    """All instances as one market, to the tolerance of the dual, 1e-6 of the gain."""
    theta = fitted.theta.ravel()
    value, _ = mean_dual(TRAIN[:8], fitted).with_gradient(theta, 0.02)
    alone = np.mean([penalized_dual(day, fitted).value - day.penalty.sum() for day in TRAIN[:8]])
    assert value == pytest.approx(alone + 0.01 * (theta @ theta), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_the_gradient_is_that_of_finite_differences(fitted, seed):
    """Central differences of 0.05 money, whose own error is the third derivative's and the tolerance's."""
    rng = np.random.default_rng(seed)
    theta, mean = rng.normal(0, 5, fitted.theta.size), mean_dual(TRAIN[:8], fitted)
    slope = mean.with_gradient(theta, 0.01)[1]
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 0.05
        difference = mean.with_gradient(theta + step, 0.01)[0] - mean.with_gradient(theta - step, 0.01)[0]
        assert slope[k] == pytest.approx(difference / 0.1, abs=0.02 * np.abs(slope).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_mean_is_convex(fitted, seed):
    rng = np.random.default_rng(seed)
    mean = mean_dual(TRAIN[:8], fitted)
    one, other = rng.normal(0, 10, (2, fitted.theta.size))
    ends, middle = [mean.with_gradient(x, 0.0)[0] for x in (one, other)], mean.with_gradient((one + other) / 2, 0.0)[0]
    assert middle <= np.mean(ends) - 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("luck", [1.0, 0.4])
def test_it_ends_at_a_minimum(fitted, luck):
    """The slope has fallen to a hundredth, and no random coefficients do better on the training instances."""
    mean = mean_dual(TRAIN[:30], fitted)
    mean.luck = luck
    theta = mean.minimum(fitted.theta.ravel(), 0.01, 50)
    best, slope = mean.with_gradient(theta, 0.01)
    start, steep = mean.with_gradient(0 * theta, 0.01)
    assert np.abs(slope).max() < 0.02 * np.abs(steep).max()
    assert best < start
    rng = np.random.default_rng(0)
    assert all(mean.with_gradient(theta + rng.normal(0, 3, theta.size), 0.01)[0] > best for _ in range(5))


@pytest.mark.slow
def test_fresh_instances_gain(fitted):
    """By 4 standard errors, what nobody is charged for in the mean being taken out; and less than the training ones."""
    gain, paid = [], []
    for day in FRESH:
        bound = penalized_dual(day, fitted)
        gain.append(bound.value - arrival_dual(day).value)
        paid.append(bound.solver.details["paid"])
    x, gain = np.column_stack([np.ones(len(FRESH)), paid]), np.array(gain)
    coefficients, *_ = np.linalg.lstsq(x, gain, rcond=None)
    residual = gain - x @ coefficients
    error = np.sqrt(residual @ residual / (len(FRESH) - 2) * np.linalg.inv(x.T @ x)[0, 0])
    assert coefficients[0] < -4 * error
    trained = np.mean([penalized_dual(day, fitted).value - arrival_dual(day).value for day in TRAIN])
    assert trained < coefficients[0] + 2 * error


@pytest.mark.slow
def test_where_dozens_wait_luck_is_not_taken_for_gain():
    """When 20 requests wait little can be gained; a fit to the luck of these days would lose 100 money on others."""
    busy = scenario("I.1", seed=0, horizon=25, request_rate=3.0)
    train, fresh = busy.sample(24, seed=1), busy.sample(30, seed=2)
    charges = fit_linear_charges(train, Foresight(fifo_presence(0.5), [1.0]), 3.0, max_iterations=10)
    gain, paid = [], []
    for day in fresh:
        bound = penalized_dual(day, charges)
        gain.append(bound.value - arrival_dual(day).value)
        paid.append(bound.solver.details["paid"])
    slope = np.cov(gain, paid)[0, 1] / np.var(paid, ddof=1)
    less_luck = np.array(gain) - slope * np.array(paid)
    assert less_luck.mean() < 2 * less_luck.std(ddof=1) / np.sqrt(30)


def test_a_large_ridge_charges_nothing_and_no_requests_charge_workers_only():
    tame = fit_linear_charges(TRAIN[:8], workers(), 0.5, ridge=1e9)
    assert np.abs(tame.theta).max() < 1e-6
    alone = fit_linear_charges(TRAIN[:8], workers())
    assert alone.theta.shape == (1, 2, 3)
    assert np.abs(alone.theta).max() > 0.1


def test_knots_are_spread_or_given():
    spread = fit_linear_charges(TRAIN[:5], workers(), 0.5, surplus_knots=4, max_iterations=1)
    surplus = np.concatenate([(day.reward - day.penalty + day.utility).ravel() for day in TRAIN[:5]])
    assert spread.surplus_knots[[0, -1]] == pytest.approx(np.quantile(surplus, [0.03, 0.97]))
    assert spread.theta.shape == (2, 4, 3)
    given = fit_linear_charges(TRAIN[:5], workers(), surplus_knots=[0.0, 9.0], time_knots=[2.0, 4.0], max_iterations=1)
    assert given.surplus_knots.tolist() == [0.0, 9.0]
    assert given.time_knots.tolist() == [2.0, 4.0]


@pytest.mark.slow
def test_the_same_instances_give_the_same_charges():
    one, again = (fit_linear_charges(TRAIN[:4], workers(), 0.5) for _ in range(2))
    assert np.array_equal(one.theta, again.theta)


def lonely(workers):
    return Instance(
        horizon=4, arrival=[0], expiry=[2], reward=[30.0], penalty=[-5.0], features=[[]], pickup=[0], dropoff=[0],
        worker_step=workers, worker_group=[0] * len(workers), utility=[[-10.0]], mu=[1.0],
    )  # fmt: skip


def test_one_request_and_no_worker_is_enough():
    """Nobody to charge wrongly: what is fitted is luck alone, held by the ridge."""
    charges = fit_linear_charges([lonely([])], Foresight([0.5], [1.0]), 0.5)
    assert isinstance(charges, LinearCharges)
    # The minimum of -total.theta + ridge/2 |theta|^2.
    assert charges.theta.ravel() == pytest.approx(charges.basis(lonely([])).total / 0.01, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"instances": []}, "instances with requests"),
        ({"ridge": -1.0}, "ridge"),
        ({"ridge": np.nan}, "ridge"),
        ({"ridge": "much"}, "ridge"),
        ({"max_iterations": -1}, "max_iterations"),
        ({"surplus_knots": 1}, "surplus_knots"),
        ({"surplus_knots": [3.0, 3.0]}, "surplus_knots"),
        ({"time_knots": [1.0]}, "time_knots"),
        ({"request_rate": -0.5}, "request_rate"),
        ({"foresight": Foresight([0.5], [1.0])}, "share"),
    ],
)
def test_bad_input_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        fit_linear_charges(**({"instances": TRAIN[:3], "foresight": workers()} | change))
