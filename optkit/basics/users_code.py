"""Code of the user's own that the kit calls: in whatever way it fails, that is one line with its name."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from functools import partial
from pathlib import Path
from traceback import walk_tb

from optkit.basics.arrays import Error
from optkit.basics.errors import OptkitError, PolicyError

KIT, STANDARD = Path(__file__).parents[1], Path(os.__file__).parent
"""Folders whose code is not the user's; nor is what is installed."""

LONGEST = 300
"""Characters of an exception's text in a message."""

_aside = False


def prints_aside() -> bool:
    """Whether what the user's code prints goes to standard error."""
    return _aside


@contextmanager
def printing_aside(wanted: bool = True) -> Iterator[None]:
    """Send what the user's code prints to standard error meanwhile: standard output is a command's answer.

    Examples
    --------
    >>> with printing_aside(), users_code("the policy"):
    ...     print("not here")
    """
    global _aside
    before, _aside = _aside, wanted
    try:
        yield
    finally:
        _aside = before


def name_of(code: object) -> str:
    """Name of a function, or of the class of what else can be called.

    Examples
    --------
    >>> name_of(name_of), name_of(partial(name_of)), name_of(3)
    ('name_of', 'name_of', 'int')
    """
    while isinstance(code, partial):
        code = code.func
    return str(getattr(code, "__name__", type(code).__name__))


@contextmanager
def users_code(what: str, error: Error = PolicyError) -> Iterator[None]:
    """Run code that is not the kit's, and make one line of its exceptions, which stay as the cause.

    Its ``sys.exit()`` is a failure too: whoever is asked for prices does not end the run. Errors of the kit, Ctrl-C and
    want of memory come through as they are.

    Parameters
    ----------
    what : str
        What runs, for the message.
    error : type, optional
        Class of the error.

    Raises
    ------
    PolicyError
        Or the error class given: "``what`` failed", with the exception, and its file and line.

    Examples
    --------
    >>> with users_code("the policy third"):
    ...     1 / 0
    Traceback (most recent call last):
    ...
    optkit.basics.errors.PolicyError: the policy third failed (ZeroDivisionError: division by zero)...
    """
    try:
        with redirect_stdout(sys.stderr) if _aside else nullcontext():
            yield
    except (OptkitError, KeyboardInterrupt, MemoryError):
        raise
    except BaseException as fault:  # SystemExit, and what else a program may end with
        raise error(f"{what} failed ({_told(fault)}){_place(fault)}") from fault


def _told(fault: BaseException) -> str:
    kind = type(fault).__name__
    try:
        said = " ".join(str(fault).split())
    except Exception:  # its text is the user's code, too
        said = ""
    if isinstance(fault, SystemExit):
        return f"it called sys.exit({said})"
    said = f"{said[:LONGEST]} ..." if len(said) > LONGEST else said
    return f"{kind}: {said}" if said else kind


def _place(fault: BaseException) -> str:
    """Where the user's code stood when it failed: the last frame that is neither the kit's nor a library's."""
    place = ""
    for frame, line in walk_tb(fault.__traceback__):
        file = Path(frame.f_code.co_filename)
        if not ({KIT, STANDARD} & {*file.parents} or "site-packages" in file.parts or file.name.startswith("<frozen")):
            # What came from another process has forgotten its file.
            place = f" in {file.name}, line {line}" if file.name != "<dynamic-code>" else f" in line {line}"
    return place
