"""A trained policy's file: exact after the round trip, refused with one clear line where it is damaged."""

import json
import os
from functools import partial

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.instances.scenario import Split
from optkit.learning import training
from optkit.learning.rounds import learn_preferences
from optkit.learning.trained import Trained
from optkit.learning.training import train
from optkit.models.value import KernelValue, LinearValue
from optkit.policies import PostDecisionPricing

STEPS = 12
"""Of the days."""


@pytest.fixture(scope="module")
def days():
    """Thirty instances of one group, thirty of three."""
    return {name: scenario(name, seed=0, horizon=STEPS).sample(30, seed=1) for name in ("I.1", "II")}


@pytest.fixture(scope="module")
def trained(days):
    """A small policy with each form of value function and choice."""
    forms = {
        "linear": ("I.1", "linear", "true"),
        "linear learned": ("II", LinearValue(by_group=True), "learned"),
        "linear busy": ("I.1", LinearValue(busy_knots=(0.0, 4.0)), "true"),
        "kernel": ("I.1", "kernel", "true"),
        "kernel pooled": ("II", KernelValue(landmarks=4), "pooled"),
    }
    with pytest.MonkeyPatch.context() as patched:  # two rounds of preferences, of up to eight, say as much of a file
        patched.setattr(training, "learn_preferences", partial(learn_preferences, rounds=2))
        return {label: train(days[name], value, choice=choice) for label, (name, value, choice) in forms.items()}


@pytest.fixture(scope="module")
def written(trained, tmp_path_factory):
    """What a file says; it is read as it is, and without its digest too."""
    path = trained["kernel pooled"].save(tmp_path_factory.mktemp("policy") / "policy.json")
    Trained.load(path)
    whole = path.read_text()
    path.write_text(json.dumps({name: part for name, part in json.loads(whole).items() if name != "sha256"}))
    Trained.load(path)
    return whole


def prices(instances, policy):
    """All compensations that a policy offers in a run."""
    seen = []
    simulate(instances, policy, observe=lambda state, offer, taken: seen.append(offer[state.offered]))
    return np.concatenate(seen)


@pytest.mark.slow
@pytest.mark.parametrize("label", ["linear", "linear learned", "linear busy", "kernel", "kernel pooled"])
def test_prices_are_the_same_after_the_round_trip(tmp_path, days, trained, label):
    """Every price on fresh instances is the same to the last digit, and so is the file when written again."""
    one = trained[label]
    path = one.save(tmp_path / "policy.json")
    again = Trained.load(path)
    fresh = scenario("I.1" if one.preferences is None else "II", seed=0, horizon=STEPS).sample(30, seed=2)
    np.testing.assert_array_equal(prices(fresh, again.policy), prices(fresh, one.policy))
    myopic = simulate(fresh, PostDecisionPricing(choice=one.policy.choice)).reward
    assert (simulate(fresh, again.policy).reward != myopic).any()
    assert again.score == one.score
    assert again.record == one.record
    assert again.save(tmp_path / "again.json").read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_the_file_is_plain_json(tmp_path, trained):
    """Anybody can read it: format, version, terms, coefficients and preferences, and nothing that is not finite."""
    one = trained["linear learned"]
    text = one.save(tmp_path / "policy.json").read_text()

    def refuse(name):
        raise AssertionError(name)

    plain = json.loads(text, parse_constant=refuse)
    assert (plain["format"], plain["version"]) == ("optkit trained policy", 1)
    assert plain["value"]["coef"] == one.value.coef_.tolist()
    assert plain["preferences"]["weights"] == one.preferences.weights.tolist()
    assert plain["settings"] == {"deviations": [8.0, 4.0], "discount": 1.0, "seeds": 1, "seed": 0}
    assert plain["source"] == {"choice": "learned", "instances": 30, "horizon": STEPS}
    assert text.isascii()


def test_the_record_as_a_table(trained):
    """One row per round, with the columns that the class promises."""
    table = trained["kernel"].table()
    assert table.columns.tolist() == ["seed", "round", "deviation", "score", "residual", "seconds", "error"]
    assert table["round"].tolist() == [1, 2]
    assert table["deviation"].tolist() == [8.0, 4.0]
    assert (table["residual"] > 0).all()


def test_learned_preferences_come_back(tmp_path, trained):
    """Weights, scales, places and standard errors are those that were learned."""
    one = trained["linear learned"].preferences
    again = Trained.load(trained["linear learned"].save(tmp_path / "policy.json")).preferences
    np.testing.assert_array_equal(again.weights, one.weights)
    np.testing.assert_array_equal(again.scale, one.scale)
    assert again.attributes == one.attributes
    assert again.pooled == one.pooled
    for a, b in zip(again.covariance, one.covariance, strict=True):
        np.testing.assert_array_equal(a, b)


def test_saving_replaces_whole_files(tmp_path, trained):
    """An older file is replaced; nothing else is left in the folder."""
    path = tmp_path / "policy.json"
    path.write_text("old")
    assert trained["kernel"].save(str(path)) == path
    assert Trained.load(str(path)).value.coef_.shape == trained["kernel"].value.coef_.shape
    assert os.listdir(tmp_path) == ["policy.json"]


def test_where_nothing_can_be_written(tmp_path, trained):
    """A missing folder, a folder in place of a file, and no name at all are OptkitErrors; no scraps are left."""
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "none" / "policy.json", tmp_path / "folder", ""):
        with pytest.raises(OptkitError) as caught:
            trained["linear"].save(path)
        assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == ["folder"]


def test_a_value_function_of_ones_own_is_not_written(tmp_path, days):
    """Without to_dict there is nothing to write: an InputError that names the class."""

    class Nothing:
        def fit(self, experience):
            return self

        def value(self, sets):
            return np.zeros(len(sets))

        def opportunity_cost(self, sets):
            return np.zeros(sets.member.shape)

    with pytest.raises(InputError, match="Nothing has no to_dict"):
        train(days["I.1"][:5], Nothing(), choice="true").save(tmp_path / "policy.json")
    assert not os.listdir(tmp_path)


def refused(path):
    """Load a file that must be refused; return the message."""
    with pytest.raises(DataError) as caught:
        Trained.load(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no JSON"),
        (b"\xff\xfe\x00", "no JSON"),
        (b"{", "no JSON"),
        (b"[" * 100_000, "no JSON"),
        (b"[]", "no trained policy"),
        (b"null", "no trained policy"),
        (b'{"format": "something else", "version": 1}', "no trained policy"),
        (b'{"format": "optkit trained policy"}', "version None"),
        (b'{"format": "optkit trained policy", "version": 2}', "version 2"),
        (b'{"format": "optkit trained policy", "version": 1}', "incomplete"),
        (b"\x80\x04\x95\x0a\x00\x00\x00\x00\x00\x00\x00\x8c\x06policy\x94.", "no JSON"),
    ],
    ids=["empty", "binary", "open", "deep", "list", "null", "foreign", "no version", "new", "bare", "pickle"],
)
def test_foreign_files(tmp_path, content, words):
    """What is no trained policy is a DataError that says what it is instead."""
    path = tmp_path / "policy.json"
    path.write_bytes(content)
    assert words in refused(path)


def test_files_that_are_not_there(tmp_path):
    """A missing file and a folder are DataErrors."""
    assert "cannot be read" in refused(tmp_path / "none.json")
    assert "cannot be read" in refused(tmp_path)


def test_truncated_files(tmp_path, trained):
    """However little is missing at the end, the file is refused."""
    path = trained["kernel"].save(tmp_path / "policy.json")
    whole = path.read_bytes()
    for size in (1, len(whole) // 2, len(whole) - 2):
        path.write_bytes(whole[:size])
        assert "no JSON" in refused(path)


def changed(plain, where, what):
    """A deep copy with something else in one place."""
    copy = json.loads(json.dumps(plain))
    inner = copy
    for key in where[:-1]:
        inner = inner[key]
    inner[where[-1]] = what
    return copy


TERM = ("value", "terms", 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "what"),
    [
        (("value",), None),
        (("value",), []),
        (("value",), "linear"),
        (("value", "kind"), "Other"),
        (("value", "settings"), {"nonsense": 1}),
        (("value", "terms"), []),
        (("value", "terms"), None),
        (("value", "coef"), []),
        (("value", "coef"), [[0.0]]),
        (("value", "coef", 0, 0), float("nan")),
        (("value", "coef", 0, 0), float("inf")),
        (("value", "coef", 0, 0), None),
        (("value", "coef", 0, 0), True),
        (("value", "coef", 0, 0), "1.5"),
        (("score",), "3"),
        (("value", "coef", 0, 0), 10**400),
        (("value", "coef", 0), [1.0]),
        ((*TERM, "order"), "reward"),
        ((*TERM, "order"), -1),
        ((*TERM, "rank_knots"), [3.0, 1.0, 0.0]),
        ((*TERM, "features"), []),
        ((*TERM, "features", "kind"), "spline"),
        ((*TERM, "features", "gamma"), float("nan")),
        ((*TERM, "features", "scale"), [1.0]),
        ((*TERM, "features", "center", 0), float("nan")),
        ((*TERM, "features", "landmarks", 0, 0), float("inf")),
        (("preferences",), "true"),
        (("preferences",), {}),
        (("preferences", "weights"), [[1.0]]),
        (("preferences", "weights", 0, 0), float("nan")),
        (("preferences", "scale", 0), -1.0),
        (("preferences", "attributes", "pickups"), "many"),
        (("score",), None),
        (("score",), float("nan")),
        (("score",), 10**400),
        (("settings",), [1]),
        (("record",), "long"),
        (("record",), [1]),
        (("failures",), 3),
    ],
)
def test_damaged_files(tmp_path, written, where, what):
    """One wrong entry anywhere, and the file is refused in one line, without a digest too."""
    path, plain = tmp_path / "policy.json", json.loads(written)
    path.write_text(json.dumps(changed(plain, where, what)))
    assert "was changed or damaged" in refused(path)
    del plain["sha256"]
    path.write_text(json.dumps(changed(plain, where, what)))
    refused(path)


@pytest.mark.parametrize("name", ["value", "preferences", "score", "settings", "record", "failures"])
def test_missing_parts(tmp_path, trained, name):
    """Every part is needed; the message says which one is missing."""
    path = trained["linear"].save(tmp_path / "policy.json")
    plain = json.loads(path.read_text())
    del plain[name], plain["sha256"]
    path.write_text(json.dumps(plain))
    assert name in refused(path)


@pytest.mark.parametrize(("label", "words"), [("linear learned", "group"), ("kernel", "1 worker groups")])
def test_instances_that_the_policy_does_not_know(days, trained, label, words):
    """Other worker groups than in training are an InputError that says so, and so is a longer horizon."""
    other = days["I.1" if label == "linear learned" else "II"]
    with pytest.raises(InputError, match=words):
        simulate(other, trained[label].policy)
    longer = scenario("I.1", seed=0, horizon=90).sample(5, seed=0)
    with pytest.raises(InputError, match="beyond the 12 steps"):
        simulate(longer, trained["kernel"].policy)


def test_the_outcome_of_a_split_keeps_its_score(tmp_path, days):
    """With validation instances the score is what the policy earns there; it is kept in the file."""
    one = train(Split(days["I.1"], [], days["I.1"][:10]), choice="true")
    assert one.score == max(row["score"] for row in one.record)
    assert Trained.load(one.save(tmp_path / "policy.json")).score == one.score
