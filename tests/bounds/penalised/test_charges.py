"""What foresight is charged at: against the definition, and zero in the mean whatever one does without it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.bounds.penalised import charges as module
from optkit.bounds.penalised.charges import Charges
from optkit.bounds.penalised.foresight import Foresight, fifo_presence, surroundings
from optkit.instances.instance import Instance
from optkit.learning.training import train
from optkit.models.pricing import optimal_prices
from optkit.models.value import LinearValue
from optkit.models.value.request_sets import ZeroSetValue, removal_differences
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.batch import Batch


class Made:
    """A value function that is no sum over requests, has a level for each step, and may look at busy stretches."""

    def __init__(self, sees_busy=False, level=0.0):
        self.sees_busy, self.level = sees_busy, level

    def value(self, sets):
        """Square root of the surplus times steps left, less for each pair, (b,)."""
        worth = np.where(sets.member, np.maximum(sets.mean_surplus, 1.0) * sets.steps_left, 0.0).sum(axis=1)
        count = sets.member.sum(axis=1)
        busy = sets.busy if self.sees_busy else 1
        return self.level * (1 + sets.step) ** 2 + np.sqrt(worth) * (1 + 0.1 * busy) - 0.7 * count * (count - 1)

    def opportunity_cost(self, sets):
        """Differences, (b, w)."""
        return removal_differences(self.value, sets)


def day_of(horizon, kinds, arrivals, groups):
    """An instance in which requests (step, kind) arrive and workers of some groups come, -1 for none."""
    seen = np.flatnonzero(np.array(groups) >= 0)
    arrival = np.array([step for step, _ in arrivals], int)
    kind = np.array([k for _, k in arrivals], int)
    life = np.array([2, 1])
    return Instance(
        horizon=horizon, arrival=arrival, expiry=np.minimum(arrival + life[kind], horizon - 1),
        reward=kinds["reward"][kind], penalty=kinds["penalty"][kind], features=np.zeros((kind.size, 0)), pickup=kind,
        dropoff=0 * kind, worker_step=seen, worker_group=np.array(groups)[seen], utility=kinds["utility"][:, kind],
        mu=[2.0, 5.0], outside_utility=[0.0, 1.5],
    )  # fmt: skip


KINDS = {
    "reward": np.array([30.0, 22.0]),
    "penalty": np.array([-6.0, -1.0]),
    "utility": np.array([[-12.0, -3.0], [4.0, -20.0]]),
}
COMES = [(), (0,), (1,), (0, 1)]
"""Kinds that may arrive together."""
CHANCE = np.array([0.4, 0.25, 0.2, 0.15])
SHARE = np.array([0.3, 0.7])
PRESENCE = np.array([0.35, 0.6, 0.8])
HORIZON = 4


def small_foresight():
    pool = [day_of(HORIZON, KINDS, [(t, k) for t in range(HORIZON) for k in c], [-1] * HORIZON) for c in COMES]
    return Foresight(PRESENCE, SHARE, pool, weight=CHANCE)


def sets_of(table, step, index, busy):
    from optkit.models.value.request_sets import RequestSets

    index = np.array(index, int)[None, :]
    return RequestSets(table, step, index, np.ones(index.shape, bool), np.array([busy]))


def one_step_value(table, mu, value, step, open_, group, busy):
    """G by hand for one set: penalties of those that expire, profit with a worker of a group, and V of the rest."""
    waits = [i for i in open_ if table.expiry[i] > step]
    stretch = busy + 1 if group >= 0 else 0
    total = sum(table.penalty[i] for i in open_ if table.expiry[i] == step)
    if group < 0 or not open_:
        return total + value.value(sets_of(table, step, waits, stretch))[0]
    total += value.value(sets_of(table, step, waits, stretch))[0]
    cost = dict(zip(waits, value.opportunity_cost(sets_of(table, step, waits, stretch))[0], strict=True))
    worth = [table.reward[i] - (0.0 if i in cost else table.penalty[i]) - cost.get(i, 0.0) for i in open_]
    return total + optimal_prices(worth, table.utility[group, open_], mu[group]).profit


@pytest.mark.slow
@pytest.mark.parametrize("sees_busy", [False, True])
@pytest.mark.parametrize("groups", [[0, -1, 1, 1], [-1, 1, 1, 0], [1, 0, 1, -1], [-1, -1, -1, -1]])
def test_charges_are_their_definition(sees_busy, groups):
    """Subset by subset, with loops over workers and arrivals and the public pricing function."""
    day = day_of(HORIZON, KINDS, [(0, 0), (0, 1), (1, 0), (2, 1), (2, 0), (3, 1)], groups)
    value, foresight = Made(sees_busy), small_foresight()
    charges = Charges(day, value, foresight, 0)
    around = surroundings(day, foresight, np.random.default_rng(0))
    stretch = 0
    for step in range(-1, HORIZON - 1):
        stretch = stretch + 1 if step >= 0 and groups[step] >= 0 else 0
        now, waiting = step + 1, np.flatnonzero((day.arrival <= step) & (step < day.expiry))
        p = PRESENCE[min(stretch, 2)]

        def g(members, arrivals, group, now=now, stretch=stretch):
            open_ = [*members, *arrivals]
            return one_step_value(around.requests, day.mu, value, now, open_, group, stretch)

        found = charges(step, waiting)
        for subset in range(1 << waiting.size):
            members = [i for bit, i in enumerate(waiting) if subset >> bit & 1]
            came = g(members, np.flatnonzero(day.arrival == now), groups[now])
            expected = 0.0
            for row, chance in zip(around.drawn[now], CHANCE, strict=True):
                arrivals = row[row >= 0]
                expected += chance * (1 - p) * g(members, arrivals, -1)
                expected += chance * p * sum(SHARE[d] * g(members, arrivals, d) for d in range(2))
            # Sums of some hundred money, rounded.
            assert found[subset] == pytest.approx(came - expected, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("most", [None, 1, 0])
@pytest.mark.parametrize("sees_busy", [False, True])
@pytest.mark.parametrize("history", [[0, 1, -1, -1], [-1, -1, -1, -1], [-1, 0, -1, -1]])
def test_charges_are_zero_in_the_mean_over_what_the_next_step_may_bring(sees_busy, history, most):
    """For every set that waits, by enumeration of workers, groups and arrivals: nothing is simulated."""
    past, step = [(0, 0), (0, 1), (1, 0)], 1
    busy = {(0, 1): 2, (-1, -1): 0, (-1, 0): 1}[tuple(history[:2])]
    total = np.zeros(4)
    for (arrivals, chance), group in product(zip(COMES, CHANCE, strict=True), (-1, 0, 1)):
        p = PRESENCE[busy] * SHARE[group] if group >= 0 else 1 - PRESENCE[busy]
        now = [*history[:2], group, -1]
        day = day_of(HORIZON, KINDS, [*past, *((2, k) for k in arrivals)], now)
        total += chance * p * Charges(day, Made(sees_busy), small_foresight(), 0, most)(step, np.array([0, 2]))
    assert total == pytest.approx(np.zeros(4), abs=1e-11)


def test_charges_before_the_first_step_are_zero_in_the_mean_too():
    mean = spread = 0.0
    for (arrivals, chance), group in product(zip(COMES, CHANCE, strict=True), (-1, 0, 1)):
        p = PRESENCE[0] * SHARE[group] if group >= 0 else 1 - PRESENCE[0]
        day = day_of(HORIZON, KINDS, [(0, k) for k in arrivals], [group, -1, -1, -1])
        found = Charges(day, Made(), small_foresight(), 0).idle(np.array([-1]))
        mean, spread = mean + chance * p * found, spread + chance * p * found**2
    assert mean == pytest.approx(0.0, abs=1e-11)
    assert spread > 1.0


def test_a_level_of_the_value_function_costs_nothing():
    """A constant of the step, however large, is the same whatever comes."""
    day = day_of(HORIZON, KINDS, [(0, 0), (0, 1), (1, 0), (2, 1)], [0, 1, -1, 1])
    for step in range(HORIZON - 1):
        waiting = np.flatnonzero((day.arrival <= step) & (step < day.expiry))
        plain, lifted = (Charges(day, Made(level=x), small_foresight(), 0)(step, waiting) for x in (0.0, 1e4))
        assert lifted == pytest.approx(plain, abs=1e-8)  # 1e5 rounded


def test_what_is_known_for_sure_costs_nothing():
    """Workers who always come, of the only group, and arrivals that are all there can be: nothing is foreseen."""
    day = scenario("I.1", seed=0, horizon=8, request_rate=0.8).sample(1, seed=3)[0]
    day = replace(day, worker_step=np.arange(8), worker_group=np.zeros(8, int), noise=None, outside_noise=None)
    charges = Charges(day, Made(), Foresight([1.0], [1.0], [day], weight=[1.0]), 0)
    for step in range(-1, 7):
        waiting = np.flatnonzero((day.arrival <= step) & (step < day.expiry))
        assert charges(step, waiting) == pytest.approx(np.zeros(1 << waiting.size), abs=1e-10)
    workers = Charges(day, Made(), Foresight([1.0], [1.0]), 0)
    assert workers(3, np.flatnonzero((day.arrival <= 3) & (day.expiry > 3))) == pytest.approx(0.0, abs=1e-10)


@pytest.fixture(scope="module", params=["I.1", "II"])
def world(request):
    """A scenario of 10 steps, a value function trained in it, and policies to be charged."""
    source = scenario(request.param, seed=0, horizon=10, request_rate=0.8)
    trained = train(source.sample(60, seed=1), LinearValue(busy_knots=(0.0, 2.0)), choice="true")
    return source, trained.value, [PostDecisionPricing(), RewardPercentage(0.5), trained.policy]


def last_waits(days, policy):
    """Last step after which each request waited, by instance: a day may be simulated with the noise drawn anew."""
    batch = Batch.of(days)
    last = batch.expiry[: int(batch.request_start[-1])] - 1

    def watch(state, _, taken):
        at = np.flatnonzero(taken >= 0)
        last[state.request[at, taken[at]]] = state.step - 1

    simulate(batch, policy, observe=watch)
    return np.split(last, batch.request_start[1:-1])


@pytest.mark.slow
@pytest.mark.parametrize("arrivals", [True, False], ids=["arrivals charged", "workers only"])
def test_no_policy_pays_anything_in_the_mean(world, arrivals):
    """Over 30 instances, each with a pool of its own, within 4 standard errors.

    Besides all it pays, what a policy pays more than one that serves nobody: the noise of that is smaller.
    """
    source, value, policies = world
    days = source.sample(30, seed=2)
    pool = source.sample(30 * 6, seed=3)
    presence, share = fifo_presence(0.5), np.full(days[0].n_groups, 1 / days[0].n_groups)
    waits = [*(last_waits(days, policy) for policy in policies), [day.expiry - 1 for day in days]]
    paid = np.empty((30, len(waits)))
    for k, day in enumerate(days):
        foresight = Foresight(presence, share, pool[6 * k : 6 * k + 6] if arrivals else (), draws=2)
        charges = Charges(day, value, foresight, seed=k)
        paid[k] = charges.along(np.array([w[k] for w in waits]), np.ones(day.n_requests, bool))
    for sample in [*paid.T, *(paid[:, :-1] - paid[:, -1:]).T]:
        error = sample.std(ddof=1) / np.sqrt(len(sample))
        assert error > 0.05
        assert abs(sample.mean()) <= 4 * error


@pytest.mark.slow
def test_who_has_foresight_pays(world):
    """The test above could fail: who lets wait what the next step makes dearest pays more than who serves nobody."""
    source, value, _ = world
    paid = []
    for k, day in enumerate(source.sample(20, seed=4)):
        charges = Charges(day, value, Foresight(fifo_presence(0.5), np.full(day.n_groups, 1 / day.n_groups)), seed=k)
        waiting = [np.flatnonzero((day.arrival <= step) & (step < day.expiry))[:4] for step in range(day.horizon - 1)]
        tables = [charges(step, requests) for step, requests in enumerate(waiting)]
        paid.append(sum(table.max() - table[-1] for table in tables))
    assert np.mean(paid) > 4 * np.std(paid, ddof=1) / np.sqrt(20)


def test_those_of_the_largest_surplus_are_looked_at():
    """The others may wait or not, in whatever order they are listed; of three alike the first two are taken."""
    arrivals = [(0, 1), (0, 0), (0, 1), (0, 0), (0, 0)]  # the second kind has the smaller surplus
    day = day_of(HORIZON, KINDS, arrivals, [0, 1, -1, 0])
    day = replace(day, expiry=np.full(5, 3))
    whole, some = (Charges(day, Made(), small_foresight(), 0, most) for most in (None, 2))
    best = np.array([1, 3])
    alone = whole(0, best)
    assert np.unique(alone.round(9)).size == 3  # they are alike
    for order in (np.arange(5), np.arange(5)[::-1]):
        found = some(0, order)
        for subset in range(32):
            members = order[np.flatnonzero(subset >> np.arange(5) & 1)]
            assert found[subset] == alone[np.isin(best, members) @ [1, 2]]


@pytest.mark.slow
@pytest.mark.parametrize("most", [None, 2, 0])
@pytest.mark.parametrize("sees_busy", [False, True])
def test_along_a_run_are_the_entries_of_its_sets(sees_busy, most):
    """The tables' entries, and what is charged where nothing waits, add up to the charge of each of 30 runs."""
    source = scenario("II", seed=0, horizon=9, request_rate=0.6)
    day = source.sample(1, seed=8)[0]
    foresight = Foresight(fifo_presence(0.5), np.full(3, 1 / 3), source.sample(12, seed=9), np.exp(-0.6), draws=3)
    charges, rng = Charges(day, Made(sees_busy), foresight, 7, most), np.random.default_rng(0)
    last = rng.integers(day.arrival - 1, day.expiry, (30, day.n_requests))
    tracked = np.arange(day.n_requests) != 1
    total, idle = np.zeros(30), []
    for step in range(-1, day.horizon - 1):
        waiting = np.flatnonzero(tracked & (day.arrival <= step) & (step < day.expiry))
        if waiting.size:
            bits = (last[:, waiting] >= step) @ (1 << np.arange(waiting.size))
            total += charges(step, waiting)[bits]
        else:
            idle.append(step)
    assert charges.along(last, tracked) == pytest.approx(total + charges.idle(np.array(idle)), abs=1e-10)
    assert np.unique(total.round(6)).size > (1 if most == 0 else 5) - (most == 0)


def test_subsets_may_be_valued_in_parts(monkeypatch):
    source = scenario("I.1", seed=0)
    day = source.sample(1, seed=8)[0]
    waiting = np.flatnonzero((day.arrival <= 20) & (day.expiry > 20))
    assert waiting.size >= 3
    charges = Charges(day, Made(), Foresight(fifo_presence(0.5), [1.0], source.sample(5, seed=9)), 7)
    whole = charges(20, waiting)
    monkeypatch.setattr(module, "CHUNK", 3)
    assert np.array_equal(charges(20, waiting), whole)


def test_the_seed_draws_the_arrivals():
    source = scenario("I.1", seed=0, horizon=10)
    day = source.sample(1, seed=8)[0]
    foresight = Foresight(fifo_presence(0.5), [1.0], source.sample(50, seed=9), draws=2)
    totals = [Charges(day, ZeroSetValue(), foresight, seed).idle(np.arange(-1, 9)) for seed in (1, 1, 2)]
    assert totals[0] == totals[1] != totals[2]
