"""The result type of every bound, and the check that it claims no more than it proves."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import scenario
from optkit.basics.errors import OptkitError, SolverError
from optkit.bounds import full_information
from optkit.bounds.bound import prove


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
