"""The queue of workers, with one rate or one for each step: against enumeration, simulation and renewal theory."""

import numpy as np
import pytest
from scipy.stats import poisson

from optkit.basics.errors import InputError
from optkit.bounds.penalised import foresight
from optkit.bounds.penalised.presence import CERTAIN, LARGEST, fifo_presence, presence_at
from optkit.instances.instance import fifo_queue


def paths_of(rates, most=9):
    """Probability of everything that can be seen, by enumeration of up to ``most`` joining at each step."""
    joined = np.indices([most + 1] * len(rates)).reshape(len(rates), -1)
    waiting, seen, p = np.zeros(joined.shape[1], int), np.zeros(joined.shape, bool), np.ones(joined.shape[1])
    for step, rate in enumerate(rates):
        waiting += joined[step]
        seen[step] = waiting > 0
        waiting -= seen[step]
        p *= poisson.pmf(joined[step], rate)
    paths, of = np.unique(seen.T, axis=0, return_inverse=True)
    chance = np.bincount(of.ravel(), weights=p)
    return {tuple(path): chance[i] for i, path in enumerate(paths.tolist())}


def stretch_before(seen):
    """For how many steps in a row, up to the last of these, a worker was seen."""
    return next((k for k, one in enumerate(reversed(seen)) if not one), len(seen))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_the_table_is_that_of_enumerated_queues(seed):
    """Rates of every kind, zero and sudden among them: each history foretells the next step as its stretch does.

    More than nine who join at once have a chance below 1e-8.
    """
    rng = np.random.default_rng(seed)
    rates = rng.choice([0.0, 0.05, 0.3, 0.6, 0.9], 4) * rng.uniform(0.5, 1.0, 4)
    table, paths = fifo_presence(rates), paths_of(rates)
    for step in range(4):
        for history in {seen[:step] for seen in paths}:
            some = sum(p for seen, p in paths.items() if seen[:step] == history)
            busy = sum(p for seen, p in paths.items() if seen[: step + 1] == (*history, True))
            if some > 1e-4:
                assert busy / some == pytest.approx(table[step, stretch_before(history)], abs=1e-4)
        marginal = sum(p for seen, p in paths.items() if seen[step])
        assert marginal == pytest.approx(presence_at(rates)[step], abs=1e-6)


def test_rates_that_change_are_those_of_long_simulations():
    """A quiet morning and a rush: every step and stretch that is seen often enough, within 4.5 standard errors."""
    rng, rates = np.random.default_rng(5), np.repeat([0.2, 1.3, 0.4], [10, 10, 20])
    table = fifo_presence(rates)
    waiting, stretch = np.zeros(40_000, int), np.zeros(40_000, int)
    checked = 0
    for step, rate in enumerate(rates):
        waiting += rng.poisson(rate, waiting.size)
        for k in range(step + 1):
            here = waiting[stretch == k] > 0
            p = table[step, k]
            if here.size > 400:
                checked += 1
                assert here.mean() == pytest.approx(p, abs=4.5 * np.sqrt(p * (1 - p) / here.size))
        stretch = np.where(waiting > 0, stretch + 1, 0)
        waiting -= waiting > 0
    assert checked > 300


@pytest.mark.parametrize("rate", [0.0, 0.1, 0.5, 0.9, 1.7, 30.0, 50.0])
def test_rates_that_do_not_change_are_one_rate(rate):
    """The table repeats the row of one rate; rates that differ by nothing to speak of make the same to rounding."""
    row = fifo_presence(rate, 39)
    assert np.array_equal(fifo_presence(np.full(40, rate)), np.tile(row, (40, 1)))
    nearly = fifo_presence(np.append(np.full(39, rate), rate + 1e-15))
    for step in range(40):
        here = np.minimum(np.arange(40), step)
        assert nearly[step] == pytest.approx(row[here], abs=1e-10)
    assert presence_at(np.full(40, rate)) == pytest.approx(presence_at(rate, 40), abs=1e-15)


@pytest.mark.parametrize("rate", [0.0, 0.2, 1.0, 3.0])
def test_presence_of_workers_is_that_of_a_simulated_queue(rate):
    """Ten thousand queues, within five standard errors."""
    rng, queue = np.random.default_rng(0), np.zeros(10_000, int)
    for p in presence_at(rate, 15):
        queue += rng.poisson(rate, queue.size)
        assert abs((queue > 0).mean() - p) <= 5 * np.sqrt(p * (1 - p) / queue.size) + 1e-12
        queue -= queue > 0


def test_a_shorter_table_leaves_only_stretches_out():
    rates = np.random.default_rng(3).uniform(0, 1.2, 15)
    whole, short = fifo_presence(rates), fifo_presence(rates, 4)
    assert short.shape == (15, 5)
    for step in range(15):
        assert short[step] == pytest.approx(whole[step, :5], abs=1e-13)


def test_the_name_in_foresight_is_the_same_function():
    assert foresight.fifo_presence is fifo_presence


def transitions(rate, runs, horizon, rng):
    """Length of the busy stretch before each step of queues that begin empty, and whether a worker is seen."""
    before, seen = [], []
    for _ in range(runs):
        step, _ = fifo_queue(np.repeat(np.arange(horizon), rng.poisson(rate, horizon)), horizon)
        now = np.zeros(horizon, bool)
        now[step] = True
        stretch = 0
        for one in now:
            before.append(stretch)
            seen.append(one)
            stretch = stretch + 1 if one else 0
    return np.array(before), np.array(seen)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.2, 0.5, 0.9, 1.4])
def test_the_queue_is_that_of_long_simulations(rate):
    """Each stretch's frequency within 4 standard errors: given the stretch, the next step is a toss of its own."""
    before, seen = transitions(rate, 400, 200, np.random.default_rng(0))
    table = fifo_presence(rate)
    checked = 0
    for stretch in range(9):
        here = seen[before == stretch]
        if here.size > 300:
            checked += 1
            p = table[stretch]
            assert here.mean() == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / here.size))
    assert checked >= (4 if rate == 0.2 else 9)


def test_stretches_as_long_as_the_horizon_are_in_the_default_table():
    """At rate 0.95 over 200 steps, the expected and the actual number of workers after 60 busy steps and more."""
    before, seen = transitions(0.95, 300, 200, np.random.default_rng(1))
    long_ = before >= 60
    p = fifo_presence(0.95)[before[long_]]
    assert p.size > 10_000
    assert seen[long_].sum() == pytest.approx(p.sum(), abs=4 * np.sqrt((p * (1 - p)).sum()))


@pytest.mark.parametrize("rate", [0.1, 0.5, 0.8])
def test_a_share_of_the_steps_equal_to_the_rate_is_busy(rate):
    """Renewals: idle steps are 1/(1 - rate) apart, and a stretch lasts beyond k with the product of k + 1 entries."""
    lasts = np.cumprod(fifo_presence(rate, 600))
    # 600 steps leave less than 1e-7 of the busiest queue's stretches.
    assert 1.0 + lasts.sum() == pytest.approx(1.0 / (1.0 - rate), rel=1e-6)


@pytest.mark.parametrize("rate", [0.3, 1.0, 3.0])
def test_the_first_entries_by_hand(rate):
    """After an idle step one must join; after one busy step he had to be alone, and nobody may join."""
    idle = rate * np.exp(-2 * rate) / (1 - np.exp(-rate))
    assert fifo_presence(rate, 1) == pytest.approx([1 - np.exp(-rate), 1 - idle], abs=1e-12)


def test_longer_stretches_and_higher_rates_make_a_worker_likelier():
    tables = np.array([fifo_presence(rate, 30) for rate in (0.0, 0.1, 0.5, 0.99, 1.0, 1.5, 5.0, 20.0, 39.9, 40.1, 1e8)])
    assert (np.diff(tables, axis=0) >= -1e-12).all()
    assert (np.diff(tables, axis=1) >= -1e-12).all()  # rounding of sums of probabilities
    assert ((tables >= 0) & (tables <= 1)).all()
    assert (tables[0] == 0).all()
    assert (tables[-1] == 1).all()
    assert fifo_presence(0.99 * CERTAIN, 3) == pytest.approx(np.ones(4), abs=1e-15)


@pytest.mark.parametrize("rate", [0.5, 1.2])
def test_a_short_table_is_the_beginning_of_a_long_one(rate):
    assert fifo_presence(rate, 4) == pytest.approx(fifo_presence(rate, 80)[:5], abs=1e-12)


@pytest.mark.parametrize(
    ("rate", "longest"), [(-0.1, 5), (np.inf, 5), (np.nan, 5), (0.5, -1), (0.5, 2.5), (0.5, 10**9), ([0.5, 0.6], 10**9)]
)
def test_a_rate_or_length_out_of_range_is_refused(rate, longest):
    with pytest.raises(InputError, match=r"^(rate|longest)( is| =|\[)"):
        fifo_presence(rate, longest)


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        ([0.5, -0.1], r"rate\[1\] = -0.1"),
        ([np.nan, 0.5], r"rate\[0\] is nan"),
        ([], "shape"),
        ([[0.5]], "shape"),
        ("often", "rate holds text"),
        (np.append(np.ones(LARGEST), 0.5), "take longer steps"),
    ],
)
def test_rates_that_are_none_are_refused(rate, message):
    with pytest.raises(InputError, match=message) as caught:
        fifo_presence(rate)
    assert "\n" not in str(caught.value)
