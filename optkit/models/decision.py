"""The arguments that every function about one decision shares, checked and brought to one shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, mask, real
from optkit.basics.errors import InputError

__all__ = ["AtPrices", "Bools", "Decisions", "Floats"]


class AtPrices(NamedTuple):
    """What workers make of proposed prices in S decisions.

    Attributes
    ----------
    shape : tuple of int
        The leading shape that the caller had.
    compensation : (S, n) float
        The prices, in money.
    log_odds : (S, n) float
        ``(u_i + c_i - u_0) / mu``: log-odds of each request against the outside option, ``-inf`` where not offered.
    """

    shape: tuple[int, ...]
    compensation: Floats
    log_odds: Floats


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
        ``(u_i - u_0) / mu``: log-odds of the request against the outside option at compensation 0; finite.
    mu : (S, 1) float
        Noise scale, in money.
    offered : (S, n) bool or None
        Mask of the requests that can be served; None where all can. Those of utility ``-inf`` cannot.
    advantage : (S, n) float
        ``a_i / mu = (v_i + u_i - u_0) / mu``, ``-inf`` where a request cannot be served.
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
        given = _together("value", value, utility, mu, outside_utility, offered)
        return cls(given.shape, given.money, given.logit, given.mu, given.offered, given.log_odds)

    @staticmethod
    def at_prices(
        compensation: npt.ArrayLike,
        utility: npt.ArrayLike,
        mu: npt.ArrayLike,
        outside_utility: npt.ArrayLike,
        offered: npt.ArrayLike | None,
    ) -> AtPrices:
        """Check and broadcast prices like :meth:`of`, and say how workers see them."""
        given = _together("compensation", compensation, utility, mu, outside_utility, offered)
        return AtPrices(given.shape, given.money, given.log_odds)

    def rows(self, index: npt.NDArray[Any]) -> Decisions:
        """Some of the decisions."""
        shown = None if self.offered is None else self.offered[index]
        return Decisions(
            (len(index),), self.value[index], self.logit[index], self.mu[index], shown, self.advantage[index]
        )


class _Given(NamedTuple):
    """Money and utilities of one shape: ``log_odds`` is ``(money + u - u_0) / mu``, the rest as in Decisions."""

    shape: tuple[int, ...]
    money: Floats
    logit: Floats
    mu: Floats
    offered: Bools | None
    log_odds: Floats


def _together(
    name: str,
    money: npt.ArrayLike,
    utility: npt.ArrayLike,
    mu: npt.ArrayLike,
    outside_utility: npt.ArrayLike,
    offered: npt.ArrayLike | None,
) -> _Given:
    """Check what is worth as much as utility, a value or a compensation, together with the utilities."""
    m, u = _per_request(name, real(name, money)), _per_request("utility", real("utility", utility, accept="-inf"))
    scale, outside = real("mu", mu)[..., None], real("outside_utility", outside_utility)[..., None]
    if np.any(scale <= 0):
        raise InputError(f"mu = {scale.min()} is not positive; it is the scale of the worker's noise, in money")
    shown = None if offered is None else _per_request("offered", mask("offered", offered))
    try:
        *lead, n = np.broadcast_shapes(
            m.shape, u.shape, scale.shape, outside.shape, () if shown is None else shown.shape
        )
    except ValueError:
        given = f"{name} {m.shape}, utility {u.shape}, mu {scale.shape[:-1]}, outside_utility {outside.shape[:-1]}"
        given += "" if shown is None else f", offered {shown.shape}"
        raise InputError(f"shapes do not fit together: {given}; requests go last, mu has the leading shape") from None
    shape, size = tuple(lead), int(np.prod(lead))

    def flat(x: npt.NDArray[Any], last: int) -> npt.NDArray[Any]:
        return (x if x.shape == (*shape, last) else np.broadcast_to(x, (*shape, last))).reshape(size, last)

    m, u, scale, outside = flat(m, n), flat(u, n), flat(scale, 1), flat(outside, 1)
    shown = None if shown is None else flat(shown, n)
    with np.errstate(over="ignore", invalid="ignore"):
        relative = u - outside
        # Adding before dividing lets opposite amounts and utilities cancel exactly.
        logit, log_odds = relative / scale, (m + relative) / scale
        all_finite = np.isfinite(logit.sum() + log_odds.sum())  # NaN and infinity survive a sum
    if not all_finite:
        never = np.isneginf(u)
        if (lost := ~(np.isfinite(logit) & np.isfinite(log_odds) | never)).any():
            s, i = (int(k) for k in np.argwhere(lost)[0])
            raise InputError(
                f"{name} {m[s, i]:g} and utility {u[s, i]:g} less {outside[s, 0]:g}, in units of mu = {scale[s, 0]:g}, "
                f"are beyond any float (request {i}); a request that cannot be served has utility -inf"
            )
        if never.any():
            logit = np.where(never, 0.0, logit)
            shown = ~never if shown is None else shown & ~never
    if shown is not None:
        log_odds = np.where(shown, log_odds, -np.inf)
    return _Given(shape, m, logit, scale, shown, log_odds)


def _per_request(name: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an array with the requests last; InputError if it has none."""
    if array.ndim == 0:
        raise InputError(f"{name} is a single number; give an array whose last axis holds the requests")
    return array
