"""Days of more steps than fit in memory: what goes by steps says so, what goes by workers works."""

import pytest

from optkit import Instance, simulate
from optkit.basics.errors import InputError, InstanceError
from optkit.bounds import arrival_information, full_information
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.bound import prove
from optkit.bounds.fluid.bound import FluidModel
from optkit.bounds.penalised.foresight import Foresight
from optkit.gap.worker_tests import worker_test
from optkit.policies import PostDecisionPricing


@pytest.fixture(scope="module")
def long_day():
    """Two requests, one of which waits until a date that somebody wrote in seconds since 1970."""
    return Instance(
        horizon=1_700_000_601, arrival=[0, 1], expiry=[2, 1_700_000_600], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
        features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 1_700_000_000], worker_group=[0, 0],
        utility=[[-10.0, -12.0]], mu=[1.0],
    ).with_noise(0)  # fmt: skip


@pytest.mark.parametrize(
    "by_steps",
    [
        lambda day: simulate(day, PostDecisionPricing()),
        lambda day: FluidModel.from_instances([day]),
        lambda day: Foresight([0.5], [1.0]).of_workers(day),
        lambda day: worker_test([day], Foresight([0.5], [1.0])),
        lambda day: stages(day, every_step=True),
    ],
    ids=["simulation", "fluid", "foresight", "worker test", "lattice"],
)
def test_what_goes_by_steps_is_refused_before_any_memory_is_taken(long_day, by_steps):
    """One line that names the horizon and the likely mistake, not gigabytes of zeros."""
    with pytest.raises(InstanceError, match=r"horizon is 1,700,000,601: .* seconds since 1970") as caught:
        by_steps(long_day)
    assert "\n" not in str(caught.value)


def test_what_goes_by_workers_takes_any_horizon(long_day):
    """Full and arrival information look at the steps of workers alone."""
    for bound in (full_information(long_day), arrival_information(long_day)):
        assert bound.value > 0
        assert prove(bound, long_day).gap < 1e-6


def test_many_long_days_are_refused_by_their_size(long_day):
    """A hundred days of ten million steps would take 24 GB at once: said before they are laid out."""
    day = Instance(
        horizon=10_000_000, arrival=[0], expiry=[2], reward=[30.0], penalty=[-5.0], features=[[]], pickup=[0],
        dropoff=[0], worker_step=[1], worker_group=[0], utility=[[-10.0]], mu=[1.0],
    ).with_noise(0)  # fmt: skip
    with pytest.raises(InputError, match="100 instances of up to 10,000,000 steps take 24 GB to simulate together"):
        simulate([day] * 100, PostDecisionPricing())
