"""The mean of value functions: its values and costs, its file, and what it refuses."""

import json

import numpy as np
import pytest
from sklearn.base import clone

from optkit import scenario, simulate
from optkit.basics.errors import DataError, InputError, TrainingError
from optkit.learning.trained import Trained
from optkit.learning.training import train
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.mean import MeanValue
from optkit.models.value.request_sets import ZeroSetValue, removal_differences
from optkit.policies import PostDecisionPricing
from optkit.simulation.metrics import mean_interval


@pytest.fixture(scope="module")
def days():
    """Few and short: quick trainings."""
    return scenario("II", seed=0, horizon=15).sample(30, seed=1)


@pytest.fixture(scope="module")
def trained(days):
    """A mean of the default members."""
    return train(days, "mean", choice="true", deviations=(5.0,))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_values_and_costs_are_the_members_means(trained, random_sets, seed):
    """The costs are also the differences of the values, found by leaving out each member (1e-9: sums below 1000)."""
    mean, sets = trained.value, random_sets(seed, b=5, groups=3)
    first, second, third, fourth = mean.values_
    assert mean.sees_busy
    value = (first.value(sets) + second.value(sets) + third.value(sets) + fourth.value(sets)) / 4
    np.testing.assert_allclose(mean.value(sets), value, atol=1e-12)
    np.testing.assert_array_equal(mean.predict(sets), mean.value(sets))
    cost = sum(one.opportunity_cost(sets) for one in mean.values_) / 4
    np.testing.assert_allclose(mean.opportunity_cost(sets), cost, atol=1e-12)
    np.testing.assert_allclose(mean.opportunity_cost(sets), removal_differences(mean.value, sets), atol=1e-9)


@pytest.mark.slow
def test_members_are_fitted_as_they_would_be_alone(days):
    """To the experience of one policy each member is fitted with targets of its own; the caller's stay as they were."""
    members = [LinearValue(), KernelValue()]
    mean = train(days, MeanValue(members), choice="true", deviations=(5.0,))
    for member, fitted in zip(members, mean.value.values_, strict=True):
        alone = train(days, member, choice="true", deviations=(5.0,)).value
        np.testing.assert_array_equal(fitted.coef_, alone.coef_)
        assert not hasattr(member, "coef_")
    residuals = [one.residual_ for one in mean.value.values_]
    assert mean.value.residual_ == pytest.approx(np.sqrt((residuals[0] ** 2 + residuals[1] ** 2) / 2))
    assert min(residuals) > 0


@pytest.mark.slow
def test_one_member_is_that_member(days):
    """The mean of one value function prices as it does; of exploration it brings its own, which a setting overrides."""
    alone = train(days, LinearValue(), choice="true", deviations=MeanValue.deviations)
    mean = train(days, MeanValue([LinearValue()]), choice="true")
    assert not mean.value.sees_busy
    np.testing.assert_array_equal(simulate(days, mean.policy).reward, simulate(days, alone.policy).reward)
    assert mean.settings["deviations"] == MeanValue.deviations
    assert train(days, MeanValue([LinearValue()]), choice="true", deviations=(3.0,)).settings["deviations"] == (3.0,)


@pytest.mark.slow
def test_waiting_pays_on_fresh_instances():
    """Against the myopic policy, paired on 150 instances, the 95 % interval excludes zero."""
    source = scenario("I.1", seed=0, horizon=25)
    policy = train(source, "mean", choice="true", instances=100).policy
    fresh = source.sample(150, seed=6)
    assert mean_interval(simulate(fresh, policy).reward, simulate(fresh, PostDecisionPricing()).reward).low > 0


@pytest.mark.slow
def test_the_file_prices_as_the_policy_did(trained, days, tmp_path):
    """It holds all members; damaged ones, none, and a mean of means are refused in one line."""
    path = trained.save(tmp_path / "mean.json")
    again = Trained.load(path)
    fresh = scenario("II", seed=0, horizon=15).sample(20, seed=2)
    np.testing.assert_array_equal(simulate(fresh, again.policy).reward, simulate(fresh, trained.policy).reward)
    whole = json.loads(path.read_text())
    del whole["sha256"]  # as who edits a file does
    mean = whole["value"]
    for damaged, words in (
        ({"kind": "MeanValue"}, "it has no members"),
        ({"kind": "MeanValue", "values": []}, "it has no members"),
        ({"kind": "MeanValue", "values": [3]}, "it has no members"),
        ({"kind": "MeanValue", "values": [mean]}, "one of its members is a mean"),
        ({"kind": "MeanValue", "values": [{"kind": "LinearValue"}]}, "cannot be read"),
    ):
        path.write_text(json.dumps({**whole, "value": damaged}))
        with pytest.raises(DataError, match=words) as caught:
            Trained.load(path)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_misuse_is_told(days, tmp_path, random_sets):
    """No members, not fitted, and members that cannot be written are errors of ours."""
    for members, words in (
        ([], r"values = \[\] must be a list"),
        (LinearValue(), "must be a list of at least one value function"),
        ([LinearValue(), KernelValue], r"values\[1\] = .* is no value function"),
        ([3], r"values\[0\] = 3 is no value function: it needs fit, value, opportunity_cost"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            train(days, MeanValue(members), choice="true")
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="not fitted"):
        MeanValue().value(random_sets(0))
    with pytest.raises(InputError, match="ridge = -1"):
        train(days, MeanValue([LinearValue(), LinearValue(ridge=-1.0)]), choice="true")

    class Own(ZeroSetValue):
        def fit(self, experience):
            return self

    with pytest.raises(InputError, match="a Own has no to_dict: it cannot be kept in a checkpoint"):
        train(days, MeanValue([LinearValue(), Own()]), choice="true", checkpoint=tmp_path / "kept")
    own = train(days, MeanValue([LinearValue(), Own()]), choice="true", deviations=(5.0,))
    assert np.isnan(own.value.residual_)
    with pytest.raises(InputError, match="a mean with a Own in it cannot be written"):
        own.save(tmp_path / "own.json")


def test_after_an_error_all_is_as_it_was(drawn):
    """If a member diverges, no other has moved either."""

    class Failing(LinearValue):
        def fit(self, experience, y=None):
            if hasattr(self, "coef_"):
                raise TrainingError("it diverged")
            return super().fit(experience)

    first, second = drawn(b=30), drawn(b=60)
    mean = MeanValue([LinearValue(), Failing()]).fit(first)
    before, residual = mean.values_[0].coef_.copy(), mean.residual_
    with pytest.raises(TrainingError, match="it diverged"):
        mean.fit(second)
    np.testing.assert_array_equal(mean.values_[0].coef_, before)
    assert mean.residual_ == residual
    assert (LinearValue().fit(second).coef_ != before).any()


@pytest.mark.slow
def test_other_members_replace_those_that_were_fitted(drawn, trained, tmp_path):
    """Members go on from round to round only while they are the same; a mean from a file knows its own."""

    class Counting(LinearValue):
        rounds = 0

        def fit(self, experience, y=None):
            self.rounds += 1
            return super().fit(experience)

    experience = drawn()
    mean = MeanValue([Counting()])
    assert mean.fit(experience).fit(experience).values_[0].rounds == 2
    mean.set_params(values=[KernelValue(landmarks=3)]).fit(experience)
    assert [type(one) for one in mean.values_] == [KernelValue]
    again = Trained.load(trained.save(tmp_path / "mean.json")).value
    assert [type(one) for one in clone(again).values] == [LinearValue, KernelValue, LinearValue, LinearValue]
    assert MeanValue().fit(experience).values_[2].busy_knots is not None  # one group
    assert [one.by_group for one in again.values_[2:]] == [True, True]  # three
    assert not hasattr(clone(again).values[0], "coef_")


def test_it_has_parameters():
    """As scikit-learn's estimators have."""
    mean = MeanValue([LinearValue(ridge=3.0)])
    assert clone(mean).values[0].ridge == 3.0
    assert MeanValue().get_params() == {"values": None}
