"""Whether requests arrive as a penalised bound assumes: tested on the very days that are bounded.

What might have arrived is drawn from a pool of other instances. If they are of the same process, the days that are
bounded could as well be any others of the two together: how many requests a day has, when they arrive, how long they
live, what they bring and where they go is compared with as many days that are picked at random
(:mod:`optkit.gap.simulated_test`; a permutation test, exact for any sizes).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optkit.basics.arrays import Floats
from optkit.basics.seeds import Stream, stream
from optkit.bounds.penalised.foresight import Foresight
from optkit.gap.simulated_test import DRAWS, ProcessTest, stands_out
from optkit.instances.instance import Instance

PARTS = 8
"""Parts of the day in which arrivals are counted."""

PLACES = 40
"""Places told apart, of pick-up and of drop-off each; beyond, they are not looked at."""


def request_test(instances: Sequence[Instance], foresight: Foresight, *, seed: int = 0) -> ProcessTest | None:
    """Test whether instances' requests are of the process that a foresight's pool is drawn from.

    Parameters
    ----------
    instances : sequence of Instance
        The days that are bounded; the pool must hold none of them.
    foresight : Foresight
        Its ``arrivals`` are tested.
    seed : int
        Of the days that are picked.

    Returns
    -------
    ProcessTest or None
        None where no arrivals are charged for: nothing is assumed of them.

    Examples
    --------
    >>> from optkit import scenario
    >>> pool = Foresight([0.5], [1.0], scenario("I.2", seed=0).sample(200, seed=1))
    >>> same, busier = scenario("I.2", seed=0).sample(20, seed=2), scenario("I.1", seed=0).sample(20, seed=2)
    >>> [request_test(days, pool).contradicted for days in (same, busier)]
    [False, True]
    """
    if not foresight.arrivals:
        return None
    form, other = ({(one.horizon, one.features.shape[1]) for one in some} for some in (instances, foresight.arrivals))
    if form != other:
        return ProcessTest(0.0, f"steps and features are {sorted(form)}, those of the pool {sorted(other)}")
    rng = np.random.default_rng(stream(seed, Stream.PROCESS_TESTS, 1))
    own, pool = _sums(instances), _sums(foresight.arrivals)
    n, every, weight = len(own), len(pool), foresight.weight
    both = np.vstack([own, pool])
    # Where the pool is not all that can be, the days are among what might have been picked.
    law = np.full(n + every, 1.0 / (n + every)) if weight is None else np.concatenate([np.zeros(n), weight])
    # Number apart, sums are compared with what as many requests would add up to.
    each = law @ both / max(float(law @ both[:, 0]), 1e-300)
    both[:, 1:] -= both[:, :1] * each[1:]
    centre = law @ both
    spread = np.sqrt(law @ (both - centre) ** 2)
    less = both - centre
    varies = spread > 1e-9 * (1.0 + np.abs(centre))
    impossible = ~varies & (np.abs(less) > 1e-6 * (1.0 + np.abs(centre)))
    score = np.where(varies, less / np.where(varies, spread, 1.0), np.where(impossible, np.inf, 0.0))
    groups, number = np.unique(_names(instances[0]), return_inverse=True)
    mean_of = np.eye(groups.size)[number] / np.bincount(number)

    def statistics(rows: Floats) -> Floats:
        return np.asarray(np.cbrt(np.append(rows.mean(axis=0) ** 2 @ mean_of, (rows[:, 0] ** 2).mean())))

    some = {"replace": False} if weight is None else {"p": law}
    picked = [rng.choice(law.size, n, **some) for _ in range(DRAWS)]
    with np.errstate(invalid="ignore"):
        observed = np.nan_to_num(statistics(score[:n]), nan=np.inf)
    p, worst = stands_out(
        observed, np.array([statistics(score[rows]) for rows in picked]), [False] * groups.size + [True]
    )
    if worst == groups.size or groups[worst] == "their number":
        what = "their number" if worst < groups.size else "their numbers from day to day"
        return ProcessTest(p, f"{what}: {own[:, 0].mean():.2f} a day, {centre[0]:.2f} foretold")
    worst_column = int(np.where(number == worst, np.abs(score[:n].mean(axis=0)), -1.0).argmax())
    have = own[:, worst_column].sum() / max(own[:, 0].sum(), 1.0)
    return ProcessTest(p, f"{groups[worst]}: {have:.4g} a request in the mean, {each[worst_column]:.4g} foretold")


def _names(one: Instance) -> list[str]:
    """Name what each column of the sums tells of."""
    of_each = ["how long they live", "rewards", "penalties", *["utilities"] * one.n_groups]
    of_each += ["features"] * one.features.shape[1]
    return [
        *["their number", *["the time of day"] * PARTS],
        *[name for name in of_each for _ in range(2)],
        *["places"] * 2 * PLACES,
    ]


def _sums(instances: Sequence[Instance]) -> Floats:
    """Return sums over each day's requests, (B, f), their number first."""
    rows = []
    for one in instances:
        part = np.minimum(one.arrival * PARTS // one.horizon, PARTS - 1)
        of_each = [one.expiry - one.arrival, one.reward, one.penalty, *one.utility, *one.features.T]
        places = [np.bincount(at[(at >= 0) & (at < PLACES)], minlength=PLACES) for at in (one.pickup, one.dropoff)]
        sums = [total for x in of_each for total in (x.sum(), (x**2).sum())]
        rows.append(np.concatenate([[one.n_requests], np.bincount(part, minlength=PARTS), sums, *places]))
    return np.array(rows, dtype=float)
