"""Bring your own day as two tables, draw the workers' noise, run two policies, and bound what any could have earned."""

import numpy as np
import pandas as pd

from optkit import Instance, performance_ratio, simulate
from optkit.bounds import full_information
from optkit.policies import PostDecisionPricing, RewardPercentage

rng = np.random.default_rng(7)
n, horizon = 30, 60
arrival = np.sort(rng.integers(0, horizon - 1, n))
kilometres = rng.uniform(0.5, 6.0, n)
requests = pd.DataFrame(
    {
        "arrival": arrival,
        "expiry": np.minimum(arrival + rng.integers(2, 15, n), horizon - 1),
        "reward": 12.0 + 4.0 * kilometres,
        "penalty": -3.0,
        "utility_0": -4.0 - 1.5 * kilometres,  # cyclists feel the distance
        "utility_1": -7.0 - 0.6 * kilometres,  # drivers feel the traffic
        "kilometres": kilometres,
    }
)
workers = pd.DataFrame({"step": rng.integers(0, horizon, 35), "group": rng.integers(0, 2, 35)})

# Workers who come at the same step queue up; each is seen for one step.
day = Instance.from_frames(requests, workers, mu=[1.0, 2.0], horizon=horizon, features=["kilometres"], queue=True)
days = [day.with_noise(seed) for seed in range(200)]
print(day)

bounds = [full_information(one) for one in days]
for one, bound in zip(days, bounds, strict=True):
    verdict = bound.certificate.check(one)  # recomputed from the day alone
    assert verdict.residual == 0.0
    assert abs(verdict.gap) < 1e-9 * abs(bound.value)

ceiling = [bound.value for bound in bounds]
floor = [one.penalty.sum() for one in days]
policies = {"optimal pricing, myopic": PostDecisionPricing(), "half the reward": RewardPercentage(0.5)}
for name, policy in policies.items():
    earned = simulate(days, policy).reward
    assert np.all(earned <= np.array(ceiling) + 1e-9)
    print(f"{name:25s} {performance_ratio(earned, ceiling, floor).mean():5.1f} % of full information")
