"""What a certificate's solution is said to attain, it attains: on days whose amounts strain floats, too."""

import numpy as np
import pytest

from optkit import Instance, arrival_information
from optkit.basics.errors import OptkitError
from optkit.bounds.bound import prove


def strained(rng):
    """A few requests and workers; penalties, utilities or outside options beyond all rewards, in some."""
    n, T = int(rng.integers(1, 4)), 4
    arrival, step = np.sort(rng.integers(0, T, n)), np.sort(rng.choice(T, int(rng.integers(1, 4)), replace=False))
    utility, penalty = rng.uniform(-40, 5, (1, n)), rng.uniform(0, 10, n)
    outside = np.zeros(1)
    case = rng.integers(3)
    if case == 0:
        penalty[0] = 10.0 ** rng.uniform(8, 14)
    elif case == 1:
        utility[0, rng.integers(n)] = 10.0 ** rng.uniform(6, 12)
    else:
        outside[:] = -(10.0 ** rng.uniform(4, 10))
    return Instance(
        horizon=T, arrival=arrival, expiry=np.minimum(arrival + rng.integers(0, 4, n), T - 1),
        reward=rng.uniform(5, 50, n), penalty=-penalty, features=np.zeros((n, 0)), pickup=np.zeros(n, int),
        dropoff=np.zeros(n, int), worker_step=step, worker_group=0 * step, utility=utility,
        mu=10.0 ** rng.uniform(-1, 1, 1), outside_utility=outside, noise=np.zeros((step.size, n)),
        outside_noise=np.zeros(step.size),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("method", ["exact", "hybrid"])
def test_honest_bounds_of_strained_days_are_proven(method):
    """None is refused because its solution seems to attain more than is proven."""
    rng, proven, refused = np.random.default_rng(0), 0, []
    for _ in range(60):
        day = strained(rng)
        try:
            bound = arrival_information(day, method)
        except OptkitError as error:
            refused.append(str(error))
            continue
        verdict = prove(bound, day)
        assert verdict.attained <= verdict.bound + 1e-9 * (abs(verdict.bound) + np.abs(day.penalty).sum())
        proven += 1
    assert proven > 50
    assert not any("more than" in why for why in refused)


def test_a_liked_request_by_hand():
    """It is taken for nothing: the two rewards are all that can be earned, and no more is said to be."""
    day = Instance(
        horizon=2, arrival=[0, 0], expiry=[1, 1], reward=[30.0, 40.0], penalty=[0.0, 0.0], features=np.zeros((2, 0)),
        pickup=[0, 0], dropoff=[0, 0], worker_step=[0, 1], worker_group=[0, 0], utility=[[1e10, 1e10]], mu=[1.0],
        noise=np.zeros((2, 2)), outside_noise=[0.0, 0.0],
    )  # fmt: skip
    verdict = prove(arrival_information(day, "exact"), day)
    assert verdict.attained <= 70.0 + 1e-8
    assert verdict.bound >= 70.0
