"""Instance sets on disk: the round trip is exact, a save is all or nothing, and damage is always noticed."""

import hashlib
import json
import os
import re
import stat
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from optkit import __version__
from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.instances.clock import Clock
from optkit.instances.instance import Instance
from optkit.instances.storage import load_instances, read_description, save_instances

FILES = ["noise.parquet", "requests.parquet", "scenario.json", "workers.parquet"]
ARRAYS = ("arrival", "expiry", "reward", "penalty", "features", "pickup", "dropoff", "worker_step", "worker_group")


def random_instance(rng, n=4, workers=3, groups=2, k=2, noise="dense", outside="number", scale=1.0):
    """Draw an instance of the given size; ``scale`` sets the magnitude of its money."""
    horizon = int(rng.integers(max(workers, 1), max(workers, 1) + 9))
    arrival = rng.integers(0, horizon, n)
    drawn = Instance(
        horizon=horizon,
        arrival=arrival,
        expiry=rng.integers(arrival, horizon),
        reward=rng.normal(size=n) * scale,
        penalty=-rng.exponential(size=n) * scale,
        features=rng.normal(size=(n, k)),
        pickup=rng.integers(0, 70, n),
        dropoff=rng.integers(0, 70, n),
        worker_step=np.sort(rng.choice(horizon, workers, replace=False)),
        worker_group=rng.integers(0, groups, workers),
        utility=rng.normal(size=(groups, n)) * scale,
        mu=rng.exponential(size=groups) * scale + 1e-300,
        outside_utility=float(rng.normal()) if outside == "number" else rng.normal(size=groups),
    )
    return with_noise(drawn, rng, noise)


def with_noise(instance, rng, kind):
    if kind == "none":
        return instance
    noise = rng.normal(size=(instance.n_workers, instance.n_requests))
    if kind == "sparse":
        pairs = instance.pairs()
        noise = sparse.csr_array((noise[pairs], pairs), shape=noise.shape)
    fields = {name: getattr(instance, name) for name in (*ARRAYS, "horizon", "utility", "mu", "outside_utility")}
    return Instance(**fields, noise=noise, outside_noise=rng.normal(size=instance.n_workers))


@pytest.fixture
def instances():
    rng = np.random.default_rng(5)
    return [
        random_instance(rng, n=4 + b, workers=3 + b, noise=kind) for b, kind in enumerate(("dense", "sparse", "none"))
    ]


@pytest.fixture
def folder(tmp_path, instances):
    return save_instances(tmp_path / "set", instances, scenario={"name": "test", "seed": 5})


def change_json(folder, *path, value, seal=False):
    """Set one entry of scenario.json and drop the file's own checksum, or leave it in place with ``seal``."""
    file = folder / "scenario.json"
    document = json.loads(file.read_text())
    if not seal:
        document.pop("sha256", None)
    *inside, last = path
    place = document
    for key in inside:
        place = place[key]
    place[last] = value
    file.write_text(json.dumps(document, indent=1))


def change_table(folder, table, change):
    """Rewrite one table and put its new checksum and row count into scenario.json."""
    file = folder / f"{table}.parquet"
    data = change(pq.read_table(file))
    pq.write_table(data, file)
    stated = {"sha256": hashlib.sha256(file.read_bytes()).hexdigest(), "rows": data.num_rows}
    change_json(folder, "files", file.name, value=stated)


def set_cell(column, row, value):
    def change(table):
        at = table.column_names.index(column)
        cells = table.column(column).to_pylist()
        cells[row] = value
        return table.set_column(at, column, pa.array(cells, table.schema.field(column).type))

    return change


def bits(instance):
    return [getattr(instance, name).tobytes() for name in (*ARRAYS, "utility", "mu")]


def fails(folder, *words):
    """Check that loading raises one line that holds all the words."""
    with pytest.raises(DataError) as caught:
        load_instances(folder)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


# ---- round trip


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    sizes=st.lists(
        st.tuples(st.integers(0, 7), st.integers(0, 6), st.sampled_from(["none", "dense", "sparse"])), max_size=5
    ),
    groups=st.integers(1, 3),
    k=st.integers(0, 3),
    outside=st.sampled_from(["number", "per group"]),
    scale=st.sampled_from([1e-300, 1.0, 1e300]),
)
def test_round_trip_is_exact(seed, sizes, groups, k, outside, scale):
    """What is read back equals what was saved, to the last bit, whatever the sizes and the kinds of noise."""
    rng = np.random.default_rng(seed)
    saved = [random_instance(rng, n, workers, groups, k, kind, outside, scale) for n, workers, kind in sizes]
    with tempfile.TemporaryDirectory() as place:
        loaded = load_instances(save_instances(Path(place) / "set", saved))
    assert loaded == saved
    assert [bits(x) for x in loaded] == [bits(x) for x in saved]
    assert [repr(x) for x in loaded] == [repr(x) for x in saved]  # which also names the kind of noise
    assert [np.shape(x.outside_utility) for x in loaded] == [np.shape(x.outside_utility) for x in saved]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "dense", "sparse"])
@pytest.mark.parametrize(("n", "workers"), [(0, 0), (0, 3), (3, 0), (1, 1)])
def test_empty_instances_survive(tmp_path, n, workers, kind):
    """Neither requests nor workers need exist, and the kind of noise is kept even when it has no entry."""
    saved = [random_instance(np.random.default_rng(1), n, workers, k=0, noise=kind)] * 2
    loaded = load_instances(save_instances(tmp_path / "set", saved))
    assert loaded == saved
    assert [type(x.noise) for x in loaded] == [type(x.noise) for x in saved]


def test_empty_set_survives(tmp_path):
    """A set of no instances is a set."""
    assert load_instances(save_instances(tmp_path / "set", [])) == []


def test_negative_zero_and_extremes_keep_their_bits(tmp_path):
    """-0.0, the smallest and the largest float come back as they were."""
    odd = np.array([-0.0, 5e-324, np.finfo(float).max])
    fields = dict.fromkeys(("arrival", "expiry", "pickup", "dropoff"), np.zeros(3, int))
    saved = Instance(
        horizon=2**40, **fields, reward=odd, penalty=-np.abs(odd), features=odd[:, None], worker_step=[2**40 - 1],
        worker_group=[0], utility=[odd], mu=[5e-324], outside_utility=-0.0,
    )  # fmt: skip
    (loaded,) = load_instances(save_instances(tmp_path / "set", [saved]))
    assert loaded == saved
    assert bits(loaded) == bits(saved)
    assert np.signbit(loaded.outside_utility)


def test_same_set_gives_same_bytes(tmp_path, instances):
    """Nothing in the files depends on when or where they were written."""
    first, second = (save_instances(tmp_path / name, instances) for name in ("a", "b"))
    assert [(first / f).read_bytes() for f in FILES] == [(second / f).read_bytes() for f in FILES]


def test_noise_file_is_left_out_when_nothing_is_realised(tmp_path, instances):
    """Without noise there is no noise.parquet; an empty one is read as well."""
    folder = save_instances(tmp_path / "set", instances[2:])
    assert sorted(p.name for p in folder.iterdir()) == FILES[1:]
    assert load_instances(folder) == instances[2:]
    empty = pa.table(
        {c: pa.array([], pa.int64()) for c in ("instance", "worker", "request")} | {"noise": pa.array([], pa.float64())}
    )
    pq.write_table(empty, folder / "noise.parquet")
    change_table(folder, "noise", lambda table: table)
    assert load_instances(folder) == instances[2:]


def test_description_holds_scenario_and_sizes(folder, instances):
    """The description can be read without the tables."""
    (folder / "requests.parquet").unlink()
    description = read_description(folder)
    assert description["format"] == "optkit-instances"
    assert (description["schema"], description["optkit"]) == (1, __version__)
    assert description["scenario"] == {"name": "test", "seed": 5}
    assert [r["requests"] for r in description["instances"]] == [x.n_requests for x in instances]


def test_readable_without_optkit(folder, instances):
    """The tables, read by pandas alone, hold the arrays; the checksums are those of the files."""
    document = json.loads((folder / "scenario.json").read_text())
    requests, workers, noise = (pd.read_parquet(folder / f"{t}.parquet") for t in ("requests", "workers", "noise"))
    for name, stated in document["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == stated["sha256"]
    for b, (record, want) in enumerate(zip(document["instances"], instances, strict=True)):
        mine = requests[requests.instance == b]
        people = workers[workers.instance == b]
        for column in ("arrival", "expiry", "reward", "penalty", "pickup", "dropoff"):
            np.testing.assert_array_equal(mine[column], getattr(want, column))
        np.testing.assert_array_equal(mine.filter(regex="^feature_"), want.features)
        np.testing.assert_array_equal(mine.filter(regex="^utility_").T, want.utility)
        np.testing.assert_array_equal(people.step, want.worker_step)
        np.testing.assert_array_equal(people.group, want.worker_group)
        assert (record["horizon"], record["mu"]) == (want.horizon, list(want.mu))
        drawn = noise[noise.instance == b]
        if want.noise is None:
            assert drawn.empty
            assert people.outside_noise.isna().all()
            assert pq.read_table(folder / "workers.parquet").column("outside_noise").null_count == len(people)
            continue
        matrix = np.zeros(want.noise.shape)
        matrix[drawn.worker, drawn.request] = drawn.noise
        np.testing.assert_array_equal(matrix, want.noise.toarray() if sparse.issparse(want.noise) else want.noise)
        np.testing.assert_array_equal(people.outside_noise, want.outside_noise)


@pytest.mark.slow
def test_every_table_is_read_once(tmp_path, monkeypatch):
    """A set of 630 days is read with one pass over each table."""
    rng = np.random.default_rng(0)
    saved = [random_instance(rng, 5, 5)] * 630
    folder = save_instances(tmp_path / "set", saved)
    calls = []
    real = pq.ParquetFile
    monkeypatch.setattr(pq, "ParquetFile", lambda *a: calls.append(a) or real(*a))
    assert load_instances(folder) == saved
    assert len(calls) == 3


# ---- what may be saved


def test_instances_must_share_features_and_groups(tmp_path):
    """One set has one number of features and one of groups; the message names the odd instance."""
    rng = np.random.default_rng(0)
    for other in (random_instance(rng, k=3), random_instance(rng, groups=1)):
        with pytest.raises(
            InputError, match=r"instances\[1\] has . and . and instances\[0\] has 2 and 2 features and groups"
        ):
            save_instances(tmp_path / "set", [random_instance(rng), other])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        ({"a": np.int64(1)}, "not JSON"),
        ({"a": float("nan")}, "not JSON"),
        ({(1, 2): 3}, "not JSON"),
        ([1], "give a dict"),
    ],
)
def test_scenario_must_be_json(tmp_path, instances, scenario, message):
    """A scenario that JSON cannot hold is refused before anything is written."""
    with pytest.raises(InputError, match=message):
        save_instances(tmp_path / "set", instances, scenario=scenario)
    assert list(tmp_path.iterdir()) == []


def test_only_instances_are_saved(tmp_path, instances):
    """A lone instance or a stranger in the list is named."""
    with pytest.raises(InputError, match="put it into a list"):
        save_instances(tmp_path / "set", instances[0])
    with pytest.raises(InputError, match=r"instances\[3\] is a dict"):
        save_instances(tmp_path / "set", [*instances, {}])


# ---- overwriting


def test_existing_folder_needs_overwrite(folder, instances):
    """Without overwrite the old set stays; with it the new one replaces it, and nothing else is left behind."""
    with pytest.raises(InputError, match="overwrite=True"):
        save_instances(folder, instances[:1])
    assert load_instances(folder) == instances
    save_instances(folder, instances[:1], overwrite=True)
    assert load_instances(folder) == instances[:1]
    assert [p.name for p in folder.parent.iterdir()] == ["set"]


def test_overwrite_spares_other_folders(tmp_path, instances):
    """Overwriting refuses a folder that is not an instance set, a file, and a set that holds other files."""
    other, file = tmp_path / "thesis", tmp_path / "notes.txt"
    other.mkdir()
    (other / "chapter.tex").write_text("dear")
    file.write_text("dear")
    for place in (other, file):
        with pytest.raises(InputError, match="not an instance set"):
            save_instances(place, instances, overwrite=True)
    (other / "scenario.json").write_text('{"format": "something else"}')
    with pytest.raises(InputError, match="not an instance set"):
        save_instances(other, instances, overwrite=True)
    folder = save_instances(tmp_path / "set", instances)
    (folder / "results.csv").write_text("dear")
    with pytest.raises(InputError, match=re.escape("also holds 'results.csv'")):
        save_instances(folder, instances[:1], overwrite=True)
    assert {p.read_text() for p in (other / "chapter.tex", file, folder / "results.csv")} == {"dear"}


def test_damaged_set_can_be_overwritten(folder, instances):
    """Replacing is a remedy for a damaged table."""
    (folder / "noise.parquet").write_bytes(b"")
    save_instances(folder, instances, overwrite=True)
    assert load_instances(folder) == instances


def test_overwriting_through_a_link_replaces_its_target(folder, instances):
    """A symbolic link stays a link, and what it points at is replaced."""
    link = folder.parent / "link"
    link.symlink_to(folder)
    save_instances(link, instances[:1], overwrite=True)
    assert link.is_symlink()
    assert load_instances(folder) == instances[:1]


def test_parents_are_made(tmp_path, instances):
    """A save into folders that do not exist yet makes them, and returns the path it was given."""
    place = tmp_path / "a" / "b" / "set"
    assert save_instances(place, instances) == place
    assert load_instances(str(place)) == instances


# ---- all or nothing


def failing(real, at, error):
    """Let ``real`` run until its call number ``at``, which raises."""
    count = iter(range(1, 1000))

    def call(*args, **kwargs):
        if next(count) == at:
            raise error
        return real(*args, **kwargs)

    return call


@pytest.mark.slow
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize(
    ("what", "at"), [("replace", 1), ("replace", 2), ("fsync", 1), ("fsync", 3), ("fsync", 4)]
)  # the moves aside and into place; the first, third and last file
def test_failed_save_leaves_the_old_set(monkeypatch, folder, instances, what, at, error):
    """Whichever step fails, the old set is intact and nothing is left beside it."""
    monkeypatch.setattr(os, what, failing(getattr(os, what), at, error))
    with pytest.raises(OptkitError if isinstance(error, OSError) else KeyboardInterrupt) as caught:
        save_instances(folder, instances[:1], overwrite=True)
    if isinstance(error, OSError):
        assert "No space left on device" in str(caught.value)
    assert load_instances(folder) == instances
    assert [p.name for p in folder.parent.iterdir()] == ["set"]


def test_failed_first_save_leaves_nothing(monkeypatch, tmp_path, instances):
    """A new folder appears complete or not at all."""
    monkeypatch.setattr(os, "replace", failing(os.replace, 1, OSError(5, "Input/output error")))
    with pytest.raises(OptkitError, match=r"cannot be written \(Input/output error\)"):
        save_instances(tmp_path / "set", instances)
    assert list(tmp_path.iterdir()) == []


def test_failed_table_leaves_the_old_set(monkeypatch, folder, instances):
    """A writer that raises midway touches nothing."""
    monkeypatch.setattr(pq, "write_table", failing(pq.write_table, 2, RuntimeError("writer")))
    with pytest.raises(RuntimeError, match="writer"):
        save_instances(folder, instances[:1], overwrite=True)
    assert load_instances(folder) == instances
    assert [p.name for p in folder.parent.iterdir()] == ["set"]


def test_old_set_is_kept_when_it_cannot_be_put_back(monkeypatch, folder, instances):
    """If the disk refuses even the way back, no copy is deleted and the message says where the old set is."""
    real, count = os.replace, iter(range(1, 10))

    def refuse(*args):
        if next(count) > 1:
            raise OSError(5, "Input/output error")
        real(*args)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OptkitError, match="move it back") as caught:
        save_instances(folder, instances[:1], overwrite=True)
    (old,) = folder.parent.glob(".set.*.tmp/old")
    assert str(old) in str(caught.value)
    assert load_instances(old) == instances


def test_disk_that_does_not_flush_folders_is_no_failure(monkeypatch, folder, instances):
    """Once the files are flushed, a folder that cannot be only costs durability: the save succeeds."""
    real = os.fsync

    def fsync(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(22, "Invalid argument")
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    save_instances(folder, instances[:1], overwrite=True)
    assert load_instances(folder) == instances[:1]


def test_interrupted_save_of_a_namesake_is_not_offered(tmp_path):
    """The hidden folder of ``set.b`` is no remedy for a missing ``set``."""
    (tmp_path / ".set.b.abc.tmp" / "old").mkdir(parents=True)
    fails(tmp_path / "set", "not a folder")
    fails(tmp_path / "set.b", "move it back")


@pytest.mark.slow
@pytest.mark.parametrize("renames", [0, 1, 2])
def test_killed_save_leaves_a_whole_set(folder, instances, renames):
    """A process that dies before, between or after the renames leaves the old set or the new one, whole."""
    real, left = os.replace, [renames]

    def replace(*paths):
        if left[0]:
            real(*paths)
        left[0] -= 1
        if left[0] <= 0:
            os._exit(9)

    child = os.fork()  # spares what a new process would import
    if child == 0:
        try:
            os.replace = replace
            save_instances(folder, load_instances(folder)[:1], overwrite=True)
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    if renames == 1:
        fails(folder, "interrupted", "move it back")
        (old,) = folder.parent.glob(".set.*.tmp/old")
        os.replace(old, folder)
    assert load_instances(folder) == (instances[:1] if renames == 2 else instances)


# ---- damage


@pytest.mark.parametrize("name", FILES)
def test_missing_file(folder, name):
    """A file that is not there is named, with the remedy."""
    (folder / name).unlink()
    fails(folder, name, "is missing", "save_instances")


@pytest.mark.parametrize("name", FILES)
def test_truncated_file(folder, name):
    """A file that ends early is named."""
    file = folder / name
    file.write_bytes(file.read_bytes()[:-20])
    fails(folder, name, "truncated")


@pytest.mark.slow
@settings(max_examples=75, deadline=None)
@given(name=st.sampled_from(FILES), place=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_changed_byte_never_changes_an_instance(name, place, flip):
    """Any single changed byte is refused, or (in the JSON's own checksum entry, or a carriage return) harmless."""
    saved = [random_instance(np.random.default_rng(3), noise=kind) for kind in ("dense", "sparse")]
    with tempfile.TemporaryDirectory() as root:
        folder = save_instances(Path(root) / "set", saved, scenario={"seed": 3})
        file = folder / name
        data = bytearray(file.read_bytes())
        data[int(place * len(data))] ^= flip
        file.write_bytes(data)
        try:
            assert load_instances(folder) == saved
        except DataError as error:
            assert name in str(error)  # noqa: PT017
        else:
            assert name == "scenario.json"


def test_missing_folder_and_file_instead(tmp_path, folder):
    """A path that is no folder, and a folder that is no instance set."""
    fails(tmp_path / "nowhere", "nowhere", "not a folder")
    fails(folder / "scenario.json", "not a folder")
    (tmp_path / "empty").mkdir()
    fails(tmp_path / "empty", "scenario.json is missing")


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "\x00", '{"a": 1} x', "[" * 100_000])
def test_not_json(folder, text):
    """Anything but a JSON object is refused."""
    (folder / "scenario.json").write_text(text)
    fails(folder, "scenario.json", "not a JSON object")


def test_not_text(folder):
    """Bytes that are no UTF-8 are refused."""
    (folder / "scenario.json").write_bytes(b"\xff\xfe\xfa{}")
    fails(folder, "scenario.json", "not a JSON object")


def test_newer_schema(folder):
    """A set from a later version says so, and what to do."""
    change_json(folder, "schema", value=3)
    fails(folder, "written by a newer optkit (schema 3; this one reads up to 2): upgrade optkit")


def test_edited_description(folder, instances):
    """An edit is noticed until its checksum entry is deleted; line ends do not count."""
    change_json(folder, "scenario", "seed", value=6, seal=True)
    fails(folder, "scenario.json", "changed or damaged", "delete")
    change_json(folder, "scenario", "seed", value=6)
    assert load_instances(folder) == instances


def test_windows_line_ends_are_no_damage(folder, instances):
    """A version control system that rewrites line ends does not spoil a set."""
    file = folder / "scenario.json"
    file.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))
    assert load_instances(folder) == instances


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (["format"], "other", ["format 'other'"]),
        (["schema"], 0, ["schema 0"]),
        (["schema"], "1", ["schema '1'"]),
        (["schema"], True, ["schema True"]),
        (["scenario"], None, ["'scenario'"]),
        (["features"], -1, ["'features'"]),
        (["groups"], 1.5, ["'groups'"]),
        (["groups"], True, ["'groups'"]),
        (["groups"], 3, ["instance 0"]),
        (["features"], 3, ["requests.parquet", "no column 'feature_2'"]),
        (["files"], {}, ["does not list requests.parquet"]),
        (["files", "workers.parquet", "rows"], 7, ["workers.parquet", "rows, scenario.json says 7"]),
        (["instances"], {}, ["'instances'"]),
        (["instances", 1], 3, ["instance 1"]),
        (["instances", 1, "requests"], 3, ["requests.parquet has 5 rows of instance 1", "3"]),
        (["instances", 1, "requests"], 2**62, ["requests.parquet has 5 rows of instance 1"]),
        (["instances", 1, "workers"], 5, ["workers.parquet has 4 rows of instance 1", "5"]),
        (["instances", 1, "horizon"], 10**400, ["record of instance 1"]),
        (["instances", 1, "horizon"], 0, ["instance 1 breaks a rule: horizon is 0"]),
        (["instances", 1, "mu"], [1.0], ["record of instance 1"]),
        (["instances", 1, "mu"], [1.0, -1.0], ["instance 1 breaks a rule: mu[1]"]),
        (["instances", 1, "mu"], [1.0, float("nan")], ["instance 1 breaks a rule: mu[1]"]),
        (["instances", 1, "outside_utility"], "0", ["record of instance 1"]),
        (["instances", 1, "noise"], "fuzzy", ["record of instance 1"]),
        (["instances", 1, "noise"], [], ["record of instance 1"]),
        (["instances", 1, "noise"], "dense", ["noise.parquet", "rows of instance 1", "has 20"]),
        (["instances", 0, "noise"], "none", ["noise.parquet has 12 rows of instance 0", "has 0"]),
        (["instances", 2, "noise"], "sparse", ["instance 2 breaks a rule"]),
    ],
)
def test_wrong_description(folder, path, value, words):
    """Every entry of scenario.json is checked, against the tables too."""
    change_json(folder, *path, value=value)
    fails(folder, *words)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "change", "words"),
    [
        ("requests", lambda t: t.drop_columns("reward"), ["no column 'reward'"]),
        ("requests", lambda t: t.drop_columns("utility_1"), ["no column 'utility_1'"]),
        ("noise", lambda t: t.drop_columns("noise"), ["no column 'noise'"]),
        ("requests", lambda t: t.slice(1), ["has 3 rows of instance 0", "4"]),
        ("noise", lambda t: t.slice(0, 3), ["has 3 rows of instance 0", "12"]),
        ("requests", lambda t: t.take(np.arange(t.num_rows)[::-1]), ["out of order"]),
        ("workers", set_cell("worker", 1, 0), ["out of order", "row 1"]),
        ("workers", set_cell("worker", 2, 7), ["index range", "row 2"]),
        ("workers", set_cell("instance", 2, 7), ["unknown instance 7 in row 2"]),
        ("noise", set_cell("request", 1, 0), ["row 1"]),
        ("noise", set_cell("instance", 0, -1), ["unknown instance -1 in row 0"]),
        ("noise", set_cell("worker", 0, -1), ["index range in row 0"]),
        ("noise", set_cell("request", 0, -1), ["index range in row 0"]),
        ("noise", set_cell("request", 11, 4), ["index range in row 11"]),
        ("requests", set_cell("reward", 1, None), ["empty cells in column 'reward'"]),
        ("requests", set_cell("reward", 1, float("nan")), ["instance 0 breaks a rule: reward[1] is nan"]),
        ("requests", set_cell("penalty", 5, 1.0), ["instance 1 breaks a rule: penalty[1]"]),
        ("workers", set_cell("outside_noise", 1, None), ["instance 0 breaks a rule: outside_noise[1] is nan"]),
        ("workers", set_cell("outside_noise", 8, 1.0), ["outside_noise in instance 2", "not realised"]),
        (
            "requests",
            lambda t: t.cast(_retyped(t.schema, "reward", pa.float32())),
            ["float in column 'reward', not double"],
        ),
    ],
)
def test_wrong_table_with_right_checksum(folder, table, change, words):
    """A table that was rewritten, checksum and all, is still checked for columns, types, order and rules."""
    change_table(folder, table, change)
    with pytest.raises(DataError, match=f"{table}.parquet|instance .* breaks a rule"):
        load_instances(folder)
    fails(folder, *words)


def _retyped(schema, name, kind):
    at = schema.get_field_index(name)
    return schema.set(at, pa.field(name, kind))


@pytest.mark.parametrize("table", ["requests", "workers", "noise"])
def test_a_column_that_stands_twice(folder, table):
    """Every column of every table, a copy or not, at the end: which of the two counts is nobody's guess."""
    whole = pq.read_table(folder / f"{table}.parquet")
    for name in whole.column_names:
        pq.write_table(whole, folder / f"{table}.parquet")
        change_table(folder, table, lambda _, name=name: whole.append_column(name, whole.column(name)))
        fails(folder, f"{table}.parquet", f"has the column '{name}' twice")


def test_table_that_is_no_parquet(folder):
    """A file of another format, checksum and all, is refused."""
    data = b"instance,request\n0,0\n"
    (folder / "requests.parquet").write_bytes(data)
    change_json(folder, "files", "requests.parquet", "sha256", value=hashlib.sha256(data).hexdigest())
    fails(folder, "requests.parquet", "cannot read", "save_instances")


def test_more_columns_are_ignored(folder, instances):
    """A reader takes the columns it knows."""
    change_table(folder, "requests", lambda t: t.append_column("note", pa.array(["x"] * t.num_rows)))
    assert load_instances(folder) == instances


def test_features_beyond_those_declared_are_refused(folder):
    """Whoever edits the sizes does not drop a column in silence."""
    change_json(folder, "features", value=1)
    fails(folder, "requests.parquet", "has a column 'feature_1', beyond the features and groups")


def test_a_pipe_is_no_file(folder):
    """It might never end."""
    (folder / "scenario.json").unlink()
    os.mkfifo(folder / "scenario.json")
    fails(folder, "scenario.json", "is no regular file")


def test_folder_in_place_of_a_file(folder):
    """A folder where a table should be cannot be read."""
    (folder / "workers.parquet").unlink()
    (folder / "workers.parquet").mkdir()
    fails(folder, "workers.parquet cannot be read")


def test_labels_are_kept(tmp_path):
    """Schema 2: identifiers of text and of numbers, in some instances or all, names, queue and clock; else schema 1."""
    rng = np.random.default_rng(0)
    named = {"group_names": ("bike", "car"), "feature_names": ("km", "minutes")}
    days = [
        replace(random_instance(rng), request_id=["007", "7", "NA", " x"], worker_id=[1, 2, 3], **named),
        replace(random_instance(rng), request_id=[4, 3, 2, 1], clock=Clock("2026-03-02T08:00:00+01:00", 15.0), **named),
        replace(random_instance(rng), worker_joined=[0, 0, 0], **named),
        replace(random_instance(rng, n=0, workers=0), request_id=[], **named),
    ]
    folder = save_instances(tmp_path / "set", days)
    assert read_description(folder)["schema"] == 2
    again = load_instances(folder)
    assert again == days
    assert [None if one.request_id is None else one.request_id.tolist() for one in again] == [
        ["007", "7", "NA", " x"],
        [4, 3, 2, 1],
        None,
        [],
    ]
    with pytest.raises(InputError, match=r"instances\[1\] has group_names none and instances\[0\] bike, car"):
        save_instances(tmp_path / "other", [days[0], replace(days[1], group_names=None)])
    bare = [replace(one, request_id=None, worker_id=None, worker_joined=None, clock=None) for one in days]
    bare = [replace(one, group_names=None, feature_names=None) for one in bare]
    assert read_description(save_instances(tmp_path / "bare", bare))["schema"] == 1


@pytest.mark.parametrize(
    "path",
    [("columns", "request_id"), ("instances", 0, "labels", "request_id"), ("group_names",), ("instances", 0, "clock")],
)
def test_labels_that_do_not_fit_are_refused(tmp_path, path):
    """A description whose labels are not those of the tables."""
    day = replace(random_instance(np.random.default_rng(0)), request_id=[1, 2, 3, 4], group_names=("bike", "car"))
    folder = save_instances(tmp_path / "set", [day])
    change_json(folder, *path, value="text" if len(path) > 2 else "string", seal=True)
    with pytest.raises(DataError):
        load_instances(folder)
