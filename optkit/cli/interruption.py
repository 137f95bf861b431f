"""Ctrl-C ends a command, wherever in a library it strikes."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from optkit.cli.console import say

SWALLOWED = 0.05
"""Seconds after which an interruption that a library swallowed comes again."""

STATUS = 130
"""The exit status of a command that was interrupted, as shells have it."""


class _Interruption(KeyboardInterrupt):
    """An interruption that tells when nobody has it any more.

    Whatever handles it, or passes it on, holds it. Python drops one that is raised in a callback of the garbage
    collector or of a weak reference, and modules made by Cython drop one that strikes while they are imported: the
    work would go on after it was said to be interrupted.
    """

    def __init__(self, dropped: Callable[[], None]) -> None:
        self._dropped = dropped

    def __del__(self) -> None:
        self._dropped()


@contextmanager
def interruptible() -> Iterator[None]:
    """End what stands in the block at SIGINT or SIGTERM, with one line and exit status 130.

    A scheduler's polite end is an interruption too: worker processes must not outlive this one.
    """
    said, running = False, True

    def interrupted(*_: object) -> None:
        nonlocal said
        if not said:
            said = True
            say("", "optkit: interrupted; what was there before stays", err=True)
        raise _Interruption(dropped)

    def dropped() -> None:
        if running:  # not from here: an exception is being dropped
            again = threading.Timer(SWALLOWED, come_again)
            again.daemon = True
            again.start()

    def come_again() -> None:
        if not running:
            return
        if hasattr(signal, "pthread_kill"):  # wakes the main thread from what it waits for
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        else:
            signal.raise_signal(signal.SIGINT)

    def unraisable(what: Any) -> None:
        if what.exc_type is not _Interruption:  # which comes again, so that there is nothing to say
            before(what)

    before, sys.unraisablehook = sys.unraisablehook, unraisable
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupted)
    try:
        yield
    except BaseException:
        if said:  # whatever a library has made of it: a failed import, say
            sys.exit(STATUS)
        raise
    finally:
        running = False
        sys.unraisablehook = before
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is left is closing down
