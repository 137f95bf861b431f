"""A scenario of your own: a canteen with a rush at noon. Train on it, and certify a gap there.

Anything that makes instances will do. What is random should come from the seed that is given, so that instances can be
drawn again, and training, validation and test instances must be independent.
"""

import sys

import numpy as np

from optkit import Instance
from optkit.gap.charging import worker_charging
from optkit.gap.report import gap_report
from optkit.instances.queue import fifo_queue
from optkit.instances.scenario import Split
from optkit.learning.training import train
from optkit.policies import PostDecisionPricing

HORIZON, WORKERS = 40, 0.6
DAYS = int(sys.argv[1]) if sys.argv[1:] else 30  # that are measured


def canteen(seed: np.random.SeedSequence) -> Instance:
    """Draw a day: three times as many orders in the middle third; heavy bags are paid well and disliked."""
    rng = np.random.default_rng(seed)
    rate = np.where(np.abs(np.arange(HORIZON) - HORIZON / 2) < HORIZON / 6, 1.2, 0.4)
    arrival = np.repeat(np.arange(HORIZON), rng.poisson(rate))
    n = arrival.size
    weight, floor = rng.exponential(4.0, n), rng.integers(0, 3, n)
    joined = np.repeat(np.arange(HORIZON), rng.poisson(WORKERS, HORIZON))
    step, _ = fifo_queue(joined, HORIZON)
    return Instance(
        horizon=HORIZON,
        arrival=arrival,
        expiry=np.minimum(arrival + rng.geometric(0.2, n), HORIZON - 1),
        reward=10.0 + 2.0 * weight,
        penalty=np.full(n, -4.0),
        features=weight[:, None],
        pickup=np.zeros(n, int),
        dropoff=floor,
        worker_step=step,
        worker_group=np.zeros(step.size, int),
        utility=-(2.0 + 0.8 * weight + 1.5 * floor)[None],
        mu=np.array([1.5]),
    ).with_noise(rng)


parts = (np.random.SeedSequence(part) for part in (1, 2, 3))
split = Split(
    *([canteen(seed) for seed in part.spawn(count)] for part, count in zip(parts, (200, DAYS, 40), strict=True))
)

trained = train(split, choice="true")
policies = {"myopic": PostDecisionPricing(), "trained": trained.policy}

# Workers are known to come at a rate of 0.6 (Poisson): whoever foresees them is charged for it.
charging = worker_charging(split.train, rate=WORKERS)
report = gap_report(
    split.test, policies, value=charging.value, foresight=charging.foresight, assumptions=charging.assumptions
)
print(report.summary())
earned = report.policies.set_index("policy")["money"]
assert earned["trained"] > earned["myopic"]
assert report.best_bound == "penalised"
assert report.gap("trained")["claim"] < report.gap("trained", "full")["claim"]
