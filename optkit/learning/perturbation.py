"""Pert(epsilon): the true preferences, moved by a known distance (paper section 4.3)."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from optkit.basics.arrays import Floats
from optkit.basics.errors import InputError
from optkit.basics.seeds import check_seed
from optkit.instances.scenario import Scenario
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.preferences import Preferences


def true_preferences(scenario: Scenario) -> Preferences:
    """Return the weights and noise scales of a scenario's world as preferences: what Pert(0) knows.

    The world's weights are burdens; here they are utilities, so the sign turns.

    Examples
    --------
    >>> from optkit import scenario
    >>> true_preferences(scenario("II", seed=0)).weights.shape  # 3 groups; 3 features, travel time, 5 + 5 places
    (3, 14)
    """
    s, world = scenario.settings, scenario.world
    names = (*(f"feature_{m}" for m in range(s.characteristics)), "travel_time")
    burden = np.concatenate([world.utility_weight, world.pickup_weight, world.dropoff_weight], axis=1)
    return Preferences(Attributes(names, s.pickups, s.dropoffs, reference=False), -burden, np.full(s.groups, s.mu))


def perturb(
    preferences: Preferences,
    epsilon: float,
    seed: int | np.random.Generator,
    *,
    groups: Collection[int] | None = None,
) -> Preferences:
    """Move (w, mu) of some groups by a random vector between two spheres.

    Its Euclidean length lies between ``max(0, epsilon - 1)`` and ``epsilon``; it is uniform in that shell, on the
    condition that mu stays positive. Money and features are in the world's units, as the paper's are.

    Parameters
    ----------
    preferences : Preferences
        For the paper's benchmark, :func:`true_preferences`.
    epsilon : float
        Radius of the outer sphere, at least 0; 0 changes nothing.
    seed : int or Generator
        Source of the randomness.
    groups : collection of int, optional
        Which groups to perturb; all by default.

    Raises
    ------
    InputError
        If epsilon is negative or a group is unknown.

    Examples
    --------
    >>> from optkit import scenario
    >>> true = true_preferences(scenario("I.1", seed=0))
    >>> moved = perturb(true, 4.0, seed=0)
    >>> bool(3.0 <= np.hypot(np.linalg.norm(moved.weights - true.weights), (moved.scale - true.scale).item()) <= 4.0)
    True
    """
    if not 0 <= epsilon < np.inf:
        raise InputError(f"epsilon = {epsilon} must be a number of at least 0")
    G = len(preferences.scale)
    if not isinstance(seed, np.random.Generator):
        check_seed(seed)
    chosen = range(G) if groups is None else sorted(set(groups))
    unknown = [g for g in chosen if g not in range(G)]
    if unknown:
        raise InputError(f"group {unknown[0]} is unknown; there are 0..{G - 1}")
    rng = np.random.default_rng(seed)
    weights, scale = preferences.weights.copy(), preferences.scale.copy()
    for g in chosen:
        delta = _shell(rng, weights.shape[1] + 1, epsilon, float(scale[g]))
        weights[g] += delta[:-1]
        scale[g] += delta[-1]
    return Preferences(preferences.attributes, weights, scale, pooled=preferences.pooled)


def _shell(rng: np.random.Generator, dimension: int, epsilon: float, mu: float) -> Floats:
    inner = max(0.0, epsilon - 1.0)
    # At most every second direction lowers mu, so this ends.
    while True:
        direction = rng.normal(size=dimension)
        direction /= np.linalg.norm(direction)
        # Volume grows with the power of the radius, so uniform in the shell means uniform in that power.
        fraction = rng.uniform((inner / epsilon) ** dimension if epsilon else 1.0, 1.0)
        delta = epsilon * fraction ** (1.0 / dimension) * direction
        if mu + delta[-1] > 0:
            return np.asarray(delta)
