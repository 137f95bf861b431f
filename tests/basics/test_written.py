"""What optkit remembers of the files that it wrote."""

import pytest

from optkit.basics import written
from optkit.basics.written import remember, remembered


@pytest.fixture
def record(tmp_path, monkeypatch):
    """An own record, which is not there yet."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "optkit" / "written"


def test_what_was_remembered_is_known_to_the_byte(record):
    """Once, however often it was written."""
    assert not remembered(b"a")
    remember(b"a")
    remember(b"a")
    assert (remembered(b"a"), remembered(b"a\n"), len(record.read_bytes().split())) == (True, False, 1)


def test_the_oldest_are_forgotten(record, monkeypatch):
    """The record does not grow without end."""
    monkeypatch.setattr(written, "KEPT", 6)
    for number in range(20):
        remember(bytes([number]))
    assert remembered(bytes([19]))
    assert not remembered(bytes([0]))
    assert len(record.read_bytes().split()) <= 6


def test_a_home_that_cannot_be_written_knows_nothing(record):
    """And says nothing: files count as somebody else's."""
    record.parent.write_text("in the way")
    remember(b"a")
    assert not remembered(b"a")
