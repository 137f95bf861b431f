"""Files that appear whole or not at all: the one place where optkit writes to the disk."""

from __future__ import annotations

import hashlib
import os
import platform
import secrets
import stat
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from optkit.basics.errors import OptkitError

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

HOST = hashlib.sha256(platform.node().encode()).hexdigest()[:6]
"""Tells machines apart that share a disk: they give the same numbers to different processes."""


def write_whole(path: str | os.PathLike[str], data: bytes | str, remedy: str = "") -> Path:
    """Write one file, see :func:`write_together`.

    Returns
    -------
    Path
        The file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     write_whole(f"{place}/note.txt", "dear diary").read_text()
    'dear diary'
    """
    write_together({path: data}, remedy)
    return Path(path)


def write_together(contents: Mapping[str | os.PathLike[str], bytes | str], remedy: str = "") -> None:
    """Write files, each whole or not at all, and none before all of them are on the disk.

    Each is written under another name beside its place, flushed, and renamed. What a link points to is replaced, not
    the link; the permissions of a file that is replaced stay; one that is write-protected is not replaced.

    Parameters
    ----------
    contents : mapping from path to bytes or str
        The folders exist. Text is written as UTF-8.
    remedy : str
        What to do if the disk refuses, for the message.

    Raises
    ------
    OptkitError
        If the disk refuses; what was there before stays.
    """
    staged: list[tuple[Path, Path]] = []
    at: str | os.PathLike[str] = ""
    try:
        for at, data in contents.items():
            target = Path(os.path.realpath(at))
            staged.append((_stage(target, data.encode() if isinstance(data, str) else data), target))
        for at, (staging, target) in zip(contents, staged, strict=True):  # noqa: B007  # named if it fails
            os.replace(staging, target)
            sync_folder(target.parent)
    except OSError as error:
        raise cannot_write(at, error, remedy) from error
    finally:
        for staging, _ in staged:
            with suppress(OSError):
                staging.unlink(missing_ok=True)


def append_line(path: Path, line: bytes) -> None:
    """Add a line to a file and flush it to the disk; if that fails, or is interrupted, the file is as it was.

    Raises
    ------
    OSError
        If the disk refuses.
    """
    with open(path, "ab", buffering=0) as file, locked(file.fileno()):
        before = os.fstat(file.fileno()).st_size
        rest = memoryview(line + b"\n")
        try:
            while rest:
                rest = rest[os.write(file.fileno(), rest) :]
            os.fsync(file.fileno())
        except BaseException:
            os.ftruncate(file.fileno(), before)
            raise


def _stage(target: Path, data: bytes) -> Path:
    """Write what is to become a file beside it."""
    mode = None
    with suppress(FileNotFoundError):
        mode = target.stat().st_mode
        if not stat.S_ISREG(mode):
            raise OSError(None, "it is no regular file")
        if not os.access(target, os.W_OK):
            raise OSError(None, "it is write-protected")
    staging = target.parent / f".optkit-{HOST}-{os.getpid()}-{secrets.token_hex(4)}.tmp"
    try:
        handle = os.open(staging, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None:
            os.chmod(staging, stat.S_IMODE(mode))
    except BaseException:
        with suppress(OSError):
            staging.unlink(missing_ok=True)
        raise
    return staging


def clear_staging(folder: Path) -> None:
    """Remove what a killed process left half written; one that is alive, or of another machine, keeps its own."""
    for left in folder.glob(f".optkit-{HOST}-*-*.tmp"):
        number = left.name.split("-")[2]
        if number.isdigit() and not _alive(int(number)):
            left.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    if os.name == "nt":  # asking would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def sync_folder(folder: Path) -> None:
    """Flush a folder's list of files to the disk, where the system can."""
    with suppress(OSError):  # Windows does not open folders, and some network disks do not flush them
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def locked(handle: int) -> Iterator[None]:
    """Keep other processes that ask for the same lock waiting; where there are no locks, nobody waits."""
    with suppress(OSError, AttributeError):
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        with suppress(OSError, AttributeError):
            fcntl.flock(handle, fcntl.LOCK_UN)


_held = threading.local()


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, see :func:`locked`; a folder that cannot be opened has none.

    Who holds it already goes on.
    """
    name, mine = os.path.realpath(folder), vars(_held).setdefault("folders", set())
    with ExitStack() as ends:
        if name not in mine:
            with suppress(OSError):
                handle = os.open(folder, os.O_RDONLY)
                ends.callback(os.close, handle)
                ends.enter_context(locked(handle))
                mine.add(name)
                ends.callback(mine.discard, name)
        yield


def cannot_write(path: str | os.PathLike[str], error: OSError, remedy: str = "") -> OptkitError:
    """Return the error that the disk refuses a file or folder, in one line."""
    more = f"; {remedy}" if remedy else ""
    return OptkitError(f"{os.fspath(path)} cannot be written ({error.strerror or error}){more}")
