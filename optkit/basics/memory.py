"""What a computation would need of memory, said before the work and not by the system after it."""

from __future__ import annotations

import os
from contextlib import suppress

from optkit.basics.errors import InputError

try:
    import resource
except ImportError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]


def memory_limit() -> float:
    """Bytes that this process may take: the machine's memory, or less where its limits leave less."""
    found = [float("inf")]
    with suppress(AttributeError, OSError, ValueError):
        found.append(float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")))
    with suppress(AttributeError, OSError, ValueError):
        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        found.append(float("inf") if most == resource.RLIM_INFINITY else float(most - _taken()))
    with suppress(OSError, ValueError), open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:
        found.append(float(file.read()))
    return min(found)


def _taken() -> int:
    """Bytes of address space that are in use, where the system tells."""
    with suppress(OSError, ValueError), open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    return 0


def check_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse what would not fit in memory.

    Parameters
    ----------
    what : str
        What is asked for, in the user's words.
    needed : float
        Bytes that it takes, as far as one can tell.
    remedy : str
        How to ask for less.

    Raises
    ------
    InputError
        If it takes more than :func:`memory_limit`.

    Examples
    --------
    >>> check_memory("a day", 1e3, "take fewer steps")
    >>> check_memory("a day", 1e30, "take fewer steps")
    Traceback (most recent call last):
        ...
    optkit.basics.errors.InputError: a day would take about 9.3e+20 GiB of memory, more than there is: take fewer steps
    """
    if not needed <= memory_limit():
        raise InputError(f"{what} would take about {needed / 2**30:.2g} GiB of memory, more than there is: {remedy}")
