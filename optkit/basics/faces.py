"""Faces of packages: public names that are loaded when they are first used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def lazy_face(
    package: str, home: Mapping[str, Sequence[str]], more: Sequence[str] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and the ``__dir__`` of a package that offers names of the modules below it.

    Parameters
    ----------
    package : str
        The package's ``__name__``.
    home : mapping of str to sequence of str
        Public names by the module that defines them.
    more : sequence of str
        Public names that the package defines itself.

    Examples
    --------
    >>> getattr_, dir_ = lazy_face("shapes", {"optkit.basics.seeds": ["seed_sequence"]})
    >>> dir_(), getattr_("seed_sequence").__module__
    (['seed_sequence'], 'optkit.basics.seeds')
    """
    where = {name: module for module, names in home.items() for name in names}

    def load(name: str) -> Any:
        if name in where:
            return getattr(import_module(where[name]), name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return load, lambda: sorted([*where, *more])
