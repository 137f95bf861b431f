"""Collecting data: policies that explore, and the log of what they offered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.basics.errors import InputError
from optkit.instances.instance import Instance
from optkit.models.preferences.offers import Offers
from optkit.simulation.simulator import Policy, simulate
from optkit.simulation.state import State


class OfferLog:
    """An observer of simulations that logs what was offered and taken.

    Parameters
    ----------
    instances : sequence of Instance
        Those that are simulated, whose names of groups and features the log takes over; without them it has none.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> from optkit.policies.explore import RandomOffers
    >>> log = OfferLog()
    >>> done = simulate(scenario("I.2", seed=0).sample(5, seed=1), RandomOffers(seed=0), observe=log)
    >>> bool(log.offers().n_choices == done.served.sum())
    True
    """

    def __init__(self, instances: Sequence[Instance] = ()) -> None:
        first = instances[0] if len(instances) else None
        self._names = first.feature_names or () if first is not None else ()
        self._group_names = first.group_names if first is not None else None
        self._parts: list[tuple[Ints | Floats, ...]] = []
        self._seen = 0

    def __call__(self, state: State, offer: Floats, taken: Ints) -> None:
        """Log one step's decisions."""
        b, w = np.nonzero(state.offered)
        chosen = (taken[b] == w).astype(np.int64)
        where = (state.pickup[b, w], state.dropoff[b, w])
        self._parts.append((self._seen + b, state.group[b], state.features[b, w], *where, offer[b, w], chosen))
        self._seen += len(state.worker)

    def offers(self) -> Offers:
        """Return the log, one situation per worker who saw at least one request.

        Raises
        ------
        InputError
            If no worker saw any request.
        """
        if not self._parts:
            raise InputError("no worker saw any request in these instances: there is nothing to log")
        columns = map(np.concatenate, zip(*self._parts, strict=True))
        situation, group, features, pickup, dropoff, compensation, chosen = columns
        return Offers(
            situation, group, features, pickup, dropoff, compensation, chosen, self._names, None, self._group_names
        )


def collect(instances: Sequence[Instance], policy: Policy) -> Offers:
    """Run a policy through instances and log what it offered and what was taken.

    Parameters
    ----------
    instances : sequence of Instance
        Their noise must be realised.
    policy : callable
        :class:`RandomOffers` for the paper's data.

    Returns
    -------
    Offers
        One situation per worker who saw at least one request.

    Raises
    ------
    InputError
        If no worker saw any request.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.policies.explore import RandomOffers
    >>> log = collect(scenario("I.1", seed=0).sample(5, seed=1), RandomOffers(seed=0))
    >>> log.n_situations >= log.n_choices > 0
    True
    """
    log = OfferLog([instances] if isinstance(instances, Instance) else instances)
    simulate(instances, policy, observe=log)
    return log.offers()
