"""Policies are known by what they are."""

import subprocess
import sys
from collections import namedtuple
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.gap.policy_digest import policy_digest
from optkit.policies import PostDecisionPricing, RewardPercentage


def digest(policy):
    return policy_digest("mine", policy)


@dataclass(frozen=True)
class Paying:
    """A policy of one's own with a parameter."""

    share: float

    def __call__(self, state):
        """Pay a share."""
        return self.share * state.reward


class Slotted:
    """One whose state is in slots, and that keeps something for speed."""

    __slots__ = ("share",)

    def __init__(self, share):
        self.share = share


SHARE = 0.5


def by_global(state):
    """Pay what stands elsewhere."""
    return SHARE * state.reward


def by_attribute(share):
    """Pay what the function itself holds."""

    def paying(state):
        return paying.share * state.reward

    paying.share = share
    return paying


def remembered(share):
    """Pay by a function that remembers its answers."""
    return lru_cache(lambda reward: share * reward)


def named(share):
    """A tuple with a call of its own."""

    class Named(namedtuple("Named", "reward")):
        def __call__(self, state):
            return share * state.reward

    return Named(1.0)


class Table(dict):
    """A dict with an attribute."""

    def __init__(self, share):
        self.share = share


class Reticent:
    """One that copies less of itself than it uses."""

    def __init__(self, share):
        self.share = share

    def __getstate__(self):
        return {}


PAIRS = {
    "attributes": by_attribute,
    "remembered": remembered,
    "tuples": named,
    "dicts": Table,
    "reticent": Reticent,
    "constants": lambda x: lambda state: x * state.reward,
    "parameters": Paying,
    "slots": Slotted,
    "the kit's own": RewardPercentage,
    "partial": lambda x: partial(by_global, share=x),
    "method": lambda x: Paying(x).__call__,
    "arrays": lambda x: np.array([1.0, x]),
    "defaults": lambda x: eval(f"lambda state, share={x!r}: share"),
    "text": lambda x: eval(f"lambda state: {x!r} * state.reward"),
    "sets": lambda x: {1.0, x, "a"},
    "generators": lambda x: np.random.default_rng(int(x * 1e6)),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", PAIRS.values(), ids=PAIRS)
def test_what_differs_has_another_digest(make):
    """A number that moves by a millionth makes another policy, wherever it stands; made again, it is the same."""
    assert digest(make(0.5)) == digest(make(0.5))
    assert digest(make(0.5)) != digest(make(0.500001))


@pytest.mark.slow
def test_what_a_function_names_counts(monkeypatch):
    """A value in its module, a function that it calls, and code with other names."""
    before = digest(by_global)
    monkeypatch.setattr(sys.modules[__name__], "SHARE", 0.45)
    assert digest(by_global) != before
    assert digest(lambda state: np.exp(state.reward)) != digest(lambda state: np.sqrt(state.reward))
    assert digest(Paying(0.5)) != digest(RewardPercentage(0.5))


def test_a_file_is_known_by_what_it_does(tmp_path):
    """Read again, from elsewhere, or with a comment more, it is the same; with another number or helper it is not."""
    from optkit.cli.policy_file import own_policies

    text = "LOW = 0.4\ndef share(step):\n    return LOW + 0.01 * step\n"
    text += "def mine(state):\n    return share(state.step) * state.reward\n"
    versions = [text, "# a comment\n" + text, text.replace("0.01", "0.02"), text.replace("0.4", "0.41")]
    found = []
    for number, version in enumerate(versions):
        (tmp_path / f"own{number}.py").write_text(version)
        name = f"{tmp_path}/own{number}.py:mine"
        found.append(digest(own_policies([name])[name]))
    assert found[0] == found[1]
    assert len(set(found)) == 3


@pytest.mark.slow
def test_trained_policies_are_the_same_in_each_process():
    """Another process, with another seed of its hashes, comes to the same digest."""
    from optkit import scenario, train
    from optkit.learning.beliefs import BelievedValue

    code = (
        "from tests.gap.test_policy_digest import *\n"
        "print(digest({'a': PostDecisionPricing(), 'b': Paying(0.5), 'c': {'x', 'y', 'z'}}), digest(by_global))"
    )
    env = {"PYTHONHASHSEED": "1", "PYTHONPATH": "."}
    told = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=True, text=True).stdout
    here = digest({"a": PostDecisionPricing(), "b": Paying(0.5), "c": {"x", "y", "z"}}), digest(by_global)
    assert told.split() == list(here)
    made = [train(scenario("I.2", seed=0, horizon=8).sample(20, seed=s), "linear", choice="true") for s in (1, 1, 2)]
    same, again, other = (digest(PostDecisionPricing(value_function=BelievedValue(one.value))) for one in made)
    assert same == again
    assert same != other


def test_use_changes_nothing():
    """What a policy keeps for speed is no part of it."""
    from optkit import scenario, simulate, train

    days = scenario("I.2", seed=0, horizon=8).sample(5, seed=1)
    policy = train(days, "linear", choice="true").policy
    before = digest(policy)
    simulate(days, policy)
    assert digest(policy) == before


def test_what_has_no_lasting_form_is_refused(tmp_path):
    """One line that says to leave the checkpoint out."""
    with open(tmp_path / "file", "w") as file, pytest.raises(InputError, match="leave the checkpoint out"):
        digest(lambda state: file)


def test_what_hides_its_function_is_refused():
    with pytest.raises(InputError, match="hides the function"):
        digest(np.frompyfunc(lambda x: x, 1, 1))


@pytest.mark.parametrize("text", ["from helper import SHARE", "import helper; SHARE = helper.SHARE"])
def test_modules_that_a_function_imports_count(tmp_path, monkeypatch, text):
    """Within the call, and with values that no text of theirs shows."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "helper.py").write_text("import os\nSHARE = float(os.environ['SHARE'])\n")
    found = []
    for share in ("0.45", "0.5", "0.5"):
        monkeypatch.setenv("SHARE", share)
        monkeypatch.delitem(sys.modules, "helper", raising=False)
        space = {}
        exec(f"def policy(state):\n    {text}\n    return SHARE * state.reward\n", space)
        found.append(digest(space["policy"]))
    monkeypatch.delitem(sys.modules, "helper", raising=False)
    assert found[0] != found[1] == found[2]
