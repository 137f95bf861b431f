"""Ctrl-C and a scheduler's SIGTERM end a command, wherever they strike."""

import contextlib
import gc
import os
import signal
import sys
import time
import weakref
from unittest.mock import patch

import pytest

from optkit.cli import interruption, main
from optkit.cli.interruption import interruptible


def in_callback_of_weak_reference():
    """Where an import is let go of, Python calls back and drops what is raised there."""

    class Module:
        pass

    module = Module()
    reference = weakref.ref(module, lambda _: strike())
    del module
    return reference


def in_garbage_collection():
    """Libraries count what is collected, and Python drops what is raised there."""
    gc.callbacks.append(lambda phase, _: strike() if phase == "start" else None)
    try:
        gc.collect()
    finally:
        gc.callbacks.pop()


def in_code_that_takes_everything():
    """A user's policy that takes any error for its own."""
    with contextlib.suppress(BaseException):
        strike()


def in_code_that_makes_another_error_of_it():
    """Modules made by Cython say that an import failed."""
    try:
        strike()
    except BaseException:
        raise ImportError from None


def strike():
    """Ctrl-C, and the next bytecode in which Python looks."""
    signal.raise_signal(signal.SIGINT)
    time.sleep(0)


@pytest.fixture
def handlers():
    """Signal handlers are put back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    "swallowed",
    [
        in_callback_of_weak_reference,
        in_garbage_collection,
        in_code_that_takes_everything,
        in_code_that_makes_another_error_of_it,
    ],
)
def test_an_interruption_that_is_swallowed_comes_again(handlers, swallowed, capsys, monkeypatch):
    """It is said once, and ends the work although something dropped it."""
    monkeypatch.setattr(interruption, "SWALLOWED", 0.001)

    @interruptible()
    def work():
        swallowed()
        time.sleep(20)

    with pytest.raises(SystemExit, match="130"):
        work()
    assert capsys.readouterr().err == "\noptkit: interrupted; what was there before stays\n"


def test_an_interruption_that_is_handled_does_not_come_again(handlers, monkeypatch):
    """Cleaning up takes as long as it takes."""
    monkeypatch.setattr(interruption, "SWALLOWED", 0.001)
    cleaned = False

    @interruptible()
    def work():
        nonlocal cleaned
        try:
            strike()
        finally:
            time.sleep(0.05)
            cleaned = True

    with pytest.raises(SystemExit, match="130"):
        work()
    assert cleaned


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_interruption_is_said_and_leaves_nothing(tmp_path, sent):
    """Ctrl-C and a scheduler's SIGTERM end a run with one line, exit status 130 and no results folder."""
    reading, writing = os.pipe()
    child = os.fork()  # spares what a new process would import
    if child == 0:
        status = 1
        try:
            os.dup2(writing, 2)
            sys.stdout = sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115
            door = sys.modules["optkit.cli.app"]
            command = door._command
            with patch.object(door, "_command", lambda verb: (print("started", flush=True), command(verb))[1]):
                status = optkit_process("run", "I.1", "--out", str(tmp_path / "r"))
        finally:
            sys.stderr.flush()
            os._exit(status)
    os.close(writing)
    with open(reading) as told:
        assert told.readline() == "started\n"
        time.sleep(0.3)  # in the middle of things
        os.kill(child, sent)
        rest = told.read()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 130
    assert rest == "\noptkit: interrupted; what was there before stays\n"
    assert list(tmp_path.iterdir()) == []


def optkit_process(*arguments):
    """Run the command line with the streams of this process, and return its exit status."""
    sys.argv = ["optkit", *arguments]
    try:
        main()
    except SystemExit as left:
        return left.code
    return 0
