"""Workers whose rate changes during the day: exact means over all that can happen, with and without the truth."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from optkit import Instance
from optkit.bounds.arrival.policy_value import policy_value
from optkit.bounds.penalised.charges import KeptCharges
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.penalized import idle_steps, penalized, penalized_program
from optkit.bounds.penalised.presence import fifo_presence
from optkit.models.pricing import optimal_prices
from optkit.models.value.request_sets import ZeroSetValue

STEPS = 3
"""Each more makes four times as many days."""


class Model:
    """One type of request, at most one a step, and workers who queue; random, but the rates are given."""

    def __init__(self, seed, rates):
        rng = np.random.default_rng(seed)
        self.reward, self.penalty, self.utility = rng.uniform(20, 40), -rng.uniform(0, 8), rng.uniform(-25, 0)
        self.mu, self.life, self.chance = rng.uniform(0.5, 5), int(rng.integers(1, 4)), rng.uniform(0.3, 0.8)
        self.steps, self.presence = len(rates), fifo_presence(rates)

    def day(self, arrived, seen):
        """The day on which requests arrive and workers are seen at these steps."""
        arrival, worker = np.flatnonzero(arrived), np.flatnonzero(seen)
        n = arrival.size
        return Instance(
            horizon=self.steps, arrival=arrival, expiry=np.minimum(arrival + self.life, self.steps - 1),
            reward=np.full(n, self.reward), penalty=np.full(n, self.penalty), features=np.zeros((n, 0)),
            pickup=np.zeros(n, int), dropoff=np.zeros(n, int), worker_step=worker, worker_group=0 * worker,
            utility=np.full((1, n), self.utility), mu=[self.mu],
        )  # fmt: skip

    def days(self):
        """Every day that can be, with its probability."""
        for arrived, seen in product(product((False, True), repeat=self.steps), repeat=2):
            p, stretch = 1.0, 0
            for step in range(self.steps):
                busy = self.presence[step, stretch]
                p *= (self.chance if arrived[step] else 1 - self.chance) * (busy if seen[step] else 1 - busy)
                stretch = stretch + 1 if seen[step] else 0
            if p > 0:
                yield self.day(arrived, seen), p

    def foresight(self, presence, requests=True):
        """Workers as the table says, and the model's requests unless they are not charged for."""
        if not requests:
            return Foresight(presence, [1.0])
        pool = [self.day([one] * self.steps, [False] * self.steps) for one in (False, True)]
        return Foresight(presence, [1.0], pool, weight=[1 - self.chance, self.chance])

    def optimum(self):
        """Best mean reward by the Bellman equation; a state is the step, the stretch and who waits, by arrival."""

        @cache
        def value(step, stretch, waits):
            if step == self.steps:
                return 0.0
            busy, total = self.presence[step, stretch], 0.0
            for arrived, p in ((True, self.chance), (False, 1 - self.chance)):
                open_ = sorted(waits | ({step} if arrived else set()))
                left = frozenset(i for i in open_ if min(i + self.life, self.steps - 1) > step)
                lost = self.penalty * (len(open_) - len(left))
                total += p * (1 - busy) * (lost + value(step + 1, 0, left))
                if busy > 0:
                    later = value(step + 1, stretch + 1, left)
                    worth = [
                        self.reward - (later - value(step + 1, stretch + 1, left - {i}) if i in left else self.penalty)
                        for i in open_
                    ]
                    gain = optimal_prices(worth, [self.utility] * len(worth), self.mu).profit if worth else 0.0
                    total += p * busy * (lost + later + gain)
            return float(total)

        return value(0, 0, frozenset())


class Random:
    """Numbers by step and by how many wait."""

    def __init__(self, seed):
        self.table = np.random.default_rng(seed).normal(0, 8, (STEPS + 1, STEPS + 2))

    def value(self, sets):
        """By number, (b,)."""
        return self.table[sets.step, sets.member.sum(axis=1)]

    def opportunity_cost(self, sets):
        """Differences, (b, w)."""
        count = sets.member.sum(axis=1)
        return np.where(sets.member, (self.table[sets.step, count] - self.table[sets.step, count - 1])[:, None], 0.0)


def share_of_reward(day, share):
    return lambda step, worker, requests, open_: np.broadcast_to(share * day.reward[requests], open_.shape)


def evaluated(day, bound, shares):
    """Rewards of policies, and their charges under the bound."""
    proof = bound.certificate
    program, charges = penalized_program(day, proof.tracked, proof.multipliers), KeptCharges.of(proof.charges)
    for share in shares:
        reward = policy_value(program, share_of_reward(day, share))
        paid = policy_value(program, share_of_reward(day, share), charges)
        yield reward, reward - paid + charges.idle(idle_steps(program))


def means(model, value, foresight):
    """Mean bound, mean charges of two policies, and the least that a path leaves between them."""
    mean, least = np.zeros(3), np.inf
    for day, p in model.days():
        bound = penalized(day, value, foresight)
        paid = []
        for reward, charge in evaluated(day, bound, (0.4, 0.8)):
            least = min(least, bound.value - (reward - charge))
            paid.append(charge)
        mean += p * np.array([bound.value, *paid])
    return *mean, least


def rates_of(seed):
    rng = np.random.default_rng(seed)
    return rng.choice([0.05, 0.3, 0.9, 2.0], STEPS) * rng.uniform(0.7, 1.3, STEPS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_charges_cost_nobody_anything_and_the_bound_holds(seed):
    """Exact weights: with the rates of each step charges have mean zero, for any value function and any policy.

    So the mean bound lies above the optimum, also where arrivals are charged for. 1e-9 covers sums of some hundred
    money, rounded.
    """
    model = Model(seed, rates_of(seed))
    value = Random(seed) if seed % 2 else ZeroSetValue()
    bound, *charges, least = means(model, value, model.foresight(model.presence, requests=seed < 2))
    assert charges == pytest.approx([0.0, 0.0], abs=1e-9)
    assert bound >= model.optimum() - 1e-9
    assert least >= -1e-9


@pytest.mark.slow
def test_one_rate_for_all_steps_may_put_the_bound_below_the_optimum():
    """What rates by step guard against: as many workers in all, at the wrong time of day."""
    model = Model(1, [0.05] + [1.0] * (STEPS - 1))
    wrong, *charges, _ = means(
        model, ZeroSetValue(), model.foresight(fifo_presence(2.05 / STEPS, STEPS), requests=False)
    )
    assert wrong < model.optimum() - 0.4
    assert min(charges) > 0.4
    true, *_ = means(model, ZeroSetValue(), model.foresight(model.presence, requests=False))
    assert true >= model.optimum() - 1e-9
