"""Visited sets and Lemma 1's targets, against a loop over instances and sets written from the definitions."""

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.models.pricing import optimal_prices
from optkit.models.value import LinearValue
from optkit.models.value.experience import Experience, Workers
from optkit.models.value.request_sets import KnownRequests, RequestSets, removal_differences


class Pooled:
    """A value function that is not additive: 5 times the root of the pooled surplus times steps left, by step."""

    def value(self, sets):
        """Value of each set."""
        weight = np.abs(sets.mean_surplus) * np.maximum(sets.steps_left, 0.0)
        return (5.0 - 0.1 * sets.step) * np.sqrt(np.where(sets.member, weight, 0.0).sum(axis=1))

    def opportunity_cost(self, sets):
        """Differences of values."""
        return removal_differences(self.value, sets)


class Busy(Pooled):
    """The same, but a tenth more for each step in a row that has seen a worker."""

    sees_busy = True

    def value(self, sets):
        """Value of each set."""
        return super().value(sets) * (1.0 + 0.1 * sets.busy)


class Nothing:
    """The value function that is 0."""

    def value(self, sets):
        """Zeros."""
        return np.zeros(len(sets))

    def opportunity_cost(self, sets):
        """Zeros."""
        return np.zeros(sets.member.shape)


def random_experience(seed, groups=1, instances=6, horizon=6, discount=1.0):
    """A batch of instances with up to eleven requests each, of which some are served early."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 12, instances)
    owner = np.repeat(np.arange(instances), counts)
    N = owner.size
    arrival = np.concatenate([rng.integers(0, horizon, N), [0]])
    expiry = np.minimum(arrival + rng.integers(0, 6, N + 1), horizon - 1)
    expiry[-1] = 0
    last = np.where(rng.random(N) < 0.7, expiry[:-1] - 1, rng.integers(arrival[:-1] - 1, expiry[:-1] + 1) - 1)
    requests = KnownRequests(
        reward=np.append(rng.uniform(0, 30, N), 0.0),
        penalty=np.append(-rng.uniform(0, 10, N), 0.0),
        arrival=arrival,
        expiry=expiry,
        utility=np.concatenate([rng.uniform(-20, 5, (groups, N)), np.zeros((groups, 1))], axis=1),
        features=np.zeros((N + 1, 0)),
        pickup=np.zeros(N + 1, int),
        dropoff=np.zeros(N + 1, int),
    )
    share = rng.dirichlet(np.ones(groups))
    workers = Workers(rng.random((horizon, 4)), share, rng.uniform(0.5, 4.0, groups))
    return Experience(requests, workers, owner, last, rng.integers(0, 9, (horizon, instances)), discount)


def worth(experience, step, members):
    """The value function above of one set, by its definition."""
    r = experience.requests
    total = sum(abs(r.mean_surplus[i]) * (r.expiry[i] - step) for i in members)
    return (5.0 - 0.1 * step) * np.sqrt(total)


def lemma_1(experience, step, open_, busy, sees_busy):
    """Expected optimal value of the open requests of one instance at a step (paper section 3.1, Lemma 1)."""
    r, w, discount = experience.requests, experience.workers, experience.discount
    waits = [i for i in open_ if r.expiry[i] > step]
    presence = w.presence[step, min(busy, w.presence.shape[1] - 1)]
    # One more busy step with a worker, none without.
    then = 1.0 + 0.1 * (busy + 1) if sees_busy else 1.0
    mean = presence * then + (1.0 - presence)
    stay = sum(r.penalty[i] for i in open_ if r.expiry[i] == step) + discount * mean * worth(experience, step, waits)
    values = []
    for i in open_:
        rest = [j for j in waits if j != i]
        spared = r.penalty[i] if r.expiry[i] == step else 0.0
        cost = worth(experience, step, waits) - worth(experience, step, rest)
        values.append(r.reward[i] - spared - discount * then * cost)
    profit = 0.0
    if open_:
        for group, share in enumerate(w.share):
            profit += share * float(optimal_prices(values, r.utility[group][open_], w.mu[group]).profit)
    return stay + presence * profit


def visited(experience, step):
    """Members and next arrivals of every instance in which somebody waits after the step."""
    r, found = experience.requests, []
    for b in range(experience.busy.shape[1]):
        own = np.flatnonzero(experience.owner == b).tolist()
        waiting = [i for i in own if r.arrival[i] <= step <= experience.last[i]]
        if waiting and step + 1 < experience.horizon:
            found.append((b, waiting, [i for i in own if r.arrival[i] == step + 1]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("discount", [1.0, 0.6, 0.0])
@pytest.mark.parametrize("groups", [1, 3])
@pytest.mark.parametrize("value", [Pooled(), Busy()], ids=["blind", "seeing"])
@pytest.mark.parametrize("seed", range(2))
def test_targets_equal_a_slow_loop(seed, value, groups, discount):
    """Targets and their differences, set by set and request by request (the optimum's own accuracy: 1e-9)."""
    experience, sees = random_experience(seed, groups, discount=discount), isinstance(value, Busy)
    seen = 0
    for step in range(experience.horizon):
        expected = visited(experience, step)
        sets = experience.sets(step)
        if not expected:
            assert sets is None
            continue
        assert len(sets) == len(expected)
        target, difference = experience.target(value, step), experience.target_differences(value, step)
        assert difference.shape == sets.member.shape
        assert not difference[~sets.member].any()
        for row, (b, waiting, new) in enumerate(expected):
            assert sorted(sets.index[row, sets.member[row]]) == waiting
            assert sets.busy[row] == experience.busy[step, b]
            whole = lemma_1(experience, step + 1, [*waiting, *new], experience.busy[step, b], sees)
            assert target[row] == pytest.approx(whole, abs=1e-9)
            for column in np.flatnonzero(sets.member[row]):
                rest = [i for i in waiting if i != sets.index[row, column]]
                without = lemma_1(experience, step + 1, [*rest, *new], experience.busy[step, b], sees)
                assert difference[row, column] == pytest.approx(whole - without, abs=1e-9)
                seen += 1
    assert seen > 20


class Slow:
    """Another value function without its quick ways."""

    sees_busy = True

    def __init__(self, other):
        self.value, self.opportunity_cost = other.value, other.opportunity_cost


class Halved(LinearValue):
    """A value function that inherits a quick way which is not its own."""

    def value(self, sets):
        """Half of what was fitted."""
        return super().value(sets) / 2.0

    def opportunity_cost(self, sets):
        """Half of what was fitted."""
        return super().opportunity_cost(sets) / 2.0


class Watched(LinearValue):
    """A value function that counts how often its quick way is taken."""

    taken = 0

    def opportunity_cost_without(self, sets, row, column):
        """Count, and go it."""
        self.taken += 1
        return super().opportunity_cost_without(sets, row, column)


@pytest.mark.slow
@pytest.mark.parametrize("discount", [1.0, 0.6])
@pytest.mark.parametrize("groups", [1, 3])
@pytest.mark.parametrize("kind", [LinearValue, Halved, Watched])
def test_targets_by_the_quick_way(kind, groups, discount):
    """They are those of a value function that knows no quick way; one of a parent's is not taken (rounding: 1e-9)."""
    experience = random_experience(3, groups, instances=15, discount=discount)
    fitted = kind(busy_knots=(0.0, 2.0, 5.0), by_group=True).fit(experience)
    for step in range(experience.horizon - 1):
        expected = experience.target_differences(Slow(fitted), step)
        np.testing.assert_allclose(experience.target_differences(fitted, step), expected, atol=1e-9)
        assert np.abs(expected).max() > 1.0
    assert getattr(fitted, "taken", 1) > 0


class Plain:
    """A term without its quick way."""

    def __init__(self, other):
        self.size, self.value, self.opportunity_cost = other.size, other.value, other.opportunity_cost
        self.differences = other.differences


def test_a_term_without_a_quick_way():
    """A value function with such a term, beside one that has it, is fitted as with two that have it (1e-9 money)."""
    experience = random_experience(4, instances=40)
    terms = LinearValue(by_group=True).fit(experience).terms_
    mixed = LinearValue(terms=[Plain(terms[0]), terms[1]]).fit(experience)
    np.testing.assert_allclose(mixed.coef_, LinearValue(terms=terms).fit(experience).coef_, atol=1e-9)
    assert mixed.coef_.any()


def test_no_future_leaves_one_step():
    """With a value of 0 the target is what one step is worth: expected profit, and penalties of what expires."""
    experience = random_experience(1)
    step = next(t for t in range(experience.horizon) if experience.sets(t) is not None)
    sure = Workers(np.ones((experience.horizon, 1)), np.ones(1), np.array([2.0]))
    never = Workers(np.zeros((experience.horizon, 1)), np.ones(1), np.array([2.0]))
    parts = (experience.owner, experience.last, experience.busy)
    gain = Experience(experience.requests, sure, *parts).target(Nothing(), step)
    lost = Experience(experience.requests, never, *parts).target(Nothing(), step)
    r = experience.requests
    for row, (_, waiting, new) in enumerate(visited(experience, step)):
        open_ = np.array([*waiting, *new])
        expired = np.where(r.expiry[open_] == step + 1, r.penalty[open_], 0.0)
        assert lost[row] == pytest.approx(expired.sum(), abs=1e-12)
        one = optimal_prices(r.reward[open_] - expired, r.utility[0][open_], 2.0)
        assert gain[row] - lost[row] == pytest.approx(float(one.profit), abs=1e-9)


def test_a_group_that_never_comes_does_not_count():
    """Utilities and noise of a group with share 0 change no target."""
    one = random_experience(2, groups=2)
    step = next(t for t in range(one.horizon) if one.sets(t) is not None)

    def target(mu, utility):
        workers = Workers(one.workers.presence, np.array([1.0, 0.0]), np.array([1.5, mu]))
        r = one.requests
        shifted = r.utility + np.array([[0.0], [utility]])
        places = (r.features, r.pickup, r.dropoff)
        requests = KnownRequests(r.reward, r.penalty, r.arrival, r.expiry, shifted, *places)
        return Experience(requests, workers, one.owner, one.last, one.busy).target(Nothing(), step)

    np.testing.assert_array_equal(target(1.0, 0.0), target(7.0, 30.0))


def test_nobody_waits():
    """No sets where nobody waits, nor after the last decision; a target there is an InputError."""
    experience = random_experience(3)
    empty = Experience(
        experience.requests, experience.workers, experience.owner, experience.requests.arrival[:-1] - 1, experience.busy
    )
    assert [empty.sets(step) for step in range(empty.horizon)] == [None] * empty.horizon
    assert experience.sets(experience.horizon - 1) is None
    for one in (empty.target, empty.target_differences):
        with pytest.raises(InputError, match="nobody waited after step 0"):
            one(Nothing(), 0)
    assert empty.horizon == 6


def test_no_requests_at_all():
    """A batch without requests visits nothing."""
    experience = random_experience(0, instances=1)
    none = np.zeros(0, dtype=int)
    zeros = np.zeros(1, int)
    requests = KnownRequests(np.zeros(1), np.zeros(1), zeros, zeros, np.zeros((1, 1)), np.zeros((1, 0)), zeros, zeros)
    empty = Experience(requests, experience.workers, none, none, experience.busy)
    assert [empty.sets(step) for step in range(6)] == [None] * 6


def test_members_have_time_left():
    """Every member of a visited set can still be served at the next step, and padding is the last entry or new."""
    for seed in range(5):
        experience = random_experience(seed)
        for step in range(experience.horizon):
            sets = experience.sets(step)
            if sets is not None:
                assert isinstance(sets, RequestSets)
                assert (sets.steps_left[sets.member] >= 1).all()
                assert sets.member.any(axis=1).all()
                assert sets.step == step
