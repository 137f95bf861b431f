"""A trained policy and its file: plain JSON, nothing that could run when it is read."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.basics.files import write_whole
from optkit.basics.plain_json import is_sealed, sealed, to_json
from optkit.basics.strict_json import object_of
from optkit.basics.version import __version__
from optkit.learning.beliefs import BelievedValue
from optkit.models.preferences.preferences import Preferences
from optkit.models.value.catalogue import value_of
from optkit.models.value.request_sets import SetValue
from optkit.policies import PostDecisionPricing, TrueChoice

if TYPE_CHECKING:
    import pandas as pd

FORMAT, VERSION = "optkit trained policy", 1


@dataclass(frozen=True)
class Trained:
    """A trained policy and how it came about.

    Attributes
    ----------
    policy : PostDecisionPricing
        Optimal prices with the fitted opportunity costs.
    value : SetValue
        The fitted value function.
    preferences : Preferences or None
        The choice model; None for the truth.
    score : float
        Mean reward on the validation instances, money; the round's number where there were none.
    record : list of dict
        One entry per round: ``seed``, ``round``, ``deviation`` (money), ``score``, ``residual`` (money), ``seconds``,
        ``error``.
    settings : dict
        As in :class:`optkit.learning.training.TrainingSettings`.
    failures : list of str
        Seeds that diverged, and why.
    source : dict
        The ``choice`` model (``"given"`` for preferences that were passed), the number of training ``instances`` and
        their ``horizon``; empty if a file says nothing of them.
    """

    policy: PostDecisionPricing
    value: SetValue
    preferences: Preferences | None
    score: float
    record: list[dict[str, Any]]
    settings: dict[str, Any]
    failures: list[str] = field(default_factory=list)
    source: dict[str, Any] = field(default_factory=dict)

    def table(self) -> pd.DataFrame:
        """The record as a DataFrame."""
        import pandas as pd

        return pd.DataFrame(self.record)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the policy as JSON, whole or not at all.

        Raises
        ------
        InputError
            If the value function cannot be written: one of your own.
        OptkitError
            If the disk refuses.
        """
        target = Path(path)
        if not target.name:
            raise OptkitError(f"{os.fspath(path)!r} names no file to write a policy to")
        return write_whole(target, to_json(sealed(self.to_dict())) + "\n")

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data, as it stands in the file.

        Raises
        ------
        InputError
            If the value function cannot be written: one of your own.
        """
        if not callable(getattr(self.value, "to_dict", None)):
            raise InputError(f"a {type(self.value).__name__} has no to_dict: it cannot be written to a file")
        return {
            "format": FORMAT,
            "version": VERSION,
            "optkit": __version__,
            "value": self.value.to_dict(),  # type: ignore[attr-defined]
            "preferences": None if self.preferences is None else self.preferences.to_dict(),
            "score": self.score,
            "settings": self.settings,
            "record": self.record,
            "failures": self.failures,
            "source": self.source,
        }

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trained:
        """Read a policy that :meth:`save` wrote.

        Raises
        ------
        DataError
            If the file cannot be read, is not such a file, or was changed since; who edits one takes its entry
            ``sha256`` out.
        """
        source = Path(path)
        try:
            plain = object_of(source.read_bytes())
        except OSError as error:
            raise DataError(f"{source} cannot be read ({error.strerror or error})") from error
        except ValueError as error:
            raise DataError(f"{source} holds no trained policy of optkit ({error})") from None
        if plain.get("format") != FORMAT:
            raise DataError(f"{source} holds no trained policy of optkit")
        if plain.get("version") != VERSION:
            raise DataError(f"{source} has version {plain.get('version')!r}; this optkit reads version {VERSION}")
        if "sha256" in plain and not is_sealed(plain):
            raise DataError(f"{source} was changed or damaged (its sha256 differs; after an edit, delete that entry)")
        try:
            return cls.from_dict(plain)
        except InputError as error:
            raise DataError(f"{source}: {error}") from None

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> Trained:
        """Make a policy again from its plain data.

        Raises
        ------
        InputError
            If the data are incomplete or do not fit together.
        """
        try:
            value = value_of(plain["value"])
            believed = plain["preferences"]
            preferences = None if believed is None else Preferences.from_dict(believed)
            if not math.isfinite(score := float(plain["score"])):
                raise InputError(f"the score {score} is no number")
            more = (score, [dict(row) for row in plain["record"]], dict(plain["settings"]), list(plain["failures"]))
            told = dict(plain.get("source", {}))
        except InputError:
            raise
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise InputError(f"the trained policy is incomplete: {error!r}") from None
        choice = TrueChoice() if preferences is None else preferences
        policy = PostDecisionPricing(choice=choice, value_function=BelievedValue(value, preferences))
        return cls(policy, value, preferences, *more, told)
