"""What nobody knows of the next step: the queue of workers against simulation, and arrivals drawn from a pool."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import Instance, scenario
from optkit.basics.errors import InputError
from optkit.bounds.penalised.foresight import HAND, Foresight, join_requests, surroundings

POOL = scenario("II", seed=0, horizon=12).sample(40, seed=1)
DAY = scenario("II", seed=0, horizon=12).sample(1, seed=2)[0]
THIRDS = np.full(3, 1 / 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"presence": [0.5, 1.2]}, r"presence\[1\] = 1.2"),
        ({"presence": [np.nan]}, r"presence\[0\] is nan"),
        ({"presence": []}, "presence has shape"),
        ({"presence": 0.5}, "presence has shape"),
        ({"presence": [[[0.5]]]}, "presence has shape"),
        ({"presence": [[0.5, 0.6], [0.7, 1.5]]}, r"presence\[1, 1\] = 1.5"),
        ({"presence": ["often"]}, "presence holds text"),
        ({"share": [0.5, 0.6]}, "share adds up to 1.1"),
        ({"share": [1.5, -0.5]}, r"share\[0\]"),
        ({"share": [np.nan, 1.0]}, r"share\[0\]"),
        ({"nothing": 1.5}, "nothing"),
        ({"nothing": np.nan}, "nothing"),
        ({"draws": 0}, "draws = 0"),
        ({"draws": 2.5}, "draws = 2.5"),
        ({"draws": True}, "draws = True"),
        ({"weight": [0.5, 0.5]}, "2 entries for 40"),
        ({"weight": np.full(40, 0.5)}, "weight adds up to 20"),
        ({"weight": np.append(np.zeros(38), [1.5, -0.5])}, r"weight\[38\]"),
        ({"weight": np.full(40, np.nan)}, r"weight\[0\]"),
        ({"weight": np.full(40, 1 / 40), "nothing": 0.5}, "exclude each other"),
        ({"arrivals": [DAY, "a day"]}, "element 1 of the pool is a str"),
    ],
)
def test_what_is_no_distribution_is_refused_in_one_line(change, message):
    with pytest.raises(InputError, match=message) as caught:
        Foresight(**({"presence": [0.5], "share": [1.0], "arrivals": POOL} | change))
    assert "\n" not in str(caught.value)


def test_what_is_given_is_copied():
    given = np.array([0.5, 0.7])
    kept = Foresight(given, [1.0])
    given[0] = 9.0
    assert kept.presence[0] == 0.5


@pytest.mark.parametrize(
    ("foresight", "message"),
    [
        (Foresight([0.5], THIRDS, scenario("II", seed=0, horizon=13).sample(1, seed=1)), "horizon 13, not 12"),
        (Foresight([0.5], THIRDS, scenario("I.1", seed=0, horizon=12).sample(1, seed=1)), "instance 0 .* other groups"),
        (
            Foresight([0.5], THIRDS, [*POOL, replace(DAY, features=DAY.features[:, 1:])]),
            "instance 40 .* other groups or features",
        ),
    ],
)
def test_a_distribution_of_something_else_is_refused(foresight, message):
    with pytest.raises(InputError, match=message):
        surroundings(DAY, foresight, np.random.default_rng(0))


@pytest.mark.parametrize("groups", [1, 4])
def test_shares_of_other_groups_are_refused(groups):
    with pytest.raises(InputError, match=f"share has {groups} groups; the instance to be bounded has 3"):
        Foresight([0.5], np.full(groups, 1 / groups)).of_workers(DAY)


def test_who_has_been_seen_step_by_step():
    """A stretch begins anew after an idle step, and the last probability stands for longer ones."""
    day = replace(DAY, worker_step=[1, 2, 3, 5], worker_group=[2, 0, 1, 2], noise=None, outside_noise=None)
    seen = Foresight([0.1, 0.2, 0.3], THIRDS).of_workers(day)
    assert seen.group.tolist() == [-1, 2, 0, 1, -1, 2, -1, -1, -1, -1, -1, -1]
    assert seen.busy.tolist() == [0, 0, 1, 2, 3, 0, 1, 0, 0, 0, 0, 0]
    assert seen.presence.tolist() == [0.1, 0.1, 0.2, 0.3, 0.3, 0.1, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1]


def test_a_row_for_each_step_is_looked_up_by_step_and_stretch():
    """With rates that change the same stretch means another thing at another step; a day without a row is refused."""
    day = replace(DAY, worker_step=[1, 2, 5], worker_group=[2, 0, 2], noise=None, outside_noise=None)
    table = np.arange(36).reshape(12, 3) / 100
    seen = Foresight(table, THIRDS).of_workers(day)
    assert seen.busy.tolist() == [0, 0, 1, 2, 0, 0, 1, 0, 0, 0, 0, 0]
    assert seen.presence.tolist() == [table[t, min(k, 2)] for t, k in enumerate(seen.busy)]
    same = Foresight(np.tile([0.1, 0.2, 0.3], (12, 1)), THIRDS).of_workers(day)
    assert same.presence.tolist() == Foresight([0.1, 0.2, 0.3], THIRDS).of_workers(day).presence.tolist()
    with pytest.raises(InputError, match="a row for each of 11 steps; the instance to be bounded has 12"):
        Foresight(table[:11], THIRDS).of_workers(day)


def test_all_requests_are_in_one_table_with_utilities_above_rejecting():
    day = replace(DAY, outside_utility=[1.0, -2.0, 0.5])
    table = join_requests([day, POOL[0]])
    n = day.n_requests
    assert np.array_equal(table.utility[:, :n], day.utility - np.array([[1.0], [-2.0], [0.5]]))
    assert np.array_equal(table.utility[:, n:], POOL[0].utility)
    for name in ("reward", "penalty", "arrival", "expiry", "features", "pickup", "dropoff"):
        assert np.array_equal(getattr(table, name), np.concatenate([getattr(day, name), getattr(POOL[0], name)]))


def arrivals_by_step(day):
    """Rewards of what arrives at each step, as sorted tuples."""
    return [tuple(sorted(day.reward[day.arrival == step])) for step in range(day.horizon)]


@pytest.mark.parametrize("nothing", [None, np.exp(-0.5)])
def test_what_might_have_arrived_is_what_arrives_elsewhere_at_that_step(nothing):
    foresight = Foresight([0.5], THIRDS, POOL, nothing, draws=5)
    found = surroundings(DAY, foresight, np.random.default_rng(3))
    pool = [arrivals_by_step(one) for one in POOL]
    for step in range(DAY.horizon):
        assert found.own[step].tolist() == np.flatnonzero(DAY.arrival == step).tolist()
        rows, p = found.drawn[step], found.weight[step]
        assert p.sum() == pytest.approx(1.0, abs=1e-12)
        seen = [tuple(sorted(found.requests.reward[row[row >= 0]])) for row in rows]
        assert all(one in [other[step] for other in pool] for one in seen if one)
        filled = [one for one in seen if one]
        assert len(set(filled)) == len(filled)  # drawn without replacement
        if nothing is not None:
            assert [one for one in seen if not one] == [()]
            assert p[[not one for one in seen]] == pytest.approx([nothing])


@pytest.mark.slow
@pytest.mark.parametrize("nothing", [None, 0.6])
def test_draws_represent_the_pool(nothing):
    """Means over 150 draws of 3 within 4 standard errors of the pool's, whatever comes being weighed by its reward."""
    foresight = Foresight([0.5], THIRDS, POOL, nothing, draws=3)
    step = 4
    of_pool = np.array([one.reward[one.arrival == step].sum() for one in POOL])
    expected = of_pool.mean() if nothing is None else (1 - nothing) * of_pool[of_pool > 0].mean()
    means = []
    for seed in range(150):
        found = surroundings(DAY, foresight, np.random.default_rng(seed))
        reward = np.append(found.requests.reward, 0.0)
        means.append(found.weight[step] @ reward[found.drawn[step]].sum(axis=1))
    assert np.mean(means) == pytest.approx(expected, abs=4 * np.std(means) / np.sqrt(150))
    assert np.std(means) > 0


def test_weights_make_the_pool_all_there_is():
    weight = np.random.default_rng(5).dirichlet(np.ones(40))
    found = surroundings(DAY, Foresight([0.5], THIRDS, POOL, weight=weight), np.random.default_rng(0))
    for step in range(DAY.horizon):
        assert np.array_equal(found.weight[step], weight)
        count = (found.drawn[step] >= 0).sum(axis=1)
        assert count.tolist() == [(one.arrival == step).sum() for one in POOL]


def test_more_draws_than_the_pool_has_are_the_pool():
    found = surroundings(DAY, Foresight([0.5], THIRDS, POOL[:3], draws=99), np.random.default_rng(0))
    assert all(p == pytest.approx(np.full(3, 1 / 3)) for p in found.weight)


def test_without_a_pool_nothing_else_might_have_arrived():
    found = surroundings(DAY, Foresight([0.5], THIRDS), np.random.default_rng(0))
    assert all(rows.shape == (1, 0) and p.tolist() == [1.0] for rows, p in zip(found.drawn, found.weight, strict=True))


def test_a_pool_without_arrivals_cannot_say_what_arrives():
    """Unless it is known that nothing does."""
    none = np.zeros(0, int)
    fields = dict.fromkeys(("arrival", "expiry", "reward", "penalty", "pickup", "dropoff"), none)
    quiet = Instance(
        horizon=12, features=np.zeros((0, DAY.features.shape[1])), worker_step=[3], worker_group=[0],
        utility=np.zeros((3, 0)), mu=DAY.mu, **fields,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="no instance of the pool has arrivals at some step"):
        surroundings(DAY, Foresight([0.5], THIRDS, [quiet], 0.9), rng)
    found = surroundings(DAY, Foresight([0.5], THIRDS, [quiet], 1.0), rng)
    assert all((rows < 0).all() and p.tolist() == [1.0] for rows, p in zip(found.drawn, found.weight, strict=True))


def test_instances_share_nothing_of_a_pool_that_is_large_enough():
    """Independent errors: no instance of the pool stands for the arrivals of two; too small a pool stays whole."""
    large = Foresight([0.5], [1.0], [POOL[i % len(POOL)] for i in range(2 * HAND + 1)], draws=3)
    hands = large.dealt(2)
    assert [len(hand.arrivals) for hand in hands] == [HAND, HAND]
    assert all(hand.draws == 3 for hand in hands)
    assert [one for hand in hands for one in hand.arrivals] == list(large.arrivals[: 2 * HAND])
    assert large.dealt(3) == [large] * 3
    every = Foresight([0.5], [1.0], POOL[:2], weight=[0.4, 0.6])
    assert every.dealt(1) == [every]
    assert every.dealt(0) == []
