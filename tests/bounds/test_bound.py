"""The result type of every bound, and the check that it claims no more than it proves."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import Instance, scenario
from optkit.basics.errors import OptkitError, SolverError
from optkit.bounds import arrival_information, full_information
from optkit.bounds.bound import prove
from tests.bounds.judge import arrival_optimum


@pytest.fixture
def bounded(random_instance):
    """An instance and its bound."""
    day = random_instance(np.random.default_rng(3))
    return day, full_information(day)


def test_an_honest_bound_is_proven(bounded):
    """A bound and a looser one hold; the verdict is the certificate's own."""
    day, bound = bounded
    assert prove(bound, day) == bound.certificate.check(day)
    assert prove(replace(bound, value=bound.value + 5.0), day).bound == pytest.approx(bound.value)


def test_a_bound_below_its_proof_is_refused(bounded):
    """Who lowers the value claims more than the certificate proves."""
    day, bound = bounded
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(bound, value=bound.value - 0.1), day)


@pytest.mark.parametrize("penalty", [-1e6, -1e9, -1e12])
@pytest.mark.parametrize("method", [full_information, arrival_information])
def test_a_penalty_that_is_always_avoided_softens_nothing(random_instance, method, penalty):
    """However large one penalty is, a bound that is lower by more than the rounding of a sum with it is refused."""
    day = random_instance(np.random.default_rng(3))
    wanted = np.argmax(day.expiry - day.arrival)
    day = replace(day, penalty=np.where(np.arange(day.n_requests) == wanted, penalty, day.penalty))
    bound = method(day)
    assert prove(bound, day).bound <= bound.value
    assert abs(bound.value) < 1e4
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(bound, value=bound.value - 1e-6 * abs(bound.value) - 1e-12 * abs(penalty)), day)


@pytest.mark.slow
@pytest.mark.parametrize("outside", [-1e3, -1e5, -1e7, 1e5])
@pytest.mark.parametrize("mu", [1e-10, 0.03, 1.0, 1e3])
def test_an_outside_option_that_is_out_of_reach(outside, mu):
    """Requests of weights that overflow are bounded too, against 60 digits, up to the rounding of such utilities."""
    day = Instance(
        horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0], features=[[], []],
        pickup=[0, 0], dropoff=[0, 0], worker_step=[1, 2], worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[mu],
        outside_utility=outside,
    )  # fmt: skip
    bound = arrival_information(day, method="exact")
    prove(bound, day)
    optimum = float(arrival_optimum(day))
    told = abs(outside) / mu < 1e13  # beyond, floats say little of the weights
    assert optimum <= bound.value <= optimum + (1e-6 + 1e-13 * abs(outside) if told else 0.05 * abs(optimum))


def test_looser_prices_prove_less(bounded):
    """Prices that were tampered with prove a larger number than the bound that is claimed."""
    day, bound = bounded
    prices = replace(bound.certificate, request_dual=bound.certificate.request_dual + 50.0)
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(bound, certificate=prices), day)


def test_a_matching_that_is_none_is_refused(bounded):
    """A certificate whose matching uses a request twice does not pass."""
    day, bound = bounded
    matched = bound.certificate
    assert matched.request.size > 1
    twice = replace(matched, request=np.full_like(matched.request, matched.request[0]))
    with pytest.raises(SolverError, match="breaks a constraint"):
        prove(replace(bound, certificate=twice), day)


@pytest.mark.parametrize("value", ["a", None, True])
def test_a_bound_that_is_no_number_is_refused(value):
    day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    with pytest.raises(SolverError, match="no number"):
        replace(full_information(day), value=value)


@pytest.mark.parametrize("value", ["x", None, np.nan])
def test_a_certificate_of_other_things_is_refused(value):
    """Whatever stands where an array that proves something belongs."""
    day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    bound = full_information(day)
    for name in ("worker", "request", "request_dual"):
        forged = replace(bound, certificate=replace(bound.certificate, **{name: value}))
        with pytest.raises(OptkitError):
            prove(forged, day)
