"""What a policy or a value function is, as a digest: its code and all that it holds, not what it happens to earn.

Code of one's own is told by its bytecode and constants, and by the functions, classes and values that it names, as far
as they lead; code of installed packages by their names and versions. Names, addresses and line numbers count for
nothing, so that a file that is read again is the same. What cannot be told is refused: rows of another policy must not
be taken for this one's.
"""

from __future__ import annotations

import dis
import functools
import hashlib
import importlib
import pickle
import sys
import types
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

import numpy as np

from optkit.basics.errors import InputError
from optkit.basics.version import __version__


def policy_digest(name: str, policy: object) -> str:
    """Return the digest of a policy, or of anything that one is made of.

    Parameters
    ----------
    name : str
        What it is called in messages.
    policy : object
        A function, or an object of any class.

    Raises
    ------
    InputError
        If it holds something that has no lasting form, such as an open file.

    Examples
    --------
    >>> def paying(share):
    ...     return lambda state: share * state.reward
    >>> policy_digest("half", paying(0.5)) == policy_digest("half", paying(0.5))
    True
    >>> policy_digest("half", paying(0.5)) == policy_digest("half", paying(0.5000001))
    False
    """
    try:
        return _Digest().of(policy).hex()
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{name} holds what cannot be told apart ({error}), so its rows cannot be kept: leave the checkpoint out"
        ) from None


class _Digest:
    """Goes through an object; what it has met before is told by its number."""

    def __init__(self) -> None:
        self.met: dict[int, int] = {}
        self.alive: list[object] = []  # an address must not be used again meanwhile

    def of(self, x: Any) -> bytes:
        if x is None or type(x) in (bool, int, float, complex, str, bytes):
            return _sum(type(x).__name__, repr(x))
        if isinstance(x, types.CodeType):
            return self._code(x)
        if id(x) in self.met:
            return _sum("met", str(self.met[id(x)]))
        self.met[id(x)] = len(self.met)
        self.alive.append(x)
        if (type(x) is np.ndarray or isinstance(x, np.generic)) and x.dtype.kind != "O":
            return _sum("array", str(x.dtype), str(x.shape), x.tobytes())
        if type(x) is dict:
            return _sum("dict", *(part for key, value in x.items() for part in (self.of(key), self.of(value))))
        if type(x) in (set, frozenset):
            return _sum("set", *sorted(_Digest().of(one) for one in x))
        if type(x) in (list, tuple, np.ndarray):
            return _sum(type(x).__name__, *map(self.of, x))
        if isinstance(x, types.ModuleType):
            return self._module(x)
        if isinstance(x, types.MethodType):
            return _sum("method", self.of(x.__self__), self.of(x.__func__))
        if isinstance(x, functools.partial):
            return _sum("partial", *map(self.of, (x.func, x.args, x.keywords)))
        if isinstance(x, types.FunctionType | type | types.BuiltinFunctionType | np.ufunc):
            return self._named(x)
        if hasattr(x, "__wrapped__"):  # what functools.lru_cache makes, for one
            return _sum("wrapped", self.of(type(x)), self.of(x.__wrapped__))
        return self._object(x)

    def _module(self, x: types.ModuleType) -> bytes:
        """Return the digest of a module: its release, or of one's own its text and what it takes from others."""
        release = _release(x.__name__)
        if release is not None:
            return _sum("module", x.__name__, release)
        own = {name: value for name, value in list(vars(x).items()) if not name.startswith("__")}
        more = [part for name, value in own.items() for part in (name, self.of(value))]
        file = getattr(x, "__file__", None)
        return _sum("own module", Path(file).read_bytes() if file and Path(file).is_file() else b"", *more)

    def _named(self, x: Any) -> bytes:
        """Return the digest of a function or class: by its name if a package has it, else by what it is made of."""
        module, name = getattr(x, "__module__", None) or "builtins", getattr(x, "__qualname__", x.__name__)
        # Code that was run without a module's name says that it is of the builtins, and is somebody's own.
        release = None if module == "builtins" and isinstance(x, types.FunctionType) else _release(module)
        closure = () if isinstance(x, type) else getattr(x, "__closure__", None) or ()
        cells = [self.of(cell.cell_contents) for cell in closure]
        if isinstance(x, np.ufunc) and name.endswith("(vectorized)"):
            raise TypeError("np.frompyfunc hides the function that it was made of")
        if release is not None or not isinstance(x, types.FunctionType | type):
            owner = getattr(x, "__self__", None)
            whose = b"" if owner is None or isinstance(owner, types.ModuleType) else self.of(owner)
            return _sum("installed", module, name, release or "", whose, *cells)
        if isinstance(x, type):
            own = {name: part for name, part in vars(x).items() if name not in _ASIDE}
            return _sum("class", *map(self.of, x.__bases__), *(self._part(n, p) for n, p in own.items()))
        used = [(n, x.__globals__[n]) for n in sorted(_names(x.__code__)) if n in x.__globals__]
        told = [part for n, value in used for part in (n, self.of(value))]
        told += [self.of(_imported(n, x.__globals__)) for n in sorted(_names(x.__code__, ("IMPORT_NAME",)))]
        given = self.of(x.__defaults__), self.of(x.__kwdefaults__), self.of(vars(x))
        return _sum("function", self._code(x.__code__), *given, *cells, *told)

    def _part(self, name: str, part: Any) -> bytes:
        """Return the digest of what a class holds under a name, also behind a property or a class method."""
        if isinstance(part, property):
            return _sum(name, *map(self.of, (part.fget, part.fset, part.fdel)))
        if isinstance(part, functools.cached_property):
            return _sum(name, self.of(part.func))
        if isinstance(part, staticmethod | classmethod):
            return _sum(name, type(part).__name__, self.of(part.__func__))
        if isinstance(part, types.MemberDescriptorType | types.GetSetDescriptorType):
            return _sum(name)
        return _sum(name, self.of(part))

    def _object(self, x: Any) -> bytes:
        """Return the digest of an object: its class and its state, less what it keeps for speed."""
        kind = type(x)
        cached = {n for one in kind.__mro__ for n, p in vars(one).items() if isinstance(p, functools.cached_property)}
        made = x.__reduce_ex__(4)  # as for a copy: what cannot be copied is refused
        if isinstance(made, str):
            return _sum("named", self.of(kind), str(getattr(x, "__module__", "")), made)
        parts = [list(one) if hasattr(one, "__next__") else one for one in made]
        if len(parts) > 2 and isinstance(parts[2], dict):
            parts[2] = {name: value for name, value in parts[2].items() if name not in cached}
        own_state: Any = getattr(kind, "__getstate__", None)
        if own_state is not getattr(object, "__getstate__", None) and _release(kind.__module__) is None:
            # It may leave out what a call uses.
            parts.append({name: value for name, value in getattr(x, "__dict__", {}).items() if name not in cached})
        return _sum("object", *map(self.of, parts))

    def _code(self, code: types.CodeType) -> bytes:
        return _sum("code", code.co_code, *code.co_names, *code.co_varnames, *map(self.of, code.co_consts))


_ASIDE = frozenset(
    {
        *(
            "__dict__",
            "__weakref__",
            "__module__",
            "__doc__",
            "__qualname__",
            "__firstlineno__",
            "__static_attributes__",
        ),
        *("__annotations__", "__annotate__", "__annotate_func__", "__annotations_cache__", "__abstractmethods__"),
        *("_abc_impl", "__dataclass_fields__", "__dataclass_params__", "__match_args__", "__orig_bases__"),
        *("__parameters__", "__type_params__"),
    }
)
"""What a class holds that says nothing of what it does."""


def _sum(*parts: str | bytes) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        raw = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part
        digest.update(len(raw).to_bytes(8, "big") + raw)
    return digest.digest()


def _names(code: types.CodeType, operations: tuple[str, ...] = ("LOAD_GLOBAL", "LOAD_NAME")) -> set[str]:
    """Return all names that code and the functions within it look up in their module, or import."""
    own = {i.argval for i in dis.get_instructions(code) if i.opname in operations}
    return own.union(*(_names(one, operations) for one in code.co_consts if isinstance(one, types.CodeType)))


def _imported(name: str, namespace: dict[str, Any]) -> types.ModuleType:
    """Return a module that a function imports when it is called."""
    for full in (name, f"{namespace.get('__package__') or ''}.{name}"):
        try:
            return sys.modules.get(full) or importlib.import_module(full)
        except (ImportError, ValueError):
            continue
    raise TypeError(f"the module {name} that it imports is not there")


@functools.cache
def _release(module: str) -> str | None:
    """Return the version of the package that a module is installed with, or None if it is somebody's own."""
    top = module.partition(".")[0]
    if top == "optkit":
        return __version__
    if module == "__main__":  # a notebook's is a file of its kernel
        return None
    if top in sys.stdlib_module_names:
        return sys.version.split()[0]
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None or "site-packages" not in Path(file).parts:
        return None
    if top not in _owners():
        _owners.cache_clear()  # it may have been installed since
    try:
        return version(_owners()[top][0])
    except (KeyError, PackageNotFoundError):
        return None


@functools.cache
def _owners() -> Mapping[str, list[str]]:
    """Return who installed which package: to find out means to read the list of files of everything installed."""
    return packages_distributions()
