"""Grid search: the lockstep finds what a plain loop over settings finds."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError, PolicyError
from optkit.policies import Formula, RewardPercentage
from optkit.policies.tuning import FORMULA_GRID, PERCENTAGES, tune_formula, tune_reward_percentage

SMALL = {"reward": (0.0, 0.5, 0.7), "distance": (0.0, 10.0), "penalty": (-0.1, 0.1), "expiry_boost": (0.0, 0.3)}


@pytest.fixture(scope="module")
def days():
    """Twelve instances of scenario II, of twenty steps."""
    return scenario("II", seed=2, horizon=20).sample(12, seed=3)


@pytest.mark.slow
def test_share_against_a_plain_loop(days):
    """Every mean reward of PP's grid is that of a simulation of its own, and the best setting is returned.

    Both simulate with the same arithmetic, so rewards agree to the last bits: 1e-12 relative.
    """
    tuned = tune_reward_percentage(days)
    mean = [simulate(days, RewardPercentage(share)).reward.mean() for share in PERCENTAGES]
    assert tuned.table["mean_reward"].to_numpy() == pytest.approx(mean, rel=1e-12)
    assert tuned.table["share"].tolist() == PERCENTAGES.tolist()
    assert tuned.policy == RewardPercentage(float(PERCENTAGES[np.argmax(mean)]))
    assert tuned.mean_reward == tuned.table["mean_reward"].max()


@pytest.mark.slow
@pytest.mark.parametrize("at_once", [1, 30, 6000])
def test_formula_against_a_plain_loop(days, at_once, monkeypatch):
    """FP's grid gives the means of one simulation per setting (1e-12), however many runs share a lockstep."""
    monkeypatch.setattr("optkit.policies.tuning.RUNS_AT_ONCE", at_once)
    tuned = tune_formula(days, SMALL)
    settings = list(product(*SMALL.values()))
    mean = [simulate(days, Formula(*weights)).reward.mean() for weights in settings]
    assert tuned.table["mean_reward"].to_numpy() == pytest.approx(mean, rel=1e-12)
    assert list(tuned.table[list(SMALL)].itertuples(index=False, name=None)) == settings
    assert tuned.policy == Formula(*settings[int(np.argmax(mean))])
    assert tuned.mean_reward == pytest.approx(max(mean), rel=1e-12)


@pytest.mark.slow
def test_requests_that_a_worker_likes_as_much():
    """Of requests that are worth the same to a worker the first is taken, as by the simulator: to the last digit."""
    day = scenario("I.1", seed=0, horizon=20).sample(1, seed=1)[0]
    equal = {name: np.full(day.n_requests, value) for name, value in (("reward", 50.0), ("penalty", -10.0))}
    noise = {"noise": np.zeros((day.n_workers, day.n_requests)), "outside_noise": np.zeros(day.n_workers)}
    rising = np.linspace(-40.0, -36.0, day.n_requests).round()[None]  # several of each
    alike = replace(day, **equal, utility=rising, features=np.zeros((day.n_requests, 1)), **noise)
    unlike = replace(alike, penalty=-np.arange(1.0, 1 + day.n_requests) / 3)
    for one in (alike, unlike):
        expected = [simulate([one], RewardPercentage(share)).reward.mean() for share in PERCENTAGES]
        assert tune_reward_percentage([one]).table["mean_reward"].tolist() == expected


def test_offers_beyond_all_money():
    """A setting that pays more than an amount of money is named."""
    with pytest.raises(PolicyError, match=r"setting 1e\+200, 0, 0, 0 of the grid offers .* at step"):
        tune_formula(
            scenario("I.1", seed=0).sample(2, seed=1), {**dict.fromkeys(SMALL, (0.0,)), "reward": (0.5, 1e200)}
        )


def test_the_tuned_policy_earns_what_was_promised(days):
    """Simulating the tuned policy gives its mean reward (1e-12 relative)."""
    for tuned in (tune_reward_percentage(days), tune_formula(days, SMALL)):
        assert simulate(days, tuned.policy).reward.mean() == pytest.approx(tuned.mean_reward, rel=1e-12)


def test_the_papers_grids():
    """PP's grid is 40 to 100 per cent, FP's the 1,100 combinations of the table in appendix B.2."""
    assert PERCENTAGES.tolist() == [k / 100 for k in range(40, 101)]
    assert FORMULA_GRID == {
        "reward": (0, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95),
        "distance": (0, 5, 10, 15, 20),
        "penalty": (-0.1, -0.05, 0, 0.05, 0.1),
        "expiry_boost": (0, 0.1, 0.2, 0.3),
    }
    assert np.prod([len(values) for values in FORMULA_GRID.values()]) == 1100


def test_the_whole_grid_by_default(days):
    """Without a grid all 1,100 combinations are tried, each once."""
    table = tune_formula(days[:2]).table
    assert len(table.drop_duplicates(list(FORMULA_GRID))) == len(table) == 1100


def test_equals_go_to_the_first(days):
    """Among equally good settings the first of the grid is chosen."""
    assert tune_reward_percentage(days, [0.6, 0.6, 0.6]).table["mean_reward"].nunique() == 1
    quiet = scenario("I.1", worker_rate=0.0).sample(2, seed=0)
    assert tune_reward_percentage(quiet).policy == RewardPercentage(0.4)
    assert tune_formula(quiet, SMALL).policy == Formula(0.0, 0.0, -0.1, 0.0)


@pytest.mark.parametrize(
    "tune", [lambda d, p: tune_formula(d, SMALL, progress=p), lambda d, p: tune_reward_percentage(d, progress=p)]
)
def test_progress(days, tune, monkeypatch):
    """Progress counts instances up to their total."""
    monkeypatch.setattr("optkit.policies.tuning.RUNS_AT_ONCE", 130)
    calls = []
    tuned = tune(days, lambda done, total: calls.append((done, total)))
    done, totals = zip(*calls, strict=True)
    assert len(set(totals)) == 1
    assert list(done) == sorted(set(done))
    assert done[-1] == totals[0] == len(days)
    assert done[0] == (2 if "share" in tuned.table else 5)


@pytest.mark.parametrize(
    "grid", [[], [0.5, float("nan")], [-0.1, 0.5], [float("inf")]], ids=["empty", "nan", "negative", "infinite"]
)
def test_bad_share_grid(days, grid):
    """An empty grid of shares, or one with NaN, infinity or a negative share, is an error."""
    with pytest.raises(InputError, match="grid for share"):
        tune_reward_percentage(days, grid)


@pytest.mark.parametrize(
    "changes",
    [{"reward": ()}, {"reward": (float("nan"),)}, {"penalty": (float("inf"),)}, {"weight": (1.0,)}],
    ids=["empty", "nan", "infinite", "unknown name"],
)
def test_bad_formula_grid(days, changes):
    """An empty or infinite axis, or a weight that FP does not have, is an error."""
    with pytest.raises(InputError, match="grid"):
        tune_formula(days, {**SMALL, **changes})


def test_a_grid_that_lacks_an_axis(days):
    """A grid that leaves an axis out is an error that names all four."""
    with pytest.raises(InputError, match="reward, distance, penalty, expiry_boost"):
        tune_formula(days, {"reward": (0.5,)})


@pytest.mark.parametrize("axis", [0.5, ("half",)])
def test_a_grid_of_something_else(days, axis):
    """An axis that is no sequence of numbers is an InputError."""
    with pytest.raises(InputError):
        tune_formula(days, {**SMALL, "reward": axis})


def test_no_instances():
    """Tuning on nothing is an error, not a mean over nothing."""
    for tune in (tune_reward_percentage, tune_formula):
        with pytest.raises(InputError, match="at least one instance"):
            tune([])
