"""Claims beside the truth: reports on days of four steps whose optimum is known, whatever the workers' process is.

    python -m tests.gap.claims SECONDS FIRST

tries processes and assumptions for as long, and prints what became of each: refused, not penalised, held or broken. A
claim is made with 95 per cent confidence, so that one in twenty of those that are made may be broken.
"""

import sys
import time
from collections import Counter
from functools import cache
from itertools import product

import numpy as np

from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.policy_value import policy_value
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.gap.charging import worker_charging
from optkit.gap.report import gap_report
from optkit.learning.worker_rates import learn_worker_rates
from optkit.models.pricing import optimal_prices
from tests.bounds.penalised.test_changing_rates import STEPS, Model, share_of_reward

PATTERNS = list(product((False, True), repeat=STEPS))
"""At which steps workers are seen: a process is a probability of each."""

SHARE = 0.6
"""The policy that is reported on pays this share of the reward."""


def seen_of(joined):
    """Law of patterns, (16,), of days on which so many join the queue at each step, (days, STEPS): their shares."""
    waiting, seen = np.zeros(len(joined), int), np.zeros(joined.shape, bool)
    for step in range(STEPS):
        waiting += joined[:, step]
        seen[:, step] = waiting > 0
        waiting -= seen[:, step]
    number = seen @ (1 << np.arange(STEPS)[::-1])  # in the order of the patterns
    return np.bincount(number, minlength=len(PATTERNS)) / len(joined)


def changing(rng, size):
    """Poisson, at rates of each step."""
    return rng.poisson(rng.choice([0.05, 0.3, 0.9, 2.0], STEPS), size)


def steady(rng, size):
    """Poisson, at one rate."""
    return rng.poisson(rng.uniform(0.2, 0.9), size)


def uneven(rng, size):
    """Good days and bad ones."""
    return rng.poisson(rng.choice([rng.uniform(0.05, 0.3), rng.uniform(0.6, 1.5)], (size[0], 1)), size)


def bursts(rng, size):
    """Several at a time."""
    return int(rng.integers(2, 4)) * (rng.random(size) < rng.uniform(0.1, 0.4))


def timetable(rng, size):
    """Every other step."""
    return (np.arange(STEPS) + rng.integers(2, size=(size[0], 1))) % 2


PROCESSES = (steady, changing, uneven, bursts, timetable)
ASSUMED = ("learned", "as many in the mean", "the first rate that comes to mind")


class Days(Model):
    """Days whose workers follow any law of patterns."""

    def __init__(self, seed, law):
        super().__init__(seed, np.full(STEPS, 0.5))
        self.law = dict(zip(PATTERNS, law / law.sum(), strict=True))

    def chance_of(self, seen):
        """Probability that a day begins so."""
        return sum(p for pattern, p in self.law.items() if pattern[: len(seen)] == seen)

    def optimum(self):
        """Best mean reward of who knows the law, by the Bellman equation over all that was seen."""

        @cache
        def value(seen, waits):
            step = len(seen)
            if step == STEPS:
                return 0.0
            before, total = self.chance_of(seen), 0.0
            for came, arrived in product((False, True), repeat=2):
                p = self.chance_of((*seen, came)) / before * (self.chance if arrived else 1 - self.chance)
                if p == 0:
                    continue
                open_ = sorted(waits | ({step} if arrived else set()))
                left = frozenset(i for i in open_ if min(i + self.life, STEPS - 1) > step)
                later = value((*seen, came), left)
                gain = self.penalty * (len(open_) - len(left)) + later
                if came and open_:
                    worth = [
                        self.reward - (later - value((*seen, came), left - {i}) if i in left else self.penalty)
                        for i in open_
                    ]
                    gain += optimal_prices(worth, [self.utility] * len(worth), self.mu).profit
                total += p * gain
            return float(total)

        return value((), frozenset())

    def mean_reward(self, share):
        """Mean reward of who pays a share of the reward, over all days that can be."""
        total = 0.0
        for seen, p in self.law.items():
            for arrived in PATTERNS if p > 0 else ():
                q = p * np.prod(np.where(arrived, self.chance, 1 - self.chance))
                day = self.day(arrived, seen)
                program = SubsetProgram(day, stages(day), np.zeros(day.n_requests), np.ones(day.n_requests, bool))
                total += q * policy_value(program, share_of_reward(day, share))
        return float(total)

    def sample(self, count, rng):
        """Draw days."""
        of = rng.choice(len(PATTERNS), count, p=list(self.law.values()))
        arrived = rng.random((count, STEPS)) < self.chance
        return [self.day(a, PATTERNS[k]).with_noise(int(rng.integers(2**31))) for a, k in zip(arrived, of, strict=True)]


def attempt(seed, measured=40, others=60):
    """Make one report; return the process, the assumption, and what became of the claim."""
    rng = np.random.default_rng([4, seed])
    process, assumed = PROCESSES[seed % len(PROCESSES)], ASSUMED[seed // len(PROCESSES) % len(ASSUMED)]
    model = Days(seed, seen_of(process(rng, (20_000, STEPS))))
    other = model.sample(others, rng)
    if assumed == "learned":
        rate = learn_worker_rates(other)
    elif assumed == ASSUMED[1]:
        rate = max(float(np.mean([day.n_workers for day in other])) / STEPS, 0.01)
    else:
        rate = 0.5
    charging = worker_charging(other, rate)
    report = gap_report(
        model.sample(measured, rng),
        {"share": lambda state: SHARE * state.reward},
        value=charging.value,
        foresight=charging.foresight,
        learned=charging.learned,
        others=other if charging.learned is None else (),
        seed=seed,
    )
    if report.refused:
        return process.__name__, assumed, "refused"
    told = report.gap("share")
    far = model.optimum() - model.mean_reward(SHARE)
    if told["bound"] != "penalised":
        return process.__name__, assumed, "not penalised" if far <= told["claim_money"] else "broken"
    return process.__name__, assumed, "held" if far <= told["claim_money"] else "broken"


def main(seconds, first):
    """Attempt for as long; print what became of claims, by process and assumption."""
    found, seed, end = Counter(), first, time.monotonic() + seconds
    while time.monotonic() < end:
        found[attempt(seed)] += 1
        seed += 1
    for (process, assumed, ending), count in sorted(found.items()):
        print(f"{process:10} {assumed:36} {ending:14} {count:5}")
    broken = sum(count for (*_, ending), count in found.items() if ending == "broken")
    made = sum(count for (*_, ending), count in found.items() if ending != "refused")
    print(f"{seed - first} reports, {made} claims, {broken} broken")


if __name__ == "__main__":
    main(float(sys.argv[1]), int(sys.argv[2]))
