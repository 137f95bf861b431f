"""Standard errors that hold where choices depend on each other, or the model is not quite right."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from optkit.basics.arrays import Floats, Ints, flag
from optkit.basics.errors import InputError
from optkit.models.estimation.choices import ChoiceData
from optkit.models.estimation.identification import EstimationWarning
from optkit.models.estimation.likelihood import Likelihood, informative
from optkit.models.estimation.situations import label

FEW_CLUSTERS = 20
"""Clusters below which clustered standard errors, which are asymptotic in their number, are doubtful."""


@dataclass(frozen=True)
class Sandwich:
    """Which choices may depend on each other.

    Attributes
    ----------
    cov_type : str
        "HC0": each situation by itself; or "cluster".
    cluster : (S,) int or None
        Cluster of each situation that carries information.
    use_correction : bool
        Multiply by ``G / (G - 1) * (N - 1) / (N - k)``, with G clusters, N situations and k coefficients.
    """

    cov_type: str
    cluster: Ints | None = None
    use_correction: bool = False

    @property
    def n_clusters(self) -> int:
        """Number of clusters, G."""
        return 0 if self.cluster is None else int(self.cluster.max()) + 1

    @property
    def description(self) -> str:
        """One line that says what the standard errors are."""
        if self.cluster is None:
            return "Sandwich, with the situations as observations."
        corrected = "with" if self.use_correction else "without"
        return f"Sandwich of {self.n_clusters} clusters, {corrected} the small-sample correction."

    def covariance(self, likelihood: Likelihood, inverse: Floats, share: Floats) -> Floats:
        """Return the covariance of the estimate, (k, k).

        Parameters
        ----------
        likelihood : Likelihood
        inverse : (k, k) float
            Inverse of the information, the penalty's included.
        share : (p,) float
            Probability of every rival at the estimate.
        """
        scores = likelihood.scores(share)
        weighted = scores if likelihood.weights is None else scores * likelihood.weights[:, None]
        if self.cluster is None:
            return np.asarray(inverse @ (scores.T @ weighted) @ inverse)
        factor, G, N, k = 1.0, self.n_clusters, likelihood.total, scores.shape[1]
        sums = np.zeros((G, k))
        np.add.at(sums, self.cluster, weighted)
        if self.use_correction:
            factor = G / (G - 1.0) * (N - 1.0) / (N - k)
        return np.asarray(factor * (inverse @ (sums.T @ sums) @ inverse))


def sandwich_of(cov_type: str, kwds: Any, data: ChoiceData, likelihood: Likelihood, frame: Any) -> Sandwich | None:
    """Return what ``cov_type`` and ``cov_kwds`` of a fit ask for; None for the inverse information alone.

    ``frame`` holds the columns that a formula's arguments may be.

    Raises
    ------
    InputError
        If they do not fit together, a situation has two clusters or none, or there are too few of anything.
    """
    if not isinstance(kwds, Mapping | None):
        raise InputError(f"cov_kwds is a {type(kwds).__name__}; give a dict such as {{'groups': workers}}")
    kwds = dict(kwds or {})
    known = ("groups", "use_correction") if cov_type == "cluster" else ()
    if unknown := [key for key in kwds if key not in known]:
        raise InputError(f"cov_kwds has {unknown[0]!r}, which cov_type = {cov_type!r} does not know")
    if cov_type != "cluster":
        return None if cov_type == "nonrobust" else Sandwich("HC0")
    groups = kwds.get("groups")
    if groups is None:
        raise InputError("cov_type = 'cluster' needs cov_kwds = {'groups': ...}: the cluster of each row or situation")
    if isinstance(groups, str):
        if frame is None or groups not in frame:
            raise InputError(f"the clusters' {groups!r} is not a column of the data of a formula")
        groups = frame[groups]
    each = data.situations.each("the clusters", groups)[informative(data)]
    try:
        cluster, _ = pd.factorize(each)
    except (TypeError, NotImplementedError) as error:
        raise InputError(f"the clusters cannot serve as labels: {error}") from None
    if (cluster < 0).any():
        which = label(data.labels[informative(data)], (cluster < 0).argmax())
        raise InputError(f"the cluster of situation {which} is missing; give one to each")
    found = Sandwich("cluster", cluster, flag("use_correction", kwds.get("use_correction", True)))
    k = likelihood.rivals.shape[1]
    if found.n_clusters < 2:
        raise InputError("all situations are in one cluster, which says nothing about how clusters differ; give two")
    if found.use_correction and likelihood.total <= k:
        raise InputError(f"{likelihood.total:g} situations are too few to correct for {k} coefficients")
    if found.n_clusters < FEW_CLUSTERS:
        warnings.warn(
            f"{found.n_clusters} clusters are few; clustered standard errors are asymptotic in the number of clusters, "
            f"and doubtful below {FEW_CLUSTERS}",
            EstimationWarning,
            stacklevel=3,
        )
    return found
