"""Rates of workers by time of day, learned from days."""

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.bounds.penalised.foresight import fifo_presence
from optkit.learning.worker_rates import learn_worker_rates
from tests.gap import processes


def test_a_steady_stream_is_one_piece(half_days):
    """Half a worker a step, within four standard errors, and no piece that noise alone made."""
    found = learn_worker_rates(processes.days(processes.constant, 40, seed=0))
    assert found.start.tolist() == [0]
    assert abs(np.log(found.rate[0] / 0.5)) < 4 * np.sqrt(found.covariance[0, 0])
    assert found.presence == pytest.approx(fifo_presence(found.rate))
    assert found.days == 40


@pytest.mark.slow
def test_a_rush_is_two_pieces_and_its_queue_is_known():
    """0.1 and 0.9 a step, parted at noon: though at 0.9 a step most of those who are seen joined before."""
    found = learn_worker_rates(processes.days(processes.rush, 60, seed=1))
    assert found.start.size == 2
    assert abs(found.start[1] - 25) <= 1
    for rate, true, error in zip(found.rate[found.start], (0.1, 0.9), np.diag(found.covariance), strict=True):
        assert abs(np.log(rate / true)) < 4 * np.sqrt(error)
    assert str(found).count("at steps") == 2


@pytest.fixture
def half_days(monkeypatch):
    """Days of 16 steps: one slot a step still, and a thirtieth of the work."""
    monkeypatch.setattr(processes, "STEPS", 16)


@pytest.mark.slow
def test_errors_are_as_large_as_they_are_said_to_be(half_days):
    """Over 8 sets of days the errors of the logarithm, by their standard errors, have a spread of about 1."""
    found = [learn_worker_rates(processes.days(processes.constant, 12, seed=s)) for s in range(8)]
    score = [np.log(one.rate[-1] / 0.5) / np.sqrt(one.covariance[-1, -1]) for one in found]
    # Four standard errors of a root mean square of 8.
    assert 0.2 < np.sqrt(np.mean(np.square(score))) < 2.0
    drawn = found[0].draw(4000, np.random.default_rng(0))
    assert np.log(drawn).std(axis=0) == pytest.approx(np.full(16, np.sqrt(found[0].covariance[0, 0])), rel=0.1)


@pytest.mark.slow
def test_days_without_a_worker_and_days_full_of_them_have_rates(half_days):
    """Nobody was seen: a rate near 0, and not 0; somebody always: one so high that somebody is nearly sure."""
    nobody = learn_worker_rates(processes.days(lambda rng: np.zeros(16, int), 20, seed=0))
    assert 0 < nobody.rate.max() < 0.02
    always = learn_worker_rates(processes.days(lambda rng: np.ones(16, int), 20, seed=0))
    assert always.presence[0, 0] > 0.8
    assert np.isfinite(always.covariance).all()


def test_groups_are_counted(half_days):
    """Shares are those seen, and no group is thought impossible."""
    found = learn_worker_rates(
        processes.days(processes.constant, 20, 0, lambda step, rng: (rng.random(step.size) < 0.25).astype(int))
    )
    assert found.share.sum() == pytest.approx(1.0)
    assert 0.15 < found.share[1] < 0.35


def test_days_of_several_forms_are_refused():
    from optkit import scenario

    with pytest.raises(InputError, match="at least one"):
        learn_worker_rates([])
    mixed = [scenario("I.2", seed=0, horizon=T).sample(1, seed=1)[0] for T in (20, 21)]
    with pytest.raises(InputError, match="day 1 has 21 steps"):
        learn_worker_rates(mixed)
