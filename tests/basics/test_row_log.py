"""Rows kept as they come."""

import pytest

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.basics.row_log import RowLog


def test_rows_come_back(tmp_path):
    """What was added is there again, to the last digit, and what is missing is told."""
    log = RowLog(tmp_path / "deep" / "rows.jsonl", "a")
    log.add(2, {"x": 0.1 + 0.2, "y": None})
    log.add(0, {"x": 1e-300})
    again = RowLog(tmp_path / "deep" / "rows.jsonl", "a")
    assert again.rows == {2: {"x": 0.1 + 0.2, "y": None}, 0: {"x": 1e-300}}
    assert again.missing(range(4)) == [1, 3]


def test_a_line_cut_off_is_dropped(tmp_path):
    """At whatever byte the machine stopped, the rows before it are kept and the next is written whole."""
    path = tmp_path / "rows.jsonl"
    log = RowLog(path, "a")
    log.add(0, {"x": 1})
    kept = path.stat().st_size
    log.add(1, {"x": 2})
    whole = path.read_bytes()
    for cut in range(kept, len(whole)):
        path.write_bytes(whole[:cut])
        again = RowLog(path, "a")
        assert again.rows == {0: {"x": 1}}
        again.add(1, {"x": 3})
        assert RowLog(path, "a").rows == {0: {"x": 1}, 1: {"x": 3}}


def test_a_head_cut_off_begins_again(tmp_path):
    """A file that was just begun holds nothing."""
    path = tmp_path / "rows.jsonl"
    RowLog(path, "a")
    path.write_bytes(path.read_bytes()[:-5])
    assert RowLog(path, "a").rows == {}


def test_rows_of_others_are_refused(tmp_path):
    """Another computation's rows, another format, and damage in the middle are said, and stay as they are."""
    path = tmp_path / "rows.jsonl"
    RowLog(path, "a").add(0, {})
    whole = path.read_bytes()
    with pytest.raises(InputError, match="other instances"):
        RowLog(path, "b")
    assert path.read_bytes() == whole
    for damage in (whole[:-4] + b"\n" + whole, b'{"format": "diary"}\n', b"dear diary\n", b"[]\n"):
        path.write_bytes(damage)
        with pytest.raises(DataError):
            RowLog(path, "a")
        assert path.read_bytes() == damage


def test_a_file_in_the_way_is_said(tmp_path):
    """Where no folder can be made, the error names the file."""
    (tmp_path / "file").write_text("")
    with pytest.raises(OptkitError, match="cannot be written"):
        RowLog(tmp_path / "file" / "rows.jsonl", "a")


def test_without_a_path_nothing_is_written(tmp_path, monkeypatch):
    """Rows then live in memory."""
    monkeypatch.chdir(tmp_path)
    log = RowLog(None, "")
    log.add(0, {"x": 1})
    assert log.rows == {0: {"x": 1}}
    assert list(tmp_path.iterdir()) == []
