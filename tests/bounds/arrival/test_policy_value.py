"""The mean reward of a policy given the arrivals, against simulation, by hand, and against the optimum."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import simulate
from optkit.basics.errors import InputError, PolicyError
from optkit.bounds.arrival import policy_value as module
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.policy_value import policy_value
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.instances.instance import Instance
from optkit.models.choice import acceptance_probabilities
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.batch import Batch
from optkit.simulation.state import State


def program(day, every_step=False):
    n = day.n_requests
    return SubsetProgram(day, stages(day, every_step=every_step), np.zeros(n), np.ones(n, bool))


def offers(day, policy):
    """Any policy of the simulator, asked about all possible states of one instance."""
    batch = Batch.of(day)

    def offer(step, worker, requests, open_):
        S = len(open_)
        nobody = np.zeros(S, int)
        at = np.broadcast_to(requests, open_.shape)
        return policy(State(batch, step, np.arange(S), nobody, np.full(S, worker), at, open_))

    return offer


def by_subset(state):
    """A policy that depends on the whole set of open requests: less for each where more are open."""
    return 0.9 * state.reward / state.offered.sum(axis=1, keepdims=True)


POLICIES = {"half": RewardPercentage(0.5), "myopic": PostDecisionPricing(), "by the number of open ones": by_subset}


def busy_day(random_instance, seed):
    day = random_instance(
        np.random.default_rng(seed), requests=9, workers=7, horizon=10, lifetime=4.0, groups=2, reward=45.0
    )
    return replace(day, utility=0.5 * day.utility)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_mean_of_simulations(random_instance, seed):
    """2,000 draws of the noise, within 4 standard errors, for each policy."""
    day = busy_day(random_instance, seed)
    runs = Batch.of([day.with_noise(draw) for draw in range(2000)])
    for name, policy in POLICIES.items():
        reward = simulate(runs, policy).reward
        error = reward.std(ddof=1) / np.sqrt(reward.size)
        assert policy_value(program(day), offers(day, policy)) == pytest.approx(reward.mean(), abs=4 * error), name
        assert error < 0.01 * abs(day.reward.sum()), name


def test_policies_differ(random_instance):
    """The test above can tell the policies from each other."""
    day = busy_day(random_instance, 0)
    values = [policy_value(program(day), offers(day, policy)) for policy in POLICIES.values()]
    assert np.diff(np.sort(values)).min() > 5.0


def test_one_request_and_two_workers_by_hand():
    """Served first or second, or left to expire."""
    day = Instance(
        horizon=3, arrival=[0], expiry=[2], reward=[30.0], penalty=[-5.0], features=[[]], pickup=[0], dropoff=[0],
        worker_step=[1, 2], worker_group=[0, 1], utility=[[-10.0], [-14.0]], mu=[2.0, 5.0], outside_utility=[0.0, 1.0],
    )  # fmt: skip
    first = acceptance_probabilities([11.0], [-10.0], 2.0)[0][0]
    second = acceptance_probabilities([15.0], [-14.0], 5.0, outside_utility=1.0)[0][0]
    expected = first * 19.0 + (1 - first) * (second * 15.0 - (1 - second) * 5.0)
    found = policy_value(program(day), lambda step, worker, requests, open_: np.where(open_, 7.0 + 4.0 * step, np.nan))
    assert found == pytest.approx(expected, abs=1e-12)


def charge_of(day, seed):
    """Some charge of sets of waiting requests."""
    rng = np.random.default_rng(seed)
    linear = rng.normal(0, 4, (day.horizon, day.n_requests))

    def charge(step, requests):
        subsets = np.arange(1 << requests.size)[:, None] >> np.arange(requests.size) & 1
        return subsets @ linear[step, requests] + 0.5 * subsets.sum(axis=1) ** 2

    return charge


@pytest.mark.parametrize("charged", [False, True], ids=["free", "charged"])
@pytest.mark.parametrize("seed", range(3))
def test_the_tables_own_policy_attains_what_the_check_says_and_others_less(random_instance, seed, charged):
    day = busy_day(random_instance, seed)
    induction = program(day, every_step=True)
    charge = charge_of(day, seed) if charged else None
    tables = induction.tables(charge)
    following = {}
    for stage, later in zip(induction.stages, [*tables[1:], np.zeros(1)], strict=True):
        z = 0.0
        if charge is not None:
            after = [s for s in induction.stages if s.step == stage.step + 1]
            if after and after[0].uncertain:
                z = charge(stage.step, after[0].requests[: after[0].uncertain])
        following[stage.step] = stage, later - z

    def tables_prices(step, worker, requests, open_):
        stage, later = following[step]
        rows = open_[:, : stage.uncertain] @ (1 << np.arange(stage.uncertain))
        laid = induction.offers(stage, later, rows)
        table = tables[induction.stages.index(stage)]
        ratio = (table[rows] - later[laid.stay])[:, None] / laid.decisions.mu
        return laid.prices(ratio)[0]

    best = policy_value(induction, tables_prices, charge)
    bound, attained = induction.check(tables, charge)
    # The same sums of some hundred money in another order; the bound is raised by a few roundings per stage.
    assert best == pytest.approx(attained, abs=1e-9)
    assert best == pytest.approx(bound, abs=1e-7)
    for policy in POLICIES.values():
        assert policy_value(induction, offers(day, policy), charge) <= best + 1e-9


def test_charges_are_subtracted_once_a_step():
    """A charge that is the same for all sets lowers the value by its sum over the steps after which somebody waits."""
    day = Instance(
        horizon=6, arrival=[1, 2], expiry=[3, 4], reward=[30.0, 20.0], penalty=[-5.0, -1.0], features=[[], []],
        pickup=[0, 0], dropoff=[0, 0], worker_step=[2, 4], worker_group=[0, 0], utility=[[-10.0, -8.0]], mu=[2.0],
    )  # fmt: skip
    half, induction = offers(day.with_noise(0), RewardPercentage(0.5)), program(day, every_step=True)
    free = policy_value(induction, half)
    charged = policy_value(induction, half, lambda step, requests: np.full(1 << requests.size, 10.0**step))
    assert free - charged == pytest.approx(10.0 + 100.0 + 1000.0, abs=1e-9)


def test_nobody_is_asked_to_price_nothing(random_instance):
    seen = []

    def offer(step, worker, requests, open_):
        seen.append(open_.any(axis=1))
        return np.zeros(open_.shape)

    policy_value(program(busy_day(random_instance, 0)), offer)
    assert np.concatenate(seen).all()


def test_without_requests_or_workers_the_penalties_are_paid(random_instance):
    for sizes in ({"requests": 0}, {"workers": 0}):
        day = random_instance(np.random.default_rng(0), **sizes)
        assert policy_value(program(day), offers(day, RewardPercentage(0.5))) == pytest.approx(day.penalty.sum())


def test_states_may_be_asked_for_in_parts(random_instance, monkeypatch):
    day = busy_day(random_instance, 1)
    whole = policy_value(program(day), offers(day, by_subset))
    monkeypatch.setattr(module, "CHUNK", 3)
    assert policy_value(program(day), offers(day, by_subset)) == whole


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (lambda open_: np.full(open_.shape, -1.0), "offers -1.0 at step"),
        (lambda open_: np.full(open_.shape, np.nan), "offers nan"),
        (lambda open_: np.full(open_.shape, np.inf), "offers inf"),
        (lambda open_: np.zeros(open_.shape[0]), "returned shape"),
        (lambda open_: 5.0, r"returned shape \(\)"),
        (lambda open_: "much", "the policy returned at step .* holds text"),
        (lambda open_: [[1.0], [1.0, 2.0]], "the policy returned at step .* is ragged"),
    ],
)
def test_bad_policies_are_refused_in_one_line(random_instance, bad, message):
    day = busy_day(random_instance, 0)
    with pytest.raises(PolicyError, match=message) as caught:
        policy_value(program(day), lambda step, worker, requests, open_: bad(open_))
    assert "\n" not in str(caught.value)


def test_a_program_that_forgets_requests_is_refused(random_instance):
    day = busy_day(random_instance, 0)
    forgets = replace(program(day), multipliers=np.ones(day.n_requests))
    with pytest.raises(InputError, match="multipliers"):
        policy_value(forgets, offers(day, RewardPercentage(0.5)))
