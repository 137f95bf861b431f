"""Small instances for the tests of the bounds."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from optkit.instances.instance import Instance


def make_random_instance(
    rng: np.random.Generator,
    *,
    requests: int = 8,
    workers: int = 6,
    horizon: int = 12,
    lifetime: float = 3.0,
    groups: int = 1,
    ties: bool = False,
    sparse_noise: bool = False,
    reward: float = 30.0,
) -> Instance:
    """Draw an instance; with ``ties`` every number is a multiple of 10 and the noise is 0."""
    arrival = np.sort(rng.integers(0, horizon, requests))
    money = {
        "reward": reward + rng.uniform(0, 40, requests),
        "penalty": -rng.uniform(0, 10, requests),
        "utility": -rng.uniform(0, 60, (groups, requests)),
        "outside_utility": rng.uniform(-5, 5, groups),
    }
    if ties:
        money = {name: 10 * np.round(value / 10) for name, value in money.items()}
    instance = Instance(
        horizon=horizon,
        arrival=arrival,
        expiry=np.minimum(arrival + np.ceil(rng.exponential(lifetime, requests)).astype(int), horizon - 1),
        features=np.zeros((requests, 1)),
        pickup=np.zeros(requests, int),
        dropoff=np.zeros(requests, int),
        worker_step=np.sort(rng.permutation(horizon)[:workers]),
        worker_group=rng.integers(0, groups, workers),
        mu=rng.uniform(0.5, 5, groups),
        **money,
    ).with_noise(rng)
    noise = instance.noise.toarray() if sparse.issparse(instance.noise) else np.array(instance.noise)
    outside = np.array(instance.outside_noise)
    if ties:
        noise, outside = 0 * noise, 0 * outside
    return replace(instance, noise=sparse.csr_array(_stored(noise)) if sparse_noise else noise, outside_noise=outside)


def _stored(noise: np.ndarray) -> sparse.coo_array:
    rows, columns = np.indices(noise.shape)
    return sparse.coo_array((noise.ravel(), (rows.ravel(), columns.ravel())), shape=noise.shape)


@pytest.fixture(scope="session")
def random_instance() -> Callable[..., Instance]:
    return make_random_instance


@pytest.fixture(scope="session")
def brute_force() -> Callable[[Instance], float]:
    """Give the function that tries all matchings, from the definition and without the kit's own graph."""

    def best(instance: Instance) -> float:
        noise = instance.noise.toarray() if sparse.issparse(instance.noise) else instance.noise

        def worth(j: int, i: int) -> float:
            d = instance.worker_group[j]
            idle = instance.outside_by_group[d] + instance.outside_noise[j]
            taken = instance.utility[d, i] + noise[j, i]
            return instance.reward[i] - instance.penalty[i] - max(0.0, idle - taken)

        def rest(j: int, free: frozenset[int]) -> float:
            if j == instance.n_workers:
                return 0.0
            step = instance.worker_step[j]
            options = [i for i in free if instance.arrival[i] <= step <= instance.expiry[i]]
            return max([rest(j + 1, free)] + [worth(j, i) + rest(j + 1, free - {i}) for i in options])

        return float(instance.penalty.sum()) + rest(0, frozenset(range(instance.n_requests)))

    return best
