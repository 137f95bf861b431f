"""How likely the next worker is, given for how long workers have come without a break.

Workers queue and one is seen per step, so a busy stretch tells that the queue may be long: in scenario I.1 another
worker follows an idle step with probability 0.39, and eight busy ones with 0.72.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from optkit.basics.arrays import Bools, Floats, read_only
from optkit.instances.queue import busy_steps

LONGEST = 12
"""Busy steps beyond which all stretches count alike."""


def presence_after(seen: Bools, within: Bools | None = None) -> Floats:
    """Probability of a worker at each step after 0, 1, ..., :data:`LONGEST` busy steps, (T, LONGEST + 1).

    A logistic regression on the step and the length of the busy stretch, with half the squares of all coefficients but
    the intercept as a penalty: what few instances have shown is drawn to what all have.

    Parameters
    ----------
    seen : (T, B) bool
        Whether a worker is seen at each step of B instances.
    within : (T, B) bool, optional
        Which steps lie within each instance's horizon; all by default. What lies beyond says nothing of workers.

    Examples
    --------
    >>> presence_after(np.ones((3, 2), bool))[2]
    array([1., 1., 1., 1., 1., 1., 1., 1., 1., 1., 1., 1., 1.])
    """
    T, B = seen.shape
    inside = np.ones(seen.shape, dtype=bool) if within is None else within
    share = float(seen[inside].mean()) if inside.any() else 0.0
    table = np.full((T, LONGEST + 1), share)
    if share in (0.0, 1.0):
        return table
    before = np.concatenate([np.zeros((1, B), np.int64), np.minimum(busy_steps(seen), LONGEST)[:-1]])
    cell = np.arange(T)[:, None] * (LONGEST + 1) + before
    count = np.stack([np.bincount(cell[(seen == one) & inside], minlength=table.size) for one in (False, True)])
    return _fitted(count.astype(float).tobytes())


@lru_cache(maxsize=32)
def _fitted(counted: bytes) -> Floats:
    """Fit the regression to how often no worker and one came, by step and busy stretch, (2, T, LONGEST + 1) floats.

    It is kept, as all rounds and seeds of a training see the same workers. The same program, start and precision as
    ``sklearn.linear_model.LogisticRegression``, which takes two seconds to load.
    """
    from scipy.optimize import minimize
    from scipy.special import expit

    absent, present = np.frombuffer(counted).reshape(2, -1, LONGEST + 1)
    T = len(absent)
    total = float(absent.sum() + present.sum())

    def score(w: Floats) -> Floats:
        return np.asarray(w[:T, None] + w[T:-1] + w[-1])

    def loss(w: Floats) -> tuple[float, Floats]:
        x, slopes = score(w), w[:-1]
        pointwise = present * np.logaddexp(0.0, -x) + absent * np.logaddexp(0.0, x)
        excess = (absent + present) * expit(x) - present
        gradient = np.concatenate([excess.sum(axis=1), excess.sum(axis=0), [excess.sum()]])
        gradient[:-1] += slopes
        return (float(pointwise.sum()) + 0.5 * float(slopes @ slopes)) / total, gradient / total

    found = minimize(
        loss,
        np.zeros(T + LONGEST + 2),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": 1000, "maxls": 50, "gtol": 1e-4, "ftol": 64 * np.finfo(float).eps},
    )
    return read_only(np.asarray(expit(score(found.x))))
