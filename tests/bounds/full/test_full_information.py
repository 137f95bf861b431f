"""The full-information bound."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.basics.errors import InputError, InstanceError, SolverError
from optkit.bounds import Bound, full_information
from optkit.bounds.rounding import sum_up
from optkit.instances.instance import Instance

METHODS = (None, "assignment", "lp", "milp")
AGREE = 1e-7  # relative, as the issue demands; HiGHS works with tolerances of 1e-7 at values scaled to 1000

seeds = st.integers(0, 2**32 - 1)
kinds = st.fixed_dictionaries(
    {
        "groups": st.integers(1, 3),
        "ties": st.booleans(),
        "sparse_noise": st.booleans(),
        "lifetime": st.sampled_from([1, 5]),
    }
)


def table(values):
    """Make an instance of workers times requests in which pair (j, i) is worth values[j][i], the penalties nothing."""
    values = np.asarray(values, float)
    J, n = values.shape
    return Instance(
        horizon=max(J, 1), arrival=np.zeros(n, int), expiry=np.full(n, max(J, 1) - 1), reward=np.full(n, 100.0),
        penalty=np.zeros(n), features=np.zeros((n, 0)), pickup=np.zeros(n, int), dropoff=np.zeros(n, int),
        worker_step=np.arange(J), worker_group=np.zeros(J, int), utility=np.zeros((1, n)), mu=[1.0],
        noise=values - 100, outside_noise=np.zeros(J),
    )  # fmt: skip


# Value, request duals and worker duals, each unique, known by construction: (values, optimum, matching, y, z).
KNOWN = {
    "one pair without a rival": ([[7.0]], 7.0, [(0, 0)], None, None),
    "two workers bid for one request": ([[7.0], [5.0]], 7.0, [(0, 0)], None, None),
    "greedy is wrong": ([[10.0, 9.0], [9.0, 1.0]], 18.0, [(0, 1), (1, 0)], None, None),
    "a worker is better idle": ([[8.0, -3.0], [-1.0, -2.0]], 8.0, [(0, 0)], None, None),
    "equal values fix the prices": ([[4.0], [4.0]], 4.0, None, [4.0], [0.0, 0.0]),
    "equal requests fix the prices": ([[4.0, 4.0]], 4.0, None, [0.0, 0.0], [4.0]),
}


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", KNOWN)
def test_known_optimum_matching_and_prices(case, method):
    values, optimum, matching, y, z = KNOWN[case]
    bound = full_information(table(values), method)
    certificate = bound.certificate
    # 1e-9: rewards of 100 minus compensations round by 1e-14; HiGHS's scaled tolerance is 1e-10 of the value.
    assert bound.value == pytest.approx(optimum, abs=1e-9)
    if matching is not None:
        assert sorted(zip(certificate.worker.tolist(), certificate.request.tolist(), strict=True)) == matching
    if y is not None:
        assert certificate.request_dual == pytest.approx(y, abs=1e-9)
        assert certificate.worker_dual == pytest.approx(z, abs=1e-9)


@pytest.mark.slow
@given(seeds, kinds)
@settings(deadline=None, max_examples=25)  # the integer program takes a few milliseconds
def test_all_methods_agree_and_certify(random_instance, seed, kind):
    day = random_instance(np.random.default_rng(seed), requests=15, workers=9, **kind)
    values = {}
    for method in METHODS:
        bound = full_information(day, method)
        verdict = bound.certificate.check(day)
        scale = max(1.0, -day.penalty.sum() + verdict.bound)  # the constant may cancel the matching's value
        assert verdict.residual == 0
        assert abs(verdict.gap) <= AGREE * scale
        assert verdict.bound == pytest.approx(bound.value, abs=1e-12 * scale)  # the same sums
        values[method] = bound.value
    assert np.ptp(list(values.values())) <= AGREE * scale


@pytest.mark.slow
@settings(max_examples=50)
@given(seeds, kinds)
def test_the_default_is_the_best_of_all_matchings(random_instance, brute_force, seed, kind):
    day = random_instance(np.random.default_rng(seed), requests=6, workers=5, **kind)
    assert full_information(day).value == pytest.approx(brute_force(day), abs=1e-10)  # rounding of sums below 600


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", [{}, {"groups": 3}, {"ties": True}, {"sparse_noise": True}, {"reward": -1000.0}])
def test_brute_force_agrees_with_every_method(random_instance, brute_force, kind, method):
    day = random_instance(np.random.default_rng(5), requests=7, workers=5, **kind)
    assert full_information(day, method).value == pytest.approx(brute_force(day), rel=AGREE)


@pytest.mark.slow
@pytest.mark.parametrize("ties", [False, True])
def test_windows_programs_and_default_agree_on_a_long_horizon(random_instance, ties):
    day = random_instance(
        np.random.default_rng(6), requests=1500, workers=700, horizon=1500, lifetime=5, ties=ties, sparse_noise=True
    )
    bound = full_information(day)
    assert bound.solver.details["algorithm"] == "windows"
    assert bound.solver.details["windows"] > 1
    verdict = bound.certificate.check(day)
    assert abs(verdict.gap) <= 1e-9 * verdict.bound  # what the windows promise
    for method in ("lp", "milp"):
        assert full_information(day, method).value == pytest.approx(bound.value, rel=AGREE)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "kind",
    [{"requests": 0}, {"workers": 0}, {"requests": 0, "workers": 0}, {"reward": -1000.0}],
    ids=["no requests", "no workers", "nothing", "all pairs cost more than they earn"],
)
def test_where_nothing_is_worth_serving_all_penalties_are_paid(random_instance, kind, method):
    day = random_instance(np.random.default_rng(7), **kind)
    bound = full_information(day, method)
    assert bound.value == sum_up(day.penalty)
    assert bound.certificate.worker.size == 0
    assert bound.certificate.check(day).gap <= 1e-15 * abs(bound.value)


@pytest.mark.parametrize("method", METHODS)
def test_nobody_meets_anybody(random_instance, method):
    day = random_instance(np.random.default_rng(8))
    day = replace(day, horizon=40, worker_step=np.arange(20, 20 + day.n_workers))
    assert full_information(day, method).value == sum_up(day.penalty)


def test_the_bound_says_what_it_is(random_instance):
    bound = full_information(random_instance(np.random.default_rng(9)), "lp")
    assert isinstance(bound, Bound)
    assert (bound.kind, bound.solver.method, bound.solver.status) == ("full information", "lp", "Optimal")
    assert bound.solver.seconds > 0


def test_more_time_or_more_reward_never_lowers_the_bound(random_instance):
    """Limit cases: relaxing an instance can only help one who knows the future."""
    day = random_instance(np.random.default_rng(10))
    base = full_information(day).value
    # 1e-10 allows for the rounding of sums below 1000.
    assert full_information(replace(day, reward=day.reward + 1)).value >= base - 1e-10
    assert full_information(replace(day, expiry=np.full(8, day.horizon - 1))).value >= base - 1e-10


def test_noise_that_is_not_realised_is_refused(random_instance):
    day = replace(random_instance(np.random.default_rng(11)), noise=None, outside_noise=None)
    with pytest.raises(InstanceError, match="with_noise"):
        full_information(day)


def test_an_unknown_method_is_refused(random_instance):
    with pytest.raises(InputError, match="simplex"):
        full_information(random_instance(np.random.default_rng(12)), "simplex")


@pytest.mark.parametrize("limit", [0, -1.0, float("nan")])
def test_a_time_limit_must_be_positive(random_instance, limit):
    with pytest.raises(InputError, match="time_limit"):
        full_information(random_instance(np.random.default_rng(13)), time_limit=limit)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["lp", "milp", "assignment"])
def test_a_time_limit_is_an_error_and_no_bound(random_instance, method):
    day = random_instance(np.random.default_rng(14), requests=2000, workers=1000, horizon=2000)
    with pytest.raises(SolverError, match="raise time_limit") as caught:
        full_information(day, method, time_limit=1e-9)
    assert "\n" not in str(caught.value)


def test_a_time_limit_that_is_kept_changes_nothing(random_instance):
    day = random_instance(np.random.default_rng(15))
    assert len({full_information(day, m, time_limit=600).value for m in (None, "assignment")}) == 1


def test_a_solver_that_is_wrong_is_not_believed(random_instance, monkeypatch):
    day = random_instance(np.random.default_rng(16))
    none = np.zeros(0, int)
    home = sys.modules[
        full_information.__module__
    ]  # `import optkit.bounds.full.full_information as` gives the function
    monkeypatch.setattr(home, "dense_matching", lambda matrix: (none, none))
    with pytest.raises(SolverError, match="try another method"):
        full_information(day)


@pytest.mark.slow
def test_the_function_is_exported_even_where_its_module_was_imported_first_and_solvers_load_late_and_say_nothing():
    """Standard output belongs to the caller; HiGHS 1.16 greets there from C, once, as a first object is made."""
    code = (
        "import sys, optkit.bounds.full.full_information\n"
        "from optkit.bounds import full_information\n"
        "assert callable(full_information)\n"
        "assert not {'highspy', 'cvxpy', 'scipy.optimize', 'ortools'} & set(sys.modules)\n"
        "from optkit import scenario\n"
        "day = scenario('I.1', seed=0).sample(1, seed=1)[0]\n"
        "print([full_information(day, method=method).solver.status for method in ('lp', 'milp')])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("['Optimal', 'Optimal']\n", "")
