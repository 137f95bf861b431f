"""A scenario's fluid model, from its settings and weights alone, and its bid prices as a value function.

Nothing is sampled: request types, places and lifetimes are enumerated, and the FIFO queue's length has a distribution
that can be computed. The bound of :func:`optkit.bounds.fluid.bound.fluid_bound` is therefore proven for the scenario.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.basics.errors import InputError
from optkit.bounds.bound import Bound
from optkit.bounds.fluid.bound import FluidModel, fluid_bound
from optkit.bounds.fluid.prices import FluidPrices
from optkit.bounds.penalised.presence import presence_at
from optkit.instances.new_york.trip_scenario import TripScenario
from optkit.instances.scenario import Scenario
from optkit.simulation.state import State


def fluid_model(source: Scenario) -> FluidModel:
    """Return what is expected of a scenario: numbers of requests by type, places, arrival and expiry; workers by step.

    Parameters
    ----------
    source : Scenario
        From :func:`optkit.scenario`, one without trips and with no random term in the utility.

    Returns
    -------
    FluidModel
        One class for each request type, pair of places, arrival and expiry.

    Raises
    ------
    InputError
        If the scenario's requests come from trips, whose distribution nobody knows, or utilities are random.

    Examples
    --------
    >>> from optkit import scenario
    >>> model = fluid_model(scenario("I.2", seed=0, horizon=10))
    >>> round(float(model.count.sum()), 9), round(float(model.presence[0].sum()), 3)
    (3.0, 0.393)
    """
    s, world = source.settings, source.world
    if isinstance(source, TripScenario):
        raise InputError(f"{source.name}: how often trips come is not known; take FluidModel.from_instances")
    if s.utility_noise > 0:
        raise InputError(
            f"utility_noise = {s.utility_noise:g}: utilities are random, and each a class of its own; take "
            "FluidModel.from_instances"
        )
    kind, pickup, dropoff = np.array(list(product(range(s.types), range(s.pickups), range(s.dropoffs)))).T
    features = np.column_stack([world.kinds[kind], world.travel_time(pickup, dropoff)])
    arrival, lifetime, chance = _windows(s.horizon, s.mean_lifetime)
    classes, windows = kind.size, arrival.size
    reward = np.tile(20.0 + features @ world.reward_weight, windows)
    penalty = np.tile(features @ world.penalty_weight, windows)
    arrival, lifetime, chance = np.repeat(arrival, classes), np.repeat(lifetime, classes), np.repeat(chance, classes)
    return FluidModel(
        horizon=s.horizon,
        arrival=arrival,
        expiry=arrival + lifetime,
        reward=reward + 5.0 * (lifetime < 3),
        penalty=-(penalty + 0.1 * lifetime),
        utility=np.tile(world.utility(features, pickup, dropoff), windows),
        count=s.request_rate * chance / classes,
        presence=np.repeat(presence_at(s.worker_rate, s.horizon)[:, None] / s.groups, s.groups, axis=1),
        mu=np.full(s.groups, s.mu),
    )


def _windows(horizon: int, mean: float) -> tuple[Ints, Ints, Floats]:
    """Arrival, lifetime and probability, given the arrival, of each pair that can be: L = ceil(Exp(mean)), cut at T."""
    arrival, lifetime = (x.ravel() for x in np.mgrid[0:horizon, 0:horizon])
    left = horizon - 1 - arrival
    some = (lifetime <= left) & ((lifetime > 0) | (left == 0))
    arrival, lifetime, left = arrival[some], lifetime[some], left[some]
    longer = np.exp(-(np.maximum(lifetime, 1) - 1) / mean)
    return arrival, lifetime, np.where(lifetime == left, longer, longer * -np.expm1(-1.0 / mean))


@dataclass(frozen=True)
class BidPriceValue:
    """Fluid bid prices as a policy's value function (:class:`optkit.policies.ValueFunction`).

    It looks at each request alone, and at the step; with whom it waits does not matter. Where requests are many (I.3)
    it gains two thirds of what a trained value function does; where they are few (I.1, I.2) it does worse than none,
    because fractions of requests that never meet seem to compete for workers.

    Parameters
    ----------
    prices : FluidPrices
        From :meth:`FluidPrices.of`.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> from optkit.policies import PostDecisionPricing
    >>> source = scenario("I.2", seed=0, horizon=10)
    >>> bound, value = bid_prices(source)
    >>> earned = simulate(source.sample(200, seed=1), PostDecisionPricing(value_function=value)).reward.mean()
    >>> bool(earned < bound.value)
    True
    """

    prices: FluidPrices

    def opportunity_cost(self, state: State) -> Floats:
        """Bid price of each request that can wait, (b, w), money."""
        batch = state.batch
        utility = batch.utility[:, state.request]
        cost = self.prices.opportunity_cost(state.step, state.reward, state.penalty, utility, state.steps_left)
        return np.where(state.offered & (state.steps_left > 0), cost, 0.0)


def bid_prices(source: Scenario, tolerance: float = 1e-5) -> tuple[Bound, BidPriceValue]:
    """Bound a scenario by its fluid model, and price with the shadow prices.

    Parameters
    ----------
    source : Scenario
        As for :func:`fluid_model`.
    tolerance : float
        Relative gap at which the dual is left; the bound holds at any.

    Returns
    -------
    bound : Bound
        On the mean reward of any policy, in money; its certificate is checked against :func:`fluid_model`.
    value : BidPriceValue
        The shadow prices as a policy's value function.

    Examples
    --------
    >>> from optkit import scenario
    >>> bound, value = bid_prices(scenario("I.2", seed=0, horizon=10))
    >>> bound.kind
    'fluid'
    """
    model = fluid_model(source)
    bound = fluid_bound(model, tolerance=tolerance)
    return bound, BidPriceValue(FluidPrices.of(model, bound))
