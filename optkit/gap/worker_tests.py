"""Whether workers come as a penalised bound assumes: tested on the very days that are bounded.

Given what was seen, a worker comes with a known probability if the process is the one assumed, so that what is seen
less what was foretold adds up to little, however steps are picked by what was known before them: by time of day, by how
long workers have come or stayed away, by how many requests wait. Sums over days, and over parts of days, vary as
much as the probabilities say: more where rates change from day to day or workers come in bursts, less where they come
by timetable. All of it is compared with days that are drawn from the process (:mod:`optkit.gap.simulated_test`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.basics.seeds import Stream, stream
from optkit.bounds.penalised.foresight import Foresight
from optkit.gap.simulated_test import DRAWS, ProcessTest, stands_out
from optkit.instances.instance import Instance
from optkit.learning.worker_rates import WorkerRates

PARTS = (1, 4, 12)
"""Parts of the day, in which numbers are compared at once: a steady error, a rush, a short one."""

STRETCHES = (1, 2, 3, 5, 9)
"""Where a class of busy stretches begins, and of idle ones."""

CHUNK = 1 << 17
"""Days simulated at once."""

NAMES = (
    *(f"by time of day (parts: {parts})" if parts > 1 else "in all" for parts in PARTS),
    "by how long workers have come or stayed away",
    "by how many requests wait",
    "in their numbers from day to day",
    "in their numbers from one part of a day to another",
)
"""What the statistics compare."""

Draw = Callable[[int, Floats], Bools]
"""Who is seen at a step, (R, n), where the probability of a worker is (R, n)."""


@dataclass(frozen=True, eq=False)
class SeenWorkers:
    """Workers of n days, T steps at most.

    Attributes
    ----------
    group : (n, T) int
        Group of the worker who was seen at each step, -1 for none.
    within : (n, T) bool
        Which steps lie within each day's horizon.
    waiting : (n, T) int
        Class of the number of requests that may be waiting, among the days at the same step: 0 few, 1, 2 many.
    """

    group: Ints
    within: Bools
    waiting: Ints

    @classmethod
    def of(cls, instances: Sequence[Instance]) -> SeenWorkers:
        """Collect them; InstanceError if a day is too long to be gone through."""
        n, T = len(instances), max(one.steps for one in instances)
        group, waiting = np.full((n, T), -1), np.zeros((n, T + 1))
        for b, one in enumerate(instances):
            group[b, one.worker_step] = one.worker_group
            np.add.at(waiting[b], one.arrival, 1.0)
            np.add.at(waiting[b], one.expiry + 1, -1.0)
        open_ = waiting.cumsum(axis=1)[:, :T]
        share = (open_.argsort(axis=0, kind="stable").argsort(axis=0) + 0.5) / n  # ties in the order of the days
        within = np.arange(T) < np.array([one.horizon for one in instances])[:, None]
        return cls(group, within, np.digitize(share, [1 / 3, 2 / 3]))


def worker_test(
    instances: Sequence[Instance], foresight: Foresight, *, learned: WorkerRates | None = None, seed: int = 0
) -> ProcessTest:
    """Test whether instances' workers come, and are of the groups, that a foresight foretells.

    Parameters
    ----------
    instances : sequence of Instance
        The days that are bounded; nothing of the foresight may have been made from them.
    foresight : Foresight
        Its ``presence`` and ``share`` are tested.
    learned : WorkerRates, optional
        What they were made from, if they were learned: days are then drawn by rates and shares that might be the true
        ones, so that what few days could teach is not held against the others.
    seed : int
        Of the days that are drawn.

    Returns
    -------
    ProcessTest
        Contradicted at :data:`optkit.gap.simulated_test.LEVEL`.

    Raises
    ------
    InputError
        If the foresight does not fit the instances.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.penalised.foresight import fifo_presence
    >>> days = scenario("I.2", seed=0).sample(20, seed=1)
    >>> [worker_test(days, Foresight(fifo_presence(rate), [1.0])).contradicted for rate in (0.4, 0.5)]
    [True, False]
    """
    for one in instances:
        foresight.of_workers(one)  # does it know the groups and the steps?
    seen = SeenWorkers.of(instances)
    rng = np.random.default_rng(stream(seed, Stream.PROCESS_TESTS, 0))
    present = seen.group >= 0
    observed = _statistics(seen, foresight, 1, lambda step, p: present[None, :, step])[0]
    size = max(1, CHUNK // len(instances))
    simulated = []
    for start in range(0, DRAWS, size):
        runs = min(size, DRAWS - start)
        draw = _by_table(rng) if learned is None else _by_queue(learned.draw(runs, rng), len(instances), rng)
        simulated.append(_statistics(seen, foresight, runs, draw))
    p, worst = stands_out(observed, np.vstack(simulated), [name.startswith("in their") for name in NAMES])
    told = f"{NAMES[worst]}: {_numbers(seen, foresight)}"
    if foresight.share.size > 1:
        # Shares that were given, not learned, are the assumption itself: nothing excuses what is seen of them.
        taught = learned if learned is not None and np.array_equal(foresight.share, learned.share) else None
        of_groups = _group_p(seen, foresight.share, taught, rng)
        # Two tests share the level.
        p, told = (2 * p, told) if p <= of_groups else (2 * of_groups, _groups_told(seen, foresight.share))
    return ProcessTest(min(p, 1.0), told)


def _by_table(rng: np.random.Generator) -> Draw:
    """Draw who is seen with the probabilities that are foretold."""
    return lambda step, p: rng.random(p.shape) < p


def _by_queue(rates: Floats, days: int, rng: np.random.Generator) -> Draw:
    """Draw who is seen of a queue that Poisson workers join at rates of its own in each run, (R, T)."""
    waiting = np.zeros((len(rates), days), np.int64)

    def draw(step: int, p: Floats) -> Bools:
        nonlocal waiting
        waiting += rng.poisson(rates[:, step, None], waiting.shape)
        came = waiting > 0
        waiting -= came
        return came

    return draw


def _statistics(seen: SeenWorkers, foresight: Foresight, runs: int, draw: Draw) -> Floats:
    """Return the statistics of ``runs`` times all days, (runs, len(NAMES)); who is seen is what ``draw`` says."""
    n, T = seen.within.shape
    cells = 2 * len(STRETCHES) + 1
    busy, idle = np.zeros((runs, n), np.int64), np.zeros((runs, n), np.int64)
    steps = {parts: np.arange(T) * min(parts, T) // T for parts in PARTS}
    by_time = {parts: np.zeros((2, runs, min(parts, T))) for parts in PARTS}
    by_stretch, by_requests = np.zeros((2, runs, cells)), np.zeros((2, runs, 3))
    day, part = np.zeros((2, runs, n)), np.zeros((2, runs, n))
    squares, variances, impossible = np.zeros((2, runs)), np.zeros((2, runs)), np.zeros(runs, bool)
    row = np.arange(runs)[:, None] * cells
    for step in range(T):
        p = foresight.presence_after(np.full(busy.shape, step), busy) * seen.within[:, step]
        came = draw(step, p) & seen.within[:, step]
        less, spread = came - p, p * (1.0 - p)
        impossible |= ((spread == 0) & (less != 0)).any(axis=1)
        classes = np.digitize(busy, STRETCHES) + np.where(idle > 0, len(STRETCHES) + np.digitize(idle, STRETCHES), 0)
        among = np.eye(3)[seen.waiting[:, step]]
        for k, x in enumerate((less, spread)):
            for parts in PARTS:
                by_time[parts][k, :, steps[parts][step]] += x.sum(axis=1)
            by_stretch[k] += np.bincount((row + classes).ravel(), x.ravel(), runs * cells).reshape(runs, cells)
            by_requests[k] += x @ among
            part[k] += x
        if step == T - 1 or steps[PARTS[-1]][step + 1] != steps[PARTS[-1]][step]:
            squares[1] += (part[0] ** 2).sum(axis=1)
            variances[1] += part[1].sum(axis=1)
            day += part
            part[:] = 0.0
        busy, idle = np.where(came, busy + 1, 0), np.where(came, 0, idle + 1)
    squares[0], variances[0] = (day[0] ** 2).sum(axis=1), day[1].sum(axis=1)
    found = [_chi_square(*sums) for sums in (*by_time.values(), by_stretch, by_requests)]
    found += [squares[k] / np.maximum(variances[k], 1e-12) for k in (0, 1)]
    # Cube roots of sums of squares are nearly normal (Wilson and Hilferty), so that none outweighs the others.
    return np.asarray(np.where(impossible[:, None], np.inf, np.cbrt(np.column_stack(found))))


def _chi_square(less: Floats, spread: Floats) -> Floats:
    """Pearson's statistic over cells; a cell where next to nothing can happen says next to nothing."""
    return np.asarray((less**2 / np.maximum(spread, 1.0)).sum(axis=-1))


def _numbers(seen: SeenWorkers, foresight: Foresight) -> str:
    """Tell the part of the day, of four, in which most is amiss."""
    n, T = seen.within.shape
    came = (seen.group >= 0) & seen.within
    before = np.zeros(n, np.int64)
    p = np.zeros((n, T))
    for step in range(T):
        p[:, step] = foresight.presence_after(np.full(n, step), before) * seen.within[:, step]
        before = np.where(came[:, step], before + 1, 0)
    part = np.arange(T) * min(PARTS[1], T) // T
    sums = np.array([[x[:, part == b].sum() for b in range(part[-1] + 1)] for x in (came, p, p * (1.0 - p))])
    worst = int((np.abs(sums[0] - sums[1]) / np.sqrt(np.maximum(sums[2], 1.0))).argmax())
    where = np.flatnonzero(part == worst)
    return f"steps {where[0]} to {where[-1]} saw {sums[0, worst]:.0f} workers, {sums[1, worst]:.0f} foretold"


def _group_p(seen: SeenWorkers, share: Floats, learned: WorkerRates | None, rng: np.random.Generator) -> float:
    """P-value of the groups of those who were seen, given how many there were in each part of each day."""
    n, T = seen.within.shape
    part = np.arange(T) * min(PARTS[1], T) // T
    windows = part[-1] + 1
    counts = np.zeros((n, windows, share.size))
    for g in range(share.size):
        for b in range(windows):
            counts[:, b, g] = (seen.group[:, part == b] == g).sum(axis=1)
    total = counts.sum(axis=2).astype(np.int64)
    if (counts[..., share == 0] > 0).any():
        return 0.0
    drawn = []
    for start in range(0, DRAWS, max(1, CHUNK // total.size)):
        runs = min(max(1, CHUNK // total.size), DRAWS - start)
        might = share[None] if learned is None else rng.dirichlet(learned.group_count, runs)
        of_groups = rng.multinomial(total, might[:, None, None], size=(runs, *total.shape))
        drawn.append(_group_statistics(of_groups, share))
    return stands_out(_group_statistics(counts[None], share)[0], np.vstack(drawn), [False, False, True])[0]


def _group_statistics(counts: npt.NDArray[np.number], share: Floats) -> Floats:
    """Chi-squares of groups in all, by part of the day, and by day, (R, 3)."""
    found = []
    for axes in ((1, 2), (1,), (2,)):
        have = counts.sum(axis=axes)[..., share > 0]
        want = have.sum(axis=-1, keepdims=True) * share[share > 0]
        found.append(((have - want) ** 2 / np.maximum(want, 1e-12)).reshape(len(counts), -1).sum(axis=1))
    return np.asarray(np.cbrt(np.column_stack(found)))


def _groups_told(seen: SeenWorkers, share: Floats) -> str:
    came = seen.group[seen.group >= 0]
    have = np.bincount(came, minlength=share.size) / max(came.size, 1)
    return (
        f"by group: shares of {', '.join(f'{s:.2f}' for s in have)} were seen, "
        f"{', '.join(f'{s:.2f}' for s in share)} foretold"
    )
