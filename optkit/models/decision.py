"""The arguments that every function about one decision shares, checked and brought to one shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InputError

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Decisions:
    """S decisions over n requests each, flattened from any leading shape.

    Attributes
    ----------
    shape : tuple of int
        The leading shape that the caller had.
    value : (S, n) float
        What serving each request now is worth before paying for it, v_i, in money.
    logit : (S, n) float
        ``(u_i - u_0) / mu``: log-odds of the request against the outside option at compensation 0.
    mu : (S, 1) float
        Noise scale, in money.
    offered : (S, n) bool or None
        Mask of the offered requests; None where all are.
    advantage : (S, n) float
        ``a_i / mu = (v_i + u_i - u_0) / mu``, ``-inf`` where nothing is offered.
    """

    shape: tuple[int, ...]
    value: Floats
    logit: Floats
    mu: Floats
    offered: Bools | None
    advantage: Floats

    @classmethod
    def of(
        cls,
        value: npt.ArrayLike,
        utility: npt.ArrayLike,
        mu: npt.ArrayLike,
        outside_utility: npt.ArrayLike,
        offered: npt.ArrayLike | None,
    ) -> Decisions:
        """Check and broadcast; see :func:`optkit.models.pricing.optimal_prices` for shapes and errors."""
        v, u = per_request("value", value), per_request("utility", utility)
        scale, outside = per_decision("mu", mu), per_decision("outside_utility", outside_utility)
        if np.any(scale <= 0):
            raise InputError(f"mu = {scale.min()} is not positive; it is the scale of the worker's noise, in money")
        mask = None if offered is None else per_request("offered", offered, bool)
        try:
            *lead, n = np.broadcast_shapes(
                v.shape, u.shape, scale.shape, outside.shape, () if mask is None else mask.shape
            )
        except ValueError:
            given = (
                f"value {v.shape}, utility {u.shape}, mu {np.shape(mu)}, outside_utility {np.shape(outside_utility)}"
            )
            given += "" if mask is None else f", offered {mask.shape}"
            raise InputError(
                f"shapes do not fit together: {given}; requests go last, mu has the leading shape"
            ) from None
        shape, size = tuple(lead), int(np.prod(lead))

        def flat(x: npt.NDArray[Any], last: int) -> npt.NDArray[Any]:
            return (x if x.shape == (*shape, last) else np.broadcast_to(x, (*shape, last))).reshape(size, last)

        v, u, scale, outside = flat(v, n), flat(u, n), flat(scale, 1), flat(outside, 1)
        relative = u - outside
        # Adding before dividing lets opposite values and utilities cancel exactly.
        advantage = (v + relative) / scale
        if mask is not None:
            mask = flat(mask, n)
            advantage = np.where(mask, advantage, -np.inf)
        return cls(shape, v, relative / scale, scale, mask, advantage)

    def rows(self, index: npt.NDArray[Any]) -> Decisions:
        """Some of the decisions."""
        mask = None if self.offered is None else self.offered[index]
        return Decisions(
            (len(index),), self.value[index], self.logit[index], self.mu[index], mask, self.advantage[index]
        )


def per_request(name: str, x: npt.ArrayLike, dtype: type = float) -> npt.NDArray[Any]:
    """Return an array with the requests last; InputError if it has none or holds NaN or infinity."""
    array = _array(name, x, dtype)
    if array.ndim == 0:
        raise InputError(f"{name} is a single number; give an array whose last axis holds the requests")
    return array


def per_decision(name: str, x: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return an array with one number per decision and a last axis of length 1 to broadcast over requests."""
    return _array(name, x, float)[..., None]


def _array(name: str, x: npt.ArrayLike, dtype: type) -> npt.NDArray[Any]:
    try:
        array: npt.NDArray[Any] = np.asarray(x, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not an array of numbers; give floats") from None
    if dtype is float and not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name}{list(place) if place else ''} is {array[place]}; give finite numbers")
    return array
