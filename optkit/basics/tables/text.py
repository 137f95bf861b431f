"""Text from files: UTF-8 and nothing else, or a line that says what it is instead."""

from __future__ import annotations

import gzip
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from optkit.basics.errors import DataError

WIDE = (b"\xff\xfe", b"\xfe\xff")
"""How UTF-16 and UTF-32 begin, with either order of bytes."""


@contextmanager
def reading(path: Path, remedy: str, text: bool = True) -> Iterator[None]:
    """Turn whatever goes wrong in reading a file into a DataError of one line.

    Parsers of damaged files fail in many ways, so all of them are meant; nothing but reading belongs under it.
    """
    try:
        yield
    except DataError:
        raise
    except FileNotFoundError:
        raise DataError(f"there is no file {path}") from None
    except UnicodeDecodeError as error:
        if not text:
            raise DataError(f"cannot read {path} (a name or a text in it is not UTF-8); {remedy}") from None
        raise _not_utf8(path, error, remedy) from None
    except MemoryError:
        raise DataError(f"cannot read {path} (it wants more memory than there is); {remedy}") from None
    except Exception as error:
        why = (str(getattr(error, "strerror", None) or error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"cannot read {path} ({why}); {remedy}") from error


def open_bytes(path: Path) -> io.BufferedReader | gzip.GzipFile:
    """Open a file, gzipped if its name ends in ``.gz``."""
    return gzip.open(path, "rb") if path.suffix.lower() == ".gz" else open(path, "rb")  # its user does


def open_text(path: Path) -> TextIO:
    """Open a file as UTF-8, gzipped or not, with or without a mark at its beginning."""
    opened = open_bytes(path)
    try:
        if opened.peek(2)[:2] in WIDE:
            raise DataError(f"cannot read {path} (it is UTF-16 or UTF-32, not UTF-8): save it as UTF-8")
        return io.TextIOWrapper(opened, encoding="utf-8-sig", newline="")
    except BaseException:
        opened.close()
        raise


def lines(path: Path, file: TextIO) -> Iterator[str]:
    """Yield lines, with their ends; a NUL byte is no text."""
    for number, line in enumerate(file, 1):
        if "\0" in line:
            raise DataError(f"cannot read {path} (line {number} holds a NUL byte): it is no text, or not UTF-8")
        yield line


def _not_utf8(path: Path, error: UnicodeDecodeError, remedy: str) -> DataError:
    """Say on which line it is that a file is not UTF-8, if the file can be read again."""
    where = ""
    try:
        with open_bytes(path) as opened:
            for number, line in enumerate(opened, 1):
                try:
                    line.decode()
                except UnicodeDecodeError as again:
                    where, error = f"line {number}: ", again
                    break
    except (OSError, EOFError):
        pass
    byte = f"byte 0x{error.object[error.start]:02x}"
    return DataError(f"cannot read {path} ({where}{byte} is not UTF-8): save it as UTF-8, or {remedy}")
