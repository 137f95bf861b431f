"""optkit certify, called as a user calls it."""

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

from optkit.basics.plain_json import to_json
from optkit.gap import charging
from optkit.gap.report import gap_report
from optkit.instances.catalogue import scenario
from optkit.instances.storage import save_instances
from optkit.learning.training import train
from tests.command_line import strict
from tests.gap import processes

SETTINGS = {"split": (30, 4, 8), "horizon": 12}
SMALL = ["--set", "split=30,4,8", "--set", "horizon=12"]


@pytest.fixture
def certify(optkit, monkeypatch):
    """Run the verb in this process; return exit status, output and errors.

    Value functions for charges are trained on few instances, and arrivals drawn from few: they prove less, but as
    surely.
    """
    monkeypatch.setattr(charging, "MOST", 20)
    monkeypatch.setattr(charging, "POOL", 60)
    return partial(optkit, "certify")


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """Train, test and validation sets as optkit generate writes them."""
    folder = tmp_path_factory.mktemp("sets") / "mine"
    source = scenario("I.2", seed=0, **SETTINGS)
    for part, instances in source.split()._asdict().items():
        told = json.loads(to_json(source.describe() | {"part": part}))
        save_instances(folder / part, instances, scenario=told)
    return folder


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """The same without a word of where they come from."""
    folder = tmp_path_factory.mktemp("sets") / "own"
    for part, instances in scenario("I.2", seed=0, **SETTINGS).split()._asdict().items():
        save_instances(folder / part, instances)
    return folder


@pytest.mark.slow
def test_a_scenario_is_certified(certify, tmp_path):
    """Bounds, policies, gaps and assumptions as JSON; rows and a figure beside, with the same numbers."""
    rows, figure = tmp_path / "rows.csv", tmp_path / "ladder.png"
    status, out, _ = certify("I.2", *SMALL, "--json", "--out", rows, "--plot", figure)
    assert status == 0
    told = strict(out)
    assert [row["kind"] for row in told["bounds"]] == ["full", "lagrangian", "arrival", "penalised"]
    assert [row["policy"] for row in told["policies"]] == ["myopic", "linear"]
    assert told["instances"] == 4
    frame = pd.read_csv(rows)
    gap = next(row for row in told["gaps"] if (row["policy"], row["bound"]) == ("linear", "arrival"))
    assert gap["money"] == pytest.approx((frame["bound: arrival"] - frame["policy: linear"]).mean(), rel=1e-9)
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_folder_that_tells_its_scenario_is_certified_alike(certify, sets):
    """scenario.json names the process: the same bounds as for the scenario itself, and it is said."""
    asked = ["--policy", "myopic", "--policy", "charging", "--json"]
    from_name = strict(certify("I.2", *SMALL, *asked)[1])
    from_folder = strict(certify(sets, *asked)[1])
    for table in ("bounds", "policies", "gaps"):
        for one, other in zip(from_name[table], from_folder[table], strict=True):
            assert {k: v for k, v in one.items() if k != "seconds"} == {
                k: v for k, v in other.items() if k != "seconds"
            }
    assert any("as scenario.json says" in told for told in from_folder["assumptions"])


@pytest.mark.slow
def test_a_folder_of_ones_own(certify, own):
    """Without a process there is no penalised bound; with a worker rate there is, and what it assumes is said."""
    plain = strict(certify(own, "--policy", "myopic", "--json")[1])
    assert [row["kind"] for row in plain["bounds"]] == ["full", "lagrangian", "arrival"]
    given = strict(certify(own, "--policy", "myopic", "--worker-rate", 0.5, "--json")[1])
    assert given["bounds"][-1]["kind"] == "penalised"
    assert any("assumed to join a queue at 0.5 a step" in told for told in given["assumptions"])
    assert [row["money"] for row in plain["gaps"]] == pytest.approx(
        [row["money"] for row in given["gaps"] if row["bound"] != "penalised"]
    )


@pytest.mark.slow
def test_a_trained_policy_s_file(certify, own, tmp_path):
    """A file of optkit train is a policy under its stem, and earns what the policy itself earns."""
    split = scenario("I.2", seed=0, **SETTINGS).split()
    file = train(split, choice="true").save(tmp_path / "patient.json")
    told = strict(certify(own, "--policy", file, "--policy", "linear", "--kinds", "arrival", "--json")[1])
    patient, linear = told["policies"]
    assert patient["policy"] == "patient"
    assert patient["money"] == pytest.approx(linear["money"], rel=1e-12)


OWN = """
SHARE = 0.5
print("I am read")

def half(state):
    print("I am asked")
    return SHARE * state.reward

class Third:
    def __call__(self, state):
        return state.reward / 3

five = 5
"""


@pytest.mark.slow
def test_policies_of_ones_own(certify, own, tmp_path):
    """A folder and a policy that optkit has never seen, in two processes; the numbers are those of gap_report.

    What the policy prints is not in the way of the JSON.
    """
    (tmp_path / "own.py").write_text(OWN)
    named = [f"--policy={tmp_path}/own.py:{name}" for name in ("half", "Third")]
    status, out, _ = certify(own, *named, "--json", "--jobs", 2)
    found = {row["policy"]: row["money"] for row in strict(out)["policies"]}
    assert status == 0
    days = scenario("I.2", seed=0, **SETTINGS).split().test
    report = gap_report(days, {"half": lambda state: 0.5 * state.reward, "Third": lambda state: state.reward / 3})
    assert found == dict(zip(report.policies["policy"], report.policies["money"], strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "name", "message"),
    [
        (OWN, "gone", "defines no policy gone"),
        (OWN, "five", "defines no policy five"),
        ("1 / 0", "half", r"failed \(ZeroDivisionError: division by zero\)"),
        ("def (", "half", "SyntaxError"),
        ("import sys; sys.exit(0)", "half", r"failed \(it called sys.exit\(0\)\) in own.py, line 1"),
    ],
)
def test_a_policy_that_cannot_be_had_is_said(certify, own, tmp_path, code, name, message):
    (tmp_path / "own.py").write_text(code)
    status, _, err = certify(own, "--policy", f"{tmp_path}/own.py:{name}")
    assert status == 2
    assert re.search(message, err)
    assert certify(own, "--policy", f"{tmp_path}/none.py:half")[2].endswith(
        "there is no file " + f"{tmp_path}/none.py\n"
    )


@pytest.mark.slow
def test_a_worker_rate_that_the_days_contradict_is_refused(certify, own):
    """One line why, exit status 1, and the bounds that need no process; with JSON too."""
    asked = [own, "--policy", "myopic", "--worker-rate", 2.5]
    status, out, _ = certify(*asked)
    assert status == 1
    assert sum(line.startswith("penalised bound refused: workers do not come") for line in out.splitlines()) == 1
    assert "myopic to arrival" in out
    status, out, _ = certify(*asked, "--json")
    assert status == 1
    assert [row["kind"] for row in strict(out)["bounds"]] == ["full", "lagrangian", "arrival"]
    assert "workers do not come" in strict(out)["refused"][0]


@pytest.mark.slow
def test_a_rush_hour_is_refused_though_the_total_is_right(certify, tmp_path):
    """Half a worker a step, as is said, but few in the morning and many in the evening: nothing rests on that."""
    save_instances(tmp_path / "late", processes.days(processes.rush, 40, seed=1))
    status, out, _ = certify(tmp_path / "late", "--policy", "myopic", "--worker-rate", 0.5, "--json")
    told = strict(out)
    assert status == 1
    assert "penalised" not in [row["kind"] for row in told["bounds"]]
    assert "workers do not come" in told["refused"][0]


@pytest.mark.slow
def test_rates_are_learned_from_other_days(certify, own, tmp_path):
    """From the folder's own training days, or from another folder, whose days are none of those measured on."""
    asked = ["--policy", "myopic", "--worker-rate", "learned", "--json"]
    status, out, _ = certify(own, *asked)
    assert status == 0
    assert strict(out)["bounds"][-1]["kind"] == "penalised"
    assert any("rates learned from 38 other days" in told for told in strict(out)["assumptions"])
    save_instances(tmp_path / "late", scenario("I.2", seed=0, **SETTINGS).sample(5, seed=7))
    status, out, _ = certify(tmp_path / "late", "--train", own, *asked)
    assert status == 0
    assert strict(out)["instances"] == 5
    assert any("rates learned from 38 other days" in told for told in strict(out)["assumptions"])
    status, _, err = certify(own / "train", "--train", own, *asked)
    assert status == 2
    assert re.search(r"\d+ of the days of .* are in .* too", err)


def test_huge_offers_are_one_line(certify, own, tmp_path):
    (tmp_path / "own.py").write_text("def huge(state):\n    return 1e308 + 0.0 * state.reward\n")
    status, out, err = certify(own, "--policy", f"{tmp_path}/own.py:huge", "--kinds", "arrival")
    assert status == 2
    assert "the policy huge offers 1e+308 for request" in err
    assert err.count("\n") == 1
    assert "nan" not in out


FAILING = """
from __future__ import annotations
import sys
from dataclasses import dataclass

open(__file__ + ".log", "a").write("run\\n")

def boom(state):
    return 1 / 0

def leave(state):
    sys.exit(0)

@dataclass
class Share:
    share: float = 0.5

    def __call__(self, state):
        return self.share * state.reward
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "line", "jobs"),
    [
        ("boom", "ZeroDivisionError: division by zero.*line 9", 1),
        ("leave", r"it called sys.exit\(0\).*line 12", 1),
        ("leave", r"it called sys.exit\(0\).*line 12", 2),  # would end the process
    ],
)
def test_a_policy_that_fails_is_said(certify, own, tmp_path, name, line, jobs):
    """In one line with its name, the step and the place, and status 2; the file was run once, with two policies."""
    file = tmp_path / "own.py"
    file.write_text(FAILING)
    named = (f"--policy={file}:Share", f"--policy={file}:{name}", "--kinds", "full", "--jobs", jobs)
    status, out, err = certify(own, *named)
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert re.search(rf"the policy {name}, at step \d+, failed \({line}", err)
    assert (tmp_path / "own.py.log").read_text() == "run\n"


def test_the_traceback_on_request(certify, own, tmp_path):
    """--traceback shows where the policy failed, and the line that says why comes last."""
    (tmp_path / "own.py").write_text(FAILING)
    status, _, err = certify(own, f"--policy={tmp_path}/own.py:boom", "--kinds", "full", "--traceback")
    assert status == 2
    assert "return 1 / 0" in err
    assert err.splitlines()[-1].startswith("optkit: the policy boom, at step ")


@pytest.mark.slow
def test_a_folder_without_noise_gets_some_and_says_so(certify, tmp_path):
    """Nobody records the noise; with it drawn everything goes on, alike each time."""
    for part, instances in scenario("I.2", seed=0, **SETTINGS).split()._asdict().items():
        bare = [replace(day, noise=None, outside_noise=None) for day in instances]
        save_instances(tmp_path / part, bare)
    status, out, _ = certify(tmp_path, "--worker-rate", 0.5, "--json")
    assert status == 0
    assert "noise: drawn here for 42 instances of the folder, which have none" in strict(out)["assumptions"]
    again = strict(certify(tmp_path, "--worker-rate", 0.5, "--json")[1])
    assert again["gaps"] == strict(out)["gaps"]


@pytest.mark.slow
def test_text_and_more_instances(certify):
    """The text holds the claim and the assumptions; a scenario draws more instances than its split has."""
    status, out, _ = certify("I.2", *SMALL, "--kinds", "arrival", "--policy", "myopic", "--instances", 6)
    assert status == 0
    assert "6 test instances" in out
    assert "myopic is at most" in out
    assert "assumed: intervals" in out
    assert "penalised" not in out


@pytest.mark.slow
def test_a_stopped_report_goes_on(certify, tmp_path):
    """The same command goes on from its checkpoint, in two processes too; another command keeps its own beside."""
    kept = tmp_path / "rows.jsonl"
    asked = ["I.2", *SMALL, "--kinds", "arrival", "--policy", "myopic", "--json", "--checkpoint", kept]
    first = strict(certify(*asked)[1])
    lines = kept.read_text().splitlines()
    assert len(lines) == 5
    kept.write_text("\n".join(lines[:3]) + "\n")
    again = strict(certify(*asked, "--jobs", 2)[1])
    assert [row["points"] for row in again["gaps"]] == [row["points"] for row in first["gaps"]]
    before = kept.read_bytes()
    other = strict(certify(*asked, "--limit", 3)[1])
    assert not any(told.startswith("rows:") for told in other["assumptions"])
    assert kept.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["I.9"], "neither a scenario"),
        (["I.2", "--policy", "nonsense"], "--policy nonsense"),
        (["I.2", "--policy", "missing.json"], "missing.json cannot be read"),
        (["I.2", "--policy", "linear", "--policy", "linear"], "two of the policies are called linear"),
        (["I.2", "--policy", "charging", "--kinds", "arrival", *SMALL], "no penalised bound"),
        (["I.2", "--worker-rate", "0.5"], "--worker-rate goes with a folder"),
        (["I.2", "--worker-rate", "half"], "--worker-rate half: give a mean number"),
        (["I.2", "--worker-rate", "nan"], "--worker-rate = nan is not a finite number of at least 0"),
        (["I.2", "--worker-rate", "-1"], "--worker-rate = -1.0 is not a finite number of at least 0"),
        (["I.2", "--group-share", "0.6,0.6"], "--group-share 0.6,0.6 adds up to 1.2, not to 1"),
        (["I.2", "--group-share", "nan,1"], "--group-share = nan is not a finite number"),
        (["I.2", "--train", "elsewhere"], "--train goes with a folder"),
        (["I.2", "--group-share", "0.5,0.5"], "--group-share goes with"),
        (["I.2", "--group-share", "half"], "--group-share half"),
        (["I.2", "--out", "rows.txt"], "must be a file that ends in"),
        (["I.2", "--plot", "rows.txt"], "must be a file that ends in"),
        (["I.2", "--kinds", "nonsense"], "no bound 'nonsense'"),
    ],
)
def test_bad_input_is_one_line(certify, arguments, message):
    """What is wrong is said in one line with exit status 2."""
    status, out, told = certify(*arguments)
    assert status == 2
    assert message in told
    assert told.count("\n") == 1
    assert out == ""


@pytest.mark.slow
def test_what_a_folder_cannot_give_is_said(certify, own, sets):
    """A penalised bound without a process, and more instances than there are."""
    assert "--worker-rate" in certify(own, "--kinds", "penalised")[2]
    assert "has 4 test instances" in certify(sets, "--instances", 9)[2]


@pytest.mark.slow
def test_groups_need_their_shares(certify, tmp_path):
    """With several groups, how they are shared is part of the process."""
    save_instances(tmp_path / "two", scenario("II", seed=0, horizon=10).sample(12, seed=1))
    asked = [tmp_path / "two", "--policy", "myopic", "--worker-rate", 0.5]
    assert "3 groups of workers" in certify(*asked)[2]
    status, out, _ = certify(*asked, "--group-share", "0.25,0.25,0.5", "--json")
    assert status == 0
    assert any("0.25, 0.25, 0.5" in told for told in strict(out)["assumptions"])
    assert np.isfinite(strict(out)["bounds"][-1]["money"])
