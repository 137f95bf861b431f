"""How likely the next worker is, given for how long workers have come without a break.

Workers queue and one is seen per step, so a busy stretch tells that the queue may be long: in scenario I.1 another
worker follows an idle step with probability 0.39, and eight busy ones with 0.72.
"""

from __future__ import annotations

import numpy as np

from optkit.basics.arrays import Bools, Floats
from optkit.instances.queue import busy_steps

LONGEST = 12
"""Busy steps beyond which all stretches count alike."""


def presence_after(seen: Bools, within: Bools | None = None) -> Floats:
    """Probability of a worker at each step after 0, 1, ..., :data:`LONGEST` busy steps, (T, LONGEST + 1).

    A logistic regression on the step and the length of the busy stretch, with scikit-learn's default penalty: what few
    instances have shown is drawn to what all have.

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
    from scipy import sparse

    T, B = seen.shape
    inside = np.ones(seen.shape, dtype=bool) if within is None else within
    share = float(seen[inside].mean()) if inside.any() else 0.0
    table = np.full((T, LONGEST + 1), share)
    if share in (0.0, 1.0):
        return table
    before = np.concatenate([np.zeros((1, B), np.int64), np.minimum(busy_steps(seen), LONGEST)[:-1]])
    cell = np.arange(T)[:, None] * (LONGEST + 1) + before
    count = np.stack([np.bincount(cell[(seen == one) & inside], minlength=table.size) for one in (False, True)])
    from sklearn.linear_model import LogisticRegression

    # Two sets of indicators side by side: of the step, and of the busy stretch.
    steps = sparse.kron(sparse.eye_array(T), np.ones((LONGEST + 1, 1)))
    stretch = sparse.kron(np.ones((T, 1)), sparse.eye_array(LONGEST + 1))
    x = sparse.hstack([steps, stretch]).tocsr()
    model = LogisticRegression(max_iter=1000)
    y = np.repeat([0, 1], table.size)
    model.fit(sparse.vstack([x, x]).tocsr(), y, sample_weight=count.ravel())
    return np.asarray(model.predict_proba(x)[:, 1].reshape(table.shape))
