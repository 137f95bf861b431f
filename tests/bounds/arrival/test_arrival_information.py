"""The choice among the arrival-information bounds, and the hybrid of tables and multipliers."""

import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit import Instance, scenario
from optkit.basics.errors import InputError, SolverError
from optkit.bounds.arrival.arrival_information import arrival_hybrid, arrival_information, choose_tracked
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.arrival.exact import arrival_exact
from optkit.bounds.arrival.lattice import lattice_bits
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import prove
from optkit.bounds.full.full_information import full_information

seeds = st.integers(0, 2**32 - 1)
bounded = settings(derandomize=True, deadline=None, max_examples=25)
home = sys.modules[arrival_information.__module__]  # the package may bind the module's name to the function


@pytest.fixture(scope="module")
def busy():
    """Days of scenario I.3: 13 uncertain requests at the busiest worker in the mean."""
    return scenario("I.3", seed=0).sample(4, seed=11)


@pytest.fixture
def crowded(random_instance):
    """A day with more open requests than the exact bound takes on by default."""
    return random_instance(np.random.default_rng(0), requests=40, workers=5, horizon=10, lifetime=20.0)


@pytest.mark.slow
@bounded
@given(seeds, st.integers(0, 6), st.floats(0.0, 55.0), st.booleans())
def test_the_hybrid_holds_for_any_multipliers(random_instance, seed, limit, liking, nonnegative):
    """Tracked or not, and whatever the multipliers: never below the exact bound, and proven."""
    rng = np.random.default_rng(seed)
    day = random_instance(rng, requests=9, lifetime=5.0, groups=2)
    day = replace(day, utility=day.utility + liking)
    multipliers = rng.exponential(rng.choice([10, 100]), 9) * rng.integers(0, 2, 9)
    bound = arrival_hybrid(day, limit=limit, multipliers=multipliers, nonnegative=nonnegative)
    assert bound.value >= arrival_exact(day, nonnegative=nonnegative).value - 1e-9  # rounding of sums below 1000
    assert abs(prove(bound, day).gap) <= 1e-8  # a few roundings of the money in play per worker


def test_a_served_request_is_not_forced_on_workers_who_love_it(random_instance):
    """An untracked request may be withheld: at compensation 0 its second service would lose the multiplier twice."""
    day = random_instance(np.random.default_rng(4), requests=1, workers=4, horizon=6)
    day = replace(day, arrival=[0], expiry=[5], utility=[[50.0]])
    assert arrival_hybrid(day, limit=0, multipliers=[100.0]).value >= arrival_exact(day).value


@pytest.mark.slow
def test_the_hybrid_lies_between_the_exact_and_the_lagrangian_bound(busy):
    for day in busy:
        exact, lagrangian = arrival_exact(day).value, arrival_dual(day).value
        hybrid = [arrival_hybrid(day, limit=limit).value for limit in (0, 4, 8, 18)]
        assert hybrid[0] == pytest.approx(lagrangian, rel=1e-6)  # the dual's own tolerance
        # Multipliers were tuned with nothing tracked, so that tracking only helps.
        assert hybrid[0] > hybrid[1] > hybrid[2] >= hybrid[3] - 1e-9
        assert hybrid[3] == pytest.approx(exact, abs=1e-9)


@pytest.mark.slow
def test_a_hybrid_of_few_tracked_requests_closes_most_of_the_gap(busy):
    """With 10 tracked at a worker nine tenths of what the multipliers give away are won back, on each day."""
    for day in busy:
        exact, lagrangian = arrival_exact(day).value, arrival_dual(day).value
        assert arrival_hybrid(day, limit=10).value - exact < 0.1 * (lagrangian - exact)


@bounded
@given(seeds, st.integers(0, 12), st.integers(0, 7), st.integers(0, 8))
def test_the_tracked_fit_and_no_more_would(random_instance, seed, requests, workers, limit):
    rng = np.random.default_rng(seed)
    day = random_instance(rng, requests=requests, workers=workers, lifetime=6.0)
    tracked = choose_tracked(day, rng.uniform(0, 1, requests), limit)
    assert lattice_bits(day, tracked).max(initial=0) <= limit
    for i in np.flatnonzero(~tracked):
        more = tracked.copy()
        more[i] = True
        assert lattice_bits(day, more).max() > limit


def test_where_room_is_scarce_the_dearest_is_tracked(random_instance):
    day = random_instance(np.random.default_rng(1), requests=5, workers=3, horizon=4, lifetime=50.0)
    day = replace(day, arrival=np.zeros(5, int), expiry=np.full(5, 3))
    assert choose_tracked(day, np.array([3.0, 9.0, 1.0, 7.0, 2.0]), 2).tolist() == [False, True, False, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["exact", "hybrid", "lagrangian", "program"])
def test_every_method_is_a_proven_bound_and_says_what_it_is(busy, method):
    day = busy[0]
    bound = arrival_information(day, method)
    assert (bound.kind, bound.solver.method) == ("arrival information", method)
    prove(bound, day)
    assert bound.value >= arrival_exact(day).value - 1e-9


@pytest.mark.slow
def test_the_default_is_exact_where_it_can_be(busy):
    for day in busy:
        bound = arrival_information(day)
        assert bound.solver.method == "exact"
        assert str(bound.solver.details["largest_lattice"]) in bound.solver.details["why"]
        assert bound.value == arrival_exact(day).value


@pytest.mark.slow
def test_the_default_for_a_crowd_is_the_hybrid(crowded):
    most = lattice_bits(crowded).max()
    with pytest.raises(SolverError, match="hybrid"):
        arrival_information(crowded, "exact")
    bound = arrival_information(crowded)
    assert bound.solver.method == "hybrid"
    assert bound.solver.details["why"].startswith(f"{most} requests")
    assert bound.solver.details["largest_lattice"] == bound.solver.details["limit"] == 14
    assert bound.value < arrival_information(crowded, "lagrangian").value
    prove(bound, crowded)


def test_with_less_room_the_default_tracks_fewer_and_then_none(crowded, monkeypatch):
    monkeypatch.setattr(home, "STATES", 200)
    bound = arrival_information(crowded)
    assert bound.solver.method == "hybrid"
    assert bound.solver.details["limit"] < 14
    assert bound.solver.details["states"] <= 200
    monkeypatch.setattr(home, "STATES", 1)
    assert arrival_information(crowded).solver.method == "lagrangian"
    assert "states" in arrival_information(crowded).solver.details["why"]


@pytest.mark.slow
def test_it_is_tighter_than_full_information_in_the_mean(busy):
    for day in busy:
        full = np.mean([full_information(day.with_noise(draw)).value for draw in range(20)])
        assert arrival_information(day).value < full


@pytest.mark.parametrize("method", [None, "exact", "hybrid", "lagrangian", "program"])
@pytest.mark.parametrize("sizes", [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}])
def test_with_nobody_to_serve_or_to_be_served_the_penalties_are_paid(random_instance, sizes, method):
    day = random_instance(np.random.default_rng(2), **sizes)
    bound = arrival_information(day, method)
    assert bound.value == pytest.approx(day.penalty.sum(), rel=1e-14)
    assert prove(bound, day).gap <= 1e-14 * abs(bound.value)


def test_an_unknown_method_is_refused(busy):
    with pytest.raises(InputError, match="'simplex' is unknown"):
        arrival_information(busy[0], "simplex")


@pytest.mark.parametrize("multipliers", [[1.0], np.full(8, -1.0), np.full(8, np.inf)])
def test_multipliers_that_prove_nothing_are_refused(random_instance, multipliers):
    with pytest.raises(InputError, match="multipliers"):
        arrival_hybrid(random_instance(np.random.default_rng(3)), multipliers=multipliers)


@pytest.mark.slow
def test_a_check_is_no_dearer_than_the_solution(monkeypatch):
    """Each stage is proven in one go over its subsets, as it was solved; none is laid out request by request."""
    n, T = 60, 30
    day = Instance(
        horizon=T, arrival=np.zeros(n, int), expiry=np.full(n, T - 1), reward=np.linspace(20, 60, n),
        penalty=-np.ones(n), features=np.zeros((n, 0)), pickup=np.zeros(n, int), dropoff=np.zeros(n, int),
        worker_step=np.arange(T), worker_group=np.zeros(T, int), utility=-np.linspace(5, 30, n)[None], mu=[1.0],
    )  # fmt: skip
    done = Counter()

    def counting(name):
        own = getattr(SubsetProgram, name)

        def counted(self, stage, *more):
            done[name] += stage.states
            return own(self, stage, *more)

        monkeypatch.setattr(SubsetProgram, name, counted)

    counting("_before")
    counting("_prove")

    def laid_out(self, stage, later, rows, own=SubsetProgram.offers):
        done["offers"] += len(rows)
        return own(self, stage, later, rows)

    monkeypatch.setattr(SubsetProgram, "offers", laid_out)
    bound = arrival_information(day)
    solved = done["_before"]
    assert solved > 1_000
    done.clear()
    prove(bound, day)
    assert 0 < done["_prove"] <= solved
    assert done["_before"] == 0
    assert done["offers"] <= solved / n
