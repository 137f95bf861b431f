"""Any policy, asked for its offers in all subsets of the open requests at once."""

from __future__ import annotations

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints, locked
from optkit.bounds.arrival.policy_value import Offer
from optkit.instances.instance import Instance
from optkit.simulation.batch import Batch
from optkit.simulation.same_world import same_world
from optkit.simulation.simulator import Policy, offers
from optkit.simulation.state import State


def lattice_offers(instance: Instance, policy: Policy) -> Offer:
    """Return a policy's offers as :func:`optkit.bounds.arrival.policy_value.policy_value` asks for them.

    The policy is shown each subset as the simulator would show it: open requests packed to the left in order of
    arrival. Its offer must depend on nothing but what it is shown. If it draws random numbers, its value is that of
    what it drew, and right in the mean.

    Parameters
    ----------
    instance : Instance
        Its noise is not looked at, and need not be realised.
    policy : callable
        From a :class:`optkit.simulation.state.State` to compensations, as for :func:`optkit.simulate`.

    Raises
    ------
    PolicyError
        When called, if the policy fails, or its offers are not feasible.

    Examples
    --------
    >>> from optkit import scenario
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> offer = lattice_offers(day, lambda state: 0.5 * state.reward)
    >>> paid = offer(int(day.worker_step[3]), 3, np.array([2, 0]), np.array([[True, True], [False, True]]))
    >>> bool(np.allclose(paid, 0.5 * day.reward[[2, 0]] * [[1, 1], [0, 1]]))
    True
    """
    batch = Batch.of(instance if instance.noise is not None else instance.with_noise(0))

    def offer(step: int, worker: int, requests: Ints, open_: Bools) -> Floats:
        paid = np.zeros(open_.shape)
        some = np.flatnonzero(open_.any(axis=1))
        if some.size:
            # Columns in the order in which the requests joined.
            joined = np.lexsort((requests, instance.arrival[requests]))
            held = open_[np.ix_(some, joined)]
            count = held.sum(axis=1)
            column = joined[np.argsort(~held, axis=1, kind="stable")[:, : count.max()]]
            offered = np.arange(column.shape[1]) < count[:, None]
            request = np.where(offered, requests[column], instance.n_requests)
            # All belong to the first run, of the first instance.
            nought = np.zeros(some.size, np.int64)
            seen = (nought, nought, np.full(some.size, worker), request, offered)
            with same_world(batch, policy):
                found = offers(policy, State(batch, step, *locked(seen)))
            paid[some[:, None], column] = found
        return paid

    return offer
