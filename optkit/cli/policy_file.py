"""Policies of one's own, named on the command line as FILE.py:NAME."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, cast

from optkit.basics.errors import InputError
from optkit.basics.paths import resolved
from optkit.basics.users_code import users_code

if TYPE_CHECKING:
    from optkit.simulation.simulator import Policy


def own_policies(texts: Sequence[str]) -> dict[str, Policy]:
    """Run Python files, each once, and return what they call NAME: policies, or classes that are so without arguments.

    Raises
    ------
    InputError
        If there is no such file, it fails, or holds no such policy.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     _ = Path(f"{place}/own.py").write_text("def half(state): return 0.5 * state.reward")
    ...     [policy.__name__ for policy in own_policies([f"{place}/own.py:half"]).values()]
    ['half']
    """
    modules: dict[Path, ModuleType] = {}
    found: dict[str, Policy] = {}
    for text in texts:
        name, path = text.rpartition(":")[2], Path(text.rpartition(":")[0])
        if not path.is_file():
            raise InputError(f"--policy {text}: there is no file {path}")
        place = resolved(path)
        with users_code(f"--policy {text}: running {path}", InputError):
            if place not in modules:
                modules[place] = _run(path)
            policy = vars(modules[place]).get(name)
            policy = policy() if isinstance(policy, type) else policy
        if not callable(policy):
            raise InputError(f"--policy {text}: {path} defines no policy {name}; a policy is a function of a State")
        found[text] = cast("Policy", policy)
    return found


def _run(path: Path) -> ModuleType:
    """Run a file as a module of its own, that shares no name with any other."""
    module = ModuleType(f"policies of {resolved(path)}")
    module.__file__ = str(path)
    code = compile(path.read_bytes(), str(path), "exec", dont_inherit=True)
    sys.modules[module.__name__] = module  # classes look their module up while they are made
    try:
        exec(code, vars(module))
    finally:
        # Not to be found there, it goes to other processes with what it defines.
        del sys.modules[module.__name__]
    return module
