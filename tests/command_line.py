"""The command line, called in this process as a user calls it in one of its own: a tenth of the time."""

import contextlib
import io
import json
import signal
import sys
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from optkit.cli import main


class Done(NamedTuple):
    """How a command ended, and what it printed; named as by ``subprocess``."""

    returncode: int
    stdout: str
    stderr: str


def optkit(*arguments, cwd=None, check=None):
    """Run ``optkit`` with arguments, in a folder; ``check`` is the exit status that it must have.

    Streams are files of bytes as in a process. Signal handlers, ``sys.argv`` and the folder are put back. What only a
    process shows, such as signals, pipes and imports, needs one.
    """
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    try:
        with (
            patch.object(sys, "argv", ["optkit", *map(str, arguments)]),
            contextlib.chdir(cwd or Path.cwd()),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            main()
            status = 0
    except SystemExit as left:
        status = left.code or 0
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    done = Done(status, *(stream.buffer.getvalue().decode() for stream in (out, err)))
    assert check in (None, done.returncode), done.stderr
    return done


def strict(text):
    """Parse JSON that every reader takes."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)
