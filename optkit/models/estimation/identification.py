"""What choices can tell about the coefficients, and what they cannot."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from optkit.basics.arrays import Floats, Known
from optkit.basics.errors import InputError
from optkit.models.estimation.columns import (
    NotIdentifiedError,
    check_columns,
    column_scale,
    combination,
    refuse_separation,
)

WEAK = 0.5
"""Standard error, in units of the index per standard deviation, above which a combination counts as weakly known."""


class EstimationWarning(UserWarning):
    """The estimate stands, but the data leave something open that the message names."""


@dataclass(frozen=True)
class IdentificationReport(Known):
    """How much the choices say, and about which combination of the coefficients they say least.

    Attributes
    ----------
    situations, choices, rejections : float
        Situations that carry information, weights counted; those in which an alternative was chosen, and those in
        which the outside option was.
    eigenvalues : (k,) float
        Of the Fisher information, ascending, with every column scaled to unit standard deviation within the sets.
    weakest : pandas.Series
        Unit vector over the column names: the combination of scaled coefficients that the data know least.
    weakest_error : float
        Its standard error, in units of the index (utility / noise scale) per standard deviation; inf if not
        identified.
    condition_number : float
        Largest eigenvalue over smallest.
    verdict : str
        "identified"; "weak" if ``weakest_error`` exceeds 0.5 (the 95 % interval, one unit either way); "not
        identified".
    reason : str
        One line that says why.
    """

    situations: float
    choices: float
    rejections: float
    eigenvalues: Floats
    weakest: pd.Series
    weakest_error: float
    condition_number: float
    verdict: str
    reason: str

    def summary(self) -> str:
        """Return a few lines for a person."""
        lines = [
            f"verdict           {self.verdict}",
            f"because           {self.reason}",
            f"situations        {self.situations:g} ({self.choices:g} choices, {self.rejections:g} rejections)",
            f"weakest           {combination(self.weakest.to_numpy(), list(self.weakest.index), 0.01)}",
            f"its std error     {self.weakest_error:.3g} (per standard deviation within the sets)",
            f"eigenvalues       {' '.join(f'{x:.3g}' for x in self.eigenvalues)}",
            f"condition number  {self.condition_number:.3g}",
        ]
        return "\n".join(lines)


def identification(fitted: Any) -> IdentificationReport:
    """Report what the data of a model can tell.

    Parameters
    ----------
    fitted : ConditionalLogit or its results
        The Fisher information is taken at the estimate; a model is fitted first. Where there is none, it is taken at
        equal shares.

    Returns
    -------
    IdentificationReport
        On the data alone: a penalty moves the estimate but adds nothing to what is reported.

    Notes
    -----
    ``docs/explanation/estimation.md``, "What data can tell": offers that nobody rejects leave the level of
    utility open.

    Examples
    --------
    Three offers, all of them taken: nothing says how much worse an offer must be to be rejected.

    >>> from optkit.models.estimation import ConditionalLogit
    >>> data = pd.DataFrame({"level": 1.0, "pay": [2.0, 3.0, 5.0]})
    >>> report = identification(ConditionalLogit([1, 1, 1], data, ["a", "b", "c"], outside_option=True))
    >>> report.verdict, report.weakest.to_dict(), report.reason.split(",")[0]
    ('not identified', {'level': 1.0, 'pay': 0.0}, 'no situation chose the outside option')
    """
    model = getattr(fitted, "model", fitted)
    if not hasattr(model, "likelihood"):
        raise InputError(f"{type(fitted).__name__} is no model; give a ConditionalLogit or what its fit returned")
    likelihood, names = model.likelihood, model.column_names
    problem: NotIdentifiedError | None = None
    share, terms = likelihood.equal_shares()
    free = np.ones(len(names), bool)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            results = model.fit() if fitted is model else fitted
            share, terms = likelihood.at(np.asarray(results.params))
            if model.penalties.any():
                scale = check_columns(likelihood, names, free)
                refuse_separation(likelihood, names, scale, free, model.rejections)
        except NotIdentifiedError as caught:
            problem = caught
    scale, _ = column_scale(likelihood)
    unit = np.where(scale > 0, scale, 1.0)
    eigenvalues, vectors = np.linalg.eigh(likelihood.slopes(share, terms).information / np.outer(unit, unit))
    eigenvalues = np.maximum(eigenvalues, 0.0)
    weakest = vectors[:, 0] if problem is None else problem.direction * unit
    weakest = weakest / np.linalg.norm(weakest) * (np.sign(weakest[np.abs(weakest).argmax()]) or 1.0)
    worst = np.inf if problem is not None or eigenvalues[0] == 0 else float(eigenvalues[0] ** -0.5)
    verdict, reason = "identified", f"every combination of scaled coefficients has a standard error of at most {WEAK:g}"
    if problem is not None:
        verdict, reason = "not identified", str(problem)
    elif worst > WEAK:
        verdict, reason = "weak", f"one combination of scaled coefficients has a standard error above {WEAK:g}"
    return IdentificationReport(
        situations=likelihood.total,
        choices=likelihood.total - (model.rejections or 0.0),
        rejections=model.rejections or 0.0,
        eigenvalues=eigenvalues,
        weakest=pd.Series(weakest, index=names),
        weakest_error=worst,
        condition_number=float(eigenvalues[-1] / eigenvalues[0]) if np.isfinite(worst) else np.inf,
        verdict=verdict,
        reason=reason,
    )
