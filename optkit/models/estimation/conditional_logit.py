"""McFadden's conditional logit on ragged choice sets, as a statsmodels model."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from statsmodels.base.model import LikelihoodModel
from threadpoolctl import ThreadpoolController

from optkit.basics.arrays import is_finite, whole_number
from optkit.basics.errors import InputError
from optkit.models.decision import Floats
from optkit.models.estimation.choices import (
    ChoiceData,
    finite_column,
    finite_design,
    mask_of_rows,
    situations,
    sort_rows,
)
from optkit.models.estimation.columns import NotIdentifiedError
from optkit.models.estimation.identification import EstimationWarning, IdentificationReport, identification
from optkit.models.estimation.inputs import numbers, penalties_of
from optkit.models.estimation.likelihood import Likelihood
from optkit.models.estimation.optimum import covariances, find_optimum
from optkit.models.estimation.results import ConditionalLogitResults, ConditionalLogitResultsWrapper

__all__ = [
    "ConditionalLogit",
    "ConditionalLogitResults",
    "EstimationWarning",
    "IdentificationReport",
    "NotIdentifiedError",
    "identification",
]


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()


BY_COLUMN = ("groups", "available", "weights", "offset")
"""Arguments that a formula's data may hold as a column."""

FROM_FORMULA = {"formula", "model_spec", "design_info", "missing_idx", "_data_columns"}
"""What the formula interface of statsmodels hands to the class."""


class ConditionalLogit(LikelihoodModel):  # type: ignore[misc]
    r"""Conditional logit of choices from sets of any size, with or without an outside option.

    The probability that alternative i of situation s is chosen is
    :math:`P_i = \exp(x_i\theta) / (1[outside] + \sum_{j \in s} \exp(x_j\theta))`, over the available alternatives.

    Parameters
    ----------
    endog : (n,) array_like
        1 for the chosen alternative of each situation, 0 for the others; one row per alternative.
    exog : (n, k) array_like
        Features of the alternatives, in any units. A DataFrame gives the coefficients their names.
    groups : (n,) array_like
        Label of the situation that each row belongs to: any hashable values in any order; rows of one situation need
        not be adjacent.
    outside_option : bool
        Whether every situation also offers an option of utility 0; where no row is chosen, that option was.
    available : (n,) bool array_like, optional
        Rows that are not available are ignored, whatever they hold.
    weights : array_like, optional
        How often each situation was seen: (n,) the same in all rows of a situation, or (S,) in the order in which the
        situations appear, or a Series indexed by their labels.
    offset : (n,) array_like, optional
        Part of the index :math:`x\theta` that is known: added with coefficient 1.
    penalty : float, (k,) array_like or dict
        L2 penalty of the coefficients, at least 0; a dict gives it by column name, 0 for the others.
        The estimate maximises ``loglike(theta) - sum(penalty * theta**2) / 2``.
    missing : {"none", "raise"}
        Both refuse NaN: dropping a row would change somebody's choice set.
    **kwargs
        For the formula interface of statsmodels.

    Raises
    ------
    InputError
        If shapes do not fit, an entry is not finite, a situation has two choices, or none without an outside option.

    See Also
    --------
    identification : what the data can tell about the coefficients.
    statsmodels.discrete.conditional_models.ConditionalLogit : several choices per group, no outside option.

    Notes
    -----
    ``loglike``, ``score``, ``hessian`` and ``information`` leave the penalty out. D. McFadden (1974), "Conditional
    logit analysis of qualitative choice behavior"; K. Train, Discrete Choice Methods with Simulation, 2nd ed.,
    chapter 3; ``docs/explanation/estimation.md``.

    Examples
    --------
    Three of four workers take the better paid of two offers.

    >>> import warnings
    >>> choice, pay = [1, 0, 1, 0, 1, 0, 0, 1], [2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0]
    >>> data = pd.DataFrame({"choice": choice, "pay": pay, "worker": ["a", "a", "b", "b", "c", "c", "d", "d"]})
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", EstimationWarning)  # four situations are few
    ...     results = ConditionalLogit.from_formula("choice ~ 0 + pay", data, groups="worker").fit()
    >>> results.params.round(4).to_dict()  # log(3)
    {'pay': 1.0986}
    >>> results.predict(pd.DataFrame({"pay": [3.0, 2.0, 2.0], "worker": ["e", "e", "e"]})).round(2).tolist()
    [0.6, 0.2, 0.2]
    """

    def __init__(
        self,
        endog: Any,
        exog: Any,
        groups: Any = None,
        outside_option: bool = False,
        *,
        available: Any = None,
        weights: Any = None,
        offset: Any = None,
        penalty: float | npt.ArrayLike | Mapping[str, float] = 0.0,
        missing: Literal["none", "raise"] = "none",
        **kwargs: Any,
    ) -> None:
        if groups is None:
            raise InputError("groups is missing; give the label of the situation that each row belongs to")
        if missing not in ("none", "raise"):
            raise InputError(
                f"missing = {missing!r} would change choice sets in silence; drop whole situations, or mark rows as "
                "not available"
            )
        if unknown := sorted(set(kwargs) - FROM_FORMULA):
            raise TypeError(f"ConditionalLogit() got an unexpected keyword argument {unknown[0]!r}")
        self._data_columns: dict[str, str] = kwargs.pop("_data_columns", {})
        x = numbers("exog", exog)
        if (rows := np.shape(x)[0] if np.ndim(x) else 0) != (given := np.size(endog)):
            raise InputError(f"endog has {given} entries for the {rows} rows of exog; give one per row")
        if not rows:
            raise InputError("there are no rows; give at least one situation")
        # No constant is looked for: what would be one depends on the sets, and is checked with them.
        y = numbers("endog", endog)
        y = y.iloc[:, 0] if isinstance(y, pd.DataFrame) else y if isinstance(y, pd.Series) else y.ravel()
        try:
            super().__init__(y, x, missing="none", hasconst=False, **kwargs)
        except ValueError as error:
            raise InputError(f"statsmodels refuses the data: {' '.join(str(error).split())}") from error
        self.groups, self.outside_option = groups, bool(outside_option)
        self.available, self.weights, self.offset, self.penalty = available, weights, offset, penalty
        self._init_keys += ["groups", "outside_option", "available", "weights", "offset", "penalty"]
        self.k_params = self.exog.shape[1]
        if not self.k_params:
            raise InputError("exog has no columns; give at least one feature")
        self.penalties = penalties_of(penalty, list(self.exog_names))
        self._choices = ChoiceData.of(
            self.endog,
            groups,
            outside=self.outside_option,
            available=available,
            weights=weights,
            offset=offset,
            name=str(self.endog_names),
        )
        finite_design(self.exog, self._choices.rows, list(self.exog_names))
        self._data_attr += ["groups", "available", "weights", "offset", "_choices", "likelihood"]
        self.nobs = self.likelihood.total
        self.df_model = float(self.k_params)
        self.df_resid = self.nobs - self.df_model

    @classmethod
    def from_formula(
        cls, formula: Any, data: Any, subset: Any = None, drop_cols: Any = None, *args: Any, **kwargs: Any
    ) -> ConditionalLogit:
        """Create the model from a formula; write ``0 +`` unless an outside option gives the intercept a meaning.

        Parameters
        ----------
        formula : str
            As in statsmodels: ``"choice ~ 0 + price + C(brand)"``.
        data : pandas.DataFrame
            ``groups``, ``available``, ``weights`` and ``offset`` may be names of its columns.
        subset : array_like, optional
            Index labels, or a boolean mask, of the rows to use.
        drop_cols : list of str, optional
            Columns to leave out of the design.
        *args, **kwargs
            As for the class.

        Returns
        -------
        ConditionalLogit
        """
        if subset is not None:
            data = data.loc[subset]
        names = {key: kwargs[key] for key in BY_COLUMN if isinstance(kwargs.get(key), str)}
        for key, column in names.items():
            if column not in data:
                raise InputError(f"{key} = {column!r} is not a column of the data")
            kwargs[key] = data[column]
        # statsmodels counts stack frames to find the variables of a formula; this method is one more.
        depth = kwargs.get("eval_env")
        if depth is None or (isinstance(depth, int) and depth >= 0):
            kwargs["eval_env"] = 2 if depth is None else depth + 1
        kwargs.setdefault("missing", "raise")
        left = str(formula).split("~")[0].strip()
        if left in data and data[left].dtype == bool:  # a formula would make two columns of it
            data = data.assign(**{left: data[left].astype(float)})
        try:
            model: ConditionalLogit = super().from_formula(
                formula, data, None, drop_cols, *args, _data_columns=names, **kwargs
            )
        except Exception as error:
            origin = getattr(error, "origin", None)  # where patsy puts the variable in question
            engine = type(error).__module__.partition(".")[0] in ("patsy", "formulaic")
            if isinstance(error, InputError) or not (engine or isinstance(error, ValueError)):
                raise
            where = f" ({origin.relevant_code()})" if origin is not None else ""
            words = getattr(error, "message", None) or str(error)
            raise InputError(f"the formula does not fit the data{where}: {' '.join(words.split())}") from error
        return model

    @cached_property
    def likelihood(self) -> Likelihood:
        """The situations that carry information, in differences from the choice."""
        return Likelihood.of(self._choices, np.asarray(self.exog, dtype=float))

    @property
    def rejections(self) -> float | None:
        """How many situations chose the outside option, weights counted; None without an outside option."""
        return self._choices.rejections if self.outside_option else None

    @property
    def situations(self) -> pd.Index:
        """Labels of the situations, in order of first appearance, (S,)."""
        return self._choices.labels

    def loglike(self, params: npt.ArrayLike) -> float:
        """Return the log-likelihood, without the penalty."""
        return self.likelihood.value(np.asarray(params, dtype=float))

    def score(self, params: npt.ArrayLike) -> Floats:
        """Return the gradient of ``loglike``, (k,)."""
        return self.likelihood.slopes(*self.likelihood.at(np.asarray(params, dtype=float))).gradient

    def score_obs(self, params: npt.ArrayLike) -> Floats:
        """Return the gradient of each informative situation, weights not counted, (S, k)."""
        return self.likelihood.scores(self.likelihood.at(np.asarray(params, dtype=float))[0])

    def information(self, params: npt.ArrayLike) -> Floats:
        """Return the Fisher information, (k, k); observed and expected are the same."""
        return self.likelihood.slopes(*self.likelihood.at(np.asarray(params, dtype=float))).information

    def hessian(self, params: npt.ArrayLike) -> Floats:
        """Return the second derivatives of ``loglike``, (k, k)."""
        return -self.information(params)

    def predict(
        self,
        params: npt.ArrayLike,
        exog: Any = None,
        groups: Any = None,
        available: Any = None,
        offset: Any = None,
    ) -> Floats:
        """Return the choice probability of each row, in input order, (n,); 0 where not available.

        Without ``exog``, those of the model's own rows. With an outside option a situation's sum is below 1.
        """
        if exog is None:
            x, rows, sets, known = np.asarray(self.exog), self._choices.rows, self._choices.sets, self._choices.offset
        else:
            x = np.asarray(numbers("exog", exog))
            if x.ndim != 2 or x.shape[1] != self.k_params:
                raise InputError(f"exog has shape {x.shape}; give one column for each of {', '.join(self.exog_names)}")
            if groups is None:
                raise InputError("groups is missing; give the label of the situation that each row belongs to")
            codes, labels = situations(groups, len(x))
            rows, sets, _ = sort_rows(codes, len(labels), mask_of_rows("available", available, len(x)))
            finite_design(x, rows, list(self.exog_names))
            known = None if offset is None else finite_column("offset", offset, len(x), rows)
        index = x.take(rows, axis=0) @ np.asarray(params, dtype=float)
        probability = np.zeros(len(x))
        probability[rows] = sets.shares(index if known is None else index + known, self.outside_option)[0]
        return probability

    def fit(
        self,
        start_params: npt.ArrayLike | None = None,
        *,
        cov_type: str = "nonrobust",
        maxiter: int = 100,
        tol: float = 1e-10,
        disp: bool = False,
    ) -> ConditionalLogitResultsWrapper:
        """Maximise the (penalised) likelihood by Newton's method.

        Parameters
        ----------
        start_params : (k,) array_like, optional
            First guess; zeros by default. The objective is concave: it matters for speed alone.
        cov_type : {"nonrobust", "HC0", "robust"}
            Inverse Fisher information, or the sandwich with the situations as observations ("robust" is "HC0"). With
            a penalty the information of the penalty is added: the standard errors are conditional on it.
        maxiter : int
            Largest number of Newton steps.
        tol : float
            Distance to the maximum at which to stop, in standard errors.
        disp : bool
            Print how the search ended.

        Returns
        -------
        ConditionalLogitResults
            With names attached, as all results of statsmodels.

        Raises
        ------
        NotIdentifiedError
            A DataError: if a column never varies within a set, columns are collinear, or the choices are separated,
            and no penalty settles it.
        InputError
            If the first guess does not fit, or ``cov_type`` is unknown.

        Warns
        -----
        EstimationWarning
            If situations carry no information, are few, never (or always) end in a rejection, or leave a coefficient
            to the penalty alone.
        ConvergenceWarning
            If the search ended before the tolerance was met.
        """
        if cov_type not in ("nonrobust", "HC0", "robust"):
            raise InputError(f"cov_type = {cov_type!r} is unknown; it is 'nonrobust', 'HC0' or 'robust'")
        if whole_number("maxiter", maxiter) < 0:
            raise InputError(f"maxiter = {maxiter} is negative; give the largest number of Newton steps")
        if not (is_finite(tol) and tol >= 0):
            raise InputError(f"tol = {tol} is not a number of at least 0; give a distance in standard errors")
        k, likelihood = self.k_params, self.likelihood
        start = np.zeros(k) if start_params is None else np.asarray(start_params, dtype=float)
        if start.shape != (k,) or not np.isfinite(start).all():
            raise InputError(f"start_params has shape {start.shape}; give {k} finite numbers")
        # The matrices are tall and thin: a second BLAS thread costs two to three times what it saves.
        with _blas().limit(limits=1, user_api="blas"):
            optimum = find_optimum(
                likelihood,
                list(self.exog_names),
                self.penalties,
                self.rejections,
                start,
                max_iterations=maxiter,
                tolerance=tol,
            )
        if disp:
            ended = "Optimization terminated successfully" if optimum.converged else "Optimization did not converge"
            print(f"{ended}: log-likelihood {optimum.value:.6f}, {optimum.iterations} Newton steps")
        covariance, robust = covariances(likelihood, self.penalties, optimum, cov_type != "nonrobust")
        return ConditionalLogitResultsWrapper(ConditionalLogitResults(self, optimum, covariance, robust))
