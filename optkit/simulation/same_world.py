"""The world stays what it was while somebody's policy runs: what a policy put into it is found, and taken back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from optkit.basics.errors import PolicyError
from optkit.basics.users_code import name_of
from optkit.simulation.batch import Batch

ON_DEMAND = tuple(name for name, what in vars(Batch).items() if isinstance(what, cached_property))


@contextmanager
def same_world(batch: Batch, policy: object) -> Iterator[None]:
    """Refuse a policy that changes the instances or the batch, and put back what was there.

    Arrays cannot be written into anyway; this is for who puts others in their place.

    Raises
    ------
    PolicyError
        If something else is there afterwards.

    Examples
    --------
    >>> from optkit import scenario
    >>> batch = Batch.of(scenario("I.1", seed=0).sample(2, seed=1))
    >>> with same_world(batch, same_world):
    ...     batch.__dict__["reward"] = 2.0 * batch.reward
    Traceback (most recent call last):
    ...
    optkit.basics.errors.PolicyError: the policy same_world changed the world that it is measured in ...
    """
    for name in ON_DEMAND:  # before anybody else could say what they are
        getattr(batch, name)
    things = {f"instance {b}": one for b, one in enumerate(batch.instances)}
    before: dict[str, tuple[Any, dict[str, Any]]]
    before = {where: (thing, dict(vars(thing))) for where, thing in {**things, "the batch": batch}.items()}
    before["the noise"] = (batch.noise, dict(vars(batch.noise)))
    for where, one in things.items():
        if hasattr(one.noise, "indptr"):  # sparse: its arrays are attributes
            before[f"the noise of {where}"] = (one.noise, dict(vars(one.noise)))
    try:
        yield
    except Exception as fault:
        if changed := _put_back(before):
            raise _refused(policy, changed) from fault
        raise
    if changed := _put_back(before):
        raise _refused(policy, changed)


def _put_back(before: dict[str, tuple[Any, dict[str, Any]]]) -> str:
    """Restore what was there, and return what had been changed; nothing, if nothing was."""
    found = ""
    for where, (thing, known) in before.items():
        now = vars(thing)
        for name, value in known.items():
            if name not in now or now[name] is not value:
                now[name] = value
                found = found or f"{name} of {where}"
    return found


def _refused(policy: object, changed: str) -> PolicyError:
    return PolicyError(
        f"the policy {name_of(policy)} changed the world that it is measured in ({changed}): what it earns there says "
        "nothing; the world is what it was again"
    )
