"""Finished work that is kept: found again as it was, never taken for other work, never put over other things."""

import json
import math
import os
from dataclasses import dataclass

import numpy as np
import pytest

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.basics.keeper import Form, KeptFiles, KeptRows, work_key
from optkit.basics.plain_json import sealed

FORM = Form("a test", 3, "an entry of a test", "choose another place")
LATER = Form("a test", 4, "an entry of a test")


@dataclass
class Settings:
    """Told by its fields."""

    rate: float


class Own:
    """Told by what it shows of itself."""

    def __init__(self, shown):
        self.shown = shown

    def __repr__(self):
        return self.shown


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (0.1, math.nextafter(0.1, 1)),
        (1, 1.0),
        (1, "1"),
        (True, 1),
        (0.0, -0.0),
        (math.inf, None),
        (math.nan, None),
        ({"a": 1}, {"b": 1}),
        (b"a", "a"),
        (np.zeros(2), np.zeros((1, 2))),
        (np.zeros(2), np.zeros(2, dtype=np.float32)),
        (np.arange(5000.0), np.where(np.arange(5000) == 2500, math.nextafter(2500, 1), np.arange(5000.0))),
        (Settings(0.1), Settings(math.nextafter(0.1, 1))),
        (Own("mine"), Own("yours")),
    ],
)
def test_whatever_differs_has_another_key(one, other):
    """By one bit, by its type, by its shape; alone, and inside of other things."""
    assert work_key(one) != work_key(other)
    assert work_key(3, {"deep": [one]}) != work_key(3, {"deep": [other]})
    assert work_key({"deep": [one]}) == work_key({"deep": [one]})


def test_the_parts_of_a_key_do_not_flow_together():
    """What stands where counts."""
    assert len({work_key("ab", "c"), work_key("a", "bc"), work_key(["a", "bc"]), work_key("abc")}) == 4


def test_rows_come_back(tmp_path):
    """What was added is there again, to the last digit, and what is missing and what was there already is told."""
    path = tmp_path / "deep" / "rows.jsonl"
    log = KeptRows(path, FORM, "a")
    log.add(2, {"x": 0.1 + 0.2, "y": None})
    log.add(0, {"x": 1e-300, "y": math.nan})
    again = KeptRows(path, FORM, "a")
    assert again.rows == log.rows == {2: {"x": 0.1 + 0.2, "y": None}, 0: {"x": 1e-300, "y": None}}
    assert again.missing(range(4)) == [1, 3]
    assert (log.found, again.found) == (frozenset(), {0, 2})


def test_a_line_cut_off_is_dropped(tmp_path):
    """At whatever byte the machine stopped, the rows before it are kept and the next is written whole."""
    path = tmp_path / "rows.jsonl"
    log = KeptRows(path, FORM, "a")
    log.add(0, {"x": 1})
    kept = path.stat().st_size
    log.add(1, {"x": 2})
    whole = path.read_bytes()
    for cut in range(kept, len(whole)):
        path.write_bytes(whole[:cut])
        again = KeptRows(path, FORM, "a")
        assert again.rows == {0: {"x": 1}}
        again.add(1, {"x": 3})
        assert KeptRows(path, FORM, "a").rows == {0: {"x": 1}, 1: {"x": 3}}


def test_a_head_cut_off_begins_again(tmp_path):
    """A file that was just begun holds nothing, wherever it was cut."""
    path = tmp_path / "rows.jsonl"
    KeptRows(path, FORM, "a")
    whole = path.read_bytes()
    for cut in range(len(whole)):
        path.write_bytes(whole[:cut])
        assert KeptRows(path, FORM, "a").rows == {}


FOREIGN = {
    "a note": b"dear diary\n",
    "a note in one line": b"dear diary",
    "other JSON": b'{"format": "diary"}\n',
    "other JSON in one line": b'{"precious": 1}',
    "a list": b"[]\n",
    "no text": b"\xff\xfe\x00",
    "deep": b"[" * 100_000 + b"\n",
    "a table": b"PAR1 and so on",
    "another version's": json.dumps(LATER.entry("a", {})).encode() + b"\n",
    "another release's": json.dumps(sealed(FORM.entry("a", {}) | {"optkit": "0.0.9"})).encode() + b"\n",
    "of no version": b'{"format": "a test", "key": "a"}\n',
    "of a wrong version": b'{"format": "a test", "key": "a", "version": true, "optkit": "0.1.0"}\n',
}


@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN)
def test_what_is_not_ours_is_named_and_stays(tmp_path, content):
    """One line says which file, what about it and what to do, of rows and of entries."""
    path = tmp_path / "a.json"
    path.write_bytes(content)
    kept = KeptFiles(tmp_path, FORM)
    asked = (
        lambda: KeptRows(path, FORM, "a"),
        lambda: kept.get("a"),
        lambda: kept.put("a", {}),
        lambda: kept.forget(["a"]),
    )
    for ask in asked:
        with pytest.raises(
            DataError, match=r"a.json (is not an entry|is of version|was written by).*another place"
        ) as said:
            ask()
        assert "\n" not in str(said.value)
        assert len(str(said.value)) < 300
        assert path.read_bytes() == content


def test_rows_of_other_work_are_refused(tmp_path):
    """They stay as they are."""
    path = tmp_path / "rows.jsonl"
    KeptRows(path, FORM, "a").add(0, {})
    whole = path.read_bytes()
    with pytest.raises(InputError, match="other instances"):
        KeptRows(path, FORM, "b")
    assert path.read_bytes() == whole


def test_damaged_rows_are_named_and_stay(tmp_path):
    """Any change of a line but the last one's end is seen, and said of its line; the file stays."""
    path = tmp_path / "rows.jsonl"
    log = KeptRows(path, FORM, "a")
    for number in range(3):
        log.add(number, {"x": [number / 7]})
    head, first, *rest = path.read_bytes().splitlines(keepends=True)
    row = json.loads(first)
    harms = [
        first.replace(b"0.", b"1."),
        first[:-9] + b"\n",
        b"\n",
        b"[" * 100_000 + b"\n",
        b'{"number": 1e400, "row": {}}\n',
    ]
    harms += [
        json.dumps(changed).encode() + b"\n"
        for changed in (row | {"number": 1}, row | {"number": "0"}, row | {"row": {}})
    ]
    harms += [first[:at] + bytes([first[at] ^ 1]) + first[at + 1 :] for at in range(0, len(first) - 1, 7)]
    for harm in harms:
        path.write_bytes(head + harm + b"".join(rest))
        with pytest.raises(DataError, match=r"rows.jsonl is damaged in line"):
            KeptRows(path, FORM, "a")
        assert path.read_bytes() == head + harm + b"".join(rest)
    path.write_bytes(head.replace(b'"a"', b'"b"') + first)
    with pytest.raises(DataError, match="damaged in line 1"):
        KeptRows(path, FORM, "a")
    path.write_bytes(head + b"".join(rest))  # as one is told to: without the line
    assert KeptRows(path, FORM, "a").missing(range(3)) == [0]


def test_entries_come_back_and_damaged_ones_count_as_missing(tmp_path):
    """Cut anywhere, or changed anywhere inside, an entry is not there, and can be written anew."""
    kept = KeptFiles(tmp_path, FORM)
    assert kept.get("a") is None
    kept.put("a", {"x": [0.1 + 0.2, None]})
    assert KeptFiles(tmp_path, FORM).get("a")["x"] == [0.1 + 0.2, None]
    whole = kept.path("a").read_bytes()
    inside = whole.index(b'"key"')
    harms = [whole[:cut] for cut in range(0, len(whole) - 2, 5)]
    harms += [whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :] for at in range(inside, len(whole) - 2, 5)]
    harms = [harm for harm in harms if json.loads(whole) != _parsed(harm)]
    for number, harm in enumerate(harms, start=1):
        kept.path("a").write_bytes(harm)
        assert kept.get("a") is None
        assert kept.damaged == number
    kept.put("a", {"x": [2]})
    assert kept.get("a")["x"] == [2]
    os.rename(kept.path("a"), kept.path("b"))
    assert kept.get("b") is None  # it is another's
    kept.forget(["a", "b"])
    assert list(tmp_path.iterdir()) == []


def _parsed(text):
    try:
        return json.loads(text)
    except ValueError:
        return None


def test_what_is_no_file_is_said(tmp_path):
    """A folder, a device and a pipe are not waited for; where no folder can be made, the error names the file."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="folder is a folder"):
        KeptRows(tmp_path / "folder", FORM, "a")
    for make, told in (
        (lambda: KeptRows(tmp_path / "file" / "rows", FORM, "a"), "rows"),
        (lambda: KeptFiles(tmp_path / "file", FORM), "file"),
    ):
        with pytest.raises(OptkitError, match=f"{told} cannot be"):
            make()
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.json")
        for ask in (lambda: KeptRows(tmp_path / "pipe.json", FORM, "a"), lambda: KeptFiles(tmp_path, FORM).get("pipe")):
            with pytest.raises(InputError, match=r"pipe.json is no regular file: choose another place"):
                ask()


def test_without_a_path_nothing_is_written(tmp_path, monkeypatch):
    """Rows then live in memory."""
    monkeypatch.chdir(tmp_path)
    log = KeptRows(None, FORM, "")
    log.add(0, {"x": 1})
    assert log.rows == {0: {"x": 1}}
    assert list(tmp_path.iterdir()) == []


def test_a_row_is_of_its_work(tmp_path):
    """Whoever puts one file's rows under another's head is told; older rows do not say whose they are."""
    for key in ("a" * 32, "b" * 32):
        KeptRows(tmp_path / key[0], FORM, key).add(0, {"bound": 1.0})
    head, _ = (tmp_path / "a").read_text().splitlines()
    _, row = (tmp_path / "b").read_text().splitlines()
    (tmp_path / "mixed").write_text(f"{head}\n{row}\n")
    with pytest.raises(InputError, match="a row of other work in line 2"):
        KeptRows(tmp_path / "mixed", FORM, "a" * 32)
    (tmp_path / "old").write_text(f"{head}\n{json.dumps(sealed({'number': 0, 'row': {'bound': 2.0}}))}\n")
    assert KeptRows(tmp_path / "old", FORM, "a" * 32).rows == {0: {"bound": 2.0}}
    for odd in ({"number": [1], "row": {}}, {"number": 1, "row": 3}, {"number": True, "row": {}}, {"number": 1}):
        (tmp_path / "odd").write_text(f"{head}\n{json.dumps(sealed(odd))}\n")
        with pytest.raises(DataError, match="damaged in line 2"):
            KeptRows(tmp_path / "odd", FORM, "a" * 32)
