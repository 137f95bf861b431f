"""The penalised bound of single instances: its certificate, its limit, and what it is when nothing is charged."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit import Instance, scenario
from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.arrival_information import arrival_hybrid
from optkit.bounds.arrival.exact import arrival_exact
from optkit.bounds.bound import prove
from optkit.bounds.exact.exact_value import exact_value
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.bounds.penalised.penalized import idle_steps, penalized, penalized_program, tracked_requests
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.models.value.request_sets import ZeroSetValue

seeds = st.integers(0, 2**32 - 1)
bounded = settings(derandomize=True, deadline=None, max_examples=25)

SOURCE = scenario("II", seed=0, horizon=14, request_rate=0.7)
DAYS = SOURCE.sample(12, seed=1)
FORESIGHT = Foresight(fifo_presence(0.5), np.full(3, 1 / 3), SOURCE.sample(60, seed=2), np.exp(-0.7), draws=3)


@pytest.fixture(scope="module")
def value():
    return train(SOURCE.sample(60, seed=3), LinearValue(busy_knots=(0.0, 2.0)), choice="true").value


def bound_of(induction, charge):
    return induction.constant + induction.tables(charge)[0][0]


def nothing_of(requests):
    return np.zeros(1 << requests.size)


@pytest.mark.parametrize("day", DAYS[:4])
def test_without_charges_it_is_the_exact_arrival_information_bound(day):
    n = day.n_requests
    induction = penalized_program(day, np.ones(n, bool), np.zeros(n))
    # Sums of some hundred money, rounded.
    assert bound_of(induction, lambda step, requests: nothing_of(requests)) == pytest.approx(
        arrival_exact(day).value, abs=1e-9
    )


@pytest.mark.parametrize("day", DAYS[:4])
def test_charges_that_are_the_same_for_all_sets_are_subtracted(day):
    n = day.n_requests
    induction = penalized_program(day, np.ones(n, bool), np.zeros(n))
    asked = []

    def charge(step, requests):
        asked.append(step)
        return np.full(1 << requests.size, 3.0 + step)

    free = arrival_exact(day).value
    assert bound_of(induction, charge) == pytest.approx(free - sum(3.0 + step for step in asked), abs=1e-9)
    # Every step after which something can happen is charged once, here or as an idle one.
    assert sorted([*asked, *idle_steps(induction)]) == list(range(-1, day.horizon - 1))


def test_who_foresees_nothing_pays_nothing():
    """Workers and requests that are the same in all instances: it is the arrival-information bound."""
    for day in DAYS[:4]:
        sure = replace(day, worker_step=np.arange(14), worker_group=np.zeros(14, int), noise=None, outside_noise=None)
        foresight = Foresight([1.0], [1.0, 0.0, 0.0], [sure], weight=[1.0])
        assert penalized(sure, ZeroSetValue(), foresight).value == pytest.approx(arrival_exact(sure).value, abs=1e-9)


@pytest.mark.slow
def test_it_is_the_same_for_the_same_seed_only(value):
    bounds = [penalized(DAYS[0], value, FORESIGHT, seed=seed).value for seed in (1, 1, 2)]
    assert bounds[0] == bounds[1] != bounds[2]
    spawned = np.random.SeedSequence(5).spawn(1)[0]
    assert penalized(DAYS[0], value, FORESIGHT, seed=spawned).certificate.check(DAYS[0]).gap < 1e-8


@pytest.mark.slow
def test_the_noise_is_not_looked_at(value):
    day = DAYS[1]
    bound = penalized(day, value, FORESIGHT)
    other = day.with_noise(99)
    assert penalized(other, value, FORESIGHT).value == bound.value
    assert prove(bound, other).bound == prove(bound, day).bound


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0, 2, 12])
@pytest.mark.parametrize("day", DAYS[:2])
def test_every_bound_is_proven_and_reached(day, value, limit):
    """Also that of a hybrid, whose charges are worked out anew; 1e-8 is a few roundings of the money in play."""
    bound = penalized(day, value, FORESIGHT, limit=limit)
    assert abs(prove(bound, day).gap) <= 1e-8
    record = bound.solver
    assert record.method == ("exact" if limit == 12 else "hybrid")
    assert record.details["largest_lattice"] <= limit
    assert record.details["tracked"] == tracked_requests(day, limit).sum()
    assert (bound.certificate.multipliers[bound.certificate.tracked] == 0).all()


@pytest.mark.slow
@bounded
@given(seeds, st.integers(0, 9), st.integers(0, 6), st.floats(0.0, 50.0), st.integers(0, 9))
def test_random_instances_are_proven(random_instance, seed, requests, workers, liking, limit):
    day = random_instance(np.random.default_rng(seed), requests=requests, workers=workers, groups=2)
    day = replace(day, utility=day.utility + liking)
    foresight = Foresight([0.4, 0.7], [0.3, 0.7])
    assert abs(prove(penalized(day, ZeroSetValue(), foresight, limit=limit), day).gap) <= 1e-8


@pytest.mark.parametrize("from_stage", [0, 4])
def test_lowered_tables_do_not_pass(value, from_stage):
    bound = penalized(DAYS[2], value, FORESIGHT)
    tables = tuple(table - 0.1 * (j >= from_stage) for j, table in enumerate(bound.certificate.tables))
    claimed = bound.value - 0.1 if from_stage == 0 else bound.value
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(bound, value=claimed, certificate=replace(bound.certificate, tables=tables)), DAYS[2])


def test_other_arrivals_than_the_seeds_do_not_pass(value):
    """The charges are made anew from the seed: who drew until he liked them is found out."""
    lower, higher = sorted((penalized(DAYS[2], value, FORESIGHT, seed=seed) for seed in (1, 2)), key=lambda b: b.value)
    forged = replace(higher.certificate, tables=lower.certificate.tables)
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(lower, certificate=forged), DAYS[2])


def test_a_certificate_of_another_instance_is_refused(value):
    bound = penalized(DAYS[2], value, FORESIGHT)
    for other in (DAYS[3], replace(DAYS[2], reward=DAYS[2].reward + 1e-9)):
        with pytest.raises(InputError, match="another instance"):
            bound.certificate.check(other)


@pytest.mark.parametrize(
    "change",
    [
        {"multipliers": np.full(DAYS[2].n_requests, -1.0)},
        {"multipliers": np.full(DAYS[2].n_requests, np.nan)},
        {"multipliers": np.zeros(1)},
        {"tables": ()},
        {"limit": 1},
    ],
    ids=["negative", "nan", "too few", "no tables", "other limit"],
)
def test_a_certificate_that_does_not_fit_is_refused(value, change):
    bound = penalized(DAYS[2], value, FORESIGHT, limit=2)
    assert not bound.certificate.tracked.all()
    with pytest.raises(InputError):
        replace(bound.certificate, **change).check(DAYS[2])


@pytest.mark.parametrize("limit", [-1, 2.5, True, "8", None])
def test_a_limit_is_a_whole_number(limit):
    for name in ("limit", "charged"):
        with pytest.raises(InputError, match="limit"):
            penalized(DAYS[0], ZeroSetValue(), FORESIGHT, **{name: limit})


@pytest.mark.slow
@pytest.mark.parametrize("charged", [0, 2])
@pytest.mark.parametrize("day", DAYS[2:4])
def test_fewer_requests_may_be_charged_for_than_are_told_apart(value, day, charged):
    bound = penalized(day, value, FORESIGHT, charged=charged)
    assert bound.solver.method == "exact"
    assert bound.solver.details["largest_lattice"] > charged
    assert abs(prove(bound, day).gap) <= 1e-8
    assert abs(bound.value - penalized(day, value, FORESIGHT).value) > 1e-3
    nothing_waits = bound.certificate.charges.along((day.arrival - 1)[None], np.ones(day.n_requests, bool))[0]
    if charged == 0:
        assert bound.value == pytest.approx(arrival_exact(day).value - nothing_waits, abs=1e-9)


def test_a_distribution_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match="share"):
        penalized(DAYS[0], ZeroSetValue(), Foresight([0.5], [1.0]))


@pytest.mark.parametrize("sizes", [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}])
@pytest.mark.parametrize("horizon", [1, 12])
def test_an_empty_instance_is_worth_its_penalties_less_its_luck(random_instance, sizes, horizon):
    """Exactly so, by the charges of the sets that wait when nobody is served."""
    sizes = {"requests": 3, "workers": 1, "lifetime": 2.0} | sizes
    day = random_instance(np.random.default_rng(7), horizon=horizon, **sizes)
    bound = penalized(day, ZeroSetValue(), Foresight([0.4], [1.0]))
    everybody = np.ones(day.n_requests, bool)
    luck = bound.certificate.charges.along((day.expiry - 1)[None], everybody)[0]
    assert bound.value == pytest.approx(day.penalty.sum() - luck, abs=1e-10)
    assert abs(prove(bound, day).gap) <= 1e-10
    if not day.n_requests:
        assert bound.value == 0.0


def test_one_step_without_luck_is_the_exact_value():
    """A day of one step: what comes before the first decision is charged, so that every path is worth the same."""
    model = SmallModel(
        horizon=1, reward=[30.0], penalty=[-5.0], lifetime=[0], utility=[[-10.0]], mu=[2.0], arrivals=[[0.2, 0.5, 0.3]],
        workers=[0.4, 0.6],
    )  # fmt: skip
    pool = [one_step(model, count, False) for count in (0, 1, 2)]
    foresight = Foresight([0.6], [1.0], pool, weight=[0.2, 0.5, 0.3])
    for count, worker in product((0, 1, 2), (False, True)):
        bound = penalized(one_step(model, count, worker), ZeroSetValue(), foresight)
        assert bound.value == pytest.approx(exact_value(model).value, abs=1e-9)


def one_step(model, count, worker):
    return Instance(
        horizon=1, arrival=[0] * count, expiry=[0] * count, reward=[30.0] * count, penalty=[-5.0] * count,
        features=np.zeros((count, 1)), pickup=[0] * count, dropoff=[0] * count, worker_step=[0] if worker else [],
        worker_group=[0] if worker else [], utility=np.full((1, count), -10.0), mu=model.mu,
    )  # fmt: skip


def two_kinds(horizon, lifetime, groups):
    """Two requests arrive at each step, and a worker of some group, who wants only one of the two kinds."""
    arrival, kind = np.repeat(np.arange(horizon), 2), np.tile([0, 1], horizon)
    return Instance(
        horizon=horizon, arrival=arrival, expiry=np.minimum(arrival + lifetime, horizon - 1),
        reward=np.full(kind.size, 60.0), penalty=np.full(kind.size, -5.0), features=np.zeros((kind.size, 0)),
        pickup=kind, dropoff=0 * kind, worker_step=np.arange(horizon), worker_group=groups,
        utility=np.array([[-10.0, -90.0], [-90.0, -10.0]])[:, kind], mu=[2.0, 2.0],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("horizon", "lifetime"), [(2, 1), (3, 2), (4, 3)])
def test_the_hybrid_is_a_bound_in_the_mean(horizon, lifetime):
    """All groups enumerated. Were requests chosen for tracking with foresight, several of these would lie below."""
    model = SmallModel(
        horizon=horizon, reward=[60.0] * 2, penalty=[-5.0] * 2, lifetime=[lifetime] * 2,
        utility=[[-10.0, -90.0], [-90.0, -10.0]], mu=[2.0, 2.0], joint_arrivals=[((1, 1), 1.0)], workers=[0.0, 1.0],
    )  # fmt: skip
    paths = [two_kinds(horizon, lifetime, groups) for groups in product((0, 1), repeat=horizon)]
    foresight = Foresight([1.0], [0.5, 0.5])

    def mean(**sizes):
        return np.mean([penalized(day, ZeroSetValue(), foresight, **sizes).value for day in paths])

    exact = mean()
    assert exact >= exact_value(model).value - 1e-9
    for limit, charged in ((0, 9), (1, 9), (2, 9), (3, 9), (9, 1), (9, 2), (3, 2), (9, 0)):
        assert mean(limit=limit, charged=charged) >= exact - 1e-9, (limit, charged)


@pytest.mark.slow
def test_the_hybrid_lies_above_the_exact_lattice_in_the_mean(value):
    """Over 6 instances, within 4 standard errors of the difference; with nothing tracked it is far above."""
    means = {}
    whole = np.array([penalized(day, value, FORESIGHT, seed=k).value for k, day in enumerate(DAYS[:6])])
    for limit in (0, 3):
        some = [penalized(day, value, FORESIGHT, seed=k, limit=limit).value for k, day in enumerate(DAYS[:6])]
        more = np.array(some) - whole
        means[limit] = more.mean()
        assert more.mean() >= -4 * more.std(ddof=1) / np.sqrt(more.size)
    assert means[0] > 0.0
    assert penalized(DAYS[0], value, FORESIGHT, seed=0, limit=12).value == whole[0]


@pytest.mark.slow
@pytest.mark.parametrize("day", DAYS[:2])
def test_a_hybrid_that_charges_nothing_is_that_of_the_arrivals(day, value):
    """Nothing tracked: the Lagrangian bound, less charges that are the same for all policies."""
    bound = penalized(day, value, FORESIGHT, limit=0)
    assert not bound.certificate.tracked[day.arrival < day.expiry].any()
    idle = bound.certificate.charges.idle(np.arange(-1, day.horizon - 1))
    free = arrival_hybrid(day, limit=0, multipliers=bound.certificate.multipliers, nonnegative=False).value
    # Requests that never wait are tracked here, at compensations of at least 0.
    assert bound.value + idle <= free + 1e-8
    assert bound.value + idle == pytest.approx(free, rel=0.02)


@bounded
@given(seeds, st.integers(0, 14), st.integers(0, 6), st.integers(1, 11))
def test_tracking_does_not_look_ahead(random_instance, seed, requests, limit, now):
    """Later arrivals and all workers may be changed: who has arrived is tracked as before, and never too many."""
    day = random_instance(np.random.default_rng(seed), requests=requests, lifetime=6.0, groups=2)
    other = random_instance(np.random.default_rng(seed + 1), requests=requests, lifetime=6.0, groups=2)
    past, later = day.arrival <= now, other.arrival > now
    fields = ("arrival", "expiry", "reward", "penalty", "pickup", "dropoff", "features")
    mixed = replace(
        other, mu=day.mu, outside_utility=day.outside_utility, noise=None, outside_noise=None,
        utility=np.concatenate([day.utility[:, past], other.utility[:, later]], axis=1),
        **{name: np.concatenate([getattr(day, name)[past], getattr(other, name)[later]]) for name in fields},
    )  # fmt: skip
    tracked = tracked_requests(day, limit)
    assert np.array_equal(tracked[past], tracked_requests(mixed, limit)[: past.sum()])
    waiting = [(tracked & (day.arrival <= t) & (t < day.expiry)).sum() for t in range(day.horizon)]
    assert max(waiting) <= limit
    alone = [((day.arrival <= t) & (t < day.expiry)).sum() for t in range(day.horizon)]
    assert tracked.all() or max(alone) > limit
