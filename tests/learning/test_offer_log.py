"""Exploring policies and the log: what was offered, to whom, and what was taken."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError, InstanceError
from optkit.learning.offer_log import collect
from optkit.policies import RewardPercentage
from optkit.policies.explore import Explore, RandomOffers


@pytest.fixture(scope="module")
def days():
    """Thirty instances of three worker groups."""
    return scenario("II", seed=1).sample(30, seed=4)


def offers_of(instances, policy):
    """All (state, compensations) of a run."""
    seen = []
    result = simulate(instances, policy, observe=lambda state, offer, taken: seen.append((state, offer, taken)))
    return seen, result


def test_log_equals_a_replay(days):
    """Choices in the log are simulate's accepted requests at their compensations, one situation per deciding worker."""
    log = collect(days, RandomOffers(seed=3))
    seen, result = offers_of(days, RandomOffers(seed=3))
    assert log.n_situations == sum(len(state.worker) for state, _, _ in seen)
    assert log.n_choices == (result.accepted >= 0).sum()
    paid = result.compensation[result.accepted >= 0]
    np.testing.assert_array_equal(np.sort(log.compensation[log.chosen == 1]), np.sort(paid))
    assert len(log) == sum(state.offered.sum() for state, _, _ in seen)


@pytest.mark.slow
def test_every_row_is_the_request_and_the_worker_of_its_state(days):
    """Row by row: the group is the worker's, features and places the request's, and the taken column is marked."""
    log = collect(days, RandomOffers(seed=3))
    seen, _ = offers_of(days, RandomOffers(seed=3))
    row = 0
    situations = []
    for state, offer, taken in seen:
        for b in range(len(state.worker)):
            one = days[state.instance[b]]
            worker = state.worker[b] - state.batch.worker_start[state.instance[b]]
            requests = (state.request[b] - state.batch.request_start[state.instance[b]])[state.offered[b]]
            rows = slice(row, row := row + requests.size)
            assert len(set(log.situation[rows])) == 1
            situations.append(log.situation[rows][0])
            assert (log.group[rows] == one.worker_group[worker]).all()
            np.testing.assert_array_equal(log.features[rows], one.features[requests])
            np.testing.assert_array_equal(log.pickup[rows], one.pickup[requests])
            np.testing.assert_array_equal(log.dropoff[rows], one.dropoff[requests])
            np.testing.assert_array_equal(log.compensation[rows], offer[b][state.offered[b]])
            np.testing.assert_array_equal(log.chosen[rows], np.flatnonzero(state.offered[b]) == taken[b])
    assert row == len(log)
    assert len(set(situations)) == len(situations)


def test_random_offers_stay_in_their_range_and_fill_it(days):
    """Shares of the reward lie between low and high; a uniform sample of thousands reaches within 1 % of both ends."""
    seen, _ = offers_of(days, RandomOffers(0.4, 0.85, seed=0))
    share = np.concatenate([(offer / np.where(s.offered, s.reward, 1))[s.offered] for s, offer, _ in seen])
    assert share.min() >= 0.4 - 1e-12
    assert share.max() <= 0.85 + 1e-12
    assert share.min() < 0.405
    assert share.max() > 0.845
    assert share.mean() == pytest.approx(0.625, abs=4 * 0.45 / np.sqrt(12 * share.size))


def test_the_same_seed_offers_the_same(days):
    """Offers are reproducible, another seed gives others, and they are drawn anew for each offer."""
    one, again, other = (collect(days, RandomOffers(seed=s)) for s in (5, 5, 6))
    np.testing.assert_array_equal(one.compensation, again.compensation)
    assert one.compensation.size != other.compensation.size or (one.compensation != other.compensation).any()
    assert np.unique(one.compensation).size == len(one)


def test_explore_adds_noise_of_the_deviation(days):
    """Far from 0 the noise has mean 0 and the deviation asked for, within 4 standard errors."""
    base = RewardPercentage(0.6)
    seen, _ = offers_of(days, Explore(base, 2.0, seed=1))
    noise = np.concatenate([(offer - base(s))[s.offered & (s.reward > 40)] for s, offer, _ in seen])
    assert abs(noise.mean()) < 4 * 2 / np.sqrt(noise.size)
    assert noise.std() == pytest.approx(2.0, abs=4 * 2 / np.sqrt(2 * noise.size))


def test_explore_never_pays_less_than_nothing(days):
    """Noise larger than the prices is cut off at 0; no noise leaves the policy as it is."""
    log = collect(days, Explore(RewardPercentage(0.01), 5.0))
    assert log.compensation.min() == 0
    plain = collect(days, RewardPercentage(0.6))
    np.testing.assert_array_equal(collect(days, Explore(RewardPercentage(0.6), 0.0)).compensation, plain.compensation)


@pytest.mark.parametrize("policy", [RandomOffers, Explore])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_ranges_are_checked_when_made(policy, value):
    """Negative, NaN or endless shares and deviations are refused at once."""
    with pytest.raises(InputError):
        RandomOffers(value, value) if policy is RandomOffers else Explore(RewardPercentage(0.5), value)


def test_an_empty_range_is_refused():
    """The smallest share is at most the largest."""
    with pytest.raises(InputError, match=r"high = 0\.4 is not a finite number of at least 0\.9"):
        RandomOffers(0.9, 0.4)


def test_nobody_sees_anything():
    """No instances, or none in which a worker meets a request, is an InputError that says so."""
    idle = scenario("I.1", seed=0, worker_rate=1e-9).sample(2, seed=0)
    for instances in ([], idle):
        with pytest.raises(InputError, match="no worker saw any request"):
            collect(instances, RandomOffers())


def test_noise_must_be_realised(days):
    """Without noise nobody chooses."""
    with pytest.raises(InstanceError, match="not realised"):
        collect([replace(days[0], noise=None, outside_noise=None)], RandomOffers())


@pytest.mark.parametrize("make", [lambda s: RandomOffers(seed=s), lambda s: Explore(RewardPercentage(0.5), 1.0, s)])
def test_a_negative_seed_is_refused(days, make):
    """A seed that NumPy cannot take is an InputError with its name."""
    with pytest.raises(InputError, match="seed"):
        collect(days[:1], make(-1))
