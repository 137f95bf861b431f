"""What policies are compared with is proven to be a bound of each day, and days are independent ones."""

from dataclasses import replace

import pytest

from optkit import arrival_information, full_information, gap_report, scenario
from optkit.basics.errors import InputError
from optkit.evaluation.comparison import compare
from optkit.policies import RewardPercentage

DAYS = scenario("I.1", seed=0, horizon=20).sample(3, seed=1)
BOUNDS = [full_information(day) for day in DAYS]
HALF = {"half": RewardPercentage(0.5)}


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        (BOUNDS[::-1], "bound 0 is not proven to be one of instance 0"),
        ([replace(one, value=0.9 * one.value) for one in BOUNDS], "not the bound .* that is claimed"),
        ([arrival_information(day) for day in DAYS], "bound 0 is of arrival information"),
        ([one.value for one in BOUNDS], "bound 0 is a float"),
    ],
)
def test_bounds_of_others_are_refused(bounds, message):
    """Of other days, lowered, in the mean only, or bare numbers."""
    with pytest.raises(InputError, match=message):
        compare(DAYS, HALF, bounds)


def test_the_same_day_twice_is_no_second_day():
    """Neither a comparison nor a report takes a copy for another draw; days on which nothing happens may be alike."""
    again = [DAYS[0], DAYS[1], replace(DAYS[0])]
    with pytest.raises(InputError, match="instances 0 and 2 are the same"):
        compare(again, HALF, [BOUNDS[0], BOUNDS[1], BOUNDS[0]])
    with pytest.raises(InputError, match="instances 0 and 2 are the same"):
        gap_report(again, HALF, kinds="full")
    moods = [DAYS[0].with_noise(1), DAYS[0].with_noise(2)]  # another mood is no other day
    with pytest.raises(InputError, match="instances 0 and 1 are the same"):
        gap_report(moods, HALF, kinds="full")
    with pytest.raises(InputError, match="instances 0 and 1 are the same"):
        compare(moods, HALF, [full_information(day) for day in moods])
    small = [one.with_noise(k) for k, one in enumerate(scenario("I.1", seed=0, horizon=1).sample(1, seed=4) * 2)]
    assert len(gap_report(small, HALF, kinds="full").rows) == 2
    idle = scenario("I.1", seed=0, horizon=2, worker_rate=0.0).sample(3, seed=1)
    assert len(gap_report(idle, HALF, kinds="full").rows) == 3


@pytest.mark.parametrize("policies", [[RewardPercentage(0.5)], RewardPercentage(0.5), {"half": 0.5}])
def test_policies_are_a_mapping(policies):
    with pytest.raises(InputError, match=r"policies is a|cannot be called"):
        compare(DAYS, policies, BOUNDS)
    with pytest.raises(InputError, match=r"policies is a|cannot be called"):
        gap_report(DAYS, policies, kinds="full")
