"""A policy of one's own, named on the command line as FILE.py:NAME."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import TYPE_CHECKING, cast

from optkit.basics.errors import InputError

if TYPE_CHECKING:
    from optkit.simulation.simulator import Policy


def own_policy(text: str) -> Policy:
    """Run a Python file and return what it calls NAME: a policy, or a class that is one without arguments.

    Raises
    ------
    InputError
        If there is no such file, it fails, or holds no such policy.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     _ = Path(f"{place}/own.py").write_text("def half(state): return 0.5 * state.reward")
    ...     own_policy(f"{place}/own.py:half").__name__
    'half'
    """
    file, _, name = text.rpartition(":")
    if not Path(file).is_file():
        raise InputError(f"--policy {text}: there is no file {file}")
    try:
        found = runpy.run_path(file)
        policy = found[name]() if isinstance(found.get(name), type) else found.get(name)
    except Exception as error:  # the user's own code may fail in any way
        raise InputError(f"--policy {text}: running {file} failed ({type(error).__name__}: {error})") from error
    if not callable(policy):
        raise InputError(f"--policy {text}: {file} defines no policy {name}; a policy is a function of a State")
    return cast("Policy", policy)
