"""What may stand where a file is to be written: nothing, or an earlier one of the same kind that optkit wrote."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from optkit.basics.errors import InputError
from optkit.basics.files import write_together
from optkit.basics.folders import writable_parent
from optkit.basics.keeper import read_regular
from optkit.basics.paths import resolved


@dataclass(frozen=True)
class OwnFile:
    """A kind of file that a verb writes.

    Attributes
    ----------
    what : str
        Such a file in words, for example "trained policy".
    is_ours : callable
        From the bytes of a file to whether optkit wrote them as a file of this kind.
    suffixes : tuple of str
        Endings of its name; any by default.

    Examples
    --------
    >>> import tempfile
    >>> note = OwnFile("note", lambda data: data.startswith(b"note: "))
    >>> with tempfile.TemporaryDirectory() as place:
    ...     note.write(f"{place}/a", b"note: first")
    ...     note.write(f"{place}/a", b"note: second")
    ...     Path(f"{place}/a").read_text()
    'note: second'
    """

    what: str
    is_ours: Callable[[bytes], bool]
    suffixes: tuple[str, ...] = ()

    def check(
        self, path: str | os.PathLike[str], option: str = "--out", reads: Iterable[str | os.PathLike[str]] = ()
    ) -> None:
        """Refuse a file that could not be written or is not to be replaced; call it before the work too.

        Parameters
        ----------
        path : path
            A link stands for what it leads to.
        option : str
            What the user wrote before it.
        reads : iterable of path
            What the verb reads: that is never written over.

        Raises
        ------
        InputError
            If something else is there, the name ends otherwise, or its folder may not be written to.
        """
        told, target = f"{option} {os.fspath(path)}", resolved(path)
        if target.is_dir() or (self.suffixes and Path(path).suffix not in self.suffixes):
            endings = f" that ends in {' or '.join(self.suffixes)}" if self.suffixes else ""
            raise InputError(f"{told} must be a file{endings}")
        if not (target.parent.is_dir() and writable_parent(target)):
            raise InputError(f"{told} cannot be written: its folder does not exist, or may not be written to")
        if any(os.path.exists(one) and target.exists() and os.path.samefile(one, target) for one in reads):
            raise InputError(f"{told} is what is read: choose another")
        before = read_regular(target, "choose another")
        if before and not self.is_ours(before):
            raise InputError(f"{told} exists and holds no {self.what}: choose another")

    def write(self, path: str | os.PathLike[str], data: bytes, option: str = "--out") -> None:
        """Write a file, whole or not at all, where :meth:`check` finds nothing against it.

        Raises
        ------
        InputError
            If something else is there by now.
        OptkitError
            If the disk refuses; what was there before stays.
        """
        self.check(path, option)
        write_together({path: data})
