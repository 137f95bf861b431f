"""Results of a conditional logit: statsmodels' own, with what discrete choice adds."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2
from statsmodels.base.model import LikelihoodModelResults, LikelihoodResultsWrapper
from statsmodels.base.wrapper import populate_wrapper
from statsmodels.iolib.summary import Summary

from optkit.basics.errors import InputError
from optkit.models.decision import Floats
from optkit.models.estimation.identification import IdentificationReport, identification
from optkit.models.estimation.newton import Optimum


class ConditionalLogitResults(LikelihoodModelResults):  # type: ignore[misc]
    """A fitted conditional logit.

    Everything that :class:`statsmodels.base.model.LikelihoodModelResults` has: ``params``, ``bse``, ``tvalues``,
    ``pvalues``, ``conf_int()``, ``cov_params()``, ``t_test()``, ``wald_test()``, ``save()``; and:

    Attributes
    ----------
    llf : float
        Log-likelihood at the estimate, without the penalty.
    llnull : float
        Log-likelihood at coefficients of 0: equal shares of all available alternatives, the outside option included.
        It is not that of a model with alternative-specific constants.
    llr, llr_pvalue : float
        Likelihood ratio statistic against ``llnull``, and its chi-squared p-value.
    prsquared, prsquared_adj : float
        McFadden's ``1 - llf / llnull``, and with the number of coefficients taken from llf.
    aic, bic : float
        Akaike's and Schwarz's criteria; the number of situations counts as the number of observations.
    nobs : float
        Situations that carry information, weights counted.
    converged : bool
        Whether the search met its tolerance.
    mle_retvals : dict
        ``iterations``, ``converged`` and ``decrement`` (distance to the maximum in standard errors).
    """

    def __init__(self, model: Any, optimum: Optimum, covariance: Floats, robust: Floats | None) -> None:
        super().__init__(model, optimum.params, normalized_cov_params=covariance, scale=1.0)
        self._llf, self.converged = optimum.value, optimum.converged
        self.nobs, self.df_model, self.df_resid = model.nobs, model.df_model, model.df_resid
        self.method = "Newton"
        self.mle_settings = {"optimizer": "newton"}
        self.mle_retvals = {
            "iterations": optimum.iterations,
            "converged": optimum.converged,
            "decrement": optimum.decrement,
        }
        self.cov_type, self.cov_kwds = "nonrobust", {"description": "Inverse of the Fisher information."}
        if robust is not None:
            self.cov_params_default = robust
            self.cov_type, self.cov_kwds = "HC0", {"description": "Sandwich, with the situations as observations."}

    @property
    def llf(self) -> float:
        """Log-likelihood at the estimate, without the penalty."""
        return self._llf

    @cached_property
    def llnull(self) -> float:
        """Log-likelihood at coefficients of 0."""
        return float(self.model.loglike(np.zeros(len(self.params))))

    @property
    def llr(self) -> float:
        """Likelihood ratio statistic against coefficients of 0."""
        return 2.0 * float(self.llf - self.llnull)

    @property
    def llr_pvalue(self) -> float:
        """p-value of ``llr`` under a chi-squared distribution with k degrees of freedom."""
        return float(chi2.sf(self.llr, self.df_model))

    @property
    def prsquared(self) -> float:
        """McFadden's pseudo R-squared."""
        return 1.0 - float(self.llf / self.llnull)

    @property
    def prsquared_adj(self) -> float:
        """McFadden's pseudo R-squared, adjusted for the number of coefficients."""
        return 1.0 - float((self.llf - self.df_model) / self.llnull)

    @property
    def aic(self) -> float:
        """Akaike's information criterion."""
        return 2.0 * float(self.df_model - self.llf)

    @property
    def bic(self) -> float:
        """Schwarz's information criterion."""
        return float(np.log(self.nobs) * self.df_model - 2.0 * self.llf)

    @property
    def fittedvalues(self) -> Floats:
        """Choice probability of each row, (n,)."""
        fitted: Floats = self.model.predict(self.params)
        return fitted

    def identification(self) -> IdentificationReport:
        """Report what the data can tell; see :func:`optkit.models.estimation.identification.identification`."""
        return identification(self)

    def predict(self, exog: Any = None, transform: bool = True, *args: Any, **kwargs: Any) -> Any:
        """Choice probabilities.

        Parameters
        ----------
        exog : (m, k) array_like or DataFrame, optional
            New alternatives; by default the model's own rows. For a model from a formula, a DataFrame with the
            formula's variables. Columns of a DataFrame are matched by name if the model has names.
        transform : bool
            Whether to pass ``exog`` through the model's formula, if it has one.
        *args, **kwargs
            ``groups`` (needed with ``exog``), ``available`` and ``offset``, one entry per row. For a model from a
            formula they are taken from the columns of ``exog`` that held them when it was fitted.

        Returns
        -------
        (m,) ndarray or Series
            Probability of each row, in the order given; a situation adds up to 1, or with an outside option to
            less.

        Raises
        ------
        InputError
            If columns are missing, shapes do not fit, or an entry is not finite.
        """
        if exog is None:
            fitted, labels = self.fittedvalues, self.model.data.row_labels
            return fitted if labels is None else pd.Series(fitted, index=labels)
        if isinstance(exog, pd.DataFrame):
            for position, key in enumerate(("groups", "available", "offset")):
                column = self.model._data_columns.get(key)
                if column in exog and len(args) <= position:
                    kwargs.setdefault(key, exog[column])
            if not hasattr(self.model, "formula") and self.model.data.row_labels is not None:
                missing = [name for name in self.model.exog_names if name not in exog]
                if missing:
                    raise InputError(f"exog has no column {missing[0]}; the model has one")
                exog = exog[self.model.exog_names]
        return super().predict(exog, transform, *args, **kwargs)

    def summary(
        self, yname: str | None = None, xname: list[str] | None = None, title: str | None = None, alpha: float = 0.05
    ) -> Summary:
        """Tabulate the fit.

        Parameters
        ----------
        yname, xname, title : optional
            Names of the choice and of the coefficients, and the heading.
        alpha : float
            1 - alpha is the level of the confidence intervals.

        Returns
        -------
        statsmodels.iolib.summary.Summary
            Prints as text; ``as_latex()``, ``as_html()`` and ``as_csv()`` as usual.
        """
        model = self.model
        sizes, rejections = model.likelihood.sets.sizes + 1, model.rejections
        left = [
            ("Dep. Variable:", None),
            ("Model:", None),
            ("Method:", [f"MLE, {self.method}"]),
            ("Date:", None),
            ("Time:", None),
            ("converged:", [str(self.converged)]),
            ("Covariance Type:", [self.cov_type]),
        ]
        right = [
            ("No. Situations:", [f"{self.nobs:g}"]),
            ("Outside Chosen:", ["no such option" if rejections is None else f"{rejections:g}"]),
            ("Alternatives:", [f"{sizes.min()} to {sizes.max()}"]),
            ("Pseudo R-squ.:", [f"{self.prsquared:.4g}"]),
            ("Log-Likelihood:", [f"{self.llf:.5g}"]),
            ("LL-Null:", [f"{self.llnull:.5g}"]),
            ("LLR p-value:", [f"{self.llr_pvalue:.4g}"]),
        ]
        table = Summary()
        heading = title or "Conditional Logit Regression Results"
        table.add_table_2cols(self, gleft=left, gright=right, yname=yname, xname=xname, title=heading)
        table.add_table_params(self, yname=yname, xname=xname, alpha=alpha, use_t=self.use_t)
        notes = ["LL-Null: equal shares of all alternatives (coefficients of 0)."]
        if model.penalties.any():
            notes.append("Penalised: estimates are shrunk; standard errors are conditional on the penalty.")
        if not self.converged:
            notes.append("Warning: the search ended before the maximum.")
        table.add_extra_txt(notes)
        return table


class ConditionalLogitResultsWrapper(LikelihoodResultsWrapper):  # type: ignore[misc]
    """Attaches names to the results."""


populate_wrapper(ConditionalLogitResultsWrapper, ConditionalLogitResults)
