"""Outcomes of a training kept seed by seed, so that what was interrupted goes on where it was."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.basics.plain_json import to_json
from optkit.basics.version import __version__
from optkit.instances.digest import exact_digest
from optkit.instances.instance import Instance
from optkit.learning.trained import Trained
from optkit.models.preferences.preferences import Preferences
from optkit.models.value.mean import MeanValue


class Checkpoint:
    """A folder of one file per seed, named by what the training consists of.

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
        If the folder cannot be made.
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
        self.folder = None if folder is None else Path(folder)
        if self.folder is None:
            return
        groups = max((one.n_groups for one in instances), default=1)
        members = estimator.members(groups) if isinstance(estimator, MeanValue) else []
        for one in (estimator, *members):
            if not callable(getattr(one, "to_dict", None)):
                raise InputError(f"a {type(one).__name__} has no to_dict: it cannot be kept in a checkpoint")
        believed = choice if isinstance(choice, str) else choice.to_dict()
        form = estimator.get_params() if hasattr(estimator, "get_params") else repr(estimator)
        plain = {name: value for name, value in settings.items() if name != "seeds"}
        told = to_json([__version__, plain, type(estimator).__name__, repr(form), repr(members), believed])
        self.key = hashlib.sha256(told.encode() + exact_digest(instances) + exact_digest(validation)).hexdigest()[:16]
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OptkitError(f"{self.folder} cannot be made ({error.strerror or error})") from error

    def _path(self, number: int) -> Path:
        assert self.folder is not None
        return self.folder / f"{self.key}-seed-{number}.json"

    def load(self, number: int) -> Trained | None:
        """Return the outcome of a seed, or None if there is none that can be read."""
        if self.folder is None or not self._path(number).exists():
            return None
        try:
            return Trained.load(self._path(number))
        except DataError:
            return None  # it is trained again

    def save(self, number: int, outcome: Trained) -> None:
        """Keep the outcome of a seed.

        Raises
        ------
        OptkitError
            If the disk refuses.
        """
        if self.folder is not None:
            outcome.save(self._path(number))
