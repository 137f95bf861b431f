"""Collecting data: policies that explore, and the log of what they offered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optkit.errors import InputError
from optkit.instance import Floats, Instance, Ints
from optkit.models.offers import Offers
from optkit.simulator import Policy, simulate
from optkit.state import State


def check_seed(seed: object) -> None:
    """Raise an InputError unless the seed is a whole number of at least 0."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed {seed!r} is not a whole number >= 0")


@dataclass(frozen=True)
class RandomOffers:
    """Pay a random share of the reward, drawn anew for every offer (paper section 3.4: 40 to 85 per cent).

    Parameters
    ----------
    low, high : float
        Range of the share, ``0 <= low <= high``.
    seed : int
        Source of the randomness: the same seed pays the same on the same instances.

    Raises
    ------
    InputError
        If the range is empty or negative.

    Examples
    --------
    >>> from optkit import scenario
    >>> log = collect(scenario("I.2", seed=0).sample(5, seed=1), RandomOffers(0.3, 0.5, seed=0)).to_frame()
    >>> bool(log["compensation"].gt(0).all())
    True
    """

    low: float = 0.4
    high: float = 0.85
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high < np.inf:
            raise InputError(f"shares from {self.low} to {self.high}: give 0 <= low <= high")
        check_seed(self.seed)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money."""
        rng = np.random.default_rng([self.seed, state.step])
        return np.maximum(rng.uniform(self.low, self.high, state.offered.shape) * state.reward, 0.0)


@dataclass(frozen=True)
class Explore:
    """Another policy's compensations plus Gaussian noise, cut off at 0.

    Parameters
    ----------
    policy : callable
        The policy to explore around.
    deviation : float
        Standard deviation of the noise, in money.
    seed : int
        Source of the randomness.

    Raises
    ------
    InputError
        If the deviation is negative.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> from optkit.policies import RewardPercentage
    >>> days = scenario("I.2", seed=0).sample(5, seed=1)
    >>> half, around_half = RewardPercentage(0.5), Explore(RewardPercentage(0.5), deviation=2.0)
    >>> bool((simulate(days, half).reward != simulate(days, around_half).reward).any())
    True
    """

    policy: Policy
    deviation: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.deviation < np.inf:
            raise InputError(f"deviation = {self.deviation} must be a number of at least 0, in money")
        check_seed(self.seed)

    def __call__(self, state: State) -> Floats:
        """Compensations (b, w), in money."""
        rng = np.random.default_rng([self.seed, state.step])
        offer = np.asarray(self.policy(state), dtype=float)
        return np.maximum(offer + rng.normal(0.0, self.deviation, offer.shape), 0.0)


class OfferLog:
    """An observer of simulations that logs what was offered and taken.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> log = OfferLog()
    >>> done = simulate(scenario("I.2", seed=0).sample(5, seed=1), RandomOffers(seed=0), observe=log)
    >>> bool(log.offers().n_choices == done.served.sum())
    True
    """

    def __init__(self) -> None:
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
        return Offers(situation, group, features, pickup, dropoff, compensation, chosen)


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
    >>> log = collect(scenario("I.1", seed=0).sample(5, seed=1), RandomOffers(seed=0))
    >>> log.n_situations >= log.n_choices > 0
    True
    """
    log = OfferLog()
    simulate(instances, policy, observe=log)
    return log.offers()
