"""The simulator against a slow one written from paper section 2, and the laws that every run obeys."""

import dataclasses
from contextlib import suppress

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse, stats

from optkit import Instance, scenario, simulate
from optkit.basics.errors import InputError, InstanceError, OptkitError, PolicyError
from optkit.models.choice import acceptance_probabilities
from optkit.models.pricing import optimal_prices
from optkit.policies import Formula, PostDecisionPricing, RewardPercentage
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import run


def slow_simulation(instance, price):
    """Simulate one instance step by step; ``price(instance, step, worker, request)`` gives a list of compensations.

    Written from paper section 2 alone: state, choice, penalties, post-decision state. Ties go to the earlier request.
    """
    noise = instance.noise.toarray() if sparse.issparse(instance.noise) else instance.noise
    outside = np.broadcast_to(instance.outside_utility, instance.mu.shape)
    active, accepted, paid, expired = [], [-1] * instance.n_workers, [np.nan] * instance.n_workers, []
    margin = penalty = 0.0
    for step in range(instance.horizon):
        active += [i for i in range(instance.n_requests) if instance.arrival[i] == step]
        for j in range(instance.n_workers):
            if instance.worker_step[j] != step or not active:
                continue
            group = instance.worker_group[j]
            best, most = -1, outside[group] + instance.outside_noise[j]
            for i, c in zip(active, price(instance, step, j, list(active)), strict=True):
                gained = instance.utility[group, i] + c + noise[j, i]
                if gained > most or (best == -1 and gained == most):
                    best, most, cost = i, gained, c
            if best >= 0:
                active.remove(best)
                accepted[j], paid[j] = best, cost
                margin += instance.reward[best] - cost
        for i in [i for i in active if instance.expiry[i] == step]:
            active.remove(i)
            expired.append(i)
            penalty += instance.penalty[i]
    assert active == []
    return accepted, paid, expired, margin, penalty


# Policies twice: as optkit sees them, and for the slow simulator.


def slow_share(instance, step, j, active):
    return [max(0.0, 0.6 * instance.reward[i]) for i in active]


def slow_formula(instance, step, j, active):
    prices = []
    for i in active:
        pay = 0.5 * instance.reward[i] + 7 * instance.features[i, -1] - 0.1 * instance.penalty[i]
        prices.append(max(0.0, pay + (0.3 * instance.reward[i] if instance.expiry[i] == step else 0.0)))
    return prices


def slow_myopic(instance, step, j, active):
    group = instance.worker_group[j]
    value = [instance.reward[i] - (instance.penalty[i] if instance.expiry[i] == step else 0.0) for i in active]
    outside = np.broadcast_to(instance.outside_utility, instance.mu.shape)[group]
    found = optimal_prices(value, instance.utility[group, active], instance.mu[group], outside_utility=outside)
    return found.compensation.tolist()


def slow_odd(instance, step, j, active):
    return [float((7 * i + 5 * step + 3 * j) % 23) for i in active]


class Odd:
    """A user's own policy: prices that differ for every request, step and worker."""

    def __call__(self, state):
        """Prices made from the numbers of the request, the step and the worker."""
        request = state.request - state.batch.request_start[state.instance][:, None]
        worker = state.worker - state.batch.worker_start[state.instance]
        return (7 * request + 5 * state.step + 3 * worker[:, None]) % 23


PAIRS = {
    "share": (RewardPercentage(0.6), slow_share),
    "formula": (Formula(0.5, 7.0, -0.1, 0.3), slow_formula),
    "myopic": (PostDecisionPricing(), slow_myopic),
    "odd": (Odd(), slow_odd),
}


def assert_same(instances, result, price):
    """Compare a simulation with the slow one: choices exactly, payments and totals to rounding.

    Both add the same numbers in another order, so totals may differ by 1e-9 of the money that moves. Prices made of
    sums in another order, the formula's and the myopic ones, may differ by 1e-9 of themselves, others not at all.
    """
    tolerance = 1e-9 if price in (slow_formula, slow_myopic) else 0
    for b, instance in enumerate(instances):
        accepted, paid, expired, margin, penalty = slow_simulation(instance, price)
        J, n = instance.n_workers, instance.n_requests
        assert result.accepted[b, :J].tolist() == accepted
        assert (result.accepted[b, J:] == -1).all()
        np.testing.assert_allclose(result.compensation[b, :J], paid, rtol=tolerance)
        assert np.isnan(result.compensation[b, J:]).all()
        assert np.flatnonzero(result.expired[b, :n]).tolist() == sorted(expired)
        assert not result.expired[b, n:].any()
        scale = 1 + np.abs(instance.reward).sum() + np.abs(instance.penalty).sum()
        assert abs(result.margin[b] - margin) < 1e-9 * scale
        assert abs(result.penalty[b] - penalty) < 1e-9 * scale
        assert result.reward[b] == result.margin[b] + result.penalty[b]


@st.composite
def small_instances(draw, features=2):
    """Draw a small instance of any layout: groups, mixed horizons, crowds, nobody, dense or sparse noise."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    horizon, n, groups = draw(st.integers(1, 9)), draw(st.integers(0, 12)), draw(st.integers(1, 3))
    workers = draw(st.integers(0, horizon))
    arrival = rng.integers(0, horizon, n)
    instance = Instance(
        horizon=horizon,
        arrival=arrival,
        expiry=rng.integers(arrival, horizon),
        reward=rng.uniform(-5, 60, n),
        penalty=-rng.uniform(0, 20, n),
        features=rng.uniform(0, 1, (n, features)),
        pickup=np.zeros(n),
        dropoff=np.zeros(n),
        worker_step=np.sort(rng.choice(horizon, workers, replace=False)),
        worker_group=rng.integers(0, groups, workers),
        utility=rng.uniform(-40, 5, (groups, n)),
        mu=rng.uniform(0.1, 5, groups),
        outside_utility=draw(st.sampled_from([0.0, 4.0])) if draw(st.booleans()) else rng.uniform(-3, 3, groups),
    ).with_noise(rng)
    return thinned(instance) if draw(st.booleans()) else instance


def thinned(instance):
    """Return the same instance with its noise stored sparsely."""
    return dataclasses.replace(instance, noise=sparse.coo_array(instance.noise))


def tiny(**changes):
    """Make one worker who sees two requests at step 1, without noise: a compensation of 10 is just enough."""
    return Instance(
        **{
            "horizon": 3,
            "arrival": [0, 1],
            "expiry": [1, 2],
            "reward": [30.0, 40.0],
            "penalty": [-5.0, -6.0],
            "features": np.zeros((2, 1)),
            "pickup": [0, 0],
            "dropoff": [0, 0],
            "worker_step": [1],
            "worker_group": [0],
            "utility": [[-10.0, -10.0]],
            "mu": [1.0],
            "noise": [[0.0, 0.0]],
            "outside_noise": [0.0],
            **changes,
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize("policy", PAIRS)
@pytest.mark.parametrize("name", ["I.1", "I.2", "I.3", "II"])
def test_scenarios_against_the_slow_simulator(name, policy):
    """On every scenario and for every policy the lockstep simulator and the slow one agree."""
    instances = scenario(name, seed=1).sample(6, seed=2)
    fast, slow = PAIRS[policy]
    assert_same(instances, simulate(instances, fast), slow)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.lists(small_instances(), min_size=1, max_size=5), st.sampled_from(sorted(PAIRS)))
def test_small_instances_against_the_slow_simulator(instances, policy):
    """They agree on any mixture of horizons, groups, crowds, dense and sparse noise, down to nobody at all."""
    fast, slow = PAIRS[policy]
    assert_same(instances, simulate(instances, fast), slow)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.lists(small_instances(), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_laws_of_every_run(instances, seed):
    """Money adds up, each request ends accepted or expired exactly once, and workers take only what is open.

    The tolerance of 1e-9 is for sums of at most 12 amounts below 100, taken in another order.
    """
    rng = np.random.default_rng(seed)
    result = simulate(instances, lambda state: rng.uniform(0, 60, state.offered.shape))
    for b, instance in enumerate(instances):
        took = np.flatnonzero(result.accepted[b] >= 0)
        served = result.accepted[b, took]
        expired = np.flatnonzero(result.expired[b])
        assert sorted([*served, *expired]) == list(range(instance.n_requests))
        assert (took < instance.n_workers).all()
        step = instance.worker_step[took]
        assert ((instance.arrival[served] <= step) & (step <= instance.expiry[served])).all()
        paid = result.compensation[b, took]
        assert np.isfinite(paid).all()
        assert np.isnan(np.delete(result.compensation[b], took)).all()
        assert abs(result.margin[b] - (instance.reward[served] - paid).sum()) < 1e-9
        assert abs(result.penalty[b] - instance.penalty[expired].sum()) < 1e-9
        assert result.reward[b] == result.margin[b] + result.penalty[b]
        assert result.served[b] == took.size


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.lists(small_instances(), min_size=2, max_size=5), st.sampled_from(sorted(PAIRS)))
def test_company_does_not_matter(instances, policy):
    """An instance ends the same alone, in company and in any order; optimal prices to rounding, others to the bit."""
    price = PAIRS[policy][0]
    together = simulate(instances, price)
    backwards = simulate(instances[::-1], price)
    tolerance = 1e-9 if policy == "myopic" else 0
    for b, instance in enumerate(instances):
        alone = simulate(instance, price)
        for other, at in ((together, b), (backwards, len(instances) - 1 - b)):
            assert np.array_equal(alone.accepted[0], other.accepted[at, : instance.n_workers])
            assert np.array_equal(alone.expired[0], other.expired[at, : instance.n_requests])
            paid = other.compensation[at, : instance.n_workers]
            np.testing.assert_allclose(alone.compensation[0], paid, rtol=tolerance)
            np.testing.assert_allclose(alone.reward[0], other.reward[at], rtol=tolerance, atol=tolerance)


def test_sparse_noise_is_the_same_noise():
    """Storing the noise sparsely, for all or for some instances, changes nothing."""
    instances = scenario("II", seed=0).sample(6, seed=3)
    dense = simulate(instances, Odd())
    for changed in ([thinned(i) for i in instances], [thinned(i) if k % 2 else i for k, i in enumerate(instances)]):
        result = simulate(changed, Odd())
        assert np.array_equal(result.accepted, dense.accepted)
        assert np.array_equal(result.reward, dense.reward)


@pytest.mark.slow
def test_frequencies_follow_the_choice_model():
    """Over many draws of the noise, choices come as often as the multinomial logit says, in both groups.

    Pearson's chi-square over three requests and the rejection, 20,000 draws in ten days of so many pairs that their
    noise is sparse; it must not reject at 1e-6.
    """
    T = 2_000
    offer, utility = np.array([9.0, 12.0, 14.0]), np.array([[-8.0, -12.0, -15.0], [-11.0, -10.0, -13.0]])
    mu, outside = np.array([1.0, 4.0]), np.array([0.5, -1.0])
    day = Instance(
        horizon=T,
        arrival=np.repeat(np.arange(T), 3),
        expiry=np.repeat(np.arange(T), 3),
        reward=np.ones(3 * T),
        penalty=np.zeros(3 * T),
        features=np.zeros((3 * T, 1)),
        pickup=np.zeros(3 * T),
        dropoff=np.zeros(3 * T),
        worker_step=np.arange(T),
        worker_group=np.arange(T) % 2,
        utility=np.tile(utility, T),
        mu=mu,
        outside_utility=outside,
    )
    days = [day.with_noise(seed) for seed in range(10)]
    assert all(sparse.issparse(one.noise) for one in days)
    result = simulate(days, lambda state: np.tile(offer, (len(state.row), 1)))
    taken = np.where(result.accepted < 0, 3, result.accepted % 3)
    for d in (0, 1):
        chance, reject = acceptance_probabilities(offer, utility[d], mu[d], outside_utility=outside[d])
        observed = np.bincount(taken[:, day.worker_group == d].ravel(), minlength=4)
        assert stats.chisquare(observed, 10_000 * np.append(chance, reject)).pvalue > 1e-6


@pytest.mark.parametrize(("pay", "accepted"), [(10.0, 1), (10.0 - 1e-9, -1), (10.0 + 1e-9, 1)])
def test_an_indifferent_worker_accepts(pay, accepted):
    """A worker for whom accepting and rejecting are worth exactly the same accepts."""
    result = simulate(tiny(), lambda state: np.array([[0.0, pay]]))
    assert result.accepted.tolist() == [[accepted]]


def test_a_tie_goes_to_the_earlier_request():
    """Between two equally good requests the worker takes the one that arrived first."""
    assert simulate(tiny(), lambda state: np.full((1, 2), 11.0)).accepted.tolist() == [[0]]
    swapped = tiny(arrival=[1, 0])
    assert simulate(swapped, lambda state: np.full((1, 2), 11.0)).accepted.tolist() == [[1]]


def test_one_run_by_hand():
    """Serving the second request for 12 earns 40 - 12; the first expires and costs 5."""
    result = simulate(tiny(), lambda state: np.array([[0.0, 12.0]]))
    assert (result.reward[0], result.margin[0], result.penalty[0]) == (23.0, 28.0, -5.0)
    assert result.expired.tolist() == [[True, False]]
    assert result.to_frame().to_dict("records") == [{"run": 0, "worker": 0, "request": 1, "compensation": 12.0}]


def test_serving_at_the_last_step_spares_the_penalty():
    """A request served at its expiry costs no penalty; one whose worker comes a step later expires."""
    assert simulate(tiny(), lambda state: np.array([[12.0, 0.0]])).reward.tolist() == [30 - 12 - 6]
    late = tiny(expiry=[0, 2])
    assert simulate(late, lambda state: np.full(state.offered.shape, 99.0)).accepted.tolist() == [[1]]


def test_nothing_offered_is_no_decision():
    """Steps without a worker or without open requests do not ask the policy."""

    def never(state):
        raise AssertionError("asked")

    assert (
        simulate(tiny(worker_step=[], worker_group=[], noise=np.zeros((0, 2)), outside_noise=[]), never).reward == -11
    )
    assert simulate(tiny(arrival=[2, 2], expiry=[2, 2]), never).reward == -11


def test_what_a_policy_sees():
    """The state holds the open requests of every instance with their characteristics, padded where there are fewer."""
    two = [tiny(), tiny(arrival=[1, 2], expiry=[2, 2], features=[[3.0], [4.0]], pickup=[7, 8])]
    seen = []
    simulate(two, lambda state: seen.append(state) or np.zeros(state.offered.shape))
    (state,) = seen
    assert state.step == 1
    assert state.instance.tolist() == state.row.tolist() == state.worker.tolist() == [0, 1]
    assert state.offered.tolist() == [[True, True], [True, False]]
    assert state.request[state.offered].tolist() == [0, 1, 2]
    assert state.reward[state.offered].tolist() == [30.0, 40.0, 30.0]
    assert state.penalty[state.offered].tolist() == [-5.0, -6.0, -5.0]
    assert state.features[state.offered].tolist() == [[0.0], [0.0], [3.0]]
    assert state.pickup[state.offered].tolist() == [0, 0, 7]
    assert state.dropoff[state.offered].tolist() == [0, 0, 0]
    assert state.steps_left[state.offered].tolist() == [0, 1, 1]
    assert state.expiring.tolist() == [[True, False], [False, False]]
    assert state.utility[state.offered].tolist() == [-10.0] * 3
    assert state.mu.tolist() == [1.0, 1.0]
    assert state.outside_utility.tolist() == [0.0, 0.0]
    assert state.group.tolist() == [0, 0]


def bad_at(value):
    """A policy that offers ``value`` for the second request that it sees in the last row."""

    def price(state):
        offer = np.ones(state.offered.shape)
        offer[-1, 1] = value
        return offer

    return price


@pytest.mark.parametrize("value", [np.nan, -1.0, -1e-300, np.inf, -np.inf, 1e308])
def test_an_infeasible_price_is_named(value):
    """NaN, infinity or a negative price is a PolicyError that names price, request, instance and step."""
    bystander = tiny(worker_step=[2])
    with pytest.raises(PolicyError) as caught:
        simulate([bystander, tiny()], bad_at(value))
    message = str(caught.value)
    for words in (f"offers {value}", "request 1 ", "instance 1 ", "step 1", "finite number >= 0"):
        assert words in message
    assert "\n" not in message


@pytest.mark.parametrize("value", [np.nan, -1.0, np.inf])
def test_what_stands_in_the_padding_is_ignored(value):
    """A policy may put anything where nothing is offered."""
    two = [tiny(), tiny(arrival=[1, 2], expiry=[2, 2])]
    result = simulate(two, lambda state: np.where(state.offered, 11.0, value))
    assert result.accepted.tolist() == [[0], [0]]


@pytest.mark.parametrize(
    "policy",
    [
        lambda state: None,
        lambda state: 5.0,
        lambda state: [1.0, 2.0],
        lambda state: np.ones((2, 2)),
        lambda state: np.ones((1, 2, 1)),
        lambda state: "free",
        lambda state: [["free", "cheap"]],
        lambda state: [[1.0], [2.0, 3.0]],
        lambda state: {"price": 1},
        lambda state: np.ones((1, 2)) * 1j,
        lambda state: np.array([["1", "2"]]),
    ],
    ids=["None", "number", "flat", "rows", "3-D", "word", "words", "ragged", "dict", "complex", "digits"],
)
def test_a_policy_that_returns_something_else(policy):
    """Anything but an array of numbers, one per decision and request, is a PolicyError of one line."""
    with pytest.raises(PolicyError, match=r"the policy <lambda> returned") as caught:
        simulate(tiny(), policy)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, OptkitError)


def test_lists_and_integers_are_numbers():
    """A policy may return nested lists or integers."""
    assert simulate(tiny(), lambda state: [[0, 11]]).compensation.tolist() == [[11.0]]


def spoil(name):
    """A policy that writes into what it was shown, and offers too little for anybody."""

    def price(state):
        array = getattr(state, name)
        array[...] = 1 if array.dtype != bool else ~array
        return np.ones(state.offered.shape)

    return price


@pytest.mark.parametrize("name", ["reward", "penalty", "features", "pickup", "mu"])
def test_a_policy_that_writes_into_characteristics_changes_nothing(name):
    """A policy that scribbles over rewards, penalties or features does not change what is earned."""
    with suppress(PolicyError):  # it may also be stopped
        assert simulate(tiny(), spoil(name)).reward.tolist() == [-11.0]


@pytest.mark.parametrize("name", ["utility", "offered", "request", "worker", "outside_utility"])
def test_a_policy_cannot_bend_the_world(name):
    """A policy that writes into the state, say ``state.utility += 1``, is stopped: workers keep their preferences."""
    with pytest.raises(PolicyError, match="read-only"):
        simulate(tiny(), spoil(name))


class SilentError(Exception):
    """An exception that cannot even be shown."""

    def __str__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (ZeroDivisionError("mine"), "ZeroDivisionError: mine"),
        (ValueError("two\nlines"), "ValueError: two lines"),
        (KeyError(), "KeyError"),
        (StopIteration(3), "StopIteration: 3"),
        (SystemExit(0), r"it called sys.exit\(0\)"),
        (GeneratorExit(), "GeneratorExit"),
        (OSError(2, "gone"), "FileNotFoundError: .Errno 2. gone"),
        (RuntimeError("x" * 9999), "RuntimeError: x{300} [.]{3}"),
        (SilentError(), "SilentError"),
    ],
    ids=lambda x: type(x).__name__,
)
def test_a_policy_that_fails(fault, said):
    """It is named in one line, with the step, the reason and the place; its own exception is the cause."""

    def broken(state):
        raise fault

    with pytest.raises(
        PolicyError, match=f"the policy broken, at step 1, failed .{said}. in test_simulator.py, line"
    ) as e:
        simulate(tiny(), broken)
    assert e.value.__cause__ is fault
    assert "\n" not in str(e.value)
    assert len(str(e.value)) < 500


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), MemoryError(), InputError("a weight is wrong")], ids=repr)
def test_what_is_not_the_policys_to_answer_for(fault):
    """Ctrl-C, want of memory and errors of the kit come through as they are."""

    def broken(state):
        raise fault

    with pytest.raises(type(fault)) as caught:
        simulate(tiny(), broken)
    assert caught.value is fault


class NoArray:
    """What says that it is an array, and is not."""

    def __array__(self, *args, **more):
        raise TypeError("no")


def test_an_answer_that_fails_when_it_is_looked_at():
    """So is what the policy returned."""
    with pytest.raises(PolicyError, match="the policy <lambda>, at step 1, failed"):
        simulate(tiny(), lambda state: NoArray())


def test_observe():
    """The observer sees each decision once, in order of steps, with the offers and the choices that were made."""
    instances = scenario("I.1", seed=0).sample(4, seed=5)
    log, steps = [], []

    def watch(state, offer, taken):
        assert offer.shape == state.offered.shape
        assert (offer[~state.offered] == 0).all()
        assert state.offered[taken >= 0, taken[taken >= 0]].all()
        steps.append(state.step)
        for r in np.flatnonzero(taken >= 0):
            b = state.instance[r]
            request = state.request[r, taken[r]] - state.batch.request_start[b]
            worker = state.worker[r] - state.batch.worker_start[b]
            log.append((int(b), int(worker), int(request), float(offer[r, taken[r]])))

    def price(state):
        return np.where(state.offered, 0.6 * state.reward, 99.0)

    result = simulate(instances, price, observe=watch)
    assert steps == sorted(set(steps))
    assert sorted(log) == list(result.to_frame().itertuples(index=False, name=None))
    assert np.array_equal(simulate(instances, RewardPercentage(0.6)).reward, result.reward)


def test_observe_sees_rejections():
    """A decision that ends in a rejection is observed as column -1."""
    seen = []
    simulate(tiny(), RewardPercentage(0.0), observe=lambda state, offer, taken: seen.append(taken.tolist()))
    assert seen == [[-1]]


def test_a_batch_can_be_used_again():
    """A Batch serves several policies, with the results of the list it was made from."""
    instances = scenario("II", seed=0).sample(5, seed=5)
    batch = Batch.of(instances)
    assert Batch.of(batch) is batch
    for policy, _ in PAIRS.values():
        assert np.array_equal(simulate(batch, policy).reward, simulate(instances, policy).reward)
    assert len(batch) == 5


def test_several_runs_share_an_instance():
    """run() takes runs in any order, several through one instance, told apart by state.row."""
    instances = scenario("I.1", seed=0).sample(3, seed=5)
    share = np.array([0.5, 0.6, 0.7, 0.8])
    which = np.array([2, 0, 2, 1])
    result = run(Batch.of(instances), lambda state: share[state.row][:, None] * state.reward, which)
    for r in range(4):
        alone = simulate(instances[which[r]], RewardPercentage(share[r]))
        assert result.reward[r] == alone.reward[0]
        assert np.array_equal(result.accepted[r, : alone.accepted.shape[1]], alone.accepted[0])


def test_one_instance_or_any_iterable():
    """One instance, a list, a tuple and a generator are all taken."""
    instances = scenario("I.1", seed=0).sample(2, seed=5)
    expected = simulate(instances, RewardPercentage(0.6)).reward
    for given_as in (tuple(instances), iter(instances)):
        assert np.array_equal(simulate(given_as, RewardPercentage(0.6)).reward, expected)
    assert simulate(instances[0], RewardPercentage(0.6)).reward.tolist() == expected[:1].tolist()


def test_no_instances():
    """No instances give an empty result, as an empty array gives an empty sum."""
    result = simulate([], RewardPercentage(0.5))
    assert result.reward.shape == (0,)
    assert result.accepted.shape == (0, 0)
    assert len(result.to_frame()) == 0


def test_instances_that_cannot_be_simulated():
    """What is no instance, has no noise or other features is refused, with its place in the list."""
    with pytest.raises(InputError, match="element 1 is a str"):
        simulate([tiny(), "day"], RewardPercentage(0.5))
    with pytest.raises(InstanceError, match=r"instance 1 .*with_noise"):
        simulate([tiny(), tiny(noise=None, outside_noise=None)], RewardPercentage(0.5))
    with pytest.raises(InputError, match=r"\[1, 2\] features"):
        simulate([tiny(), tiny(features=np.zeros((2, 2)))], RewardPercentage(0.5))


def test_a_number_is_no_list_of_instances():
    """Passing something that is no list of instances is an InputError."""
    with pytest.raises(InputError):
        simulate(42, RewardPercentage(0.5))


@pytest.mark.parametrize("name", ["I.1", "II"])
def test_every_offer_is_kept_if_asked_for(name):
    """Against an observer's loop: who was offered what, and took it or not; identifiers join it to one's tables."""
    days = scenario(name, seed=0, horizon=10).sample(3, seed=1)
    days = [dataclasses.replace(day, request_id=[f"r{i}" for i in range(day.n_requests)]) for day in days]
    seen = []

    def watch(state, offer, taken):
        for b in range(len(state.row)):
            for w in np.flatnonzero(state.offered[b]):
                instance = state.instance[b]
                request = state.request[b, w] - state.batch.request_start[instance]
                seen.append((state.row[b], state.step, state.group[b], f"r{request}", offer[b, w], taken[b] == w))

    done = simulate(days, RewardPercentage(0.6), observe=watch, keep_offers=True)
    found = done.to_frame(rejected=True)
    columns = ["run", "step", "group", "request_id", "compensation", "accepted"]
    assert sorted(map(tuple, found[columns].to_numpy(object).tolist())) == sorted(seen)
    taken = found[found["accepted"]][["run", "worker", "request", "compensation"]].reset_index(drop=True)
    plain = done.to_frame()[["run", "worker", "request", "compensation"]]
    pd.testing.assert_frame_equal(taken.sort_values(["run", "worker"], ignore_index=True), plain)
    with pytest.raises(InputError, match="keep_offers=True"):
        simulate(days, RewardPercentage(0.6)).to_frame(rejected=True)
