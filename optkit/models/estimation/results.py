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

from optkit.basics.arrays import Floats, flag, number, real
from optkit.basics.errors import InputError
from optkit.models.estimation.choices import mask_of_rows
from optkit.models.estimation.formulas import column_of, evaluated
from optkit.models.estimation.identification import IdentificationReport, identification
from optkit.models.estimation.inputs import contrasts, numbers
from optkit.models.estimation.newton import Optimum
from optkit.models.estimation.sandwich import Sandwich
from optkit.models.frames import frame_of
from optkit.models.rows import Rows, labelled


class ConditionalLogitResults(LikelihoodModelResults):  # type: ignore[misc]
    """A fitted conditional logit.

    Everything that :class:`statsmodels.base.model.LikelihoodModelResults` has: ``params``, ``bse``, ``tvalues``,
    ``pvalues``, ``conf_int()``, ``cov_params()``, ``t_test()``, ``wald_test()``, ``save()``; and:

    Attributes
    ----------
    llf : float
        Log-likelihood at the estimate, without the penalty.
    llnull : float
        Log-likelihood at coefficients of 0: equal shares of all available alternatives, the outside option included,
        or with an offset the shares by the offset alone. It is not that of a model with alternative-specific constants.
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
    cov_type, cov_kwds : str, dict
        How the standard errors were made; ``cov_kwds["description"]`` says it in words.
    mle_retvals : dict
        ``iterations``, ``converged`` and ``decrement`` (distance to the maximum in standard errors).
    """

    def __init__(self, model: Any, optimum: Optimum, covariance: Floats, sandwich: Sandwich | None) -> None:
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
        self.cov_type = "nonrobust"
        self.cov_kwds: dict[str, Any] = {"description": "Inverse of the Fisher information."}
        if sandwich is not None:
            self.cov_params_default = sandwich.covariance(model.likelihood, covariance, optimum.share)
            self.cov_type, self.cov_kwds = sandwich.cov_type, {"description": sandwich.description}
            if sandwich.cov_type == "cluster":
                self.cov_kwds |= {"use_correction": sandwich.use_correction, "n_groups": sandwich.n_clusters}

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

    def predict(
        self,
        exog: Any = None,
        transform: bool = True,
        groups: Any = None,
        available: Any = None,
        offset: Any = None,
    ) -> Any:
        """Choice probabilities.

        Parameters
        ----------
        exog : (m, k) array_like or DataFrame, optional
            New alternatives; by default the model's own rows. For a model from a formula, a DataFrame with the
            formula's variables. Columns of a table of any library are matched by name if the model has names.
        transform : bool
            Whether to pass ``exog`` through the model's formula, if it has one.
        groups, available, offset : (m,) array_like, optional
            As for the model, one entry per row; ``groups`` is needed with ``exog``. What has an index is matched with
            ``exog`` by label. For a model from a formula they are taken from the columns of ``exog`` that held them
            when it was fitted.

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
        try:
            flag("transform", transform)
        except InputError as error:
            raise InputError(f"{error}; groups, available and offset are given by name: groups=...") from None
        if exog is None:
            fitted, index = self.fittedvalues, self.model.data.row_labels
            return fitted if index is None else pd.Series(fitted, index=index)
        by_formula = transform and hasattr(self.model, "formula")
        named = frame_of("exog", exog)
        row = isinstance(exog, pd.Series) and self.model.k_params > 1
        index = exog.index if labelled(exog) and not row else None
        given = {"groups": groups, "available": available, "offset": offset}
        if isinstance(named, pd.DataFrame):
            for key, column in self.model._data_columns.items():
                if key in given and given[key] is None and (column in named or key == "offset"):
                    given[key] = column_of(named, key, column, "exog")
        if not by_formula:
            x = self._columns(named)
            rows = Rows(len(x), index, "exog")
        else:
            if not isinstance(named, pd.DataFrame):
                raise InputError(f"exog is a {type(exog).__name__}; the model has a formula: give a DataFrame")
            rows = Rows(len(named), index, "exog")
            mask = mask_of_rows("available", rows.take("available", given["available"]), rows)
            x = evaluated(self, named, np.arange(len(named)) if mask is None else np.flatnonzero(mask))
        frame = pd.DataFrame(x, index=index)
        probability = self.model.predict(self.params, x if index is None else frame, **given)
        return probability if index is None else pd.Series(probability, index=index)

    def _columns(self, x: Any) -> Any:
        """Return the model's columns of new alternatives, (m, k): by name where both have names."""
        names = self.model.column_names
        if isinstance(x, pd.Series) and len(names) > 1:
            x = x.to_frame().T  # one alternative
        if isinstance(x, pd.DataFrame):
            place = {str(name): i for i, name in enumerate(x.columns)}
            if self.model.named or set(names) <= set(place):
                if missing := [name for name in names if name not in place]:
                    raise InputError(f"exog has no column {missing[0]}; it has {', '.join(place)}")
                x = x.iloc[:, [place[name] for name in names]]
        array = np.asarray(numbers("exog", x))
        if array.ndim == 1:
            array = array[:, None] if len(names) == 1 else array[None, :]
        if array.ndim != 2:
            raise InputError(f"exog has shape {array.shape}; give one column for each of {', '.join(names)}")
        return array

    def t_test(self, r_matrix: Any, cov_p: Any = None, use_t: bool | None = None) -> Any:
        """Test linear combinations of the coefficients one by one, as statsmodels does.

        Parameters
        ----------
        r_matrix : str, (k,) or (q, k) array_like, Series or DataFrame, or a tuple of such and (q,) values
            A Series or DataFrame goes by the names of the coefficients, in any order; arrays go by place.
        cov_p : (k, k) array_like or DataFrame, optional
            Another covariance of the coefficients; a DataFrame goes by their names.
        use_t : bool, optional
            Whether to use Student's distribution.

        Returns
        -------
        statsmodels.stats.contrast.ContrastResults
            One test per row.

        Raises
        ------
        InputError
            If labels are not the names of the coefficients, each once, or an entry is not a finite number; or if
            there is nothing to test, as with weights that are all 0.
        """
        names = self.model.column_names
        use_t = None if use_t is None else flag("use_t", use_t)
        asked, given = contrasts("r_matrix", r_matrix, names), contrasts("cov_p", cov_p, names)
        return _decided(super().t_test(asked, given, use_t))

    def wald_test(
        self, r_matrix: Any, cov_p: Any = None, invcov: Any = None, use_f: bool | None = None, **options: Any
    ) -> Any:
        """Test linear combinations of the coefficients jointly, as statsmodels does; ``f_test`` does it by this.

        Parameters
        ----------
        r_matrix, cov_p : array_like, Series or DataFrame
            As of :meth:`t_test`.
        invcov : (q, q) array_like, optional
            Inverse covariance of the combinations.
        use_f : bool, optional
            Whether to use the F distribution.
        **options
            ``df_constraints`` and ``scalar``, as of statsmodels.

        Returns
        -------
        statsmodels.stats.contrast.ContrastResults
            One test of all rows.

        Raises
        ------
        InputError
            As :meth:`t_test`.
        """
        names = self.model.column_names
        asked, given = contrasts("r_matrix", r_matrix, names), contrasts("cov_p", cov_p, names)
        use_f = None if use_f is None else flag("use_f", use_f)
        inverse = None if invcov is None else real("invcov", invcov)
        return _decided(super().wald_test(asked, given, invcov=inverse, use_f=use_f, **options))

    def conf_int(self, alpha: float = 0.05) -> Any:
        """Return the confidence interval of each coefficient, (k, 2), at level ``1 - alpha``.

        Raises
        ------
        InputError
            If ``alpha`` is not between 0 and 1.
        """
        if not 0.0 < number("alpha", alpha) < 1.0:
            raise InputError(f"alpha = {alpha} is not between 0 and 1: 0.05 is for an interval of 95 %")
        return super().conf_int(alpha)

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
        null = "equal shares of all alternatives" if model.offset is None else "shares by the offset alone"
        notes = [f"LL-Null: {null} (coefficients of 0)."]
        if self.cov_type != "nonrobust":
            notes.append(f"Standard errors: {self.cov_kwds['description']}")
        if model.penalties.any():
            notes.append("Penalised: estimates are shrunk; standard errors are conditional on the penalty.")
        if not self.converged:
            notes.append("Warning: the search ended before the maximum.")
        table.add_extra_txt(notes)
        return table


def _decided(test: Any) -> Any:
    """Return a test, or refuse one that tests nothing: its p-value is NaN."""
    undecided = np.flatnonzero(np.isnan(np.atleast_1d(test.pvalue)))
    if undecided.size:
        raise InputError(
            f"r_matrix: row {undecided[0]} has no variance: its weights are all 0, or those of coefficients that are "
            "known exactly; there is nothing to test"
        )
    return test


class ConditionalLogitResultsWrapper(LikelihoodResultsWrapper):  # type: ignore[misc]
    """Attaches names to the results."""


populate_wrapper(ConditionalLogitResultsWrapper, ConditionalLogitResults)
