"""McFadden's conditional logit on ragged choice sets, as a statsmodels model."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from statsmodels.base.model import LikelihoodModel
from threadpoolctl import ThreadpoolController

from optkit.basics.arrays import Floats, flag, number, one_of, whole_number
from optkit.basics.errors import InputError
from optkit.models.estimation.choices import (
    ChoiceData,
    finite_column,
    finite_design,
    mask_of_rows,
    sort_rows,
)
from optkit.models.estimation.columns import NotIdentifiedError
from optkit.models.estimation.formulas import Made, UnknownColumnError, prepared, translated
from optkit.models.estimation.identification import EstimationWarning, IdentificationReport, identification
from optkit.models.estimation.inputs import coefficients, numbers, penalties_of
from optkit.models.estimation.likelihood import Likelihood
from optkit.models.estimation.optimum import covariance, find_optimum
from optkit.models.estimation.results import ConditionalLogitResults, ConditionalLogitResultsWrapper
from optkit.models.estimation.sandwich import sandwich_of
from optkit.models.estimation.situations import situation_of
from optkit.models.rows import Rows, labelled

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


FROM_FORMULA = {"formula", "model_spec", "design_info", "missing_idx"}
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
        Features of the alternatives, in any units. A table of any library gives the coefficients their names.
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
    Whatever has an index, as pandas' Series have, is matched with ``exog`` by label, or refused; arrays and lists are
    taken by place.

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
        missing: str = "none",
        **kwargs: Any,
    ) -> None:
        if groups is None:
            raise InputError("groups is missing; give the label of the situation that each row belongs to")
        if isinstance(missing, str) and missing == "drop":
            raise InputError(
                "missing = 'drop' would change choice sets in silence; drop whole situations, or mark rows as not "
                "available"
            )
        one_of("missing", missing, ("none", "raise"))
        self.outside_option = flag("outside_option", outside_option)
        made: Made | None = kwargs.pop("_made", None)
        if unknown := sorted(set(kwargs) - FROM_FORMULA):
            raise TypeError(f"ConditionalLogit() got an unexpected keyword argument {unknown[0]!r}")
        self._data_columns: dict[str, str] = {} if made is None else made.columns
        if made is not None:
            endog, exog = made.design(endog, exog)
        x = numbers("exog", exog)
        y = numbers("endog", endog)
        if (n := np.shape(x)[0] if np.ndim(x) else 0) != (given := np.size(y)):
            raise InputError(f"endog has {given} entries for the {n} rows of exog; give one per row")
        if not n:
            raise InputError("there are no rows; give at least one situation")
        y = y.iloc[:, 0] if isinstance(y, pd.DataFrame) else y if isinstance(y, pd.Series) else y.ravel()
        # A table of another library has columns, but no labels of rows.
        rows = Rows.of(n, exog=exog, endog=endog, groups=groups, available=available, offset=offset)
        y = rows.take("endog", y if labelled(endog) else np.asarray(y))
        if isinstance(x, pd.DataFrame) and rows.labels is not None and not labelled(exog):
            x = x.set_axis(rows.labels, axis=0)
        groups, available, offset = (
            rows.take(key, value) for key, value in (("groups", groups), ("available", available), ("offset", offset))
        )
        # No constant is looked for: what would be one depends on the sets, and is checked with them.
        try:
            super().__init__(y, x, missing="none", hasconst=False, **kwargs)
        except ValueError as error:
            raise InputError(f"statsmodels refuses the data: {' '.join(str(error).split())}") from error
        self._frame: Any = None if made is None else made.frame
        self.named = isinstance(x, pd.DataFrame) or getattr(x, "name", None) is not None
        self.groups = groups
        self.available, self.weights, self.offset, self.penalty = available, weights, offset, penalty
        self._init_keys += ["groups", "outside_option", "available", "weights", "offset", "penalty"]
        self.k_params = self.exog.shape[1]
        if not self.k_params:
            raise InputError("exog has no columns; give at least one feature")
        self.penalties = penalties_of(penalty, self.column_names)
        self._choices = ChoiceData.of(
            self.endog,
            groups,
            outside=self.outside_option,
            available=available,
            weights=weights,
            offset=offset,
            name=str(self.endog_names),
            rows=rows,
        )
        finite_design(self.exog, self._choices.rows, self.column_names, rows)
        self._data_attr += ["groups", "available", "weights", "offset", "_frame", "_choices", "likelihood"]
        self.nobs = self.likelihood.total
        self.df_model = float(self.k_params)
        self.df_resid = self.nobs - self.df_model

    @classmethod
    def from_formula(
        cls,
        formula: Any,
        data: Any,
        subset: Any = None,
        drop_cols: Any = None,
        groups: Any = None,
        outside_option: bool = False,
        **kwargs: Any,
    ) -> ConditionalLogit:
        """Create the model from a formula.

        Without an outside option no intercept means anything: a formula's is left out, and the first level of a
        categorical variable is the base of the others, whether or not the formula says ``0 +``.

        Parameters
        ----------
        formula : str
            As in statsmodels: ``"choice ~ price + C(brand)"``. Text and categories have one effect per level.
        data : DataFrame
            ``groups``, ``available``, ``weights`` and ``offset`` may be names of its columns. Rows that are not
            available may hold anything, and nothing.
        subset : array_like, optional
            Index labels, or a boolean mask, of the rows to use.
        drop_cols : list of str, optional
            Columns to leave out of the design.
        groups : (n,) array_like or str
            Situation of each row. What has labels is matched with those of ``data``.
        outside_option : bool
            Whether every situation also offers an option of utility 0.
        **kwargs
            As for the class.

        Returns
        -------
        ConditionalLogit

        Raises
        ------
        InputError
            If the formula does not fit the data, or a column is missing; and as for the class.
        """
        given = {"groups": groups} | {key: kwargs.pop(key, None) for key in ("available", "weights", "offset")}
        if unknown := sorted(set(kwargs) - {"penalty", "missing", "eval_env"}):
            raise TypeError(f"from_formula() got an unexpected keyword argument {unknown[0]!r}")
        # statsmodels counts stack frames to find the variables of a formula; this method is one more.
        depth = kwargs.pop("eval_env", None)
        if depth is None or (isinstance(depth, int) and depth >= 0):
            depth = 2 if depth is None else depth + 1
        flag("outside_option", outside_option)
        made, table, given = prepared(formula, data, subset, drop_cols, given, outside_option, depth)
        kwargs = {"missing": "raise"} | kwargs | given | {"outside_option": outside_option, "eval_env": depth}
        # With an intercept, which is then left out, categories are coded against a base.
        ways = [formula] if outside_option or not isinstance(formula, str) else [f"{formula} + 1", formula]
        for way in ways:
            try:
                model: ConditionalLogit = super().from_formula(way, table, None, None, _made=made, **kwargs)
                break
            except UnknownColumnError:  # perhaps one of those that the formula has as it is written
                if way is ways[-1]:
                    raise
            except SystemExit as error:
                raise InputError(f"the formula {formula} ends the program: write it without exit()") from error
            except Exception as error:
                rows = Rows(len(made.labels), made.labels)
                raise translated(error, formula, table, rows, made.used) from error
        model.formula = formula
        return model

    @property
    def column_names(self) -> list[str]:
        """Names of the columns as text, for messages, (k,)."""
        return [str(name) for name in self.exog_names]

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

    def _checked(self, params: Any) -> Floats:
        return coefficients("params", params, self.column_names)

    def loglike(self, params: npt.ArrayLike) -> float:
        """Return the log-likelihood, without the penalty."""
        return self.likelihood.value(self._checked(params))

    def score(self, params: npt.ArrayLike) -> Floats:
        """Return the gradient of ``loglike``, (k,)."""
        return self.likelihood.slopes(*self.likelihood.at(self._checked(params))).gradient

    def score_obs(self, params: npt.ArrayLike) -> Floats:
        """Return the gradient of each informative situation, weights not counted, (S, k)."""
        return self.likelihood.scores(self.likelihood.at(self._checked(params))[0])

    def information(self, params: npt.ArrayLike) -> Floats:
        """Return the Fisher information, (k, k); observed and expected are the same."""
        return self.likelihood.slopes(*self.likelihood.at(self._checked(params))).information

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
            x, used, sets, known = np.asarray(self.exog), self._choices.rows, self._choices.sets, self._choices.offset
        else:
            x = np.asarray(numbers("exog", exog))
            if x.ndim != 2 or x.shape[1] != self.k_params:
                names = ", ".join(self.column_names)
                raise InputError(f"exog has shape {x.shape}; give one column for each of {names}")
            if groups is None:
                raise InputError("groups is missing; give the label of the situation that each row belongs to")
            rows = Rows.of(len(x), exog=exog, groups=groups, available=available, offset=offset)
            codes, labels = situation_of(rows.take("groups", groups), rows)
            open_rows = mask_of_rows("available", rows.take("available", available), rows)
            used, sets, _ = sort_rows(codes, len(labels), open_rows)
            finite_design(x, used, self.column_names, rows)
            known = None if offset is None else finite_column("offset", rows.take("offset", offset), rows, used)
        index = x.take(used, axis=0) @ self._checked(params)
        probability = np.zeros(len(x))
        probability[used] = sets.shares(index if known is None else index + known, self.outside_option)[0]
        return probability

    def fit(
        self,
        start_params: npt.ArrayLike | None = None,
        *,
        cov_type: str = "nonrobust",
        cov_kwds: Mapping[str, Any] | None = None,
        maxiter: int = 100,
        tol: float = 1e-10,
        disp: bool = False,
    ) -> ConditionalLogitResultsWrapper:
        """Maximise the (penalised) likelihood by Newton's method.

        Parameters
        ----------
        start_params : (k,) array_like, optional
            First guess; zeros by default. The objective is concave: it matters for speed alone.
        cov_type : {"nonrobust", "HC0", "robust", "cluster"}
            Inverse Fisher information, or the sandwich with the situations as observations ("robust" is "HC0"), or
            with clusters of them, such as all choices of one worker. With a penalty the information of the penalty is
            added: the standard errors are conditional on it.
        cov_kwds : dict, optional
            For "cluster": ``groups``, the cluster of each row, or of each situation as ``weights`` are given, or for a
            model from a formula the name of a column; and ``use_correction`` (default True), whether to multiply the
            covariance by ``G / (G - 1) * (N - 1) / (N - k)`` as statsmodels and Stata do, with G clusters, N situations
            (weights counted) and k coefficients.
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
            If the first guess does not fit, ``cov_type`` is unknown, or a situation has two clusters or none.

        Warns
        -----
        EstimationWarning
            If situations carry no information, they or clusters are few, never (or always) end in a rejection, or
            leave a coefficient to the penalty alone.
        ConvergenceWarning
            If the search ended before the tolerance was met.
        """
        one_of("cov_type", cov_type, ("nonrobust", "HC0", "robust", "cluster"))
        whole_number("maxiter", maxiter, least=0)
        number("tol", tol, least=0.0)
        flag("disp", disp)
        k, likelihood = self.k_params, self.likelihood
        start = np.zeros(k) if start_params is None else coefficients("start_params", start_params, self.column_names)
        sandwich = sandwich_of(cov_type, cov_kwds, self._choices, likelihood, self._frame)
        # The matrices are tall and thin: a second BLAS thread costs two to three times what it saves.
        with _blas().limit(limits=1, user_api="blas"):
            optimum = find_optimum(
                likelihood,
                self.column_names,
                self.penalties,
                self.rejections,
                start,
                max_iterations=maxiter,
                tolerance=tol,
            )
        if disp:
            ended = "Optimization terminated successfully" if optimum.converged else "Optimization did not converge"
            print(f"{ended}: log-likelihood {optimum.value:.6f}, {optimum.iterations} Newton steps")
        inverse = covariance(self.penalties, optimum)
        return ConditionalLogitResultsWrapper(ConditionalLogitResults(self, optimum, inverse, sandwich))
