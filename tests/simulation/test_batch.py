"""Batches: instances laid end to end, looked up by numbers that run across all of them."""

import dataclasses

import numpy as np
import pytest
from scipy import sparse

from optkit import scenario
from optkit.basics.errors import InputError, InstanceError
from optkit.simulation.batch import Batch


@pytest.fixture(scope="module")
def days():
    """Five instances that differ in horizon, groups and crowds, one of them without requests."""
    two = scenario("II", seed=0).sample(2, seed=1)
    long = scenario("I.1", seed=0, horizon=70).sample(1, seed=2)
    empty = scenario("I.1", seed=0, request_rate=0.0).sample(1, seed=3)
    return [two[0], *empty, *long, two[1], *scenario("I.1", seed=0, worker_rate=0.0).sample(1, seed=4)]


def sparsely(day):
    """Return the instance with its noise stored sparsely."""
    return dataclasses.replace(day, noise=sparse.csr_array(day.noise))


def test_requests_end_to_end(days):
    """Request i of instance b stands at request_start[b] + i of every array; one harmless entry follows the last."""
    batch = Batch.of(days)
    assert np.diff(batch.request_start).tolist() == [d.n_requests for d in days]
    for name in ("reward", "penalty", "arrival", "expiry", "features", "pickup", "dropoff"):
        array = getattr(batch, name)
        assert len(array) == batch.request_start[-1] + 1
        assert np.array_equal(array[:-1], np.concatenate([getattr(d, name) for d in days]))
        assert not array[-1].any()


def test_workers_end_to_end(days):
    """Worker j of instance b stands at worker_start[b] + j, with the group, mu and outside option of its instance."""
    batch = Batch.of(days)
    for day, start in zip(days, batch.worker_start, strict=False):
        for j in range(day.n_workers):
            group = day.worker_group[j]
            assert batch.worker_group[start + j] == group
            assert batch.worker_mu[start + j] == day.mu[group]
            assert batch.worker_outside[start + j] == day.outside_by_group[group]
            assert batch.outside_noise[start + j] == day.outside_noise[j]


def test_worker_of_a_step(days):
    """worker_at names the worker that each instance sees at a step, and -1 where there is none or the day is over."""
    batch = Batch.of(days)
    assert batch.worker_at.shape == (70, 5)
    for b, day in enumerate(days):
        seen = np.full(70, -1)
        seen[day.worker_step] = batch.worker_start[b] + np.arange(day.n_workers)
        assert batch.worker_at[:, b].tolist() == seen.tolist()


def test_arrivals_of_a_step(days):
    """Arrivals lists the requests of every instance and step, in the order of their numbers."""
    batch = Batch.of(days)
    order, begin = batch.arrivals
    for b, day in enumerate(days):
        for step in range(batch.horizon):
            expected = batch.request_start[b] + np.flatnonzero(day.arrival == step)
            assert order[begin[step, b] : begin[step + 1, b]].tolist() == expected.tolist()


def test_utility_by_group(days):
    """Utilities stand by group; groups that an instance does not have read 0."""
    batch = Batch.of(days)
    assert batch.utility.shape == (3, batch.request_start[-1] + 1)
    for day, start in zip(days, batch.request_start, strict=False):
        block = batch.utility[:, start : start + day.n_requests]
        assert np.array_equal(block[: day.n_groups], day.utility)
        assert not block[day.n_groups :].any()


@pytest.mark.parametrize("kind", ["dense", "sparse", "mixed"])
def test_noise_of_compatible_pairs(days, kind):
    """The noise function reads, for every pair that meets, what the instance holds, however it is stored."""
    stored = [sparsely(d) if kind == "sparse" or (kind == "mixed" and b % 2) else d for b, d in enumerate(days)]
    batch = Batch.of(stored)
    for b, day in enumerate(days):
        worker, request = day.pairs()
        found = batch.noise(worker + batch.worker_start[b], (request + batch.request_start[b])[:, None])
        assert np.array_equal(found[:, 0], day.pair_noise())


def test_padding_can_be_looked_up(days):
    """Noise for the entry beyond the last request is some finite number, not an error."""
    for stored in (days, [sparsely(d) for d in days]):
        batch = Batch.of(stored)
        last = np.array([[batch.request_start[-1]]])
        for worker in (0, batch.worker_start[-1] - 1):
            assert np.isfinite(batch.noise(np.array([worker]), last)).all()


def test_no_instances():
    """A batch of nothing has no steps, no requests and no workers."""
    batch = Batch.of([])
    assert (len(batch), batch.horizon, batch.groups) == (0, 0, 1)
    assert batch.request_start.tolist() == batch.worker_start.tolist() == [0]


def test_what_is_no_batch():
    """Other things, instances without noise and mixed features are refused."""
    (day,) = scenario("I.1", seed=0).sample(1, seed=0)
    with pytest.raises(InputError, match="element 1 is a int"):
        Batch.of([day, 3])
    with pytest.raises(InstanceError, match="with_noise"):
        Batch.of(dataclasses.replace(day, noise=None, outside_noise=None))
    with pytest.raises(InputError, match="features"):
        Batch.of([day, *scenario("I.1", characteristics=1).sample(1, seed=0)])
