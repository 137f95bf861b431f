"""Files are whole or not there, and what was there before stays until the new one is on the disk."""

import os
import stat
import subprocess
import sys

import pytest

from optkit.basics import files
from optkit.basics.errors import OptkitError
from optkit.basics.files import append_line, clear_staging, write_together, write_whole


def listing(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_written_is_there(tmp_path):
    """Bytes as they are, text as UTF-8, nothing beside them."""
    assert write_whole(tmp_path / "a", b"\xff\n").read_bytes() == b"\xff\n"
    assert write_whole(tmp_path / "a", "µ\n").read_bytes() == "µ\n".encode()
    assert listing(tmp_path) == ["a"]


@pytest.mark.parametrize("fails", ["os.fsync", "os.replace", "os.open", "os.fdopen", "os.chmod"])
def test_a_disk_that_refuses_leaves_what_was_there(tmp_path, monkeypatch, fails):
    """Wherever it refuses, one line names the file, the old files stand, and nothing is left beside them."""
    old = {tmp_path / "a": "1", tmp_path / "b": "2"}
    write_together(old)

    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(fails, refuse)
    with pytest.raises(OptkitError, match=r"/a cannot be written \(No space left on device\)$"):
        write_together({tmp_path / "a": "3", tmp_path / "b": "4", tmp_path / "c": "5"})
    monkeypatch.undo()
    assert {path: path.read_text() for path in old} == old
    assert listing(tmp_path) == ["a", "b"]


def test_none_is_replaced_before_all_are_written(tmp_path, monkeypatch):
    """If the second of two does not fit on the disk, the first is the old one too."""
    write_together({tmp_path / "a": "1", tmp_path / "b": "2"})
    flush, count = os.fsync, iter(range(9))

    def full(handle):
        if next(count) == 1:
            raise OSError(28, "No space left on device")
        flush(handle)

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OptkitError, match="/b cannot be written"):
        write_together({tmp_path / "a": "3", tmp_path / "b": "4"})
    assert (tmp_path / "a").read_text() == "1"
    assert listing(tmp_path) == ["a", "b"]


def test_an_interruption_leaves_what_was_there(tmp_path, monkeypatch):
    """Ctrl-C while the disk works: as if nothing had been asked for."""
    write_whole(tmp_path / "a", "1")

    def stop(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "a", "2")
    with pytest.raises(KeyboardInterrupt):
        append_line(tmp_path / "a", b"2")
    assert (tmp_path / "a").read_text() == "1"
    assert listing(tmp_path) == ["a"]


def test_permissions_and_links_stay(tmp_path):
    """A private file stays private, and a link goes on pointing to the file, which is the one that is written."""
    secret, link = tmp_path / "secret", tmp_path / "link"
    secret.write_text("1")
    secret.chmod(0o600)
    link.symlink_to("secret")
    write_whole(link, "2")
    assert link.is_symlink()
    assert secret.read_text() == "2"
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    before = os.umask(0o027)
    try:
        assert stat.S_IMODE(write_whole(tmp_path / "new", "1").stat().st_mode) == 0o640
    finally:
        os.umask(before)


def test_what_is_no_file_is_not_replaced(tmp_path):
    """Folders, pipes and missing folders: one line, and they stay."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder", "none/file"):
        with pytest.raises(OptkitError, match=rf"{name} cannot be written \("):
            write_whole(tmp_path / name, "1")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert listing(tmp_path) == ["folder", "pipe"]


def test_write_protected_files_stay(tmp_path, monkeypatch):
    """As for anybody who opens them; root may write anywhere, so that the refusal is made up here."""
    write_whole(tmp_path / "a", "1")
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(OptkitError, match="it is write-protected"):
        write_whole(tmp_path / "a", "2")
    assert (tmp_path / "a").read_text() == "1"


def test_a_line_is_added_whole_or_not_at_all(tmp_path, monkeypatch):
    """Also where the system takes but a part of it at a time, and then no more."""
    path, write = tmp_path / "rows", os.write
    append_line(path, b"first")
    monkeypatch.setattr("os.write", lambda handle, data: write(handle, data[:2]))
    append_line(path, b"second")
    assert path.read_bytes() == b"first\nsecond\n"
    count = iter(range(9))

    def full(handle, data):
        if next(count) == 2:
            raise OSError(28, "No space left on device")
        return write(handle, data[:2])

    monkeypatch.setattr("os.write", full)
    with pytest.raises(OSError, match="No space"):
        append_line(path, b"third and long")
    assert path.read_bytes() == b"first\nsecond\n"


def test_what_a_dead_process_left_is_cleared(tmp_path):
    """One that is alive keeps its own, and so does another machine; nobody else's hidden file is touched."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    gone = f".optkit-{files.HOST}-{dead.pid}-00.tmp"
    stay = [f".optkit-{files.HOST}-{os.getpid()}-00.tmp", f".optkit-{'x' * 6}-{dead.pid}-00.tmp", f".{dead.pid}.tmp"]
    for name in (gone, *stay):
        (tmp_path / name).write_text("half")
    clear_staging(tmp_path)
    assert listing(tmp_path) == sorted(stay)
