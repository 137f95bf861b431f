"""Outcomes kept seed by seed: found again by the same training, and by no other."""

import importlib
import json
import linecache
import os
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.basics.plain_json import sealed, to_json
from optkit.instances.digest import LABELS, exact_digest
from optkit.instances.instance import Instance
from optkit.learning.checkpoints import Checkpoint
from optkit.learning.rounds import learn_once
from optkit.learning.trained import Trained
from optkit.learning.training import train
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.mean import MeanValue

SETTINGS = {"deviations": (8.0, 4.0), "discount": 1.0, "seeds": 1, "seed": 0}


@pytest.fixture(scope="module")
def days():
    """Eight instances."""
    return scenario("I.1", seed=0).sample(8, seed=1)


@pytest.fixture(scope="module")
def outcome(days):
    """Some outcome."""
    return train(days, choice="true")


def checkpoint(folder, days, **changes):
    """A checkpoint of a training, or of one that differs in something."""
    given = {
        "settings": SETTINGS,
        "estimator": LinearValue(),
        "choice": "true",
        "instances": days[:6],
        "validation": days[6:],
    }
    return Checkpoint(folder, **{**given, **changes})


@pytest.mark.slow
def test_what_was_kept_is_found(tmp_path, days, outcome):
    """Nothing is there at first; then the same training, described anew, finds each seed's own outcome."""
    one = checkpoint(tmp_path / "new" / "folder", days)
    assert one.load(0) is None
    one.save(0, outcome)
    again = checkpoint(tmp_path / "new" / "folder", [replace(day) for day in days])
    np.testing.assert_array_equal(again.load(0).value.coef_, outcome.value.coef_)
    assert again.load(1) is None


def test_no_folder_keeps_nothing(days, outcome):
    """Without a folder nothing is written or found."""
    one = checkpoint(None, days)
    one.save(0, outcome)
    assert one.load(0) is None


def test_more_seeds_go_on(tmp_path, days):
    """The number of seeds does not count: more seeds use those that are there."""
    more = checkpoint(tmp_path, days, settings={**SETTINGS, "seeds": 5})
    assert more.key == checkpoint(tmp_path, days).key


@pytest.mark.parametrize(
    "changes",
    [
        {"settings": {**SETTINGS, "deviations": (8.0,)}},
        {"settings": {**SETTINGS, "discount": np.nextafter(1.0, 0.0)}},
        {"settings": {**SETTINGS, "deviations": (8.0, np.nextafter(4.0, 5.0))}},
        {"settings": {**SETTINGS, "seed": 1}},
        {"estimator": LinearValue(ridge=np.nextafter(LinearValue().ridge, 9.0))},
        {"estimator": LinearValue(busy_knots=(0.0, 4.0))},
        {"estimator": KernelValue()},
        {"choice": "learned"},
        {"choice": "pooled"},
    ],
)
def test_another_training_is_another(tmp_path, days, changes):
    """Whatever is set otherwise, the outcome of the first training is not taken for the second's."""
    assert checkpoint(tmp_path, days, **changes).key != checkpoint(tmp_path, days).key


def test_the_members_of_a_mean_count(tmp_path, days, monkeypatch):
    """A default that has changed since, as an update of the kit may do, is another training."""
    before = checkpoint(tmp_path, days, estimator=MeanValue()).key
    assert checkpoint(tmp_path, days, estimator=MeanValue()).key == before
    monkeypatch.setattr("optkit.models.value.mean._default", lambda groups: [LinearValue(), KernelValue()])
    assert checkpoint(tmp_path, days, estimator=MeanValue()).key != before


def test_given_preferences_count(tmp_path, days):
    """Preferences that are given are part of the training."""
    one, other = (learn_once(days, seed=seed).preferences for seed in (0, 1))
    keys = {checkpoint(tmp_path, days, choice=choice).key for choice in (one, other, "true")}
    assert len(keys) == 3
    assert checkpoint(tmp_path, days, choice=one).key in keys


def up(values):
    """The next larger floats: one digit in the last place."""
    return np.nextafter(values, np.inf)


CHANGES = {
    "horizon": lambda day: day.horizon + 1,
    "arrival": lambda day: np.where(np.arange(day.n_requests) == 0, 0, day.arrival),
    "expiry": lambda day: np.minimum(day.expiry + 1, day.horizon - 1),
    "reward": lambda day: up(day.reward),
    "penalty": lambda day: -up(-day.penalty),
    "features": lambda day: up(day.features),
    "pickup": lambda day: day.pickup + 1,
    "dropoff": lambda day: day.dropoff + 1,
    "worker_step": lambda day: np.append(0, day.worker_step[1:]),
    "worker_group": lambda day: np.zeros_like(day.worker_group) + 1,
    "utility": lambda day: up(day.utility),
    "mu": lambda day: up(day.mu),
    "outside_utility": lambda day: up(day.outside_utility),
    "noise": lambda day: up(day.noise),
    "outside_noise": lambda day: up(day.outside_noise),
}


@pytest.mark.slow
@pytest.mark.parametrize("part", ["instances", "validation"])
@pytest.mark.parametrize("name", [field.name for field in fields(Instance) if field.name not in LABELS])
def test_other_instances_are_another_training(tmp_path, days, name, part):
    """Every field of every instance but labels counts, in what is trained on and in what is chosen by."""
    days = scenario("II", seed=0).sample(4, seed=1) if name == "worker_group" else days
    own = {"instances": days[:2], "validation": days[2:4]}
    late = own[part][1]
    assert not np.array_equal(CHANGES[name](late), getattr(late, name))
    changed = {**own, part: [own[part][0], replace(late, **{name: CHANGES[name](late)})]}
    assert checkpoint(tmp_path, days, **changed).key != checkpoint(tmp_path, days, **own).key


@pytest.mark.slow
def test_another_process_knows_the_instances_again():
    """The digest says what instances are, not where: noise that is not realised, as in arrivals, had an address."""
    code = (
        "from dataclasses import replace; from optkit import scenario;"
        "from optkit.instances.digest import exact_digest;"
        "day = scenario('I.2', seed=0, horizon=10).sample(1, seed=1)[0];"
        "print(exact_digest([day, replace(day, noise=None, outside_noise=None)]).hex())"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout
    day = scenario("I.2", seed=0, horizon=10).sample(1, seed=1)[0]
    assert told.strip() == exact_digest([day, replace(day, noise=None, outside_noise=None)]).hex()


def test_who_is_for_training_counts(tmp_path, days):
    """The same instances cut at another place are another training."""
    one = checkpoint(tmp_path, days, instances=days[:5], validation=days[5:])
    assert one.key != checkpoint(tmp_path, days).key
    assert one.key != checkpoint(tmp_path, days, instances=days, validation=[]).key


@pytest.mark.parametrize("cut", [0, 30, -3])
def test_damaged_files_are_not_there(tmp_path, days, outcome, cut):
    """A file that was cut off counts as none, and can be written again."""
    one = checkpoint(tmp_path, days)
    one.save(0, outcome)
    (name,) = os.listdir(tmp_path)
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:cut])
    assert one.load(0) is None
    one.save(0, outcome)
    assert one.load(0) is not None


@pytest.mark.parametrize("content", [b"{}", b"\xff", b"a diary"])
def test_what_is_not_ours_stays(tmp_path, days, outcome, content):
    """Something else in the place of an outcome is said before the training, and stays."""
    one = checkpoint(tmp_path, days)
    path = tmp_path / f"{one.key}-seed-0.json"
    path.write_bytes(content)
    for ask in (lambda: one.load(0), lambda: one.save(0, outcome)):
        with pytest.raises(DataError, match=r"seed-0.json is not a trained policy that optkit kept, so it stays"):
            ask()
    assert path.read_bytes() == content


def test_another_release_is_named(tmp_path, days, outcome):
    """What another release trained is not taken, nor replaced: its numbers may be others."""
    one = checkpoint(tmp_path, days)
    one.save(0, outcome)
    (path,) = tmp_path.iterdir()
    path.write_text(to_json(sealed(json.loads(path.read_text()) | {"optkit": "0.0.9"})))
    with pytest.raises(DataError, match=r"was written by optkit 0.0.9, and this is .* choose another folder"):
        one.load(0)


def test_the_code_of_ones_own_value_function_counts(tmp_path, days, monkeypatch):
    """A class that was edited since, in a file or at a prompt, is another training by the same settings."""

    def key(source):
        told = {"__name__": "prompt", "LinearValue": LinearValue}
        exec(f"class Own(LinearValue):\n    def fit(self, experience):\n        {source}", told)
        return checkpoint(tmp_path, days, estimator=told["Own"]()).key

    assert key("return 1") == key("return 1")
    assert key("return 1") != key("return 2")
    monkeypatch.syspath_prepend(tmp_path)
    keys = set()
    for number in range(2):
        (tmp_path / "mine.py").write_text(
            f"from optkit.models.value import LinearValue\nSHARE = {number}\nclass Own(LinearValue):\n    pass\n"
        )
        sys.modules.pop("mine", None)
        linecache.clearcache()
        keys.add(checkpoint(tmp_path / "kept", days, estimator=importlib.import_module("mine").Own()).key)
    monkeypatch.delitem(sys.modules, "mine")
    assert len(keys) == 2


def test_the_file_is_a_trained_policy(tmp_path, days, outcome):
    """What is kept can be loaded and used like any trained policy."""
    checkpoint(tmp_path, days).save(0, outcome)
    (name,) = os.listdir(tmp_path)
    policy = Trained.load(tmp_path / name).policy
    np.testing.assert_array_equal(simulate(days, policy).reward, simulate(days, outcome.policy).reward)


def test_a_folder_that_cannot_be_made(tmp_path, days):
    """A file where the folder should be is an OptkitError, before any work is done."""
    (tmp_path / "file").write_text("")
    with pytest.raises(OptkitError, match="file cannot be written"):
        checkpoint(tmp_path / "file", days)


def test_what_cannot_be_written_is_refused_at_once(tmp_path, days):
    """A value function without to_dict is an InputError that names it."""
    with pytest.raises(InputError, match="a object has no to_dict"):
        checkpoint(tmp_path, days, estimator=object())
