"""The first-in first-out queue in which workers wait to be seen."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Ints, ints
from optkit.basics.errors import InstanceError


def fifo_queue(arrival: npt.ArrayLike, horizon: int) -> tuple[Ints, Ints]:
    """Line workers up: one is seen per step, in order of arrival, and stays for that step only (paper section 2.2).

    Parameters
    ----------
    arrival : (J,) int, non-decreasing
        The step at which each worker joins the queue.
    horizon : int
        Number of steps; workers whose turn does not come before it are not served.

    Returns
    -------
    step, served : (S,) int
        The step at which each served worker is seen, strictly increasing, and the worker's position in ``arrival``.

    Raises
    ------
    InstanceError
        If arrivals are not whole numbers in order.

    Examples
    --------
    >>> fifo_queue([0, 0, 0, 5], horizon=6)
    (array([0, 1, 2, 5]), array([0, 1, 2, 3]))
    """
    joined = ints("arrival", arrival, (None,), error=InstanceError)
    if (np.diff(joined) < 0).any():
        j = int((np.diff(joined) < 0).argmax()) + 1
        raise InstanceError(f"arrival[{j}] = {joined[j]} comes before arrival[{j - 1}]: sort the workers by arrival")
    place = np.arange(joined.size)
    # Worker j is seen at max(joined_j, seen_{j-1} + 1), so seen_j - j is the running maximum of joined_j - j.
    seen = np.maximum.accumulate(joined - place) + place if joined.size else joined
    served = np.flatnonzero(seen < horizon)
    return seen[served], served


def busy_steps(seen: Bools) -> Ints:
    """For how many steps, up to and with each, a worker has been seen without a break, (T, B).

    Parameters
    ----------
    seen : (T, B) bool
        Whether a worker is seen at each step.

    Examples
    --------
    >>> busy_steps(np.array([[True], [True], [False], [True]])).ravel().tolist()
    [1, 2, 0, 1]
    """
    step = np.arange(1, len(seen) + 1)[:, None]
    idle = np.where(seen, 0, step)
    return np.asarray(step - np.maximum.accumulate(idle, axis=0) if len(seen) else np.zeros(seen.shape, dtype=np.int64))
