"""Preferences are applied by the names of groups and features, in whatever order instances have them."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError
from optkit.learning.training import train

GROUPS, FEATURES = ("bike", "car", "van"), ("a", "b", "c", "d")


def days(count, groups=GROUPS, features=FEATURES):
    """Days of scenario II with groups and features in some order."""
    g, f = [GROUPS.index(name) for name in groups], [FEATURES.index(name) for name in features]
    place = np.argsort(g)
    return [
        replace(
            day, utility=day.utility[g], mu=day.mu[g], worker_group=place[day.worker_group],
            features=day.features[:, f], group_names=groups, feature_names=features,
        )
        for day in scenario("II", seed=0, horizon=12).sample(count, seed=1)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def trained():
    return train(days(60), seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("groups", [("van", "bike", "car"), ("car", "van", "bike")])
@pytest.mark.parametrize("features", [FEATURES, ("d", "c", "a", "b")])
def test_the_order_of_names_does_not_matter(trained, groups, features):
    """A trained policy earns the same on the same days, whichever column comes first; so do the preferences alone."""
    assert trained.preferences.group_names == GROUPS
    assert trained.preferences.attributes.names == FEATURES
    usual, other = simulate(days(4), trained.policy), simulate(days(4, groups, features), trained.policy)
    assert other.reward == pytest.approx(usual.reward, rel=1e-9)
    mixed = trained.preferences.called(groups, features)
    assert mixed.called(GROUPS, FEATURES).to_dict() == trained.preferences.to_dict()
    assert mixed.table().set_index(["group", "parameter"])["estimate"].to_dict() == pytest.approx(
        trained.preferences.table().set_index(["group", "parameter"])["estimate"].to_dict()
    )


@pytest.mark.slow
def test_other_names_are_refused(trained):
    """Groups and features that the preferences never met."""
    with pytest.raises(InputError, match="know the groups bike, car, van, and not foot"):
        simulate([replace(day, group_names=("bike", "car", "foot")) for day in days(2)], trained.policy)
    with pytest.raises(InputError, match="know the features a, b, c, d, and not x"):
        simulate([replace(day, feature_names=("a", "b", "c", "x")) for day in days(2)], trained.policy)
    one, two = days(2)
    with pytest.raises(InputError, match="differently"):
        simulate([one, replace(two, group_names=("car", "bike", "van"))], trained.policy)
