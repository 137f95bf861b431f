"""Backward induction over subsets of open requests, against a recursion from the definition of the process."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize

from optkit.basics.errors import InputError
from optkit.bounds.arrival.lattice import lattice_bits, reachable, stages
from optkit.bounds.arrival.subsets import SubsetProgram

seeds = st.integers(0, 2**32 - 1)
bounded = settings(derandomize=True, deadline=None, max_examples=25)


def best_profit(value, logit, mu, nonnegative=True):
    """Optimal profit of one decision: the root R of R = sum_i max_c w_i e^(c/mu) (v_i - c - R), by bisection."""

    def excess(R):
        price = np.asarray(value) - mu - R
        price = np.maximum(price, 0.0) if nonnegative else price
        with np.errstate(over="ignore"):
            return float((np.exp(logit + price / mu) * (value - price - R)).sum()) - R

    if not len(value):
        return 0.0
    low = min(0.0, min(value)) - 1.0
    high = max(0.0, max(value)) + mu * (1 + len(value)) * np.exp(max(0.0, max(logit)) / 50)
    while excess(high) > 0:
        high += 2 * abs(high) + mu
    return brentq(excess, low, high, xtol=1e-13, rtol=1e-15)


def from_definition(day, charge=None, nonnegative=True):
    """Value of the process step by step, penalties at expiry and all, for one who knows the arrivals."""
    worker = dict(zip(day.worker_step.tolist(), range(day.n_workers), strict=True))

    @cache
    def after(step, waiting):
        """What follows a decision, given those who are unserved then."""
        expired = sum(day.penalty[i] for i in waiting if day.expiry[i] == step)
        stay = frozenset(i for i in waiting if day.expiry[i] > step)
        fee = charge(step, stay) if charge is not None else 0.0
        return expired - fee + before(step + 1, stay)

    @cache
    def before(step, waiting):
        if step == day.horizon:
            return 0.0
        open_ = waiting | {i for i in range(day.n_requests) if day.arrival[i] == step}
        base = after(step, open_)
        if step not in worker:
            return base
        d = day.worker_group[worker[step]]
        members = sorted(open_)
        value = np.array([day.reward[i] - base + after(step, open_ - {i}) for i in members])
        logit = (day.utility[d, members] - day.outside_by_group[d]) / day.mu[d]
        return base + best_profit(value, logit, day.mu[d], nonnegative)

    return before(0, frozenset())


def program(day, *, nonnegative=True, every_step=False):
    n = day.n_requests
    return SubsetProgram(day, stages(day, every_step=every_step), np.zeros(n), np.full(n, nonnegative))


def value_of(induction, charge=None):
    return induction.constant + induction.tables(charge)[0][0]


def liked(day, by=55.0):
    """The same day with workers who would often pay to work: prices are held at 0."""
    return replace(day, utility=day.utility + by)


KINDS = {
    "usual": {},
    "three groups": {"groups": 3},
    "long lifetimes": {"requests": 7, "lifetime": 8.0},
    "ties": {"ties": True},
    "crowded": {"requests": 7, "horizon": 6, "workers": 5},
    "nothing worth serving": {"reward": -80.0},
}


def test_the_reference_prices_as_a_direct_search_does():
    """The test's own pricing, by its dual, agrees with maximising the profit over the prices."""
    value, logit = np.array([3.0, 1.0, -0.5]), np.array([0.5, 1.5, 0.2])

    def loss(c):
        weight = np.exp(logit + c / 0.8)
        return -float((weight * (value - c)).sum() / (1 + weight.sum()))

    found = minimize(loss, np.ones(3), bounds=[(0, None)] * 3, options={"ftol": 1e-14})
    assert best_profit(value, logit, 0.8) == pytest.approx(-found.fun, abs=1e-7)  # the search stops at a slope of 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("liking", [0.0, 55.0], ids=["prices free", "prices held at 0"])
@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_the_induction_is_the_process(random_instance, kind, seed, liking):
    day = liked(
        random_instance(np.random.default_rng(seed), **{"requests": 6, "workers": 4, "horizon": 8, **kind}), liking
    )
    # 1e-9: a few hundred money units, rounded in each of up to 8 steps, and brentq's 1e-13.
    assert value_of(program(day)) == pytest.approx(from_definition(day), abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_prices_of_either_sign_give_more_where_workers_would_pay(random_instance, seed):
    day = liked(random_instance(np.random.default_rng(seed), requests=5, workers=3, horizon=6))
    free = value_of(program(day, nonnegative=False))
    assert free == pytest.approx(from_definition(day, nonnegative=False), abs=1e-9)
    assert free > value_of(program(day)) + 0.01


@pytest.mark.parametrize(("mu", "reward"), [(0.01, 30.0), (1e-3, 1e5), (100.0, 30.0)])
def test_exponents_beyond_floating_point_do_no_harm(random_instance, mu, reward):
    day = replace(random_instance(np.random.default_rng(1), requests=5, workers=3, horizon=6, reward=reward), mu=[mu])
    # 1e-9 of the money in play.
    assert value_of(program(day)) == pytest.approx(from_definition(day), rel=1e-9)


@pytest.mark.slow
@bounded
@given(seeds, st.floats(0.0, 70.0), st.sampled_from([0.3, 1.0, 20.0]))
def test_the_quick_pricing_is_the_closed_form_at_every_subset(random_instance, seed, liking, mu):
    """Whatever the table of the next stage holds, the halves of the table and the laid-out decisions agree."""
    from optkit.models.pricing import closed_form

    rng = np.random.default_rng(seed)
    day = replace(liked(random_instance(rng, requests=9, workers=4, horizon=8, lifetime=5.0), liking), mu=[mu])
    induction = program(day)
    for stage, following in zip(induction.stages, induction.stages[1:], strict=False):
        later = rng.uniform(-30, 60, following.states)
        offers = induction.offers(stage, later, np.arange(stage.states))
        profit = mu * closed_form.nonnegative(offers.decisions).ratio[:, 0]
        # Money of about 100, rounded; the quick form allows itself one rounding of mu.
        assert induction._before(stage, later) == pytest.approx(later[stage.after] + profit, abs=1e-11)


class Recorder:
    """A charge that is no sum over requests, and that remembers for what it was called."""

    def __init__(self, day, seed):
        rng = np.random.default_rng(seed)
        self.linear = rng.normal(0, 4, (day.horizon, day.n_requests))
        self.square = rng.normal(0, 1, day.horizon)
        self.calls = []

    def of_set(self, step, waiting):
        """Money for one set of those who wait."""
        members = sorted(waiting)
        return self.linear[step, members].sum() + self.square[step] * len(members) ** 2 if members else 0.0

    def __call__(self, step, requests):
        """Money for all subsets."""
        self.calls.append((step, requests.tolist()))
        subsets = np.arange(1 << requests.size)[:, None] >> np.arange(requests.size) & 1
        return subsets @ self.linear[step, requests] + self.square[step] * subsets.sum(axis=1) ** 2


@pytest.mark.parametrize("liking", [0.0, 40.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_charge_is_taken_after_each_decision(random_instance, seed, liking):
    day = liked(random_instance(np.random.default_rng(seed), requests=6, workers=3, horizon=8, groups=2), liking)
    charge = Recorder(day, seed)
    value = value_of(program(day, every_step=True), charge)
    assert value == pytest.approx(from_definition(day, charge.of_set), abs=1e-9)
    assert abs(value - value_of(program(day))) > 0.1  # it does matter


def test_a_charge_is_asked_for_once_a_step_backwards_about_those_who_wait(random_instance):
    day = random_instance(np.random.default_rng(3))
    charge = Recorder(day, 3)
    program(day, every_step=True).tables(charge)
    wait = {t: np.flatnonzero((day.arrival <= t) & (t < day.expiry)).tolist() for t in range(day.horizon)}
    asked = [step for step, _ in charge.calls]
    assert asked == [step for step in range(day.horizon - 1, -1, -1) if wait[step]]
    assert all(sorted(requests) == wait[step] for step, requests in charge.calls)


@pytest.mark.parametrize("seed", range(5))
def test_a_charge_of_nothing_is_no_charge(random_instance, seed):
    """All steps with a charge of 0, and workers' steps alone, are the same value."""
    day = random_instance(np.random.default_rng(seed), requests=12, workers=7, horizon=14, groups=2)
    zero = value_of(program(day, every_step=True), lambda step, requests: np.zeros(1 << requests.size))
    assert zero == pytest.approx(value_of(program(day)), abs=1e-10)  # rounding of sums below 1000


def test_a_worker_who_finds_nothing_open_changes_nothing(random_instance):
    day = random_instance(np.random.default_rng(7), requests=3, workers=2, horizon=4)
    day = replace(day, horizon=9, worker_step=[1, 7])
    induction = program(day, every_step=True)
    tables = induction.tables()
    assert induction.constant + tables[0][0] == pytest.approx(from_definition(day), abs=1e-9)
    assert induction.check(tables)[0] == pytest.approx(from_definition(day), abs=1e-8)


def test_a_charge_of_the_wrong_shape_is_refused(random_instance):
    day = random_instance(np.random.default_rng(4))
    for wrong in (
        lambda step, requests: np.zeros(requests.size),
        lambda step, requests: np.full(1 << requests.size, np.nan),
    ):
        with pytest.raises(InputError, match="one finite number per subset"):
            program(day, every_step=True).tables(wrong)


@pytest.mark.slow
@bounded
@given(seeds, st.floats(0.0, 60.0))
def test_any_tables_prove_a_bound_and_give_a_policy(random_instance, seed, liking):
    """Noise on the tables neither breaks the proof nor lets the policy earn more than the optimum."""
    rng = np.random.default_rng(seed)
    induction = program(liked(random_instance(rng, lifetime=4.0), liking))
    tables = induction.tables()
    best = induction.constant + tables[0][0]
    bound, attained = induction.check([table + rng.normal(0, 3, table.size) for table in tables])
    assert bound >= best - 1e-9
    assert attained <= best + 1e-9
    bound, attained = induction.check(tables)
    assert best - 1e-9 <= bound <= best + 1e-8  # it adds a few roundings of the money in play per stage
    assert attained == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_tables_with_charges_are_proven_too(random_instance, seed):
    day = random_instance(np.random.default_rng(seed), requests=6, workers=3, horizon=8)
    charge, induction = Recorder(day, seed), program(day, every_step=True)
    tables = induction.tables(charge)
    bound, attained = induction.check(tables, charge)
    assert bound == pytest.approx(induction.constant + tables[0][0], abs=1e-8)
    assert attained == pytest.approx(bound, abs=1e-8)
    lower = [table - 1.0 if j <= 3 else table for j, table in enumerate(tables)]
    # It is raised again by the 1 that it lacks, or by up to twice that where a decision is made.
    assert bound - 1e-8 <= induction.check(lower, charge)[0] <= bound + 1.0 + 1e-8


def test_a_hopelessly_low_table_still_proves_a_bound(random_instance):
    induction = program(random_instance(np.random.default_rng(5)))
    tables = induction.tables()
    bound, _ = induction.check([np.full_like(table, -1e6) for table in tables])
    assert induction.constant + tables[0][0] <= bound < np.inf


@pytest.mark.parametrize("huge", [-1e308, 1e308])
@pytest.mark.parametrize("stage", [0, 2, 5])
def test_tables_at_the_end_of_floating_point_prove_nothing_false(random_instance, stage, huge):
    induction = program(random_instance(np.random.default_rng(5)))
    tables = induction.tables()
    best = induction.constant + tables[0][0]
    bound, _ = induction.check([np.full_like(t, huge) if j == stage else t for j, t in enumerate(tables)])
    assert not bound < best - 1e-9


@pytest.mark.parametrize(
    "tamper", [lambda t: t[:-1], lambda t: [*t[:-1], t[-1] * np.nan], lambda t: [*t[:-1], t[-1][:-1]]]
)
def test_tables_that_do_not_fit_are_refused(random_instance, tamper):
    induction = program(random_instance(np.random.default_rng(6)))
    with pytest.raises(InputError, match="table"):
        induction.check(tamper(induction.tables()))


@bounded
@given(seeds, st.integers(0, 10), st.integers(0, 6), st.integers(0, 2**10 - 1))
def test_the_sizes_are_known_beforehand(random_instance, seed, requests, workers, subset):
    day = random_instance(np.random.default_rng(seed), requests=requests, workers=workers)
    tracked = (subset >> np.arange(requests) & 1).astype(bool)
    bits = dict(zip(day.worker_step.tolist(), lattice_bits(day, tracked).tolist(), strict=True))
    found = {stage.step: stage.uncertain for stage in stages(day, tracked=tracked)}
    assert found == {step: bits[step] for step in found}
    assert all(bits[step] == 0 for step in bits if step not in found)


@pytest.mark.parametrize("seed", range(4))
def test_reachable_subsets_are_those_that_some_course_of_service_leaves(random_instance, seed):
    day = random_instance(np.random.default_rng(seed), requests=7, workers=5, horizon=10, lifetime=5.0)
    cut = stages(day)
    for j, rows in enumerate(reachable(cut)):
        uncertain = cut[j].requests[: cut[j].uncertain].tolist()
        earlier = [set(stage.requests.tolist()) for stage in cut[:j]]

        def can_be_served(group, workers):
            """Whether each of the group can have had a worker of its own: Hall's condition."""
            return all(
                sum(bool(set(part) & options) for options in workers) >= size
                for size in range(1, len(group) + 1)
                for part in combinations(group, size)
            )

        expected = [
            sum(1 << p for p, i in enumerate(uncertain) if i not in gone)
            for size in range(len(uncertain) + 1)
            for gone in combinations(uncertain, size)
            if can_be_served(gone, earlier)
        ]
        assert rows.tolist() == sorted(expected)
