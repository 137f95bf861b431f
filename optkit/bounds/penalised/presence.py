r"""How likely a worker is at each step of a first-in first-out queue that nobody sees, given who was seen before.

Workers join by Poisson draws and queue; one is seen a step, and leaves (paper section 2.2). A step without a worker
shows that the queue is empty, so all that the past tells is for how many steps in a row a worker has been seen. With
the queue started empty at step :math:`t - k` and :math:`f_j` the distribution of its length after j steps that each saw
a worker,

.. math:: p(t, k) = 1 - f_k(0)\, e^{-\lambda_t}, \qquad
          f_{j+1}(q) = \frac{\sum_i f_j(q + 1 - i)\, \pi_i(\lambda_{t-k+j})}{p(t - k + j, j)},

with pi the Poisson probabilities: convolutions, each with the rate of its own step.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, check_memory, floats, whole_number
from optkit.basics.errors import InputError

CERTAIN = 40.0
"""Workers who join in a step, in the mean, beyond which one is there for sure: exp(-40) is less than rounding."""

LONGEST = 250
"""Busy stretch that is told apart from longer ones."""

LARGEST = 2_000
"""Steps of a day whose rates change: the table has a row and a column for each, and takes a minute at so many."""

MOST = 100_000
"""Busy steps that a table may tell apart: their number squared is its work, minutes at so many."""

NOTHING = 1e-40
"""Probability below which a number of workers is left out of a table: far beneath any stretch that ever happens."""


def fifo_presence(rate: npt.ArrayLike, longest: int | None = None) -> Floats:
    """Probability of a worker after k steps in a row that saw one, if Poisson(rate) join a queue each step.

    Parameters
    ----------
    rate : float, or (T,) float
        Mean number of workers who join the queue in a step; one for each step of the day where it changes.
    longest : int, optional
        Stretch beyond which the last probability is used; :data:`LONGEST` by default for one rate, and the day's length
        for one a step, where nothing is ever beyond it. From the horizon on it is never used, and nothing is amiss; the
        probabilities converge slowly, at rate 0.75 from 0.944 after 60 steps to 0.958 after 250.

    Returns
    -------
    (longest + 1,) or (T, longest + 1) float
        Entry k, of each step's row, is the probability after k steps in a row that saw a worker, and an idle one or
        the day's beginning before them. A row's last attainable entry stands for longer stretches, which cannot be.

    Raises
    ------
    InputError
        If a rate is negative or not finite, there is none, ``longest`` is no whole number from 0 to 100,000, or
        rates change over more than 2,000 steps.

    Examples
    --------
    >>> fifo_presence(0.5, 3).round(3)
    array([0.393, 0.533, 0.601, 0.642])
    >>> fifo_presence([0.1, 0.1, 0.9]).round(3)
    array([[0.095, 0.095, 0.095],
           [0.095, 0.14 , 0.14 ],
           [0.593, 0.613, 0.624]])
    """
    rates = checked_rates(rate)
    if rates.size > LARGEST:
        raise InputError(f"rates change over {rates.size} steps, more than {LARGEST}: take longer steps, or one rate")
    if longest is None:
        longest = max(LONGEST, rates.size) if rates.ndim == 0 else rates.size - 1
    longest = whole_number("longest", longest, least=0, most=MOST)
    rows = rates.size if rates.ndim else 1
    # Under rates that change the longest row ends with the day: the others are filled up with it.
    check_memory("the table of a queue", 32.0 * rows * (longest + 1), "give a smaller longest")
    if rates.ndim == 0:
        if rates > CERTAIN:
            return np.ones(longest + 1)
        return np.asarray(_after_busy_steps(np.full((1, longest + 1), float(rates)))[0])
    T, most = rates.size, min(longest, rates.size - 1)
    if (rates == rates[0]).all():
        return np.array(np.broadcast_to(fifo_presence(rates[0], longest), (T, longest + 1)))
    # Row s: what a queue that is empty before step s meets; beyond the day whatever, for nobody looks.
    meets = np.minimum(np.arange(T)[:, None] + np.arange(most + 1), T - 1)
    found = _after_busy_steps(rates[meets])
    step, stretch = np.arange(T)[:, None], np.arange(longest + 1)
    attained = np.minimum(stretch, np.minimum(step, most))
    return np.asarray(found[step - attained, attained])


def presence_at(rate: npt.ArrayLike, horizon: int | None = None) -> Floats:
    """Probability that a worker is seen at each step of a day, (T,), whatever happened before.

    Parameters
    ----------
    rate : float, or (T,) float
        As in :func:`fifo_presence`.
    horizon : int, optional
        Length of the day, needed where there is one rate for all of it.

    Examples
    --------
    >>> presence_at(0.5, 4).round(3)
    array([0.393, 0.448, 0.47 , 0.481])
    """
    rates = checked_rates(rate)
    steps = rates.size if horizon is None else horizon
    after = np.broadcast_to(fifo_presence(rates, max(steps - 1, 0)), (steps, max(steps, 1)))
    seen, stretch = np.zeros(steps), np.ones(1)  # stretch: of the busy steps before, its distribution
    for step in range(steps):
        busy = stretch * after[step, : stretch.size]
        seen[step] = busy.sum()
        stretch = np.append((stretch - busy).sum(), busy)
    return seen


def checked_rates(rate: npt.ArrayLike) -> Floats:
    """Return a rate, or one for each step, or raise an InputError that names the first that is none."""
    rates = floats("rate", rate, None)
    if rates.ndim > 1 or not rates.size:
        raise InputError(f"rate has shape {rates.shape}: give one number, or one for each step of the day")
    if (rates < 0).any():
        i = int((rates < 0).argmax())
        place = f"rate[{i}]" if rates.ndim else "rate"
        raise InputError(f"{place} = {rates.ravel()[i]:g} must be a finite number of at least 0: workers a step")
    return rates


def _after_busy_steps(rates: Floats) -> Floats:
    """Return p of each start (row) and stretch (column), where the queue that began empty there meets ``rates``.

    Of several rows, row s is looked at as far as the day goes, and column k no further than the rows but the last k.
    """
    rows, steps = rates.shape
    # One row is cheap, and exact for stretches that never happen, too.
    nothing, highest = (0.0, float(rates.sum())) if rows == 1 else (NOTHING, float(rates.max()))
    most = int(np.ceil(highest + 12.0 * np.sqrt(highest) + 20))
    found, length = np.zeros(rates.shape), np.ones((rows, 1))
    # A day has few rates, and each is met in many places.
    distinct, which = np.unique(rates, return_inverse=True)
    joins, which = _poisson(distinct, most), which.reshape(rates.shape)
    for k in range(steps):
        length = length[: max(rows - k, 1)]
        join = joins[which[: len(length), k]]
        joined = _joined(length, join[:, : _last_above(join, nothing)])
        # Whoever has as many before him as there are steps left is never seen: those may be lumped together.
        joined = np.column_stack([joined[:, : steps - k], joined[:, steps - k :].sum(axis=1)])
        total, busy = joined.sum(axis=1), joined[:, 1:].sum(axis=1)
        found[: len(length), k] = np.where(busy > 0, 1.0 - joined[:, 0] / total, 0.0)
        # After a stretch that cannot be, anything may follow: an empty queue is as good as any.
        length = np.where(busy[:, None] > 0, joined[:, 1:], np.eye(1, joined.shape[1] - 1))
        length /= length.sum(axis=1)[:, None]
        length = length[:, : _last_above(length, nothing)]
    return found


def _joined(length: Floats, join: Floats) -> Floats:
    """Distribution of the sum of two independent numbers, row by row."""
    if len(length) == 1:
        return np.convolve(length[0], join[0])[None]
    total = np.zeros((len(length), length.shape[1] + join.shape[1] - 1))
    for i in range(min(length.shape[1], join.shape[1])):
        if join.shape[1] < length.shape[1]:
            total[:, i : i + length.shape[1]] += join[:, i : i + 1] * length
        else:
            total[:, i : i + join.shape[1]] += length[:, i : i + 1] * join
    return total


def _poisson(rate: Floats, most: int) -> Floats:
    """Probabilities of 0, 1, ..., ``most`` who join at each rate, (rates, most + 1)."""
    from scipy.special import gammaln, xlogy  # scipy.stats says the same, and takes half a second to load

    k, mean = np.arange(most + 1), rate[:, None]
    return np.asarray(np.exp(xlogy(k, mean) - gammaln(k + 1) - mean))


def _last_above(table: Floats, nothing: float) -> int:
    """Number of columns up to the last in which some row has more than nothing."""
    return int((table.max(axis=0) > nothing).nonzero()[0].max(initial=0)) + 1
