"""Bring your own value of waiting: by hand, then fitted, against the myopic policy and the kit's linear function.

A value function tells what a set of waiting requests is worth to the future, and so how much serving one of them now
costs: that is all that the optimal prices need of it. Two methods are enough; with a third, fit, it can be trained.
"""

import numpy as np

from optkit import scenario, simulate
from optkit.learning.beliefs import BelievedValue
from optkit.learning.training import train
from optkit.models.value.experience import Experience
from optkit.models.value.request_sets import RequestSets, removal_differences
from optkit.policies import PostDecisionPricing
from optkit.simulation.metrics import mean_interval


class ShareOfSurplus:
    """A request that waits costs its penalty if it is never served, and a share of its surplus is hoped for."""

    def __init__(self, share: float | np.ndarray = 0.5, patience: float = 5.0) -> None:
        self.share = share  # one number, or one per step
        self.patience = patience  # steps

    def penalty(self, sets: RequestSets) -> np.ndarray:
        """Penalty of each request, (b, w), money; 0 for padding."""
        return np.where(sets.member, sets.requests.penalty[sets.index], 0.0)

    def hope(self, sets: RequestSets) -> np.ndarray:
        """What serving each gains over letting it expire, less as its time runs out, (b, w), money; 0 for padding."""
        time = 1.0 - np.exp(-sets.steps_left.clip(min=0.0) / self.patience)
        return np.where(sets.member, sets.mean_surplus.clip(min=0.0) * time, 0.0)

    def opportunity_cost(self, sets: RequestSets) -> np.ndarray:
        """What each set loses with each of its requests, (b, w), money."""
        share = self.share if isinstance(self.share, float) else self.share[sets.step]
        return np.asarray(self.penalty(sets) + share * self.hope(sets))

    def value(self, sets: RequestSets) -> np.ndarray:
        """Value of each set, (b,), money: requests do not get into each other's way."""
        return np.asarray(self.opportunity_cost(sets).sum(axis=1))

    def fit(self, experience: Experience) -> "ShareOfSurplus":
        """Find the share of each step by least squares, backwards: the target of a step uses the share of the next."""
        self.share = np.zeros(experience.horizon)
        for step in reversed(range(experience.horizon - 1)):
            sets = experience.sets(step)
            if sets is None:
                self.share[step] = self.share[step + 1]
            else:
                x = self.hope(sets)
                y = experience.target_differences(self, step) - self.penalty(sets)
                self.share[step] = np.vdot(x, y) / max(np.vdot(x, x), 1e-9)
        return self


split = scenario("I.1", seed=0, split=(200, 200, 30)).split()

# All of them on the same instances, with the workers' true preferences to keep the comparison pure.
by_hand = ShareOfSurplus()
policies = {
    "myopic": PostDecisionPricing(),
    "own, by hand": PostDecisionPricing(value_function=BelievedValue(by_hand)),
    "own, fitted": train(split, ShareOfSurplus(), choice="true").policy,
    "linear": train(split, "linear", choice="true").policy,
}
earned = {name: simulate(split.test, policy).reward for name, policy in policies.items()}
for name, reward in earned.items():
    gain = mean_interval(reward, earned["myopic"])
    interval = f"{gain.mean:+5.1f} [{gain.low:+.1f}, {gain.high:+.1f}]"
    print(f"{name:14s} {reward.mean():6.1f} money a day, {interval} to myopic")

# Waiting has a value, and even a crude idea of it pays; the linear function, which also ranks the requests, earns more.
assert mean_interval(earned["own, by hand"], earned["myopic"]).low > 0
assert mean_interval(earned["own, fitted"], earned["myopic"]).low > 0
assert mean_interval(earned["linear"], earned["own, fitted"]).low > 0


# Opportunity costs must be differences of values: compare yours with brute force on the sets that a policy meets.
class Checked(ShareOfSurplus):
    """The same, with a check of every answer."""

    answers = 0

    def opportunity_cost(self, sets: RequestSets) -> np.ndarray:
        """Opportunity costs that agree with evaluating every set without each of its requests."""
        cost = super().opportunity_cost(sets)
        np.testing.assert_allclose(cost, removal_differences(by_hand.value, sets), atol=1e-9)
        self.answers += len(sets)
        return cost


checked = Checked()
simulate(split.test[:20], PostDecisionPricing(value_function=BelievedValue(checked)))
print(f"opportunity costs of {checked.answers} sets are the differences of their values")
assert checked.answers > 100
