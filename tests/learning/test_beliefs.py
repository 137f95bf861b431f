"""What a platform believes of a batch, and value functions of sets as those of a policy."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError, PolicyError, TrainingError
from optkit.learning.beliefs import BelievedValue, believed_requests, believed_workers
from optkit.learning.training import train
from optkit.learning.worker_presence import presence_after
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.preferences import Preferences
from optkit.models.value.request_sets import ZeroSetValue, removal_differences
from optkit.policies import PostDecisionPricing
from optkit.simulation.batch import Batch


@pytest.fixture(scope="module")
def days():
    """Twenty instances of three groups."""
    return scenario("II", seed=0).sample(20, seed=1)


@pytest.fixture(scope="module")
def preferences(days):
    """Some preferences that know the places of these instances, far from the truth."""
    k = days[0].features.shape[1]
    places = [max(int(getattr(one, name).max()) for one in days) + 1 for name in ("pickup", "dropoff")]
    attributes = Attributes(tuple(f"x{i}" for i in range(k)), *places)
    weights = -np.random.default_rng(0).uniform(0, 10, (3, len(attributes.columns)))
    return Preferences(attributes, weights, np.array([1.0, 2.0, 3.0]))


class Pooled:
    """A value function that is not additive: the root of the pooled surplus times one more than the steps left."""

    def __init__(self):
        self.told = []

    def value(self, sets):
        """Value of each set."""
        worth = np.where(sets.member, np.abs(sets.mean_surplus) * (1.0 + sets.steps_left), 0.0)
        return 4.0 * np.sqrt(worth.sum(axis=1))

    def opportunity_cost(self, sets):
        """Differences of values."""
        self.told.append(sets)
        return removal_differences(self.value, sets)


class Nothing:
    """The value function that is 0."""

    def value(self, sets):
        """Zeros."""
        return np.zeros(len(sets))

    def opportunity_cost(self, sets):
        """Zeros."""
        return np.zeros(sets.member.shape)


def test_true_requests_are_the_instances(days):
    """Requests lie end to end, the padding last; utilities are those of the instances."""
    found = believed_requests(Batch.of(days))
    N = sum(one.n_requests for one in days)
    for name in ("reward", "penalty", "arrival", "expiry", "features", "pickup", "dropoff"):
        whole = getattr(found, name)
        assert len(whole) == N + 1
        np.testing.assert_array_equal(whole[:N], np.concatenate([getattr(one, name) for one in days]))
    np.testing.assert_array_equal(found.utility[:, :N], np.concatenate([one.utility for one in days], axis=1))


def test_utilities_are_relative_to_each_instances_own_outside_utility(days):
    """Where rejecting is worth more, requests are worth less, instance by instance and group by group."""
    one, other = (replace(days[i], outside_utility=u) for i, u in ((0, 5.0), (1, [1.0, 2.0, -3.0])))
    found = believed_requests(Batch.of([one, other])).utility
    n = one.n_requests
    np.testing.assert_array_equal(found[:, :n], one.utility - 5.0)
    np.testing.assert_array_equal(found[:, n:-1], other.utility - np.array([[1.0], [2.0], [-3.0]]))


def test_learned_utilities(days, preferences):
    """With a choice model its utilities count, for each group."""
    batch = Batch.of(days)
    found = believed_requests(batch, preferences)
    for group in range(3):
        expected = preferences.utility_of(batch.features, batch.pickup, batch.dropoff, np.array(group))
        np.testing.assert_array_equal(found.utility[group], expected)
    assert (found.utility != believed_requests(batch).utility).any()


def test_workers(days, preferences):
    """Shares are counted, noise is the model's or the truth, presence comes from the steps that saw a worker."""
    batch = Batch.of(days)
    true, learned = believed_workers(batch), believed_workers(batch, preferences)
    groups = np.concatenate([one.worker_group for one in days])
    np.testing.assert_allclose(true.share, [(groups == g).mean() for g in range(3)], atol=1e-15)
    np.testing.assert_array_equal(true.mu, days[0].mu)
    np.testing.assert_array_equal(learned.mu, [1.0, 2.0, 3.0])
    seen = np.zeros((days[0].horizon, len(days)), bool)
    for b, one in enumerate(days):
        seen[one.worker_step, b] = True
    np.testing.assert_array_equal(true.presence, presence_after(seen))
    np.testing.assert_array_equal(learned.presence, true.presence)


def test_short_days_say_nothing_of_later_steps(days):
    """Days that end early are no days without workers: the later steps are those of the long days (noise: 0.05)."""
    long = scenario("II", seed=0, horizon=100).sample(40, seed=3)
    both = believed_workers(Batch.of([*days, *long])).presence
    alone = believed_workers(Batch.of(long)).presence
    assert both.shape == alone.shape
    assert both[50:].mean() == pytest.approx(alone[50:].mean(), abs=0.05)


def test_no_workers_at_all():
    """Without workers nobody is expected, and no group has a share."""
    idle = scenario("I.1", seed=0, worker_rate=0.0).sample(3, seed=1)
    found = believed_workers(Batch.of(idle))
    assert not found.presence.any()
    assert found.share.tolist() == [0.0]


def test_a_pooled_model_speaks_for_all_groups(days, preferences):
    """With one model for all, every group has its noise."""
    pooled = Preferences(preferences.attributes, preferences.weights[:1], np.array([2.5]), pooled=True)
    assert believed_workers(Batch.of(days), pooled).mu.tolist() == [2.5, 2.5, 2.5]
    found = believed_requests(Batch.of(days), pooled).utility
    np.testing.assert_array_equal(found[0], found[2])


@pytest.mark.parametrize("believed", ["true", "learned"])
def test_costs_are_those_of_the_sets_that_would_wait(days, preferences, believed):
    """At every decision: V(R') - V(R' without i) over open requests that do not expire, 0 for those that do."""
    choice = None if believed == "true" else preferences
    adapter, seen = BelievedValue(Pooled(), choice), 0

    def look(state, offer, taken):
        nonlocal seen
        cost = adapter.opportunity_cost(state)
        assert cost.shape == state.offered.shape
        assert not cost[state.expiring | ~state.offered].any()
        requests = believed_requests(state.batch, choice)
        for b in range(len(state.worker)):
            waits = np.flatnonzero(state.offered[b] & ~state.expiring[b])
            worth = np.abs(requests.mean_surplus[state.request[b]]) * (1.0 + state.steps_left[b])
            for i in waits:
                rest = worth[waits].sum() - worth[i]
                expected = 4 * np.sqrt(worth[waits].sum()) - 4 * np.sqrt(max(rest, 0.0))
                assert cost[b, i] == pytest.approx(expected, abs=1e-5)
                seen += 1

    simulate(days[:4], PostDecisionPricing(), observe=look)
    assert seen > 100


def test_nothing_to_wait_for_is_myopic(days):
    """A value function of 0 gives the myopic policy, bit for bit."""
    policy = PostDecisionPricing(value_function=BelievedValue(Nothing()))
    np.testing.assert_array_equal(simulate(days, policy).reward, simulate(days, PostDecisionPricing()).reward)


def test_beliefs_are_worked_out_once_for_each_batch(days):
    """All decisions of a simulation share what is believed; another batch has its own, and so does the first again."""
    value = Pooled()
    policy = PostDecisionPricing(value_function=BelievedValue(value))
    first = simulate(days[:3], policy).reward
    assert len({id(sets.requests) for sets in value.told}) == 1
    simulate(days[3:], policy)
    assert len({id(sets.requests) for sets in value.told}) == 2
    np.testing.assert_array_equal(simulate(days[:3], policy).reward, first)


def test_the_busy_stretch_is_told_to_who_asks(days):
    """A value function that sees busy stretches gets each instance's, counted up to now; others get none."""
    blind, seeing = Pooled(), Pooled()
    seeing.sees_busy = True
    told = []

    def look(state, offer, taken):
        steps = [np.isin(np.arange(state.step + 1), days[i].worker_step)[::-1] for i in state.instance]
        told.append([int(np.argmin(np.append(one, False))) for one in steps])

    for value in (blind, seeing):
        simulate(days, PostDecisionPricing(value_function=BelievedValue(value)), observe=look)
    assert all(sets.busy is None for sets in blind.told)
    assert [sets.busy.tolist() for sets in seeing.told] == told[len(blind.told) :]


class Broken(Nothing):
    """A value function whose costs are what it is told."""

    def __init__(self, cost):
        self.cost = cost

    def opportunity_cost(self, sets):
        """What it is told."""
        return self.cost(sets)


@pytest.mark.parametrize(
    ("cost", "error", "words"),
    [
        (lambda sets: np.full(sets.member.shape, np.nan), TrainingError, "Broken returns .* no numbers at step"),
        (lambda sets: np.full(sets.member.shape, np.inf), TrainingError, "no numbers"),
        (lambda sets: np.zeros(len(sets)), InputError, r"Broken returns opportunity costs of shape \(20,\)"),
        (lambda sets: 0.0, InputError, r"shape \(\)"),
    ],
)
def test_a_broken_value_function_is_named(days, cost, error, words):
    """Costs that are no numbers or not one for each request are an error that names who returned them."""
    crowded = [replace(one, worker_step=np.arange(one.n_workers)).with_noise(0) for one in days]
    crowded = [replace(one, arrival=np.zeros_like(one.arrival)) for one in crowded]
    with pytest.raises(error, match=words):
        simulate(crowded, PostDecisionPricing(value_function=BelievedValue(Broken(cost))))


def test_groups_that_the_preferences_do_not_know(days, preferences):
    """A worker group without preferences is an InputError that names it."""
    few = Preferences(preferences.attributes, preferences.weights[:2], preferences.scale[:2])
    with pytest.raises(InputError, match="group 2 is unknown"):
        believed_requests(Batch.of(days), few)


@pytest.mark.parametrize("fault", [ZeroDivisionError("mine"), SystemExit(0), TypeError()], ids=repr)
def test_a_value_function_of_ones_own_that_fails(days, fault):
    """It is named in one line, with the step, when it is asked for prices, and when it is fitted."""

    class Broken(ZeroSetValue):
        def opportunity_cost(self, sets):
            raise fault

        def fit(self, experience):
            raise fault

    with pytest.raises(PolicyError, match=r"the opportunity_cost of Broken, at step \d+, failed .* in test_beliefs.py"):
        simulate(days, PostDecisionPricing(value_function=BelievedValue(Broken())))
    with pytest.raises(PolicyError, match=r"the fit of Broken failed .* in test_beliefs.py") as caught:
        train(days, Broken(), choice="true")
    assert caught.value.__cause__ is fault


@pytest.mark.parametrize("wrong", [np.zeros((1, 1)), "dear", None])
def test_targets_of_a_value_function_that_answers_wrongly(days, wrong):
    """Values of another shape do not become targets of another shape: InputError, with the function's name."""

    class Mistaken(ZeroSetValue):
        def value(self, sets):
            return np.zeros((len(sets), 1)) if isinstance(wrong, np.ndarray) else wrong

        def fit(self, experience):
            step = next(t for t in range(experience.horizon) if experience.sets(t) is not None)
            experience.target(self, step)

    with pytest.raises(InputError, match="Mistaken returns"):
        train(days, Mistaken(), choice="true")
