"""The benchmark sets: frozen, written whole, checked, and read without optkit."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.instances.benchmark import sets as benchmark_sets
from optkit.instances.benchmark.digest import DECIMALS
from optkit.instances.benchmark.sets import (
    benchmark_digest,
    check_benchmark_sets,
    datasheet,
    freeze,
    frozen,
    write_benchmark_sets,
)
from optkit.instances.catalogue import scenario
from optkit.instances.instance import Instance
from optkit.instances.scenario import Scenario, Split
from optkit.instances.storage import load_instances, read_description, save_instances
from tests.command_line import optkit


def contents(folder):
    """Return all files of a folder: their bytes by their names."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module", autouse=True)
def drawn_once():
    """Each split is drawn once, however many tests want it."""
    draw, drawn = Scenario.split, {}

    def split(source):
        name = json.dumps(source.describe(), default=str)
        drawn[name] = drawn.get(name) or draw(source)
        return Split(*map(list, drawn[name]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Scenario, "split", split)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The smallest set, I.2 in world 0, as it is written."""
    folder = tmp_path_factory.mktemp("benchmark") / "sets"
    assert write_benchmark_sets(folder, ["I.2"], [0])["kept"] == []
    return folder


@pytest.fixture
def copy(made, tmp_path):
    """A copy of it that may be spoilt."""
    return shutil.copytree(made, tmp_path / "sets")


@pytest.mark.slow
def test_a_set_is_the_split_of_its_scenario(made):
    """The parts hold what the scenario draws, and say where it comes from."""
    split = scenario("I.2", seed=0).split()
    for part, drawn in split._asdict().items():
        assert load_instances(made / "I.2-0" / part) == drawn
        assert read_description(made / "I.2-0" / part)["scenario"]["part"] == part
    assert sorted(path.name for path in made.iterdir()) == ["CHECKSUMS.json", "I.2-0", "README.md"]
    assert list(check_benchmark_sets(made)["sets"]) == ["I.2-0"]


@pytest.mark.slow
def test_digests_are_frozen():
    """Two sets, with one worker group and with three, have the numbers and digests that are frozen, and so the code."""
    assert len(frozen()["sets"]) == 20
    assert len({part["sha256"] for one in frozen()["sets"].values() for part in one.values()}) == 60
    for name, world in (("I.2", 0), ("II", 3)):
        drawn = freeze([name], [world])
        assert drawn["sets"][f"{name}-{world}"] == frozen()["sets"][f"{name}-{world}"]
        assert {key: drawn[key] for key in ("format", "version", "decimals")} == {
            key: frozen()[key] for key in ("format", "version", "decimals")
        }


@pytest.mark.slow
def test_the_digest_does_not_depend_on_the_last_bit(made):
    """Each float of a set may be off by five units in its last place, noise near 0 by 1e-15, and the digest stays."""
    days, rng = load_instances(made / "I.2-0" / "validation"), np.random.default_rng(0)

    def off(values):
        change = rng.choice([-1.0, 1.0], np.shape(values)) * np.maximum(5 * np.spacing(np.abs(values)), 1e-15)
        return values + change

    names = ("reward", "penalty", "features", "utility", "noise", "outside_noise")
    moved = [replace(one, **{name: off(getattr(one, name)) for name in names}) for one in days]
    assert moved != days
    assert benchmark_digest(moved) == benchmark_digest(days)


@pytest.mark.slow
def test_no_float_lies_near_a_rounding_boundary(made):
    """What the datasheet says of the distance to where a rounding changes, for this set."""
    for part in ("train", "test", "validation"):
        days = load_instances(made / "I.2-0" / part)
        for name in ("reward", "penalty", "features", "utility", "noise", "outside_noise"):
            values = np.concatenate([np.ravel(getattr(one, name)) for one in days]).astype(np.longdouble)
            units = np.abs(values) * np.longdouble(10) ** DECIMALS
            assert np.abs(units - np.floor(units) - 0.5).min() / 10**DECIMALS > 1e-13


@pytest.mark.parametrize(
    "field",
    [
        *("horizon", "arrival", "expiry", "reward", "penalty", "features", "pickup", "dropoff", "worker_step"),
        *("worker_group", "utility", "mu", "outside_utility", "noise", "outside_noise"),
    ],
)
def test_the_digest_depends_on_every_field(field):
    """A change of any field, by a millionth or by one, is another content; so is another order."""
    day = Instance(
        horizon=9, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0], features=[[0.2], [0.7]],
        pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2], worker_group=[0, 0],
        utility=[[-10.0, -12.0], [-9.0, -8.0]], mu=[1.0, 2.0],
    ).with_noise(seed=0)  # fmt: skip
    value = np.array(getattr(day, field))
    value.flat[-1] += 1 if value.dtype.kind == "i" else 1.1e-6
    other = replace(day, **{field: value if value.ndim else value.item()})
    assert benchmark_digest([other]) != benchmark_digest([day])
    assert benchmark_digest([other, day]) != benchmark_digest([day, other])
    assert benchmark_digest([day]) == benchmark_digest([replace(day, outside_utility=np.zeros(2))])


def test_the_digest_takes_what_is_not_realised_and_refuses_what_is_too_large():
    """Instances without noise have a digest; a number that has no 64-bit count of millionths has none."""
    day = scenario("I.2", seed=0).sample(1, seed=0)[0]
    bare = replace(day, noise=None, outside_noise=None)
    zero = replace(day, noise=np.zeros_like(day.noise), outside_noise=np.zeros_like(day.outside_noise))
    assert len({benchmark_digest([one]) for one in (day, bare, zero)}) == 3
    with pytest.raises(InputError, match=r"1e\+13 is too large"):
        benchmark_digest([replace(day, reward=np.full(day.n_requests, 1e13))])


@pytest.mark.slow
def test_what_is_drawn_otherwise_is_refused(tmp_path, monkeypatch):
    """Another stream of random numbers is found out before anything of the set is written."""
    honest = benchmark_sets.scenario
    monkeypatch.setattr(benchmark_sets, "scenario", lambda name, seed: honest(name, seed + 1))
    with pytest.raises(DataError, match=r"drawn here for I.2-0/train is not version 1 .*NumPy"):
        write_benchmark_sets(tmp_path / "sets", ["I.2"], [0])
    assert not (tmp_path / "sets").exists()


@pytest.mark.slow
def test_an_interrupted_run_goes_on(copy, made, monkeypatch):
    """What is right is kept, untouched and not drawn again; what is missing is written; the end is the same."""
    shutil.rmtree(copy / "I.2-0" / "test")
    (copy / "CHECKSUMS.json").unlink()
    (copy / "README.md").unlink()
    (copy / "I.2-0" / ".test.abc.tmp").mkdir()  # what a kill leaves behind
    with pytest.raises(DataError, match="makes the folder complete"):
        check_benchmark_sets(copy)
    before = (copy / "I.2-0" / "train" / "noise.parquet").stat()
    stages = []
    again = write_benchmark_sets(copy, ["I.2"], [0], progress=lambda *told: stages.append(told))
    assert again["written"] == ["I.2-0/test"]
    assert again["kept"] == ["I.2-0/train", "I.2-0/validation"]
    assert stages == [("look", 0, 1), ("look", 1, 1), ("write", 0, 1), ("write", 1, 1)]
    assert contents(copy) == contents(made)
    after = (copy / "I.2-0" / "train" / "noise.parquet").stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    monkeypatch.setattr(benchmark_sets, "scenario", None)  # nothing is drawn
    assert write_benchmark_sets(copy, ["i.2"], [0])["written"] == []
    check_benchmark_sets(copy)


@pytest.mark.slow
def test_a_set_that_is_added_leaves_the_others_listed(copy):
    """Writing one more set keeps what the folder says of those that are there."""
    shutil.copytree(copy / "I.2-0", copy / "moved")  # not a set's name: of no interest
    about = json.loads((copy / "CHECKSUMS.json").read_text())
    write_benchmark_sets(copy, ["I.2"], [1])
    both = json.loads((copy / "CHECKSUMS.json").read_text())
    assert list(both["sets"]) == list(check_benchmark_sets(copy)["sets"]) == ["I.2-0", "I.2-1"]
    assert about["files"].items() <= both["files"].items()


def edit(path, old, new):
    """Replace text in a file, which must be there."""
    text = path.read_bytes()
    assert old in text
    path.write_bytes(text.replace(old, new, 1))


def others_in_place(folder):
    """Put an instance set of right size and form, with right checksums of its own, where a part belongs."""
    days = load_instances(folder / "I.2-0" / "validation")
    days[7] = replace(days[7], reward=days[7].reward + 0.01)
    save_instances(folder / "I.2-0" / "validation", days, overwrite=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f: (f / "README.md").write_text("# Other words"), r"README.md was changed"),
        (lambda f: (f / "README.md").unlink(), r"README.md is missing"),
        (lambda f: edit(f / "I.2-0/train/noise.parquet", b"PAR1", b"PAR2"), r"noise.parquet is damaged"),
        (lambda f: (f / "I.2-0/test/workers.parquet").unlink(), r"workers.parquet is missing"),
        (lambda f: shutil.rmtree(f / "I.2-0/test"), r"test is not a folder"),
        (lambda f: edit(f / "I.2-0/test/scenario.json", b'"optkit": "', b'"optkit": "9'), r"scenario.json was changed"),
        (others_in_place, r"validation is not this part of version 1 \(content"),
        (lambda f: (f / "I.2-0/test/notes.txt").write_text("mine"), r"notes.txt is not listed"),
        (lambda f: (f / "CHECKSUMS.json").write_text("{"), r"CHECKSUMS.json is damaged"),
        (
            lambda f: edit(f / "CHECKSUMS.json", b'"version": 1', b'"version": 2'),
            r"is of version 2, this optkit's is 1",
        ),
        (lambda f: edit(f / "CHECKSUMS.json", b'"requests": ', b'"requests": 9'), r"does not say of I.2-0"),
        (lambda f: edit(f / "CHECKSUMS.json", b'"I.2-0": {', b'"I.2-8": {'), r"does not say of I.2-0"),
        (lambda f: (f / "II-4").mkdir(), r"does not say of II-4"),
        (lambda f: shutil.rmtree(f), r"is not a folder"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_tampering_is_detected(copy, spoil, said):
    """Whatever is changed, removed or added, the check names it, in one line; an unspoilt copy passes elsewhere."""
    spoil(copy)
    with pytest.raises(DataError, match=said) as caught:
        check_benchmark_sets(copy)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_wrong_part_is_replaced_only_when_asked(copy, made):
    """A part that is not right is an error, or replaced with overwrite; what is no instance set always stays."""
    others_in_place(copy)
    with pytest.raises(DataError, match=r"validation is not this part .* or pass overwrite=True"):
        write_benchmark_sets(copy, ["I.2"], [0])
    assert write_benchmark_sets(copy, ["I.2"], [0], overwrite=True)["written"] == ["I.2-0/validation"]
    assert contents(copy) == contents(made)
    (copy / "I.2-0" / "test" / "scenario.json").write_text("a diary")
    with pytest.raises(InputError, match="is not an instance set, so it stays"):
        write_benchmark_sets(copy, ["I.2"], [0], overwrite=True)
    assert (copy / "I.2-0" / "test" / "scenario.json").read_text() == "a diary"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("README.md", "# My project", r"README.md is not the datasheet, so it stays"),
        ("CHECKSUMS.json", '{"mine": 1}', r"CHECKSUMS.json is not the CHECKSUMS.json of benchmark sets, so it stays"),
        ("scenario.json", "{}", r"holds one instance set"),
        ("I.2-0", "a file", r"I.2-0 is not a folder"),
    ],
)
def test_what_is_not_ours_stays(tmp_path, name, text, said):
    """A file of somebody else's under one of our names is an error before anything is written."""
    (tmp_path / name).write_text(text)
    with pytest.raises(OptkitError, match=said):
        write_benchmark_sets(tmp_path, ["I.2"], [0])
    assert contents(tmp_path) == {name: text.encode()}


def test_unknown_sets_are_refused(tmp_path):
    """Version 1 has four scenarios and five worlds."""
    with pytest.raises(InputError, match=r"no scenario 'nyc-weak'; there are I\.1, I\.2, I\.3, II"):
        write_benchmark_sets(tmp_path, ["nyc-weak"])
    with pytest.raises(InputError, match="no world 5; there are 0 to 4"):
        write_benchmark_sets(tmp_path, worlds=[5])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_datasheet_is_read_without_optkit(made):
    """The code blocks of the datasheet run in plain pandas and print what it shows; the reader has ten lines."""
    text = (made / "README.md").read_text()
    assert text == datasheet()
    blocks, shown = (re.findall(rf"```{kind}\n(.*?)```", text, re.S) for kind in ("python", "text"))
    assert len(blocks[0].splitlines()) == 10
    code = "import sys\nsys.modules['optkit'] = None\n" + "".join(blocks)  # None: importing it is an error
    code += "assert not any(name.startswith('optkit.') for name in sys.modules)\n"
    options = ["-W", "error::FutureWarning", "-c", code]
    done = subprocess.run([sys.executable, *options], cwd=made, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    assert done.stdout == "".join(shown)
    days = load_instances(made / "I.2-0" / "test")
    pairs = [one.pairs() for one in days]
    least = [
        np.maximum(0.0, one.outside_noise[worker] - one.utility[0, request] - one.pair_noise())
        for one, (worker, request) in zip(days, pairs, strict=True)
    ]
    told = [len(days), sum(one.n_requests for one in days), sum(one.n_workers for one in days)]
    told += [sum(worker.size for worker, _ in pairs), round(np.concatenate(least).mean(), 2)]
    assert [float(number) for number in shown[0].split()] == pytest.approx(told)


def test_the_numbers_of_the_datasheet_are_the_frozen_ones():
    """The table of scenarios adds up what is frozen, and the settings are the scenarios'."""
    rows = dict(re.findall(r"^\| (I[I.123]*) \| (.*) \|$", datasheet(), re.M))
    assert list(rows) == list(benchmark_sets.SCENARIOS)
    for name, row in rows.items():
        settings = scenario(name, 0).settings
        parts = [part for world in range(5) for part in frozen()["sets"][f"{name}-{world}"].values()]
        sums = [sum(part[key] for part in parts) for key in ("instances", "requests", "workers")]
        wanted = [settings.request_rate, settings.worker_rate, settings.groups, *sums]
        assert [float(cell.replace(",", "")) for cell in row.split(" | ")] == wanted
    total = sum(part["instances"] for one in frozen()["sets"].values() for part in one.values())
    assert f"{total:,} instances of the pricing problem" in datasheet()


@pytest.mark.slow
def test_what_the_datasheet_says_of_scenarios_of_a_world():
    """I.1 and II share requests and workers' steps; their noise differs."""
    one, two = (scenario(name, 0).split().validation for name in ("I.1", "II"))
    for a, b in zip(one, two, strict=True):
        for name in ("arrival", "expiry", "reward", "penalty", "features", "pickup", "dropoff", "worker_step"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
        assert not np.array_equal(a.noise, b.noise)


@pytest.mark.slow
def test_the_command_line_writes_and_checks(copy):
    """optkit generate benchmark writes sets, goes on, and verifies; in words and as JSON."""
    folder = copy
    for part in ("test", "validation"):
        shutil.rmtree(folder / "I.2-0" / part)
    asked = ["generate", "benchmark", "--out", folder, "--scenario", "I.2", "--world", 0]
    told = json.loads(optkit(*asked, "--json", check=0).stdout)
    assert told["sets"] == {"I.2-0": frozen()["sets"]["I.2-0"]}
    assert (told["version"], told["written"]) == (1, ["I.2-0/test", "I.2-0/validation"])
    assert "1 set, 630 instances; 0 parts written, 3 kept" in optkit(*asked, check=0).stdout
    found = json.loads(optkit("generate", "benchmark", "--check", folder, "--json", check=0).stdout)
    assert found["sets"] == told["sets"]
    assert "are right" in optkit("generate", "benchmark", "--check", folder, check=0).stdout
    others_in_place(folder)
    done = optkit("generate", "benchmark", "--check", folder, check=2)
    assert re.fullmatch(r"optkit: \S+validation is not this part of version 1 .*\n", done.stderr)
    assert "or pass --overwrite to replace it" in optkit(*asked, check=2).stderr
    assert json.loads(optkit(*asked, "--overwrite", "--json", check=0).stdout)["written"] == ["I.2-0/validation"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["benchmark"], "--out is missing"),
        (["I.1"], "--out is missing"),
        (["benchmark", "--out", "x", "--seed", "0"], "--seed goes with a scenario, not with benchmark"),
        (["benchmark", "--out", "x", "--set", "horizon=9"], "--set goes with a scenario"),
        (["benchmark", "--out", "x", "--count", "3"], "--count goes with a scenario"),
        (["I.1", "--out", "x", "--world", "0"], "--world goes with benchmark"),
        (["I.1", "--check", "x"], "--check goes with benchmark"),
        (["benchmark", "--check", "x", "--scenario", "I.1"], "leave the other options out"),
        (["benchmark", "--check", "nowhere"], "nowhere is not a folder"),
        (["benchmark", "--out", "x", "--world", "7"], "no world 7; there are 0 to 4"),
    ],
)
def test_the_command_line_refuses(tmp_path, monkeypatch, arguments, said):
    """Options that do not go together are one line and exit status 2, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    done = optkit("generate", *arguments, check=2)
    assert done.stderr.startswith("optkit: ")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
