"""Write a policy, compare it with optimal pricing on the same days, and tune it on others.

A policy is a function from a State to compensations, for many instances at once; see CONTRIBUTING.md for its fields.
"""

import numpy as np

from optkit import performance_ratio, scenario, simulate
from optkit.bounds import full_information
from optkit.policies import PostDecisionPricing
from optkit.simulation.metrics import mean_interval

split = scenario("I.1", seed=0, split=(120, 60, 10)).split()


class Surge:
    """Pay what workers need to be indifferent, and more as requests pile up."""

    def __init__(self, base: float, surge: float) -> None:
        self.base, self.surge = base, surge

    def __call__(self, state):
        """Return compensations, (b, w)."""
        crowd = state.offered.sum(axis=1, keepdims=True)
        return np.maximum(0.0, -state.utility + self.base + self.surge * np.log(crowd))


# Tuned on training days only.
grid = [(base, surge) for base in (1.0, 2.0, 3.0, 4.0, 5.0) for surge in (-1.5, -1.0, -0.5, 0.0)]
best = max(grid, key=lambda setting: simulate(split.train, Surge(*setting)).reward.mean())
print(f"tuned on {len(split.train)} days: base {best[0]}, surge {best[1]}")

full = [full_information(day).value for day in split.test]
least = [day.penalty.sum() for day in split.test]
ratio = {
    name: performance_ratio(simulate(split.test, policy).reward, full, least)
    for name, policy in {"surge": Surge(*best), "optimal pricing, myopic": PostDecisionPricing()}.items()
}
for name, values in ratio.items():
    print(f"{name:25s} {values.mean():5.1f} %")
gain = mean_interval(ratio["optimal pricing, myopic"], ratio["surge"])
print(f"optimal prices gain {gain.mean:.2f} points [{gain.low:.2f}, {gain.high:.2f}], paired by day")
assert max(values.max() for values in ratio.values()) <= 100.0 + 1e-9
assert gain.low > 0
