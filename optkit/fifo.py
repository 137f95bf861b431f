"""The first-in first-out queue in which workers wait to be seen."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from optkit.arrays import Ints, ints
from optkit.errors import InstanceError


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
    joined = ints("arrival", arrival, (np.size(arrival),))
    if (np.diff(joined) < 0).any():
        j = int((np.diff(joined) < 0).argmax()) + 1
        raise InstanceError(f"arrival[{j}] = {joined[j]} comes before arrival[{j - 1}]: sort the workers by arrival")
    place = np.arange(joined.size)
    # Worker j is seen at max(joined_j, seen_{j-1} + 1), so seen_j - j is the running maximum of joined_j - j.
    seen = np.maximum.accumulate(joined - place) + place if joined.size else joined
    served = np.flatnonzero(seen < horizon)
    return seen[served], served
