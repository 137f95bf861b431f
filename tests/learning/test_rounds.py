"""Learning in rounds: what it records, when it stops, that it closes the gap, and what it cannot take."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

import optkit.learning.rounds as learning
from optkit import performance_ratio, scenario, simulate
from optkit.basics.errors import DataError, InputError
from optkit.bounds import full_information
from optkit.learning.offer_log import collect
from optkit.learning.rounds import learn_once, learn_preferences
from optkit.models.estimation import optimum
from optkit.models.estimation.newton import maximise
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers
from optkit.policies import PostDecisionPricing
from optkit.policies.explore import Explore, RandomOffers

COLUMNS = ["converged", "round", "group", "rmse", "mbe", "situations", "rejections", "verdict", "standard_error"]


@pytest.fixture(scope="module")
def days():
    """Forty instances of one worker group."""
    return scenario("I.1", seed=0).sample(40, seed=3)


@pytest.fixture(scope="module")
def learned():
    """What four rounds on 100 instances of I.1 teach."""
    return learn_preferences(scenario("I.1", seed=0).sample(100, seed=3), rounds=4, seed=1)


@pytest.fixture
def collected(monkeypatch):
    """Instances and policies of every round, as they were handed to collect."""
    seen = []

    def spy(instances, policy):
        seen.append((list(instances), policy))
        return collect(instances, policy)

    monkeypatch.setattr(learning, "collect", spy)
    return seen


@pytest.mark.slow
def test_rounds_are_recorded(days):
    """One row per round and group; data add up over rounds; the last row is what the preferences say of themselves."""
    told = []
    found = learn_preferences(days, rounds=3, tolerance=1e-9, seed=2, progress=lambda *done: told.append(done))
    assert found.rounds["round"].tolist() == [1, 2, 3]
    assert sorted(found.rounds.columns) == sorted(COLUMNS)
    first = found.rounds["situations"].iloc[0]
    assert (found.rounds["situations"].diff().iloc[1:] > first / 2).all()  # each round adds its own, about as many
    assert told == [(1, 3), (2, 3), (3, 3)]
    last = found.rounds.iloc[-1]
    assert last["situations"] == found.offers.n_situations
    assert last["rejections"] == found.offers.n_situations - found.offers.n_choices
    assert not found.converged
    places = [np.concatenate([getattr(one, name) for one in days]) for name in ("features", "pickup", "dropoff")]
    truth = np.concatenate([one.utility[0] for one in days])
    error = truth - found.preferences.utility_of(*places, np.array(0))
    assert last["mbe"] == pytest.approx(error.mean(), abs=1e-9)
    assert last["rmse"] == pytest.approx(np.sqrt((error**2).mean()), abs=1e-9)
    sure = found.preferences.standard_error(*places, 0)
    assert last["standard_error"] == pytest.approx(np.sqrt((sure**2).mean()), abs=1e-12)


@pytest.mark.slow
def test_truth_is_relative_to_the_outside_utility(days):
    """Utilities and the outside utility moved by the same 7 change no choice, hence no offer, estimate or error."""
    moved = [replace(one, utility=one.utility + 7.0, outside_utility=7.0) for one in days]
    one, other = (learn_preferences(each, rounds=2, seed=2).rounds for each in (days, moved))
    np.testing.assert_allclose(other[["rmse", "mbe"]], one[["rmse", "mbe"]], atol=1e-6)


@pytest.mark.slow
def test_stops_at_the_tolerance(days):
    """It stops in the first round whose standard error meets the tolerance, and says that it converged."""
    endless = learn_preferences(days, rounds=4, tolerance=1e-9, seed=0).rounds
    target = endless["standard_error"].iloc[2] * 1.0001
    assert endless["standard_error"].iloc[1] > target
    found = learn_preferences(days, rounds=4, tolerance=target, seed=0)
    assert found.converged
    assert found.rounds["round"].max() == 3
    np.testing.assert_allclose(found.rounds["rmse"], endless["rmse"].iloc[:3], rtol=1e-9)


@pytest.mark.slow
def test_the_same_seed_gives_the_same(days):
    """Seeds settle everything, also for who goes on from an earlier round; another seed sees other offers."""
    one, other = (learn_preferences(days, rounds=2, seed=s) for s in (4, 5))
    begun = learn_once(days, seed=4)
    again = learn_preferences(days, rounds=2, seed=4, begun=begun)
    np.testing.assert_array_equal(one.preferences.weights, again.preferences.weights)
    assert one.rounds.equals(again.rounds)
    assert again.offers.n_situations == one.offers.n_situations > begun.offers.n_situations
    assert learn_preferences(days, rounds=1, seed=4, begun=begun) is begun
    assert (one.preferences.weights != other.preferences.weights).any()


@pytest.mark.slow
def test_every_round_is_another_day(days, collected):
    """Later rounds see the same arrivals with noise drawn anew each time; the caller's instances stay as they are."""
    learn_preferences(days, rounds=3, tolerance=1e-9, seed=2)
    (first, opening), (second, exploring), (third, _) = collected
    assert isinstance(opening, RandomOffers)
    assert isinstance(exploring, Explore)
    for a, b, c, own in zip(first, second, third, days, strict=True):
        assert a == own
        np.testing.assert_array_equal(a.arrival, b.arrival)
        np.testing.assert_array_equal(a.worker_step, c.worker_step)
        for one, other in ((a, b), (b, c), (a, c)):
            assert not np.isin(one.outside_noise, other.outside_noise).any()
            assert not np.isin(one.noise, other.noise).any()
    assert not np.isin(second[0].noise.ravel()[:5], second[1].noise).any()


@pytest.mark.slow
def test_the_workers_of_round_two_know_nothing_of_the_arrivals(collected):
    """With the default seeds, noise of round 2 is independent of what arrived (|r| below 5 / sqrt(480) = 0.23)."""
    train = scenario("I.1", seed=0, horizon=20).split().train
    learn_preferences(train, rounds=2, tolerance=1e-9, seed=0)
    mood = [one.outside_noise[0] for one in collected[1][0]]
    arrivals = [(one.arrival == 0).sum() for one in collected[1][0]]
    assert abs(np.corrcoef(mood, arrivals)[0, 1]) < 0.23


def test_learn_once_is_the_papers_data(days):
    """One round of random offers of 40 to 85 % is a fit on collect(RandomOffers), with a ridge if it must."""
    found = learn_once(days, seed=6)
    log = collect(days, RandomOffers(seed=6))
    np.testing.assert_array_equal(found.offers.compensation, log.compensation)
    ridge = learning.RIDGE if found.rounds["verdict"].iloc[0] == "not identified" else 0.0
    np.testing.assert_allclose(found.preferences.weights, fit_preferences(log, ridge=ridge).weights, rtol=1e-9)
    assert found.rounds["round"].tolist() == [1]


@pytest.mark.slow
def test_offers_that_nobody_rejects_are_overcome():
    """From offers of 2 to 3 times the reward: not identified, utility overestimated; then RMSE below 0.25.

    200 instances and 5 rounds give a standard error near 0.12; 0.25 is the figure asked for in the issue.
    """
    instances = scenario("I.1", seed=0).sample(200, seed=9)
    found = learn_preferences(instances, rounds=5, first=RandomOffers(2.0, 3.0, seed=0), seed=0)
    first, last = found.rounds.iloc[0], found.rounds.iloc[-1]
    assert first["rejections"] == 0
    assert first["verdict"] == "not identified"
    assert first["rmse"] > 1
    assert first["mbe"] < 0  # believed too willing: negative, appendix B.4
    assert first["standard_error"] > 5
    assert last["verdict"] != "not identified"
    assert last["rmse"] < 0.25
    assert last["rejections"] > 0


@pytest.mark.slow
def test_a_round_that_is_not_identified_never_ends_the_search(days):
    """However loose the tolerance, a level that rests on the penalty is not converged."""
    found = learn_preferences(days, rounds=3, tolerance=1e6, first=RandomOffers(2.0, 3.0))
    assert found.rounds["verdict"].iloc[0] == "not identified"
    assert found.rounds["round"].max() > 1
    assert found.converged


@pytest.mark.slow
def test_standard_errors_foresee_the_errors(learned):
    """The recorded RMSE is of the size of its standard error: within a factor of 3 in identified rounds.

    About ten coefficients share the error, so that the ratio spreads by some 25 % around 1.
    """
    late = learned.rounds[learned.rounds["verdict"] != "not identified"]
    ratio = late["rmse"] / late["standard_error"]
    assert ratio.between(1 / 3, 3).all()
    assert late["rmse"].iloc[-1] < 0.25


@pytest.mark.slow
def test_learned_prices_earn_what_true_ones_do(learned):
    """On 60 test instances of I.1, paired: myopic pricing by learned preferences is within 0.3 points of the truth."""
    test = scenario("I.1", seed=0).sample(60, seed=77)
    bound = np.array([full_information(one).value for one in test])
    lost = np.array([one.penalty.sum() for one in test])
    true, own = (
        performance_ratio(simulate(test, PostDecisionPricing(**choice)).reward, bound, lost)
        for choice in ({}, {"choice": learned.preferences})
    )
    assert true.mean() > 80  # per cent
    assert abs((true - own).mean()) < 0.3


@pytest.mark.slow
def test_groups_are_learned_apart_and_pooled():
    """Scenario II: a model for each of three groups with RMSE below 0.5; one model for all is far off and says so."""
    instances = scenario("II", seed=0).sample(100, seed=1)
    multi = learn_preferences(instances, rounds=3, seed=0)
    single = learn_preferences(instances, rounds=3, seed=0, pooled=True)
    last = multi.rounds[multi.rounds["round"] == multi.rounds["round"].max()]
    assert last["group"].tolist() == [0, 1, 2]
    assert (last["rmse"] < 0.5).all()
    assert last["situations"].sum() == multi.offers.n_situations
    blind = single.rounds[single.rounds["round"] == single.rounds["round"].max()]
    assert blind["group"].tolist() == [0, 1, 2]
    assert (blind["rmse"].to_numpy() > 3 * last["rmse"].to_numpy()).all()
    assert single.preferences.pooled


def test_all_rounds_data_are_used(learned):
    """The preferences are the fit on the joined log, so that anybody can repeat it from the file."""
    assert isinstance(learned.offers, Offers)
    again = fit_preferences(learned.offers)
    np.testing.assert_array_equal(again.weights, learned.preferences.weights)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"rounds": 0}, "rounds = 0"), ({"tolerance": 0.0}, "tolerance = 0"), ({"deviation": -1.0}, "deviation = -1")],
)
def test_bad_arguments(days, arguments, words):
    """Arguments out of range are InputErrors with their names."""
    with pytest.raises(InputError, match=words):
        learn_preferences(days[:20], **{"rounds": 2, "tolerance": 1e-9, **arguments})


def only_groups(instances, change):
    """The same days with some groups of workers renamed away."""
    return [replace(one, worker_group=np.vectorize(change)(one.worker_group)) for one in instances]


def test_a_group_that_never_works_is_a_data_error():
    """A gap in the groups of the workers is a DataError that names the group."""
    instances = only_groups(scenario("II", seed=0).sample(40, seed=0), lambda g: 2 if g == 1 else g)
    with pytest.raises(DataError, match="group 1 was offered nothing"):
        learn_preferences(instances, rounds=1)


def test_the_last_group_that_never_works_is_a_data_error():
    """Which group is missing makes no difference to the error."""
    instances = only_groups(scenario("II", seed=0).sample(40, seed=0), lambda g: min(g, 1))
    with pytest.raises(DataError, match="group 2 was offered nothing"):
        learn_preferences(instances, rounds=1)


def test_a_place_that_no_worker_saw(days):
    """A request at a place of its own that no worker ever sees stops nothing, or is a DataError that says so."""
    one = days[0]
    late = one.n_requests - 1
    unseen = replace(
        one, pickup=np.where(np.arange(one.n_requests) == late, 5, one.pickup), worker_step=one.worker_step
    )
    keep = unseen.worker_step < unseen.arrival[late]
    unseen = replace(
        unseen,
        worker_step=unseen.worker_step[keep],
        worker_group=unseen.worker_group[keep],
        noise=unseen.noise[keep],
        outside_noise=unseen.outside_noise[keep],
    )
    with suppress(DataError):
        learn_preferences([unseen, *days[1:]], rounds=1)


def test_no_instances():
    """An empty list is an InputError."""
    with pytest.raises(InputError):
        learn_preferences([])


def test_a_negative_seed(days):
    """A seed that NumPy cannot take is an InputError."""
    with pytest.raises(InputError):
        learn_preferences(days[:20], seed=-1)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed", "rounds", "far"), [("I.2", 11, 8, 0), ("I.3", 1, 8, 0), ("II", 8, 3, 1)])
def test_a_maximum_that_is_far_out_is_reached(monkeypatch, name, seed, rounds, far):
    """A few days may put the maximum far out, but where nothing is separated Newton gets there: every fit converges.

    Of twelve seeds each these want the most steps, and the last has a fit that looks at first as if it had no maximum.
    """
    gone_on = []

    def watching(*problem, watch=True, **settings):
        gone_on.append(not watch)
        return maximise(*problem, watch=watch, **settings)

    monkeypatch.setattr(optimum, "maximise", watching)
    found = learn_preferences(scenario(name, seed=seed).sample(3, seed=seed), rounds=rounds, seed=seed)
    assert found.rounds["converged"].all()
    assert sum(gone_on) == far
