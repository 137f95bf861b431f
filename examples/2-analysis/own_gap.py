"""Bring your own policy and value function, and prove how far the policy is at most from optimal.

No policy can foresee. A bound that knows the arrivals can, and so lies too high; charging it for its foresight, by any
value function, brings it down without letting it fall below the optimum. The better the value function, the smaller the
gap that can be proven.
"""

import sys

import numpy as np

from optkit import scenario
from optkit.bounds import Foresight
from optkit.bounds.penalised.foresight import fifo_presence
from optkit.gap.report import gap_report
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.models.value.request_sets import ZeroSetValue
from optkit.policies import PostDecisionPricing

count = int(sys.argv[1]) if sys.argv[1:] else 40  # days that are measured
source = scenario("I.2", seed=0)
days = source.split().test[:count]


def own_policy(state):
    """Half of the reward, and more for requests that expire soon."""
    return np.where(state.steps_left < 3, 0.7, 0.5) * state.reward


# Instances of their own for training, and for what might have arrived instead: never those that are measured.
trained = train(source.sample(300, seed=71), LinearValue(), choice="true")
policies = {"own": own_policy, "myopic": PostDecisionPricing(), "trained": trained.policy}
foresight = Foresight(
    presence=fifo_presence(source.settings.worker_rate),  # of a worker, after 0, 1, ... steps in a row that saw one
    share=np.ones(1),  # one group of workers
    arrivals=tuple(source.sample(100, seed=72)),
    nothing=float(np.exp(-source.settings.request_rate)),  # probability of a step without arrivals
)

report = gap_report(days, policies, value=trained.value, foresight=foresight)
print(report.summary())
print()

# Each bound is tighter than the one before, and the policies lie below all of them, in this order.
bounds, earned = report.bounds.set_index("kind")["points"], report.policies.set_index("policy")["points"]
assert bounds.is_monotonic_decreasing
assert bounds["penalised"] > earned["trained"] > earned["myopic"] > earned["own"]

# Where all requests are told apart the gap is positive on every path, and its interval narrow: 1 point with 40 days.
gap = report.gap("trained", "penalised")
assert gap["smallest"] > 0
assert gap["points_high"] - gap["points_low"] < (1.0 if count >= 40 else 8.0 / np.sqrt(count))
assert gap["claim"] < report.gap("trained", "arrival")["claim"] < report.gap("trained", "full")["claim"]

# Any value function gives a valid bound, one that is 0 as well. A better one proves more.
crude = gap_report(days, {"trained": trained.policy}, value=ZeroSetValue(), foresight=foresight)
print(f"charged by a value function that is 0: {crude.claim()}")
assert crude.gap("trained", "penalised")["claim"] > gap["claim"]
