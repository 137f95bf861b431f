"""Whether instances come from the process that a penalised bound charges by: all tests, and what to say of them."""

from __future__ import annotations

from collections.abc import Sequence

from optkit.bounds.penalised.foresight import Foresight
from optkit.gap.request_tests import request_test
from optkit.gap.worker_tests import worker_test
from optkit.instances.instance import Instance
from optkit.learning.worker_rates import WorkerRates

OTHERS = 200
"""Other days that are tested on, at most: it takes seconds."""


def process_tests(
    instances: Sequence[Instance],
    foresight: Foresight,
    *,
    learned: WorkerRates | None = None,
    others: Sequence[Instance] = (),
    seed: int = 0,
) -> tuple[list[str], list[str]]:
    """Test workers, and requests if they are charged for, on the instances that are to be bounded.

    Parameters
    ----------
    instances : sequence of Instance
        Nothing of the foresight may have been made from them.
    foresight : Foresight
        The process.
    learned : WorkerRates, optional
        As in :func:`~optkit.gap.worker_tests.worker_test`.
    others : sequence of Instance
        Other days of which nothing of the foresight was made, and which are said to be alike: what is given, not
        learned, is tested on the first :data:`OTHERS` of them too, so that few days that are bounded hide no wrong
        rate.
    seed : int
        Of the days that are drawn.

    Returns
    -------
    refused, told : list of str
        What the instances contradict, a line each with the remedy: no penalised bound may be made. And what they were
        tested for and do not contradict.

    Examples
    --------
    >>> import numpy as np
    >>> from optkit import scenario
    >>> from optkit.bounds.penalised.foresight import fifo_presence
    >>> days = scenario("I.2", seed=0).sample(20, seed=1)
    >>> process_tests(days, Foresight(fifo_presence(0.5), np.ones(1)))[0]
    []
    """
    refused, told = [], []
    instances = [*instances, *others[:OTHERS]]
    workers = worker_test(instances, foresight, learned=learned, seed=seed)
    if workers.contradicted:
        remedy = (
            "take rates by time of day learned from other days (--worker-rate learned; optkit.learning.worker_rates)"
            if learned is None
            else "take more days to learn from, of the same kind (--train)"
        )
        refused.append(
            f"workers do not come as was assumed, {workers.told} (p = {workers.p:.3f}): "
            f"{remedy}, or leave that bound out"
        )
    else:
        told.append(f"workers: tested by time of day, busy stretch and spread, not contradicted (p = {workers.p:.2f})")
    requests = request_test(instances, foresight, seed=seed)
    if requests is not None and requests.contradicted:
        refused.append(
            f"requests do not arrive as was assumed, {requests.told} (p = {requests.p:.3f}): charge for workers alone "
            "(--worker-rate; optkit.gap.charging.worker_charging), or leave that bound out"
        )
    elif requests is not None:
        told.append(f"requests: tested by number, time, kind and place, not contradicted (p = {requests.p:.2f})")
    return refused, told
