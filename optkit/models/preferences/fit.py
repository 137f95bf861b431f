"""From logged offers to preferences: one conditional logit per worker group, or one for all."""

from __future__ import annotations

import warnings
from typing import Any, Literal

import numpy as np
import pandas as pd

from optkit.basics.arrays import MOST_MONEY, Floats, flag, number, one_of
from optkit.basics.errors import DataError, InputError
from optkit.models.estimation import ConditionalLogit, EstimationWarning, NotIdentifiedError
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences, from_index

Method = Literal["choice", "accept-reject"]


def fit_preferences(
    offers: Offers,
    *,
    pooled: bool = False,
    method: Method = "choice",
    ridge: float = 0.0,
    scale_penalty: float = 0.0,
    robust: bool = False,
    attributes: Attributes | None = None,
) -> Preferences:
    """Estimate w and mu of the index (w'x + c)/mu.

    Parameters
    ----------
    offers : Offers
        What was shown and taken.
    pooled : bool
        One model for all groups (single MNL) instead of one per group (Multi MNL).
    method : {"choice", "accept-reject"}
        Conditional logit on whole choice sets with the outside option; or the paper's way (section 3.4), a logistic
        regression that takes every offer as accepted or rejected by itself. The latter is biased however large the
        data, because a worker who takes one offer has not rejected the others; it is here for comparison.
    ridge : float
        L2 penalty of every coefficient of theta = (w/mu, 1/mu), at least 0. What the data leave open then rests on it,
        with a warning; without it that is an error.
    scale_penalty : float
        L2 penalty of 1/mu alone, as in the paper.
    robust : bool
        Sandwich covariance with situations as observations. Offers that name clusters have it with these, and
        corrected for few of them, whether asked for or not.
    attributes : Attributes, optional
        What x consists of; by default the features, pick-ups and drop-offs that the offers name.

    Returns
    -------
    Preferences
        With covariances by the delta method and the estimation results.

    Raises
    ------
    NotIdentifiedError
        A DataError: if the choices of a group do not determine its coefficients and no penalty settles it.
    DataError
        If there are no offers, a group has none, or a group's compensation makes acceptance less likely.
    InputError
        If a penalty is negative or the method unknown.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.policies.explore import RandomOffers
    >>> from optkit.learning.offer_log import collect
    >>> log = collect(scenario("I.2", seed=1).sample(200, seed=0), RandomOffers(0.3, 0.7, seed=0))
    >>> fit_preferences(log).table().query("parameter == 'mu'")["estimate"].between(0.8, 1.2).tolist()
    [True]
    """
    if not isinstance(offers, Offers):
        raise InputError(f"offers is a {type(offers).__name__}; Offers.from_frame makes offers of a table")
    number("ridge", ridge, least=0.0, most=MOST_MONEY)
    number("scale_penalty", scale_penalty, least=0.0, most=MOST_MONEY)
    one_of("method", method, ("choice", "accept-reject"))
    flag("pooled", pooled)
    flag("robust", robust)
    if not isinstance(attributes, Attributes | None):
        raise InputError(f"attributes is a {type(attributes).__name__}; give Attributes")
    if not len(offers):
        raise DataError("there are no offers to learn from")
    if attributes is None:
        attributes = Attributes(offers.names, int(offers.pickup.max()) + 1, int(offers.dropoff.max()) + 1)
    x = attributes.matrix(offers.features, offers.pickup, offers.dropoff)
    names = [*attributes.columns, "compensation"]
    design = pd.DataFrame(np.column_stack([x, offers.compensation]), columns=names)
    situation = offers.situation if method == "choice" else np.arange(len(offers))
    penalty = dict.fromkeys(names, ridge)
    penalty["compensation"] += scale_penalty
    groups = np.zeros_like(offers.group) if pooled else offers.group
    weights, scales, covariances, results = [], [], [], []
    for g in range(int(groups.max()) + 1):
        own = groups == g
        named = f"{g}" if offers.group_names is None else offers.group_names[g]
        label = "all groups" if pooled else f"group {named}"
        if not own.any():
            raise DataError(f"{label} was offered nothing: collect offers to it, or number the groups without a gap")
        clusters = None if offers.cluster is None else offers.cluster[own]
        fitted = _fit(label, offers.chosen[own], design[own], situation[own], penalty, robust, clusters)
        a, b = np.asarray(fitted.params)[:-1], float(np.asarray(fitted.params)[-1])
        if b <= 0:
            error = float(np.asarray(fitted.bse)[-1])
            raise DataError(
                f"{label}: a higher compensation makes acceptance less likely (1/mu = {b:.3g}, standard error "
                f"{error:.2g}); vary the compensations more, or look for a characteristic that is missing"
            )
        w, mu, C = from_index(a, b, np.asarray(fitted.cov_params()))
        weights.append(w)
        scales.append(mu)
        covariances.append(C)
        results.append(fitted)
    return Preferences(
        attributes, np.array(weights), np.array(scales), tuple(covariances), pooled, tuple(results), offers.group_names
    )


def _fit(
    label: str,
    chosen: Any,
    design: pd.DataFrame,
    situation: Any,
    penalty: dict[str, float],
    robust: bool,
    clusters: Any,
) -> Any:
    """Fit one model; errors and warnings say which group they are about."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            model = ConditionalLogit(chosen, design, situation, outside_option=True, penalty=penalty)
            if clusters is None:
                fitted = model.fit(cov_type="HC0" if robust else "nonrobust")
            else:
                fitted = model.fit(cov_type="cluster", cov_kwds={"groups": clusters})
        except NotIdentifiedError as error:
            remedy = str(error).replace("give penalty=", "give a ridge penalty")
            raise NotIdentifiedError(f"{label}: {remedy}", error.direction) from None
        except InputError as error:
            raise DataError(f"{label}: {error}") from None
    for one in caught:
        if issubclass(one.category, EstimationWarning):
            warnings.warn(f"{label}: {one.message}", EstimationWarning, stacklevel=3)
        else:
            warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
    return fitted


def utility_errors(
    preferences: Preferences, features: Floats, pickup: Any, dropoff: Any, truth: Floats
) -> pd.DataFrame:
    """RMSE and mean bias error of believed utilities, per group (paper appendix B.4).

    Parameters
    ----------
    preferences : Preferences
        The beliefs.
    features : (n, k) float
        Characteristics of the requests.
    pickup, dropoff : (n,) int
        Their locations.
    truth : (D, n) float
        True mean utilities less the outside utility of the group, in money.

    Returns
    -------
    DataFrame
        One row per group: ``group``, ``rmse``, ``mbe`` (money). A positive bias means that utilities are believed lower
        than they are: truth minus belief.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.learning.rounds import learn_once
    >>> days = scenario("I.1", seed=0).sample(60, seed=1)
    >>> believed, day = learn_once(days).preferences, days[0]
    >>> errors = utility_errors(believed, day.features, day.pickup, day.dropoff, day.utility)
    >>> bool(errors["rmse"].iloc[0] < 1.0)
    True
    """
    rows = []
    for group, true in enumerate(truth):
        error = true - preferences.utility_of(features, pickup, dropoff, np.array(group))
        rows.append({"group": group, "rmse": float(np.sqrt(np.mean(error**2))), "mbe": float(np.mean(error))})
    return pd.DataFrame(rows)
