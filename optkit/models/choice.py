"""Multinomial logit choice: how likely a worker takes each offer, and how likely none."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats
from optkit.models.decision import Given


def acceptance_probabilities(
    compensation: npt.ArrayLike,
    utility: npt.ArrayLike,
    mu: npt.ArrayLike = 1.0,
    *,
    outside_utility: npt.ArrayLike = 0.0,
    offered: npt.ArrayLike | None = None,
) -> tuple[Floats, Floats]:
    r"""Probabilities that a worker accepts each request, and that the worker rejects all of them.

    .. math:: P_i = \frac{e^{(u_i + c_i)/\mu}}{e^{u_0/\mu} + \sum_l e^{(u_l + c_l)/\mu}}, \qquad
              P_0 = \frac{e^{u_0/\mu}}{e^{u_0/\mu} + \sum_l e^{(u_l + c_l)/\mu}}

    Paper section 3.2, the acceptance probabilities; its print adds the outside option once per request and indexes the
    compensation in the sum by the worker, see ``docs/explanation/corrections.md``.

    Parameters
    ----------
    compensation, utility : (..., n) float
        Money; they broadcast against each other. A utility of ``-inf`` says that the worker cannot serve the request.
    mu, outside_utility : (...) float
        Noise scale (positive) and utility of rejecting, in money; one number, or one per decision.
    offered : (..., n) bool, optional
        Which requests are on offer, True or False; all by default. The others have probability 0.

    Returns
    -------
    acceptance : (..., n) float
        P_i; 0 where nothing is offered.
    rejection : (...) float
        P_0.

    Raises
    ------
    InputError
        If an entry is not finite (but for ``-inf`` in ``utility``), a ratio to mu overflows, mu is not positive, the
        mask is not made of True and False, or shapes do not fit.

    Notes
    -----
    What has labels, as pandas' Series and DataFrames have, goes by them: the same labels in another order are brought
    into that of the first argument that has any, which is that of the results; other labels are refused. Arrays and
    lists go by place.

    Examples
    --------
    >>> acceptance, rejection = acceptance_probabilities([10.0, 12.0], [-10.0, -12.0])
    >>> acceptance.round(4), rejection.round(4)
    (array([0.3333, 0.3333]), np.float64(0.3333))
    """
    seen = Given.of("compensation", compensation, utility, mu, outside_utility, offered)
    acceptance, rejection = softmax_with_outside(seen.log_odds)
    return acceptance.reshape(*seen.shape, acceptance.shape[1]), rejection.reshape(seen.shape)[()]


def softmax_with_outside(logit: Floats) -> tuple[Floats, Floats]:
    """Softmax of (S, n) log-odds against an outside option of log-odds 0: shares (S, n) and (S, 1). Never overflows."""
    top = np.maximum(logit.max(axis=1, keepdims=True, initial=0.0), 0.0)
    weight = np.exp(logit - top)
    outside = np.exp(-top)
    total = weight.sum(axis=1, keepdims=True) + outside
    return weight / total, outside / total
