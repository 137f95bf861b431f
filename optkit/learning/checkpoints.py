"""Outcomes of a training kept seed by seed, so that what was interrupted goes on where it was."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from optkit.basics.errors import InputError
from optkit.basics.keeper import Form, KeptFiles, work_key
from optkit.instances.digest import exact_digest
from optkit.instances.instance import Instance
from optkit.learning.trained import FORMAT, VERSION, Trained
from optkit.models.preferences.preferences import Preferences
from optkit.models.value.mean import MeanValue

FORM = Form(FORMAT, VERSION, "a trained policy that optkit kept", "choose another folder with --checkpoint")


class Checkpoint:
    """A folder of one file per seed, named by what the training consists of.

    Each is a trained policy like any other, see :meth:`optkit.learning.trained.Trained.load`.

    Parameters
    ----------
    folder : path or None
        None keeps nothing.
    settings : dict
        Settings of the training; the number of seeds may grow from one call to the next.
    estimator : object
        The value function before training.
    choice : str or Preferences
        The choice model.
    instances, validation : sequence of Instance
        What is trained on, and what the round is chosen by.

    Raises
    ------
    InputError
        If the value function cannot be written.
    OptkitError
        If the folder cannot be made or written to.
    """

    def __init__(
        self,
        folder: str | Path | None,
        settings: dict[str, Any],
        estimator: Any,
        choice: str | Preferences,
        instances: Sequence[Instance],
        validation: Sequence[Instance],
    ) -> None:
        self.kept: KeptFiles | None = None
        if folder is None:
            return
        groups = max((one.n_groups for one in instances), default=1)
        members = estimator.members(groups) if isinstance(estimator, MeanValue) else []
        for one in (estimator, *members):
            if not callable(getattr(one, "to_dict", None)):
                raise InputError(f"a {type(one).__name__} has no to_dict: it cannot be kept in a checkpoint")
        believed = choice if isinstance(choice, str) else choice.to_dict()
        plain = {name: value for name, value in settings.items() if name != "seeds"}
        forms = [(one, own_source(type(one))) for one in (estimator, *members)]
        self.key = work_key(plain, forms, believed, exact_digest(instances), exact_digest(validation))[:24]
        self.kept = KeptFiles(folder, FORM)

    def _name(self, number: int) -> str:
        return f"{self.key}-seed-{number}"

    def load(self, number: int) -> Trained | None:
        """Return the outcome of a seed, or None if there is none that can be read.

        Raises
        ------
        DataError
            If another version's outcome, or something else, is in its place.
        """
        told = None if self.kept is None else self.kept.get(self._name(number))
        try:
            return None if told is None else Trained.from_dict(told)
        except InputError:
            return None  # it is trained again

    def save(self, number: int, outcome: Trained) -> None:
        """Keep the outcome of a seed.

        Raises
        ------
        DataError
            If something else is in its place.
        OptkitError
            If the disk refuses.
        """
        if self.kept is not None:
            self.kept.put(self._name(number), outcome.to_dict())


def own_source(kind: type) -> list[str]:
    """Return the source of a class that is not the kit's, with that of the files that it and its bases stand in."""
    told = []
    for one in kind.__mro__:
        if one.__module__.partition(".")[0] in ("optkit", *sys.stdlib_module_names):
            continue
        try:
            told.append(inspect.getsource(sys.modules[one.__module__]))
        except (KeyError, OSError, TypeError):  # typed at a prompt
            codes = {name: getattr(value, "__code__", None) for name, value in vars(one).items()}
            told += [f"{name} {code.co_code!r} {code.co_consts}" for name, code in codes.items() if code is not None]
    return told
