"""Whether instances come from the process that a penalised bound charges by: all tests, and what to say of them."""

from __future__ import annotations

from collections.abc import Sequence

from optkit.bounds.penalised.foresight import Foresight
from optkit.gap.worker_tests import worker_test
from optkit.instances.instance import Instance


def process_tests(instances: Sequence[Instance], foresight: Foresight, seed: int = 0) -> tuple[list[str], list[str]]:
    """Test workers on the instances that are to be bounded.

    Parameters
    ----------
    instances : sequence of Instance
        Nothing of the foresight may have been made from them.
    foresight : Foresight
        The process.
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
    workers = worker_test(instances, foresight, seed=seed)
    if workers.contradicted:
        refused.append(
            f"workers do not come as was assumed, {workers.told} (p = {workers.p:.3f}): take rates by time of day "
            "learned from other days (--worker-rate learned; optkit.learning.worker_rates), or leave that bound out"
        )
    else:
        told.append(f"workers: tested by time of day, busy stretch and spread, not contradicted (p = {workers.p:.2f})")
    return refused, told
