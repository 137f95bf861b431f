"""Charges linear in openness: against the definition, and zero in the mean by enumeration."""

from itertools import product

import numpy as np
import pytest

from optkit import Instance
from optkit.basics.errors import InputError
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.linear_charges import LinearCharges

PRESENCE, SHARE, RATE = np.array([0.3, 0.6, 0.8]), np.array([0.4, 0.6]), 0.7
SURPLUS, TIME = np.array([10.0, 40.0]), np.array([1.0, 2.0, 4.0])
UTILITY = np.array([[-12.0, -3.0], [4.0, -20.0]])


def day_of(groups, arrivals):
    """Requests (step, kind, lifetime), and the workers' groups step by step, -1 for none."""
    arrival, kind, life = (np.array(column, int) for column in zip(*arrivals, strict=True)) if arrivals else [[]] * 3
    kind, arrival = np.asarray(kind, int), np.asarray(arrival, int)
    seen = np.flatnonzero(np.array(groups) >= 0)
    return Instance(
        horizon=len(groups), arrival=arrival, expiry=np.minimum(arrival + np.asarray(life, int), len(groups) - 1),
        reward=np.array([30.0, 22.0])[kind], penalty=np.array([-6.0, -1.0])[kind], features=np.zeros((kind.size, 0)),
        pickup=kind, dropoff=0 * kind, worker_step=seen, worker_group=np.array(groups)[seen],
        utility=UTILITY[:, kind], mu=[2.0, 5.0], outside_utility=[0.0, 1.5],
    )  # fmt: skip


def made(seed=0, rate=RATE, scale=10.0):
    theta = np.random.default_rng(seed).normal(0, scale, (1 if rate is None else 2, 2, 3))
    return LinearCharges(theta, SURPLUS, TIME, Foresight(PRESENCE, SHARE), rate)


def hat(x, knots):
    """Interpolation of each unit vector, by NumPy's own."""
    return np.array([np.interp(x, knots, unit) for unit in np.eye(knots.size)])


def by_hand(charges, day, i, step):
    """Charge of a request that is open after a step, by the definition."""
    stretch = 0
    while step - stretch >= 0 and step - stretch in day.worker_step:
        stretch += 1
    p = PRESENCE[min(stretch, 2)]
    surplus = [day.reward[i] - day.penalty[i] + day.utility[d, i] - day.outside_by_group[d] for d in range(2)]
    shape = [hat(s, SURPLUS) for s in surplus]
    mean = SHARE @ shape
    came = np.zeros(2)
    if step + 1 in day.worker_step:
        came = shape[day.worker_group[np.searchsorted(day.worker_step, step + 1)]]
    left = hat(day.expiry[i] - step, TIME)
    total = charges.theta[0] @ left @ (came - p * mean)
    if charges.request_rate is not None:
        total += ((day.arrival == step + 1).sum() - charges.request_rate) * (mean @ charges.theta[1] @ left)
    return total


DAY = day_of([0, 0, -1, 1, 0, -1, 1], [(0, 0, 3), (1, 1, 2), (1, 0, 5), (2, 1, 0), (4, 1, 2), (4, 0, 1)])


@pytest.mark.parametrize("rate", [RATE, None])
def test_charges_are_their_definition(rate):
    """Every request alone, open after one step more or less."""
    charges = made(rate=rate)
    for i in range(DAY.n_requests):
        total = 0.0
        for step in range(DAY.arrival[i] - 1, DAY.expiry[i]):
            last = np.where(np.arange(DAY.n_requests) == i, step, DAY.arrival - 1)
            total += by_hand(charges, DAY, i, step) if step >= DAY.arrival[i] else 0.0
            assert charges.along(DAY, last[None]) == pytest.approx([total], abs=1e-12)


def test_what_a_pair_spares_is_what_is_not_paid_after_it():
    charges = made(1)
    spared, paid = charges.shifts(DAY)
    nobody = DAY.expiry - 1
    assert charges.along(DAY, nobody[None]) == pytest.approx([paid], abs=1e-12)
    for q, worker, request in zip(spared, *DAY.pairs(), strict=True):
        last = nobody.copy()
        last[request] = DAY.worker_step[worker] - 1
        assert charges.along(DAY, last[None]) == pytest.approx([paid - q], abs=1e-11)
    assert np.ptp(spared) > 1.0


def test_the_basis_is_the_charge_per_unit():
    charges, rng = made(2), np.random.default_rng(5)
    basis = charges.basis(DAY)
    spared, paid = charges.shifts(DAY)
    assert basis.pairs @ charges.theta.ravel() == pytest.approx(spared, abs=1e-12)
    assert basis.total @ charges.theta.ravel() == pytest.approx(paid, abs=1e-12)
    assert (basis.magnitude >= np.abs(basis.total)).all()
    last = rng.integers(DAY.arrival - 1, DAY.expiry, (20, DAY.n_requests))
    twice = LinearCharges(2 * charges.theta, SURPLUS, TIME, charges.foresight, RATE)
    assert twice.along(DAY, last) == pytest.approx(2 * charges.along(DAY, last), abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.25, None])
def test_every_charge_is_zero_in_the_mean(rate):
    """All paths of four steps with one worker group or another, or none, and a request or none, by enumeration.

    Besides doing nothing, a policy that serves the oldest request whenever the second group's worker comes.
    """
    charges = made(3, rate)
    chance = {-1: None, 0: SHARE[0], 1: SHARE[1]}
    mean, spread, total = np.zeros(2), 0.0, 0.0
    for groups, comes in product(product(chance, repeat=4), product((0, 1), repeat=4)):
        p, stretch = 1.0, 0
        for group, request in zip(groups, comes, strict=True):
            there = PRESENCE[min(stretch, 2)]
            p *= (1 - there if group < 0 else there * chance[group]) * (0.25 if request else 0.75)
            stretch = stretch + 1 if group >= 0 else 0
        day = day_of(groups, [(step, step % 2, 2 + step % 2) for step in range(4) if comes[step]])
        last = np.stack([day.expiry - 1, day.expiry - 1])
        for step in range(4):
            waiting = np.flatnonzero((day.arrival <= step) & (last[1] >= step))
            if groups[step] == 1 and waiting.size:
                last[1, waiting[0]] = step - 1
        found = charges.along(day, last)
        mean, spread, total = mean + p * found, spread + p * found[1] ** 2, total + p
    assert total == pytest.approx(1.0, abs=1e-12)
    assert mean == pytest.approx(np.zeros(2), abs=1e-11)  # 1,296 paths of up to 100 money
    assert spread > 1.0


def test_a_day_without_requests_or_waiting_is_free():
    charges = made()
    for day in (day_of([0, -1, 1], []), day_of([0, -1, 1], [(0, 0, 0), (2, 1, 5)])):
        spared, paid = charges.shifts(day)
        assert paid == 0.0
        assert (spared == 0).all()
        assert charges.along(day, np.zeros((3, day.n_requests), int) - 1).tolist() == [0.0] * 3


def test_one_step_after_which_nothing_can_wait():
    assert made().shifts(day_of([1], [(0, 0, 3)]))[1] == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"theta": np.zeros((2, 3, 2))}, "theta has shape"),
        ({"theta": np.full((2, 2, 3), np.nan)}, r"theta\[0, 0, 0\] is nan, not a finite number"),
        ({"request_rate": None}, r"it needs \(1, 2, 3\)"),
        ({"request_rate": -1.0}, "request_rate = -1.0"),
        ({"request_rate": np.nan}, "request_rate = nan"),
        ({"surplus_knots": [40.0, 10.0]}, "surplus_knots"),
        ({"time_knots": [1.0]}, "time_knots"),
    ],
)
def test_what_makes_no_charges_is_refused_in_one_line(change, message):
    given = {
        "theta": np.zeros((2, 2, 3)), "surplus_knots": SURPLUS, "time_knots": TIME,
        "foresight": Foresight(PRESENCE, SHARE), "request_rate": RATE,
    }  # fmt: skip
    with pytest.raises(InputError, match=message) as caught:
        LinearCharges(**(given | change))
    assert "\n" not in str(caught.value)


def test_other_groups_are_refused():
    charges = LinearCharges(np.zeros((1, 2, 3)), SURPLUS, TIME, Foresight([0.5], [1.0]))
    for ask in (charges.basis, charges.shifts, lambda day: charges.along(day, day.expiry[None] - 1)):
        with pytest.raises(InputError, match="share has 1 groups"):
            ask(DAY)
