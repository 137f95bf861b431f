"""Training: waiting pays where it should, runs can be repeated and resumed, and what led nowhere is not returned."""

import os
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError, InstanceError, TrainingError
from optkit.instances.queue import busy_steps
from optkit.instances.scenario import Split
from optkit.learning import training
from optkit.learning.rounds import learn_preferences
from optkit.learning.training import MOODS, PATIENCE, TrainingSettings, train
from optkit.models.value import KernelValue, LinearValue
from optkit.policies import PostDecisionPricing
from optkit.policies.explore import Explore
from optkit.simulation.batch import Batch
from optkit.simulation.metrics import mean_interval

STEPS = 10
"""Of the small split's days."""


@pytest.fixture(scope="module")
def world():
    """Training instances and fresh ones of a scenario, and what the true-model myopic policy earns on the fresh."""
    known = {}

    def of(name):
        if name not in known:
            source = scenario(name, seed=0, horizon=25)
            fresh = source.sample(160, seed=6)
            known[name] = source.sample(100, seed=5), fresh, simulate(fresh, PostDecisionPricing()).reward
        return known[name]

    return of


@pytest.fixture(scope="module")
def split():
    """A small split: quick trainings."""
    days = scenario("I.1", seed=0, horizon=STEPS).sample(30, seed=3)
    return Split(days[:20], [], days[20:])


@pytest.fixture
def two_rounds(monkeypatch):
    """Preferences are learned in two rounds, of up to eight, before the training's own."""
    monkeypatch.setattr(training, "learn_preferences", partial(learn_preferences, rounds=2))


@pytest.mark.slow
@pytest.mark.parametrize("value", ["linear", "kernel"])
@pytest.mark.parametrize("name", ["I.1", "II"])
def test_waiting_pays_where_workers_are_scarce(world, name, value):
    """On fresh instances the trained policy earns more than the myopic one: the paired 95 % interval excludes zero."""
    days, fresh, myopic = world(name)
    trained = train(days, value, choice="true")
    assert mean_interval(simulate(fresh, trained.policy).reward, myopic).low > 0
    assert trained.preferences is None


@pytest.mark.slow
@pytest.mark.parametrize("value", ["linear", "kernel"])
def test_waiting_is_worth_nothing_where_nothing_can_wait(value):
    """If every request lives for one step, there is nothing to lose, and the policy is the myopic one, bit for bit."""
    days = [replace(day, expiry=day.arrival) for day in scenario("I.1", seed=0).sample(20, seed=1)]
    trained = train(days, value, choice="true")
    assert not trained.value.coef_.any()
    np.testing.assert_array_equal(simulate(days, trained.policy).reward, simulate(days, PostDecisionPricing()).reward)


@pytest.mark.slow
def test_waiting_pays_where_workers_abound():
    """With a worker at every step waiting has a value too: pay little, and wait for one who is in the mood."""
    source = scenario("I.1", seed=0, request_rate=0.08, worker_rate=3.0)
    trained = train(source.sample(100, seed=1), choice="true")
    fresh = source.sample(100, seed=2)
    gain = mean_interval(simulate(fresh, trained.policy).reward, simulate(fresh, PostDecisionPricing()).reward)
    assert gain.low > 0


@pytest.mark.slow
def test_from_raw_instances_to_a_policy(world, two_rounds):
    """With preferences learned along the way it beats the true-model myopic policy, and says what it learned."""
    days, fresh, myopic = world("I.1")
    trained = train(Split(days, [], scenario("I.1", seed=0, horizon=25).sample(30, seed=7)))
    assert mean_interval(simulate(fresh, trained.policy).reward, myopic).low > 0
    N = Batch.of(days)
    truth = N.utility[0, :-1]
    learned = trained.preferences.utility_of(N.features[:-1], N.pickup[:-1], N.dropoff[:-1], np.array(0))
    assert np.sqrt(np.mean((learned - truth) ** 2)) < 0.25
    assert trained.policy.choice is trained.preferences


@pytest.mark.slow
@pytest.mark.parametrize(("choice", "models"), [("learned", 3), ("pooled", 1)])
def test_preferences_of_several_groups(world, choice, models, two_rounds):
    """On scenario II, one model a group or one for all: waiting pays against myopic prices with the same preferences.

    With a model for each group it even beats the true-model myopic policy.
    """
    days, fresh, myopic = world("II")
    trained = train(days, choice=choice)
    earned = simulate(fresh, trained.policy).reward
    assert len(trained.preferences.scale) == models
    own = simulate(fresh, PostDecisionPricing(choice=trained.preferences)).reward
    assert mean_interval(earned, own).low > 0
    if choice == "learned":
        assert mean_interval(earned, myopic).low > 0


@pytest.mark.slow
def test_given_preferences_are_used_as_they_are(world):
    """Preferences that are given are priced with, and not learned again."""
    days = world("I.1")[0][:20]
    given = learn_preferences(days, rounds=2).preferences
    trained = train(days, choice=given)
    assert trained.preferences is given
    assert trained.policy.choice is given
    assert trained.source["choice"] == "given"
    assert (trained.value.coef_ != train(days, choice="true").value.coef_).any()


@pytest.mark.slow
def test_learned_preferences_are_refitted_every_round(split, two_rounds):
    """The offers of every round join the data: what is learned in the end is not what was learned first.

    Whoever has learned that first brings it along, and the same comes out.
    """
    learned = learn_preferences(split.train, rounds=2, seed=0)
    first = learned.preferences
    trained = train(split.train, seed=0)
    np.testing.assert_array_equal(train(split.train, learned=learned, seed=0).value.coef_, trained.value.coef_)
    for choice in ("true", "pooled"):
        with pytest.raises(InputError, match="no use for what was learned"):
            train(split.train, learned=learned, choice=choice)
    error = [np.diag(one.covariance[0])[0] for one in (first, trained.preferences)]
    assert error[1] < error[0]
    assert (trained.preferences.weights != first.weights).any()


class Spy(LinearValue):
    """A linear value function that shows what it is fitted to."""

    seen = ()

    def fit(self, experience):
        """Fit, and note the experience."""
        type(self).seen = (*type(self).seen, experience)
        return super().fit(experience)


def test_experience_is_what_the_simulation_left_waiting(split):
    """The sets of the first round are those that wait after each decision of the exploring policy, and the arrivals.

    Followed by hand from the simulator's choices, for every instance and step.
    """
    Spy.seen = ()
    train(split.train, Spy(), choice="true", deviations=(5.0,), seed=3)
    (experience,) = Spy.seen
    result = simulate(split.train, Explore(PostDecisionPricing(), 5.0, seed=3))
    starts = np.cumsum([0, *(one.n_requests for one in split.train)])
    seen = 0
    for step in range(STEPS):
        expected = {}
        for b, one in enumerate(split.train):
            done = result.accepted[b, : one.n_workers]
            served = done[(done >= 0) & (one.worker_step <= step)]
            waits = np.flatnonzero((one.arrival <= step) & (one.expiry > step))
            waits = np.setdiff1d(waits, served)
            if waits.size:
                expected[b] = (waits + starts[b]).tolist()
        sets = experience.sets(step)
        found = [] if sets is None else [sorted(i[m].tolist()) for i, m in zip(sets.index, sets.member, strict=True)]
        assert found == list(expected.values())
        seen += len(found)
        if sets is not None:
            busy = busy_steps(Batch.of(split.train).worker_at >= 0)[step, list(expected)]
            np.testing.assert_array_equal(sets.busy, busy)
    assert seen > 100
    assert experience.discount == 1.0


@pytest.mark.slow
def test_the_discount_and_the_deviations_count(split):
    """Settings reach the experience and the record; those of the estimator are taken where the caller sets none."""
    Spy.seen = ()
    trained = train(split.train, Spy(), choice="true", deviations=[3, 2, 1], discount=0.9)
    assert [one.discount for one in Spy.seen] == [0.9] * 3
    assert [row["deviation"] for row in trained.record] == [3.0, 2.0, 1.0]
    assert trained.settings == {"deviations": (3.0, 2.0, 1.0), "discount": 0.9, "seeds": 1, "seed": 0}
    assert trained.source == {"choice": "true", "instances": 20, "horizon": STEPS}

    class Printed(Spy):
        deviations, discount = (9.0,), 0.95

    trained = train(split.train, Printed(), choice="true")
    assert trained.settings["deviations"] == (9.0,)
    assert trained.settings["discount"] == 0.95
    assert train(split.train, Printed(), choice="true", discount=1.0).settings["discount"] == 1.0


@pytest.mark.slow
def test_same_seed_same_coefficients(split, two_rounds):
    """Training is reproducible, with and without learning; another seed explores otherwise."""
    for choice in ("true", "learned"):
        one, two, other = (train(split, choice=choice, seed=seed) for seed in (3, 3, 4))
        np.testing.assert_array_equal(one.value.coef_, two.value.coef_)
        assert one.score == two.score
        assert (one.value.coef_ != other.value.coef_).any()
    np.testing.assert_array_equal(one.preferences.weights, two.preferences.weights)
    assert not one.value.coef_[-1].any()


@pytest.mark.slow
def test_the_record(split):
    """One row a round: seed, round, exploration, validation score, residual and time; scores are mean rewards."""
    trained = train(split, choice="true", deviations=(8.0, 4.0, 2.0))
    names = ["seed", "round", "deviation", "score", "residual", "seconds", "error"]
    assert all(list(row) == names for row in trained.record)
    assert [row["round"] for row in trained.record] == [1, 2, 3]
    assert trained.score == max(row["score"] for row in trained.record)
    assert all(row["residual"] > 0 and row["seconds"] >= 0 and row["error"] is None for row in trained.record)
    near = simulate(split.validation, trained.policy).reward
    # The score averages four draws of the workers' moods: near what is earned with the instances' own.
    assert abs(trained.score - near.mean()) < 4 * near.std() / np.sqrt(near.size)
    assert trained.failures == []


def test_without_validation_the_last_round_counts(split):
    """Plain instances leave nothing to choose by: the score is the round, and it is the last."""
    trained = train(split.train, choice="true", deviations=(8.0, 4.0, 2.0))
    assert trained.score == 3
    assert [row["score"] for row in trained.record] == [None] * 3
    shorter = train(split.train, choice="true", deviations=(8.0, 4.0))
    assert (shorter.value.coef_ != trained.value.coef_).any()


@pytest.mark.slow
def test_seeds_are_chosen_between_by_validation(split):
    """The best of several seeds is the one with the best score, that of a training with this seed alone or better."""
    told = []
    trained = train(split, choice="true", seeds=3, progress=lambda *done: told.append(done))
    alone = train(split, choice="true")
    assert trained.score >= alone.score
    assert trained.settings["seeds"] == 3
    assert [(row["seed"], row["round"]) for row in trained.record] == [(n, k) for n in range(3) for k in (1, 2)]
    assert trained.score == max(row["score"] for row in trained.record)
    assert alone.score == max(row["score"] for row in trained.record[:2])
    assert told == sorted(told)
    assert told[-1] == (6, 6)


class Scripted:
    """An estimator that does as told in each fit: costs of every waiting request, or an error to raise."""

    def __init__(self, *costs):
        self.costs, self.cost, self.seed = list(costs), 0.0, 0

    def fit(self, experience):
        """Take the next cost, or fail."""
        step = self.costs.pop(0)
        if isinstance(step, BaseException):
            raise step
        self.cost = step(self.seed) if callable(step) else step
        if isinstance(self.cost, BaseException):
            raise self.cost
        return self

    def value(self, sets):
        """Cost times the number of members."""
        return self.cost * sets.member.sum(axis=1)

    def opportunity_cost(self, sets):
        """The cost of each member."""
        return np.where(sets.member, self.cost, 0.0)


@pytest.mark.slow
def test_progress_is_told_to_the_end(split):
    """Progress never goes back and ends at the total, whether seeds stop early, fail, or do neither."""
    failing = TrainingError("diverged")
    for value, rounds in (
        (Scripted(0.0, 0.0, 0.0), 3),
        (Scripted(2.0, 50.0, 50.0, 50.0, 50.0), 5),
        (Scripted(lambda seed: failing if seed == 1 else 1.0, 1.0), 2),
    ):
        told = []
        train(split, value, choice="true", seeds=2, deviations=(1.0,) * rounds, progress=lambda *d: told.append(d))  # noqa: B023
        assert told == sorted(told)
        assert told[-1] == (2 * rounds, 2 * rounds)
        assert {total for _, total in told} == {2 * rounds}


def test_it_stops_when_it_only_gets_worse(split):
    """After a good round, PATIENCE rounds in a row below it end the training, and the good round is returned."""
    trained = train(split, Scripted(2.0, *[60.0] * 5), choice="true", deviations=(1.0,) * 6)
    assert len(trained.record) == 1 + PATIENCE
    assert trained.value.cost == 2.0
    assert trained.score == trained.record[0]["score"]


def test_the_callers_estimator_stays_unfitted(split):
    """What is passed is a description: it is copied, and neither fitted nor changed."""
    mine = KernelValue(landmarks=3, seed=9)
    trained = train(split.train, mine, choice="true", seed=5)
    assert vars(mine) == vars(KernelValue(landmarks=3, seed=9))
    assert trained.value.coef_.shape[1] == 9
    assert trained.value.seed == 5


# Interruption and checkpoints.


def interrupted(after):
    """A progress that presses Ctrl-C once so many rounds are done."""

    def progress(done, total):
        if done > after:
            raise KeyboardInterrupt

    return progress


@pytest.mark.slow
def test_what_was_interrupted_goes_on(tmp_path, split, two_rounds):
    """Interrupted in the second of three seeds and started again, it does not repeat the first, and ends the same."""
    whole = train(split, seeds=3, seed=1)
    again = partial(train, split, seeds=3, seed=1, checkpoint=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        again(progress=interrupted(2))
    (first,) = os.listdir(tmp_path)
    before = os.stat(tmp_path / first)
    told = []
    resumed = again(progress=lambda *done: told.append(done))
    assert os.stat(tmp_path / first).st_mtime_ns == before.st_mtime_ns
    assert told[0] == (2, 6)  # nothing is told of the first seed's first round
    assert len(os.listdir(tmp_path)) == 3
    np.testing.assert_array_equal(resumed.value.coef_, whole.value.coef_)
    assert resumed.score == whole.score
    assert resumed.settings == whole.settings
    fresh = scenario("I.1", seed=0, horizon=STEPS).sample(20, seed=8)
    np.testing.assert_array_equal(simulate(fresh, resumed.policy).reward, simulate(fresh, whole.policy).reward)
    # Once all is there, nothing is trained.
    done = again(progress=lambda *done: told.append(done))
    assert told[-3:] == [(2, 6), (4, 6), (6, 6)]
    np.testing.assert_array_equal(done.value.coef_, whole.value.coef_)


@pytest.mark.slow
def test_a_damaged_checkpoint_is_trained_again(tmp_path, split):
    """A file that was cut off is replaced by the same outcome."""
    one = train(split, choice="true", checkpoint=tmp_path)
    (name,) = os.listdir(tmp_path)
    whole = (tmp_path / name).read_text()
    (tmp_path / name).write_text(whole[:500])
    two = train(split, choice="true", checkpoint=tmp_path)
    np.testing.assert_array_equal(one.value.coef_, two.value.coef_)
    assert len((tmp_path / name).read_text()) > 500


@pytest.mark.slow
def test_changed_trainings_do_not_share_checkpoints(tmp_path, split):
    """Another exploration, form, instance or validation is trained anew, and its own outcome returned."""
    other = Split([replace(one, features=one.features + 0.1) for one in split.train], [], split.validation)
    less = Split(split.train, [], split.validation[:5])
    calls = [
        partial(train, split),
        partial(train, split, deviations=(9.0,)),
        partial(train, split, LinearValue(ridge=5.0)),
        partial(train, less),
        partial(train, split.train),
        partial(train, other),
    ]
    for number, call in enumerate(calls, start=1):
        once = {"choice": "true", "deviations": (8.0,), **call.keywords}
        kept = call(**once, checkpoint=tmp_path)
        assert len(os.listdir(tmp_path)) == number
        plain = call(**once)
        np.testing.assert_array_equal(kept.value.coef_, plain.value.coef_)
        assert kept.score == plain.score


@pytest.mark.slow
def test_more_seeds_go_on_from_fewer(tmp_path, split):
    """Asking for a second seed later trains that one only, and tells of both in the settings."""
    train(split, choice="true", checkpoint=tmp_path)
    trained = train(split, choice="true", seeds=2, checkpoint=tmp_path)
    assert len(os.listdir(tmp_path)) == 2
    assert trained.settings["seeds"] == 2
    assert trained.score == train(split, choice="true", seeds=2).score


# Divergence.


def test_a_seed_that_diverges_is_told_and_left_out(split):
    """If one of two seeds fails the other is returned, with the failure."""
    failing = Scripted(lambda seed: TrainingError("diverged: costs of 1e9") if seed == 0 else 1.0, 1.0)
    trained = train(split, failing, choice="true", seeds=2)
    assert trained.failures == ["diverged: costs of 1e9"]
    assert {row["seed"] for row in trained.record} == {1}


def test_a_later_round_that_diverges_is_recorded(split):
    """The best round before it is returned; the record says what happened."""
    trained = train(
        split, Scripted(2.0, TrainingError("diverged: costs of 1e9"), 3.0), choice="true", deviations=[1] * 3
    )
    assert [row["error"] for row in trained.record] == [None, "diverged: costs of 1e9"]
    assert trained.value.cost == 2.0


def test_if_all_diverge_nothing_is_returned(split):
    """A TrainingError, the first seed's."""
    with pytest.raises(TrainingError, match="costs of seed 4"):
        train(split, Scripted(lambda seed: TrainingError(f"costs of seed {seed}")), choice="true", seeds=2, seed=4)


@pytest.mark.parametrize("cost", [np.nan, np.inf])
def test_costs_that_are_no_numbers_are_a_divergence(split, cost):
    """A value function that has run off to NaN or infinity without saying so is noticed."""
    with pytest.raises(TrainingError, match="no numbers"):
        train(split, Scripted(cost), choice="true", deviations=(1.0,))
    trained = train(split, Scripted(1.0, cost), choice="true")
    assert trained.value.cost == 1.0
    assert "no numbers" in trained.record[1]["error"]


@pytest.mark.slow
def test_a_policy_worse_than_myopic_is_refused(split):
    """If validation says that not waiting at all earns more, that is an error with the interval, not a policy."""
    with pytest.raises(TrainingError, match=r"led nowhere.*less than the myopic policy \(95 % interval"):
        train(split, Scripted(40.0, 40.0), choice="true")
    assert train(split, Scripted(0.0, 0.0), choice="true").value.cost == 0.0  # no worse is good enough


class Exploding(LinearValue):
    """A linear value function whose targets feed on themselves."""

    def fit(self, experience):
        """Fit to the experience's targets, a thousand times too large where any cost is there already."""
        targets = type(experience).target_differences

        class Feeding(type(experience)):
            def target_differences(self, value, step):
                return 40.0 * targets(self, value, step)

        return super().fit(Feeding(*(getattr(experience, name) for name in experience.__dataclass_fields__)))


def test_targets_that_explode_are_not_returned(split):
    """A sweep that multiplies costs from step to step ends in a TrainingError with the step and a remedy."""
    with pytest.raises(TrainingError, match=r"diverged: opportunity costs of .* at step \d+; raise ridge"):
        train(split, Exploding(), choice="true")


# Arguments.


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"discount": 1.5}, r"discount = 1\.5"),
        ({"discount": -0.1}, r"discount = -0\.1"),
        ({"discount": np.nan}, "discount = nan"),
        ({"discount": "all"}, "discount = 'all'"),
        ({"deviations": ()}, r"deviations = \(\)"),
        ({"deviations": (-1.0,)}, "deviations"),
        ({"deviations": (np.nan,)}, "deviations"),
        ({"deviations": (np.inf,)}, "deviations"),
        ({"deviations": 8.0}, r"deviations has shape \(\)"),
        ({"deviations": "ab"}, "deviations holds text"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 0.5}, r"seed = 0\.5"),
        ({"seeds": 0}, "seeds = 0"),
        ({"seeds": 1.5}, r"seeds = 1\.5"),
        ({"seeds": True}, "seeds = True"),
        ({"ridge": 1.0}, "no setting 'ridge'; there are deviations, discount, seeds, seed"),
        ({"choice": "guessed"}, "choice = 'guessed'"),
        ({"choice": None}, "choice = None"),
        ({"value": "quadratic"}, "value = 'quadratic' is unknown"),
        ({"value": object()}, "a object is no value function"),
        ({"value": LinearValue}, r"LinearValue is a class: pass one of its instances, LinearValue\(\)"),
        ({"value": LinearValue(ridge=-1.0)}, "ridge = -1"),
    ],
)
def test_bad_arguments_are_refused(split, arguments, words):
    """Arguments out of range are errors of ours, which name them."""
    with pytest.raises(InputError, match=words) as caught:
        train(split, **{"choice": "true", **arguments})
    assert "\n" not in str(caught.value)


def test_several_seeds_need_validation(split):
    """Without validation instances there is nothing to choose between seeds by."""
    with pytest.raises(InputError, match="seeds = 2 need validation instances"):
        train(split.train, choice="true", seeds=2)


def test_nothing_to_train_on_is_refused(split):
    """No instances, instances without requests or noise, and what is no instance are errors of ours."""
    empty = scenario("I.1", seed=0, request_rate=0.0).sample(2, seed=0)
    for instances in ([], empty, Split([], [], split.validation), 5, "I.1", [split.train]):
        with pytest.raises(InputError):
            train(instances, choice="true")
    with pytest.raises(InstanceError, match="noise"):
        train([replace(split.train[0], noise=None, outside_noise=None)], choice="true")


@pytest.mark.slow
def test_sources(split):
    """A scenario is split by itself; one instance is a sequence of one."""
    source = scenario("I.1", seed=0, split=(30, 1, 10), horizon=STEPS)
    whole, parts = train(source, choice="true"), train(source.split(), choice="true")
    np.testing.assert_array_equal(whole.value.coef_, parts.value.coef_)
    one, alone = train(split.train[0], choice="true"), train(split.train[:1], choice="true")
    np.testing.assert_array_equal(one.value.coef_, alone.value.coef_)


@pytest.mark.slow
def test_more_instances_can_be_drawn_for_a_scenario(split):
    """They take the place of the split's, with as many in proportion to choose by."""
    source = scenario("I.1", seed=0, split=(30, 1, 10), horizon=STEPS)
    more = train(source, choice="true", instances=50)
    drawn = Split(source.further("train", 50), [], source.further("validation", 17))  # 10 for 30
    by_hand = train(drawn, choice="true")
    np.testing.assert_array_equal(more.value.coef_, by_hand.value.coef_)
    assert more.record[0]["score"] == by_hand.record[0]["score"]
    for other in (split, split.train):
        with pytest.raises(InputError, match="instances = 50 can be drawn from a scenario only"):
            train(other, choice="true", instances=50)
    for wrong in (-1, 0, 1.5, True, "many"):
        with pytest.raises(InputError, match=f"instances = {wrong!r} is not a whole number of at least 1"):
            train(source, choice="true", instances=wrong)


def test_settings_are_plain():
    """Settings become plain numbers, whatever kind of numbers they came as."""
    made = TrainingSettings(np.array([8, 4]), np.float64(1.0), np.int64(2), np.int64(3))
    assert made == TrainingSettings((8.0, 4.0), 1.0, 2, 3)
    assert [type(x) for x in (*made.deviations, made.discount, made.seeds, made.seed)] == [
        float,
        float,
        float,
        int,
        int,
    ]


def test_validation_is_run_in_several_moods(split):
    """The score is the mean reward over the validation instances with the workers' noise drawn anew MOODS times."""
    batches = []

    class Watching(Scripted):
        def opportunity_cost(self, sets):
            batches.append(len(sets.requests.reward))
            return super().opportunity_cost(sets)

    train(split, Watching(1.0), choice="true", deviations=(1.0,))
    assert max(batches) == MOODS * sum(one.n_requests for one in split.validation) + 1


def test_days_of_other_groups_are_refused():
    """Workers of one day's only group are not those of another's first."""
    days = scenario("II", seed=0, horizon=8).sample(4, 1)
    one = [replace(d, utility=d.utility[:1], mu=d.mu[:1], worker_group=0 * d.worker_group) for d in days[:2]]
    with pytest.raises(InputError, match="1 and 3 worker groups"):
        train([*one, *days[2:]])
