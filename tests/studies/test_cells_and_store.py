"""Cells are their description; what is stored is whole, or is not there."""

import hashlib
import json
import os
import subprocess
import sys

import pytest

from optkit.basics.errors import DataError, OptkitError
from optkit.basics.files import HOST
from optkit.studies import cells
from optkit.studies.cells import Cell
from optkit.studies.store import CellStore, Stored

PLACE = {"scenario": "I.2", "world": 0, "set": {"horizon": 12, "split": [20, 4, 4]}}
CELL = Cell("policy", PLACE, {"policy": "PP", "seed": 0})


@pytest.mark.parametrize(
    "other",
    [
        Cell("policy", PLACE, {"policy": "FP", "seed": 0}),
        Cell("policy", PLACE, {"policy": "PP", "seed": 1}),
        Cell("policy", {**PLACE, "world": 1}, {"policy": "PP", "seed": 0}),
        Cell("policy", {**PLACE, "set": {"horizon": 13, "split": [20, 4, 4]}}, {"policy": "PP", "seed": 0}),
        Cell("bounds", PLACE, {"policy": "PP", "seed": 0}),
    ],
)
def test_what_differs_has_another_key(other):
    assert other.key != CELL.key


def test_the_schema_is_part_of_the_key(monkeypatch):
    """Results of an older meaning are not taken for new ones."""
    monkeypatch.setattr(cells, "SCHEMA", cells.SCHEMA + 1)
    assert Cell("policy", PLACE, {"policy": "PP", "seed": 0}).key != CELL.key


def test_a_result_comes_back_as_it_was(tmp_path):
    store, result = CellStore(tmp_path), {"reward": [0.1 + 0.2, 1e-300], "score": None, "taken": [[1, 2], [3, 4]]}
    assert store.get(CELL) is None
    store.put(CELL, result, 1.25)
    assert CellStore(tmp_path).get(CELL) == Stored(result, 1.25)
    told = json.loads(store.path(CELL).read_text())
    assert told["settings"] == CELL.settings
    assert told["place"] == PLACE
    store.forget([CELL])
    assert store.get(CELL) is None


@pytest.mark.parametrize(
    "harm",
    [
        lambda data: data[: len(data) // 2],
        lambda data: b"",
        lambda data: data.replace(b"0.5", b"0.6"),
        lambda data: data.replace(CELL.key.encode(), b"0" * len(CELL.key)),
    ],
)
def test_what_was_damaged_is_not_read(tmp_path, harm):
    """Cut, empty, changed, or renamed from another cell."""
    store = CellStore(tmp_path)
    store.put(CELL, {"score": 0.5}, 1.0)
    path = store.path(CELL)
    path.write_bytes(harm(path.read_bytes()))
    assert store.get(CELL) is None
    assert store.damaged == 1


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda data: data.replace(b"optkit cell", b"another cat"), "is not a cell of a study, so it stays"),
        (lambda data: b"[1, 2]", "is not a cell of a study, so it stays"),
        (lambda data: data.replace(b'"version": 2', b'"version": 1'), "is of version 1, this optkit's is 2"),
    ],
)
def test_what_is_not_ours_is_named_and_stays(tmp_path, harm, said):
    """Something else in a cell's place, or a cell of another version; also when all is to be worked out anew."""
    store = CellStore(tmp_path)
    store.put(CELL, {"score": 0.5}, 1.0)
    path = store.path(CELL)
    changed = harm(path.read_bytes())
    path.write_bytes(changed)
    for ask in (lambda: store.get(CELL), lambda: store.put(CELL, {}, 1.0), lambda: store.forget([CELL])):
        with pytest.raises(DataError, match=f"{said}: move it away, or choose another folder with --out"):
            ask()
    assert path.read_bytes() == changed


def test_cells_of_studies_on_disk_are_still_read(tmp_path):
    """As they were written until the digest was of all that an entry says."""
    store, result = CellStore(tmp_path), {"reward": [0.1 + 0.2, 1e-300], "score": None}
    digest = hashlib.sha256(json.dumps(result, sort_keys=True).encode()).hexdigest()
    about = {"format": "optkit cell", "schema": 2, "optkit": "0.0.9", "key": CELL.key, **CELL.describe()}
    text = json.dumps({**about, "seconds": 1.25, "sha256": digest, "result": result})
    store.path(CELL).write_text(text)
    assert store.get(CELL) == Stored(result, 1.25)
    for harm in (
        text.replace("1.25", "null"),
        text.replace("1.25", "1e999"),
        text.replace("e-300", "e-301"),
        text[:-1],
    ):
        store.path(CELL).write_text(harm)
        assert store.get(CELL) is None


def test_what_a_dead_process_left_is_cleared_and_a_living_one_keeps_its_own(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    names = [f".optkit-{HOST}-{process}-0.tmp" for process in (dead.pid, os.getpid())]
    for name in names:
        (tmp_path / name).write_text("half")
    CellStore(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == names[1:]


def test_a_full_disk_is_said_and_loses_nothing(tmp_path, monkeypatch):
    """The disk refuses in the middle of a write: the cells of before stay, and nothing half written is left."""
    store, other = CellStore(tmp_path), Cell("policy", PLACE, {"policy": "FP", "seed": 0})
    store.put(CELL, {"score": 0.5}, 1.0)

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OptkitError, match=r"cannot be written \(No space left on device\); what is finished stays"):
        store.put(other, {"score": 0.7}, 1.0)
    monkeypatch.undo()
    assert store.get(CELL) == Stored({"score": 0.5}, 1.0)
    assert store.get(other) is None
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_cannot_be_written_is_said_at_once(tmp_path):
    """A file stands in the way."""
    (tmp_path / "taken").write_text("")
    with pytest.raises(OptkitError, match=r"taken.* cannot be written"):
        CellStore(tmp_path / "taken")


def test_a_read_only_folder_is_said_at_once(tmp_path, monkeypatch):
    """As the system says it; root may write anywhere, so that the refusal is made up here."""

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(OptkitError, match=r"cells cannot be written \(Permission denied\); what is finished stays"):
        CellStore(tmp_path / "cells")
