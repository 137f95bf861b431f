"""A trained policy and its file: plain JSON, nothing that could run when it is read."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Known, number, text_names, whole_number
from optkit.basics.documents import read_document, write_document
from optkit.basics.errors import DataError, InputError
from optkit.basics.version import __version__
from optkit.instances.account import LeftOutWarning
from optkit.instances.clock import Clock
from optkit.learning.beliefs import BelievedValue
from optkit.models.preferences.preferences import Preferences
from optkit.models.pricing import optimal_prices
from optkit.models.value.catalogue import value_of
from optkit.models.value.request_sets import SetValue
from optkit.policies import PostDecisionPricing, TrueChoice

if TYPE_CHECKING:
    import pandas as pd

FORMAT, VERSION = "optkit trained policy", 1

MOST_GROUPS = 10_000


@dataclass(frozen=True)
class Trained(Known):
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

    def __repr__(self) -> str:
        choice = self.source.get("choice", "true" if self.preferences is None else "given")
        return f"Trained({self.value!r}, choice={choice!r}, score={self.score:.6g}, rounds={len(self.record)})"

    def _repr_html_(self) -> str:
        from html import escape

        return f"<p>{escape(repr(self))}</p>{self.table().to_html(max_rows=10, index=False)}"

    def believing(self, preferences: Preferences) -> Trained:
        """Return this policy with other preferences: what waiting is worth stays as it was learned."""
        policy = PostDecisionPricing(choice=preferences, value_function=BelievedValue(self.value, preferences))
        return replace(self, policy=policy, preferences=preferences, source={**self.source, "choice": "given"})

    def price(
        self,
        requests: Any,
        *,
        step: int | None = None,
        time: Any = None,
        group: str | int | None = None,
        mu: float | None = None,
        busy: int = 1,
    ) -> pd.DataFrame:
        """Price the requests that are open now.

        Parameters
        ----------
        requests : DataFrame, or table of polars or pyarrow
            ``reward``, ``expiry`` (the last step, or a time), the features that the policy was trained on, and, where
            they apply, ``penalty``, ``pickup``, ``dropoff``, ``request_id``; ``utility`` if it learned no preferences.
        step : int, optional
            The step at which the worker is there.
        time : str or Timestamp, optional
            Or the time, where the days that it was trained on have a clock.
        group : str or int, optional
            The worker's group; needed if there are several.
        mu : float, optional
            The worker's noise scale, in money, if the policy learned no preferences; 1 by default.
        busy : int
            For how many steps up to this one there has been a worker each: after many, more are likely to wait.

        Returns
        -------
        DataFrame
            ``request``, ``compensation``, ``acceptance`` (as the policy believes), ``value``, ``opportunity_cost`` and
            ``utility``, a row per request.

        Raises
        ------
        InputError
            If a column is missing, a request has expired, or the step is none that the policy knows.

        Warns
        -----
        LeftOutWarning
            Of requests that are open when the day ends, columns that play no part, and clocks an hour apart.

        Examples
        --------
        >>> from optkit import scenario
        >>> from optkit.learning.training import train
        >>> trained = train(scenario("I.2", seed=0, horizon=8).sample(40, seed=1), choice="true")
        >>> open_ = {"request_id": ["a", "b"], "reward": [30.0, 20.0], "expiry": [3, 7], "utility": -9.0}
        >>> open_ |= {f"feature_{f}": [0.5, 0.5] for f in range(5)}
        >>> trained.price(open_, step=3)["opportunity_cost"].round(2).tolist()[0]
        0.0
        """
        import pandas as pd

        from optkit.learning.open_requests import seen_by

        seen = seen_by(self, requests, step=step, time=time, group=group, mu=mu, busy=busy)
        if seen.notes:
            warnings.warn("; ".join(seen.notes), LeftOutWarning, stacklevel=2)
        found = optimal_prices(
            seen.value, seen.utility, seen.mu, outside_utility=seen.outside_utility, nonnegative=self.policy.nonnegative
        )
        columns = {"request": seen.names, "compensation": found.compensation, "acceptance": found.acceptance}
        more = {"value": seen.value, "opportunity_cost": seen.opportunity_cost, "utility": seen.utility}
        return pd.DataFrame(columns | more)

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
        return write_document(path, self.to_dict(), "a policy")

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
        plain = read_document(path, FORMAT, VERSION, "trained policy of optkit")
        try:
            return cls.from_dict(plain)
        except InputError as error:
            raise DataError(f"{Path(path)}: {error}") from None

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
            score = number("score", plain["score"])
            more = (score, [dict(row) for row in plain["record"]], dict(plain["settings"]), list(plain["failures"]))
            told = _source(plain.get("source", {}), value)
        except InputError:
            raise
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise InputError(f"the trained policy is incomplete: {error!r}") from None
        choice = TrueChoice() if preferences is None else preferences
        policy = PostDecisionPricing(choice=choice, value_function=BelievedValue(value, preferences))
        return cls(policy, value, preferences, *more, told)


def _source(plain: dict[str, Any], value: SetValue) -> dict[str, Any]:
    """Check what a file says of the days that were learned from, and that the value function is of as many steps.

    Raises
    ------
    InputError
        If it says something that cannot be.
    """
    told, rows = dict(plain), np.asarray(getattr(value, "coef_", 0.0))
    steps = len(rows) if rows.ndim == 2 else None
    if "horizon" in told:
        horizon = whole_number("horizon", told["horizon"], least=1)
        if steps not in (None, horizon):
            raise InputError(f"horizon = {horizon}, and the value function is of {steps} steps")
    elif steps is not None:
        told["horizon"] = steps
    if "groups" in told:
        whole_number("groups", told["groups"], least=1, most=MOST_GROUPS)
    if "clock" in told:
        Clock.read(told["clock"])
    for name in ("group_names", "feature_names"):
        if name in told:
            text_names(name, told[name])
    return told
