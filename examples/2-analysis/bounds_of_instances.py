"""Bound instances three ways, check the certificates, see a forged one fail, and add a bound of your own."""

from dataclasses import dataclass, replace

import numpy as np

from optkit import scenario, simulate
from optkit.bounds import Bound, arrival_information, full_information
from optkit.bounds.bound import SolverRecord, Verdict
from optkit.policies import PostDecisionPricing

days = scenario("I.1", seed=0).sample(40, seed=1)


@dataclass(frozen=True)
class BestRewards:
    """No more requests are served than workers come; the proof is a sum, and needs no data."""

    def check(self, instance):
        """Recompute the bound."""
        gain = np.sort(instance.reward - instance.penalty)[::-1][: instance.n_workers]
        return Verdict(instance.penalty.sum() + gain.clip(min=0.0).sum(), -np.inf, 0.0)


def best_rewards(instance):
    """A bound of one's own: the best requests, served for nothing."""
    return Bound(BestRewards().check(instance).bound, "best rewards", BestRewards(), SolverRecord("sort", "exact", 0.0))


bounds = {
    "best rewards": best_rewards,
    "full information": full_information,
    "arrival information, multipliers": lambda day: arrival_information(day, "lagrangian"),
    "arrival information, exact": lambda day: arrival_information(day, "exact"),
}
means = {}
for name, bound in bounds.items():
    found = [bound(day) for day in days]
    verdicts = [one.certificate.check(day) for one, day in zip(found, days, strict=True)]
    assert all(v.bound <= one.value + 1e-6 * abs(one.value) for v, one in zip(verdicts, found, strict=True))
    means[name] = np.mean([one.value for one in found])
    print(f"{name:34s} {means[name]:8.2f}")

# Each knows less than the one before, and so bounds more tightly in the mean; the last two bound a mean over the noise.
assert list(means.values()) == sorted(means.values(), reverse=True)
earned = simulate(days, PostDecisionPricing()).reward
print(f"{'myopic policy':34s} {earned.mean():8.2f}")
assert all(simulate(day, PostDecisionPricing()).reward[0] <= full_information(day).value + 1e-9 for day in days)

# A certificate is checked against the instance alone: whoever lowers the number is found out.
honest = full_information(days[0])
forged = replace(honest, value=honest.value - 10.0)
checked = forged.certificate.check(days[0])
print(f"claimed {forged.value:.2f}, proven {checked.bound:.2f}")
assert checked.bound > forged.value + 9.0
