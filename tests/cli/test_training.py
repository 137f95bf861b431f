"""optkit train and optkit evaluate, called as a user calls them."""

import sys
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import SolverError, TrainingError
from optkit.bounds import full_information
from optkit.cli.evaluate import MYOPIC
from optkit.evaluation import proven
from optkit.evaluation.comparison import compare
from optkit.instances.storage import save_instances
from optkit.learning.rounds import learn_once
from optkit.learning.trained import Trained
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.policies import PostDecisionPricing
from tests.command_line import strict

SMALL = ["--set", "split=30,10,5", "--set", "horizon=15"]
SETTINGS = {"split": (30, 10, 5), "horizon": 15}


@pytest.fixture(scope="module")
def split():
    """The instances that SMALL asks for."""
    return scenario("I.1", seed=0, **SETTINGS).split()


@pytest.fixture(scope="module")
def expected(split):
    """What the library trains on them: a policy with learned preferences."""
    return train(split)


@pytest.fixture(scope="module")
def file(expected, tmp_path_factory):
    """The same on disk."""
    return expected.save(tmp_path_factory.mktemp("trained") / "learned.json")


@pytest.mark.slow
def test_train_and_evaluate_show_what_the_library_finds(optkit, tmp_path, split, expected):
    """optkit train writes the library's policy and shows its course; optkit evaluate shows what it earns."""
    path = tmp_path / "policy.json"
    done = optkit("train", "I.1", *SMALL, "--out", path, check=0)
    assert Trained.load(path).value.to_dict() == expected.value.to_dict()
    for row in expected.record:
        assert f"{row['score']:.2f}" in done.stdout
        assert f"{row['residual']:.3f}" in done.stdout
    best = max(expected.record, key=lambda row: row["score"])
    assert f"chosen: seed 0, round {best['round']}: the best on validation instances" in done.stdout
    assert str(path) in done.stdout
    done = optkit("evaluate", path, "I.1", *SMALL, check=0)
    myopic = PostDecisionPricing(choice=expected.preferences)
    bounds = [full_information(day) for day in split.test]
    table = compare(split.test, {"myopic": myopic, "policy.json": expected.policy}, bounds).table
    for _, row in table.iterrows():
        assert f"{row['ratio']:.2f}" in done.stdout
    assert f"{table['difference'][1]:+.2f}" in done.stdout
    assert "policy.json" in done.stdout


@pytest.mark.slow
def test_options_reach_the_training(optkit, tmp_path):
    """The file holds the settings that were asked for, --json tells them, and the record has every round."""
    options = ["--value", "kernel", "--choice", "pooled", "--deviations", "6,3,1", "--discount", 0.9]
    path = tmp_path / "p.json"
    code, out, err = optkit(
        "train", "II", *SMALL, *options, "--seeds", 2, "--training-seed", 5, "--out", path, "--json"
    )
    told, found = strict(out), Trained.load(path)
    assert (code, err) == (0, "")
    settings = {"deviations": [6.0, 3.0, 1.0], "discount": 0.9, "seeds": 2, "seed": 5}
    assert told["settings"] == settings
    assert found.settings == settings
    assert found.source == {"choice": "pooled", "instances": 30, "horizon": 15}
    assert type(found.value).__name__ == "KernelValue"
    assert found.preferences.pooled
    assert told["record"] == found.record
    assert told["chosen"]["score"] == found.score
    assert [row["deviation"] for row in found.record[:2]] == [6.0, 3.0]


@pytest.mark.slow
def test_a_scenario_gives_as_many_instances_as_asked_for(optkit, tmp_path):
    """--instances draws them in place of the split's, and in proportion to choose by; the output says how many."""
    path = tmp_path / "p.json"
    options = ["--choice", "true", "--instances", 45, "--out", path]
    code, out, _ = optkit("train", "I.1", *SMALL, *options, "--quiet")
    assert code == 0
    assert "instances: 45 for training, 8 for validation" in out
    expected = train(scenario("I.1", seed=0, **SETTINGS), choice="true", instances=45)
    assert Trained.load(path).value.to_dict() == expected.value.to_dict()
    folder = save_instances(tmp_path / "days", scenario("I.1", seed=0).sample(20, seed=1))
    code, _, err = optkit("train", folder, *options, "--quiet")
    assert (code, err.count("\n")) == (2, 1)
    assert "can be drawn from a scenario only" in err


@pytest.mark.slow
def test_the_world_s_seed_is_the_training_s_too(optkit, tmp_path):
    """As in optkit run, one seed serves for both unless another is given."""
    optkit("train", "I.1", *SMALL, "--seed", 3, "--choice", "true", "--out", tmp_path / "p.json", "--quiet")
    expected = train(scenario("I.1", seed=3, **SETTINGS).split(), choice="true", seed=3)
    assert Trained.load(tmp_path / "p.json").value.to_dict() == expected.value.to_dict()


@pytest.mark.slow
def test_folders_are_split_as_run_splits_them(optkit, tmp_path, split):
    """The parts of a folder serve for what they are called; without validation instances the last round is taken."""
    for part in ("train", "validation"):
        save_instances(tmp_path / "set" / part, getattr(split, part))
    optkit("train", tmp_path / "set", "--choice", "true", "--out", tmp_path / "p.json")
    expected = train(split, choice="true")
    assert Trained.load(tmp_path / "p.json").value.to_dict() == expected.value.to_dict()
    save_instances(tmp_path / "bare" / "train", split.train)
    code, out, _ = optkit("train", tmp_path / "bare", "--choice", "true", "--out", tmp_path / "q.json")
    assert code == 0
    assert "round 2: the last, for there are no validation instances" in out
    expected = train(split.train, choice="true")
    assert Trained.load(tmp_path / "q.json").value.to_dict() == expected.value.to_dict()


@pytest.mark.slow
def test_evaluate_is_the_librarys_comparison(optkit, file, split, tmp_path):
    """Rows, means and the paired difference are those of compare() with the myopic policy of the same beliefs."""
    trained = Trained.load(file)
    policies = {MYOPIC: PostDecisionPricing(choice=trained.preferences), file.name: trained.policy}
    everything = [day for one in split for day in one]
    parts = {"test": split.test, "validation": split.validation, "train": split.train, "all": everything}
    forms = {".csv": pd.read_csv, ".parquet": pd.read_parquet}
    for (part, days), suffix in zip(parts.items(), [*forms, *forms], strict=True):
        wanted, out = compare(days, policies, [full_information(day) for day in days]), tmp_path / f"{part}{suffix}"
        code, text, _ = optkit("evaluate", file, "I.1", *SMALL, "--part", part, "--out", out, "--json")
        told = strict(text)
        assert code == 0
        assert told["instances"] == len(days)
        assert told["policies"] == wanted.table.to_dict(orient="records")
        pd.testing.assert_frame_equal(forms[suffix](out), wanted.per_instance)


@pytest.mark.slow
def test_another_horizon_is_told(optkit, file):
    """Steps left are right on shorter instances, but the value function of a step is not: a note says so."""
    _, same, _ = optkit("evaluate", file, "I.1", *SMALL, "--quiet")
    code, shorter, _ = optkit("evaluate", file, "I.1", *SMALL, "--set", "horizon=8", "--quiet")
    assert code == 0
    assert "note: trained on instances of 15 steps, these have 8" in shorter
    assert "note:" not in same
    told = strict(optkit("evaluate", file, "I.1", *SMALL, "--set", "horizon=8", "--json")[1])
    assert told["note"].startswith("trained on instances of 15 steps")


@pytest.mark.slow
def test_evaluate_takes_all_of_a_folder(optkit, file, tmp_path):
    """A set of fresh instances is evaluated in full with --part all, even if it is a single one."""
    save_instances(tmp_path / "fresh", scenario("I.1", seed=0, horizon=15).sample(1, seed=9))
    code, out, _ = optkit("evaluate", file, tmp_path / "fresh", "--part", "all", "--json")
    assert code == 0
    assert strict(out)["policies"][1]["instances"] == 1


def test_an_instance_without_a_bound_is_named(optkit, file, monkeypatch):
    """Where a solver gives up, the instance is left out and named, and the exit status is 1."""
    calls = iter(range(100))

    def sometimes(instance):
        if next(calls) == 1:
            raise SolverError("hit its time limit")
        return full_information(instance)

    monkeypatch.setattr(proven, "full_information", sometimes)
    code, out, _ = optkit("evaluate", file, "I.1", *SMALL)
    assert code == 1
    assert "instance 1 is left out: hit its time limit" in out
    assert "9 test instances" in out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trained_on", "value", "tried_on", "says"),
    [
        ("I.1", "linear", ["I.1", "--set", "horizon=40"], "step 15 is beyond the 15 steps"),
        ({"pickups": 2}, None, ["I.1"], "is unknown; the preferences know 0..1"),
        ({"characteristics": 1}, None, ["I.1"], "the preferences know"),
        ({}, None, ["II"], "worker group 1 is unknown"),
        ("II", "kernel", ["I.1"], "3 worker groups"),
    ],
    ids=["horizon", "place", "features", "group", "groups of the value function"],
)
def test_what_a_policy_does_not_know_is_one_line(optkit, tmp_path, trained_on, value, tried_on, says):
    """Instances that a policy was not made for: status 2 and one line that names the file and what is unknown."""
    path = tmp_path / "p.json"
    if value:  # a value function, and the true preferences
        assert optkit("train", trained_on, *SMALL, "--choice", "true", "--value", value, "--out", path)[0] == 0
    else:  # preferences learned in other worlds
        days = scenario("I.1", seed=0, **SETTINGS, **trained_on).split().train
        train(days, choice=learn_once(days).preferences, deviations=(8.0,)).save(path)
    code, out, err = optkit("evaluate", path, *tried_on[:1], *SMALL, *tried_on[1:])
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"optkit: {path} does not fit the instances of {tried_on[0]}: ")
    assert says in err


@pytest.mark.slow
def test_interrupted_training_goes_on_from_its_checkpoint(optkit, tmp_path, monkeypatch):
    """Ctrl-C in the second seed: one is told how to go on, and the same command ends as if nothing had happened."""
    asked = ["I.1", *SMALL, "--choice", "true", "--seeds", 2]
    common = [*asked, "--checkpoint", tmp_path / "kept"]

    @contextmanager
    def impatient(_):
        def tell(_, done, total):
            assert total == 4
            if done == 3:
                raise KeyboardInterrupt

        yield tell

    with monkeypatch.context() as patch:
        patch.setattr(sys.modules["optkit.cli.train"], "progress_bar", impatient)
        code, _, err = optkit("train", *common, "--out", tmp_path / "p.json")
    assert code == 130
    assert f"kept in {tmp_path / 'kept'}: the same command goes on" in err
    assert not (tmp_path / "p.json").exists()
    (kept,) = (tmp_path / "kept").iterdir()
    before = kept.read_bytes()
    assert optkit("train", *common, "--out", tmp_path / "p.json")[0] == 0
    assert kept.read_bytes() == before
    assert len(list((tmp_path / "kept").iterdir())) == 2
    optkit("train", *asked, "--out", tmp_path / "q.json")
    one, other = (Trained.load(tmp_path / name) for name in ("p.json", "q.json"))
    assert one.value.to_dict() == other.value.to_dict()
    assert one.score == other.score


@pytest.mark.slow
def test_interruption_without_a_checkpoint_says_what_would_have_helped(optkit, tmp_path, monkeypatch):
    """Nothing is kept then, and nothing is written."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("optkit.learning.training.train", interrupted)
    code, _, err = optkit("train", "I.1", *SMALL, "--out", tmp_path / "p.json")
    assert code == 130
    assert "--checkpoint FOLDER" in err
    assert list(tmp_path.iterdir()) == []


def diverge_from(monkeypatch, call):
    """Make the fit of linear value functions fail from this call on."""
    fit, calls = LinearValue.fit, iter(range(1, 100))

    def failing(self, experience, y=None):
        if next(calls) >= call:
            raise TrainingError("training diverged: opportunity costs of 1e9")
        return fit(self, experience, y)

    monkeypatch.setattr(LinearValue, "fit", failing)


def test_divergence_is_told_and_nothing_is_written(optkit, tmp_path, monkeypatch):
    """If no round comes to anything: status 2, one line, no file."""
    diverge_from(monkeypatch, 1)
    code, out, err = optkit("train", "I.1", *SMALL, "--choice", "true", "--out", tmp_path / "p.json")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "diverged" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_later_round_that_diverges_is_told(optkit, tmp_path, monkeypatch):
    """The policy is then that of the rounds before."""
    diverge_from(monkeypatch, 2)
    code, out, _ = optkit("train", "I.1", *SMALL, "--choice", "true", "--out", tmp_path / "p.json")
    assert code == 0
    assert "seed 0, round 2: training diverged" in out
    assert "chosen: seed 0, round 1" in out


@pytest.mark.slow
def test_a_seed_that_diverges_is_told(optkit, tmp_path, monkeypatch):
    """With two seeds of two rounds, a failure in the third round leaves the first seed."""
    diverge_from(monkeypatch, 3)
    code, out, _ = optkit("train", "I.1", *SMALL, "--choice", "true", "--seeds", 2, "--out", tmp_path / "p.json")
    assert code == 0
    assert "a seed is left out: training diverged" in out
    assert "chosen: seed 0" in out


@pytest.mark.slow
def test_a_policy_is_replaced_and_nothing_else(optkit, tmp_path):
    """An earlier policy makes room for the new one."""
    common = ["train", "I.1", *SMALL, "--choice", "true", "--out", tmp_path / "p.json"]
    optkit(*common)
    first = Trained.load(tmp_path / "p.json")
    assert optkit(*common, "--value", "kernel")[0] == 0
    assert type(Trained.load(tmp_path / "p.json").value) is not type(first.value)
    assert [path.name for path in tmp_path.iterdir()] == ["p.json"]


BAD = {
    "no folder for the policy": (["train", "I.1", "--out", "no/p.json"], "cannot be written"),
    "suffix": (["train", "I.1", "--out", "p.txt"], "ends in .json"),
    "somebody's file": (["train", "I.1", "--out", "notes.json"], "holds no trained policy: choose another"),
    "checkpoint is a file": (["train", "I.1", "--checkpoint", "notes.json"], "--checkpoint notes.json"),
    "scenario": (["train", "IV"], "'IV' is neither a scenario"),
    "value": (["train", "I.1", *SMALL, "--value", "cubic"], "'cubic' is unknown"),
    "choice": (["train", "I.1", *SMALL, "--choice", "guess"], "choice = 'guess'"),
    "deviations": (["train", "I.1", *SMALL, "--deviations", "8;4"], "--deviations 8;4"),
    "negative deviation": (["train", "I.1", *SMALL, "--deviations", "8,-4"], "deviations"),
    "discount": (["train", "I.1", *SMALL, "--discount", "2"], "discount = 2"),
    "seeds": (["train", "I.1", *SMALL, "--seeds", "0"], "seeds = 0"),
    "instances": (["train", "I.1", *SMALL, "--instances", "-5"], "instances = -5"),
    "training seed": (["train", "I.1", *SMALL, "--training-seed", "-1"], "seed"),
    "nothing to choose by": (["train", "I.1", "--set", "split=5,5,0", "--seeds", "2"], "validation instances"),
    "no policy": (["evaluate", "absent.json", "I.1"], "absent.json cannot be read"),
    "not a policy": (["evaluate", "notes.json", "I.1"], "holds no trained policy"),
    "part": (["evaluate", "learned.json", "I.1", "--part", "tests"], "--part tests"),
    "empty part": (["evaluate", "learned.json", "I.1", "--set", "split=5,5,0", "--part", "validation"], "no instances"),
    "rows": (["evaluate", "learned.json", "I.1", "--out", "rows.txt"], "ends in .csv or .parquet"),
    "no folder for rows": (["evaluate", "learned.json", "I.1", "--out", "no/rows.csv"], "cannot be written"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_input_is_one_line_and_status_2(optkit, tmp_path, monkeypatch, file, case):
    """Every wrong argument or file: status 2, nothing on standard output, one line, and nothing written."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.json").write_text('{"mine": true}')
    (tmp_path / "learned.json").write_bytes(file.read_bytes())
    arguments, words = BAD[case]
    code, out, err = optkit(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("optkit: ")
    assert err.count("\n") == 1
    assert words in err
    assert {path.name for path in tmp_path.iterdir()} == {"notes.json", "learned.json"}
    assert (tmp_path / "notes.json").read_text() == '{"mine": true}'


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--out", "no/p.json"], ["--out", "notes.json"], ["--deviations", "x"]])
def test_refused_before_the_training_and_not_after(optkit, tmp_path, monkeypatch, arguments):
    """What can be known to be wrong is said before any work is done."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "notes.json").write_text("{}")
    monkeypatch.setattr("optkit.learning.training.train", lambda *_, **__: pytest.fail("trained"))
    assert optkit("train", "I.1", *SMALL, *arguments)[0] == 2


def test_a_missing_extra_is_one_line_that_installs_it(optkit, tmp_path, monkeypatch):
    """Without PyTorch, --value attention names the extra, with status 2 and before any training."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "torch", None)  # as if it were not installed
    for module in ("network", "training"):
        monkeypatch.delitem(sys.modules, f"optkit.models.value.attention.{module}", raising=False)
    monkeypatch.setattr("optkit.learning.training.simulate", lambda *_, **__: pytest.fail("trained"))
    code, out, err = optkit("train", "I.1", *SMALL, "--value", "attention")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "pip install 'optkit[attention]'" in err


def test_the_file_prices_as_the_policy_did(split, expected, file):
    """What optkit evaluate runs is what was trained, to the last digit."""
    one, other = (simulate(split.test, trained.policy).reward for trained in (expected, Trained.load(file)))
    assert np.array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["train", "evaluate"])
def test_help(optkit, verb):
    """Both verbs explain themselves."""
    code, out, _ = optkit(verb, "--help")
    assert code == 0
    assert "--json" in out
