"""Light value functions as estimators; their laws are in test_laws.py, and test_value_exactly.py knows the truth."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone

from optkit.basics.errors import InputError, TrainingError
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.catalogue import value_of
from optkit.models.value.features import HatFeatures
from optkit.models.value.ranked_term import RankedTerm

FORMS = pytest.mark.parametrize(
    "form",
    [
        LinearValue(),
        LinearValue(by_group=True),
        LinearValue(busy_knots=(0.0, 3.0, 10.0)),
        KernelValue(landmarks=5),
        KernelValue(landmarks=5, busy_knots=(0.0, 3.0, 10.0)),
    ],
    ids=["linear", "by group", "busy", "kernel", "busy kernel"],
)


@pytest.mark.slow
@FORMS
@pytest.mark.parametrize("groups", [1, 3])
def test_a_function_of_the_form_is_found(random_sets, drawn, form, groups):
    """Where the targets are of the form itself, a small ridge finds them again, on sets never seen (1e-3 money)."""
    template = clone(form).fit(drawn(groups=groups, b=200))
    theta = np.random.default_rng(5).normal(size=template.coef_.shape[1])
    template.coef_ = np.tile(theta, (4, 1))

    found = clone(form).set_params(ridge=1e-7)
    found.fit(drawn(lambda sets, _: template.opportunity_cost(sets), groups=groups, b=200))
    sets = random_sets(77, 20, 6, groups, ties=False)
    truth = template.opportunity_cost(sets)
    np.testing.assert_allclose(found.opportunity_cost(sets), truth, atol=1e-3)
    assert np.abs(truth).max() > 0.5
    assert found.residual_ < 1e-4


@FORMS
def test_nobody_ever_waits(random_sets, drawn, form):
    """With nothing to learn from nothing fails, and what waits is worth its penalty: it will expire."""
    experience = drawn()
    experience._sets = [None] * 3
    fitted = clone(form).fit(experience)
    assert not fitted.coef_.any()
    sets = random_sets(0)
    expired = np.where(sets.member, sets.penalty, 0.0)
    np.testing.assert_array_equal(fitted.opportunity_cost(sets), expired)
    np.testing.assert_array_equal(fitted.value(sets), expired.sum(axis=1))
    assert fitted.residual_ == 0.0


@pytest.mark.parametrize(
    ("seeing", "blind"),
    [
        (LinearValue(busy_knots=(0.0, 7.0, 14.0)), LinearValue()),
        (KernelValue(landmarks=8, busy_knots=(0.0, 7.0, 14.0)), KernelValue(landmarks=8)),
    ],
    ids=["linear", "kernel"],
)
def test_what_the_busy_stretch_tells_is_learned(random_sets, drawn, seeing, blind):
    """Targets that depend on the busy stretch are fitted better by a function that sees it; it says that it does."""

    def target(sets, value):
        return sets.penalty + (drawn.urgency(sets, value) - sets.penalty) * (1.0 + sets.busy[:, None] / 5.0)

    assert not seeing.sees_busy
    seeing, blind = (clone(form).fit(drawn(target, b=200)) for form in (seeing, blind))
    assert (seeing.sees_busy, blind.sees_busy) == (True, False)
    assert seeing.residual_ < 0.6 * blind.residual_
    with pytest.raises(InputError, match="pass busy"):
        seeing.value(replace(random_sets(0), busy=None))


def test_groups_rank_by_their_own_surplus(drawn):
    """Requests are ranked by mean surplus, or by each group's and by urgency."""
    one = LinearValue().fit(drawn())
    three = LinearValue(by_group=True).fit(drawn(groups=3))
    assert [t.order for t in one.terms_] == ["surplus"]
    assert [t.order for t in three.terms_] == [0, 1, 2, "urgency"]
    assert [t.features.group for t in three.terms_] == [0, 1, 2, None]
    surplus = drawn().requests.mean_surplus[:-1]  # the last is padding
    ends = np.quantile(surplus, [0.03, 0.97])
    np.testing.assert_allclose(one.terms_[0].features.surplus_knots, ends, rtol=1e-12)
    assert (one.coef_.shape, three.coef_.shape) == ((4, 18), (4, 72))


@FORMS
def test_it_is_an_estimator(random_sets, drawn, form):
    """Parameters are read and set, clones are unfitted and equal, predict is value, and fit returns the estimator."""
    experience, sets = drawn(), random_sets(0)
    one = clone(form)
    assert one.get_params() == form.get_params()
    assert one.fit(experience) is one
    np.testing.assert_array_equal(one.predict(sets), one.value(sets))
    again = clone(one)
    assert not hasattr(again, "coef_")
    again.set_params(ridge=50.0)
    assert again.ridge == 50.0
    assert one.ridge == 1.0
    assert np.abs(again.fit(experience).coef_).sum() < np.abs(one.coef_).sum()
    with pytest.raises(ValueError, match="Invalid parameter"):
        again.set_params(nonsense=1)


def test_parameters_count_at_the_next_fit(drawn):
    """A second fit starts afresh: with new parameters, and for other groups."""
    one = LinearValue().fit(drawn())
    one.set_params(surplus_knots=4, time_knots=(1.0, 5.0), rank_knots=(0.0, 2.0))
    assert one.fit(drawn()).coef_.shape == (4, 16)
    three = drawn(groups=3)
    np.testing.assert_array_equal(one.fit(three).coef_, clone(one).fit(three).coef_)
    kernel = KernelValue(landmarks=5).fit(drawn())
    assert kernel.set_params(landmarks=3).fit(three).coef_.shape == (4, 9)


def test_the_seed_places_the_landmarks(drawn):
    """The same seed gives the same landmarks; there are no more than different requests."""
    experience = drawn()
    one, two, other = (KernelValue(landmarks=4, seed=s).fit(experience) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.coef_, two.coef_)
    assert (one.terms_[0].features.landmarks != other.terms_[0].features.landmarks).any()
    few = drawn(b=1, ties=True)
    different = {(*s.surplus[0, i], s.steps_left[0, i]) for t in range(3) for s in [few.sets(t)] for i in
                 np.flatnonzero(s.member[0])}  # fmt: skip
    assert KernelValue(landmarks=50).fit(few).terms_[0].features.size == len(different)


@FORMS
def test_what_is_not_fitted_says_so(random_sets, drawn, form):
    """Without a fit, or beyond its steps, there is no value: an InputError that tells why."""
    one, sets = clone(form), random_sets(0)
    for ask in (one.value, one.opportunity_cost, one.predict, lambda _: one.to_dict()):
        with pytest.raises(InputError, match="is not fitted: call fit first"):
            ask(sets)
    one.fit(drawn())
    for step in (4, -1):
        late = replace(sets, step=step)
        with pytest.raises(InputError, match=f"step {step} is beyond the 4 steps"):
            one.opportunity_cost(late)


@pytest.mark.slow
@pytest.mark.parametrize(
    "explode",
    [
        lambda sets, value: sets.mean_surplus * 1e6,
        lambda sets, value: sets.mean_surplus * np.nan,
        lambda sets, value: 100.0 + 1e4 * np.abs(value.opportunity_cost(replace(sets, step=sets.step + 1))),
    ],
    ids=["large", "NaN", "feeding on itself"],
)
@FORMS
def test_an_explosion_is_a_training_error(drawn, form, explode):
    """Targets that explode are told, with the step and a remedy; the estimator stays as it was, fitted or not."""
    fine, bad = drawn(), drawn(explode, groups=3)
    one = clone(form)
    with pytest.raises(TrainingError, match=r"diverged: opportunity costs of .* at step \d; raise ridge"):
        one.fit(bad)
    assert vars(one) == vars(form)
    one.fit(fine)
    before = dict(vars(one))
    with pytest.raises(TrainingError):
        one.fit(bad)
    assert list(vars(one)) == list(before)
    assert all(vars(one)[name] is before[name] for name in before)


@pytest.mark.parametrize(
    ("form", "words"),
    [
        (LinearValue(ridge=-1.0), "ridge = -1"),
        (LinearValue(ridge=np.inf), "ridge = inf"),
        (LinearValue(ridge=np.nan), "ridge = nan"),
        (LinearValue(ridge="much"), "ridge = 'much'"),
        (LinearValue(memory=1.5), r"memory = 1\.5"),
        (KernelValue(memory="all"), "memory = 'all'"),
        (LinearValue(surplus_knots=1), "surplus_knots = 1"),
        (LinearValue(surplus_knots=2.5), r"surplus_knots = 2\.5"),
        (LinearValue(time_knots=(3.0, 1.0)), "time_knots"),
        (LinearValue(rank_knots=(0.0,)), "rank_knots"),
        (LinearValue(busy_knots=(1.0, 0.0)), "busy_knots"),
        (KernelValue(busy_knots=(1.0, 0.0)), "busy_knots"),
        (KernelValue(busy_knots="ab"), "busy_knots holds text"),
        (LinearValue(rank_knots="ab"), "rank_knots holds text"),
        (KernelValue(landmarks=0), "landmarks = 0"),
        (KernelValue(landmarks=1.5), r"landmarks = 1\.5"),
        (KernelValue(gamma=0.0), "gamma = 0"),
        (KernelValue(gamma=np.nan), "gamma = nan"),
    ],
)
def test_bad_settings(drawn, form, words):
    """Settings out of range are InputErrors that name them, and no half-fitted estimator is left."""
    with pytest.raises(InputError, match=words):
        form.fit(drawn())
    assert not hasattr(form, "coef_")
    assert not hasattr(form, "terms_")


def plain():
    """Plain data of a small value function with coefficients 0."""
    term = RankedTerm(HatFeatures(None, [0.0, 1.0], [1.0, 2.0]), "surplus", [0.0, 1.0])
    one = LinearValue()
    one.terms_, one.coef_ = [term], np.zeros((2, 8))
    return one.to_dict()


@pytest.mark.parametrize(
    "damage",
    [
        {"kind": "Pickle"},
        {"kind": []},
        {"settings": {"nonsense": 1}},
        {"settings": None},
        {"terms": None},
        {"terms": []},
        {"terms": ["a"]},
        {"terms": [{"order": "surplus", "rank_knots": [0.0, 1.0]}]},
        {"terms": [{**plain()["terms"][0], "busy_knots": [0.0, 1.0]}]},
        {"coef": None},
        {"coef": []},
        {"coef": [[0.0] * 7] * 2},
        {"coef": [[0.0] * 8, [0.0] * 7]},
        {"coef": [[[0.0] * 8]]},
        {"coef": [[float("nan")] * 8] * 2},
        {"coef": [[float("inf")] * 8] * 2},
        {"coef": [[None] * 8] * 2},
        {"coef": [[10**400] * 8] * 2},
        {"coef": [["a"] * 8] * 2},
    ],
)
def test_damaged_plain_data(damage):
    """What is no value function is an InputError of one line; what is not damaged is read."""
    assert value_of(plain()).coef_.shape == (2, 8)
    with pytest.raises(InputError) as caught:
        value_of({**plain(), **damage})
    assert "\n" not in str(caught.value)
