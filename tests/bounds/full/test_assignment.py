"""The certificate of the full-information bound."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import strategies as st

from optkit import scenario
from optkit.basics.errors import InputError, InstanceError
from optkit.bounds import Certificate, full_information
from optkit.bounds.full.assignment import AssignmentCertificate

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture
def day(random_instance):
    return random_instance(np.random.default_rng(0), groups=2)


def test_it_is_a_certificate(day):
    assert isinstance(full_information(day).certificate, Certificate)


def test_a_tampered_value_shows(day):
    bound = full_information(day)
    tampered = replace(bound, value=bound.value - 1)
    # 1e-12 relative: the check repeats the same arithmetic, perhaps summed in another order.
    assert tampered.certificate.check(day).bound == pytest.approx(tampered.value + 1, rel=1e-12)


def test_prices_that_are_too_low_are_paid_for_by_the_workers(day):
    bound = full_information(day)
    tampered = replace(bound.certificate, request_dual=0.5 * bound.certificate.request_dual)
    verdict = tampered.check(day)
    assert verdict.bound > bound.value
    assert verdict.gap > 0


def test_wrong_worker_duals_do_no_harm(day):
    bound = full_information(day)
    lie = replace(bound.certificate, worker_dual=0 * bound.certificate.worker_dual)
    assert lie.check(day) == bound.certificate.check(day)


def test_a_request_used_twice_is_caught(day):
    certificate = full_information(day).certificate
    twice = replace(certificate, request=np.full_like(certificate.request, certificate.request[0]))
    verdict = twice.check(day)
    assert verdict.residual == certificate.request.size - 1
    assert verdict.attained == -np.inf


def test_a_worker_used_twice_is_caught(random_instance):
    day = random_instance(np.random.default_rng(1), horizon=2, requests=2, workers=2, lifetime=50)
    everyone = AssignmentCertificate(np.array([1, 1]), np.array([0, 1]), np.zeros(2), np.zeros(2))
    assert everyone.check(day).residual == 1
    assert everyone.check(day).attained == -np.inf


def test_a_pair_that_never_meets_is_caught(day):
    worker, request = np.array([0]), np.flatnonzero(day.arrival > day.worker_step[0])[:1]
    certificate = AssignmentCertificate(worker, request, np.zeros(8), np.zeros(6))
    assert certificate.check(day).residual == 1
    assert certificate.check(day).attained == -np.inf


@pytest.mark.parametrize(("worker", "request_"), [(-1, 0), (0, -1), (6, 0), (0, 8), (5, 7 + 8)])
def test_a_pair_that_does_not_exist_is_caught(day, worker, request_):
    certificate = AssignmentCertificate(np.array([worker]), np.array([request_]), np.zeros(8), np.zeros(6))
    assert certificate.check(day).residual == 1


def test_a_pair_that_is_worth_less_than_nothing_counts_as_such(random_instance):
    day = random_instance(np.random.default_rng(2), reward=-500.0, requests=1, workers=12)
    worker = int(np.flatnonzero((day.worker_step >= day.arrival[0]) & (day.worker_step <= day.expiry[0]))[0])
    verdict = AssignmentCertificate(np.array([worker]), np.array([0]), np.zeros(1), np.zeros(12)).check(day)
    assert verdict.residual == 0
    assert verdict.attained < verdict.bound - 400


def test_the_certificate_of_another_instance_does_not_pass(random_instance, day):
    other = random_instance(np.random.default_rng(3), groups=2)
    verdict = full_information(day).certificate.check(other)
    assert verdict.residual > 0 or verdict.gap > 0.1
    assert verdict.bound >= full_information(other).value - 1e-10  # rounding of sums below 1000


@pytest.mark.parametrize("prices", [np.zeros(7), np.full(8, np.nan), np.zeros((8, 1))])
def test_prices_of_the_wrong_kind_are_refused(day, prices):
    with pytest.raises(InputError, match="request_dual"):
        replace(full_information(day).certificate, request_dual=prices).check(day)


def test_pairs_of_different_lengths_are_refused(day):
    with pytest.raises(InputError, match="per pair"):
        replace(full_information(day).certificate, worker=np.zeros(1, int)).check(day)


def test_an_instance_without_noise_cannot_be_checked_against(day):
    certificate = full_information(day).certificate
    with pytest.raises(InstanceError, match="with_noise"):
        certificate.check(replace(day, noise=None, outside_noise=None))


def test_shadow_prices_by_identifier():
    """They add up to the bound, less the penalties that are due anyway; losing a request costs its price at most."""
    day = scenario("I.1", seed=0, horizon=12).sample(1, seed=3)[0]
    named = replace(day, request_id=[f"r{i}" for i in range(day.n_requests)])
    bound = full_information(named)
    requests, workers = bound.certificate.shadow_prices(named)
    assert isinstance(requests, pd.Series)
    assert requests.index.tolist() == named.request_id.tolist()
    assert requests.sum() + workers.sum() + day.penalty.sum() == pytest.approx(bound.value, rel=1e-12)
    lying = replace(bound.certificate, worker_dual=0 * bound.certificate.worker_dual)
    pd.testing.assert_series_equal(lying.shadow_prices(named)[1], workers)
    for i in range(day.n_requests):
        keep = np.arange(day.n_requests) != i
        columns = ("arrival", "expiry", "reward", "penalty", "features", "pickup", "dropoff")
        kept = {name: getattr(day, name)[keep] for name in columns}
        rest = replace(day, utility=day.utility[:, keep], noise=day.noise[:, keep], **kept)
        lost = bound.value - day.penalty[i] - full_information(rest).value
        assert -1e-9 <= lost <= requests.iloc[i] + 1e-9
