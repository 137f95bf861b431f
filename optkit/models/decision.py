"""The arguments that every function about one decision shares, checked and brought to one shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, mask, real
from optkit.basics.errors import InputError
from optkit.models.rows import Rows, labelled

__all__ = ["Bools", "Decisions", "Floats", "Given"]

BEYOND = 2.0**1000
"""Money, in its own unit and in units of mu, is below this, about 1e301: no sum or difference of it overflows."""


@dataclass(frozen=True)
class Decisions:
    """S decisions over n requests each, flattened from any leading shape, in units of the noise.

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
        return Given.of("value", value, utility, mu, outside_utility, offered).decisions()

    def rows(self, index: npt.NDArray[Any]) -> Decisions:
        """Some of the decisions."""
        shown = None if self.offered is None else self.offered[index]
        return Decisions(
            (len(index),), self.value[index], self.logit[index], self.mu[index], shown, self.advantage[index]
        )


class Given(NamedTuple):
    """The arguments of S decisions as they were given, in money, checked and flattened from any leading shape.

    Attributes
    ----------
    shape : tuple of int
        The leading shape that the caller had.
    money : (S, n) float
        What is worth as much as utility: the values of the requests, or their compensations.
    utility : (S, n) float
        u_i; 0 where a request cannot be served.
    outside_utility, mu : (S, 1) float
        u_0 and the noise scale.
    offered : (S, n) bool or None
        As in :class:`Decisions`.
    logit, log_odds : (S, n) float
        ``(u_i - u_0) / mu`` and ``(money_i + u_i - u_0) / mu``, the latter ``-inf`` where a request cannot be served.
    """

    shape: tuple[int, ...]
    money: Floats
    utility: Floats
    outside_utility: Floats
    mu: Floats
    offered: Bools | None
    logit: Floats
    log_odds: Floats

    @classmethod
    def of(
        cls,
        name: str,
        money: npt.ArrayLike,
        utility: npt.ArrayLike,
        mu: npt.ArrayLike,
        outside_utility: npt.ArrayLike,
        offered: npt.ArrayLike | None,
    ) -> Given:
        """Check and broadcast, here and nowhere else; ``name`` is what the errors call the money.

        What has labels goes by them, see :func:`by_label`.

        Raises
        ------
        InputError
            If an entry is not finite (but for ``-inf`` in ``utility``) or beyond any float, mu is not positive, the
            mask is not made of True and False, or shapes do not fit.
        """
        money, utility, offered, mu, outside_utility = by_label(
            {name: money, "utility": utility, "offered": offered},
            {"mu": mu, "outside_utility": outside_utility},
        )
        m, u = _per_request(name, real(name, money)), _per_request("utility", real("utility", utility, accept="-inf"))
        scale, outside = real("mu", mu)[..., None], real("outside_utility", outside_utility)[..., None]
        least, most = scale.min(initial=1.0), scale.max(initial=1.0)
        if not (least >= 1.0 / BEYOND and most <= BEYOND):
            if least <= 0:
                raise InputError(f"mu = {least} is not positive; it is the scale of the worker's noise, in money")
            odd = least if least < 1.0 / BEYOND else most
            raise InputError(f"mu = {odd:g} is too near an end of what a float holds: take another unit of money")
        shown = None if offered is None else _per_request("offered", mask("offered", offered))
        try:
            *lead, n = np.broadcast_shapes(
                m.shape, u.shape, scale.shape, outside.shape, () if shown is None else shown.shape
            )
        except ValueError:
            given = f"{name} {m.shape}, utility {u.shape}, mu {scale.shape[:-1]}, outside_utility {outside.shape[:-1]}"
            given += "" if shown is None else f", offered {shown.shape}"
            raise InputError(
                f"shapes do not fit together: {given}; requests go last, mu has the leading shape"
            ) from None
        shape, size = tuple(lead), int(np.prod(lead))

        def flat(x: npt.NDArray[Any], last: int) -> npt.NDArray[Any]:
            return (x if x.shape == (*shape, last) else np.broadcast_to(x, (*shape, last))).reshape(size, last)

        shown = None if shown is None else flat(shown, n)
        return cls._within(name, shape, flat(m, n), flat(u, n), flat(outside, 1), flat(scale, 1), shown)

    @classmethod
    def _within(
        cls,
        name: str,
        shape: tuple[int, ...],
        m: Floats,
        u: Floats,
        outside: Floats,
        scale: Floats,
        shown: Bools | None,
    ) -> Given:
        """Hold everything against :data:`BEYOND`, in its own unit and in units of mu, and take the ratios."""
        with np.errstate(over="ignore", invalid="ignore"):
            relative = u - outside
            # Adding before dividing lets opposite amounts and utilities cancel exactly.
            together = m + relative
            logit, log_odds = relative / scale, together / scale
        room = BEYOND * min(1.0, scale.min(initial=1.0))
        if not (largest(relative) <= room and largest(together) <= room):
            never = np.isneginf(u)
            if never.any():
                shown = ~never if shown is None else shown & ~never
            limit = BEYOND * np.minimum(1.0, scale)
            lost = ~((np.abs(relative) <= limit) & (np.abs(together) <= limit))
            if (told := lost if shown is None else lost & shown).any():
                s, i = (int(k) for k in np.argwhere(told)[0])
                raise InputError(
                    f"{name} {m[s, i]:g} and utility {u[s, i]:g} less {outside[s, 0]:g}, in units of "
                    f"mu = {scale[s, 0]:g}, are beyond any float (request {i}); a request that cannot be served has "
                    "utility -inf"
                )
            # What cannot be served counts for nothing, whatever stands there.
            m, u, logit = (np.where(lost, 0.0, x) for x in (m, u, logit))
        if shown is not None:
            log_odds = np.where(shown, log_odds, -np.inf)
        return cls(shape, m, u, outside, scale, shown, logit, log_odds)

    def decisions(self) -> Decisions:
        """Return the decisions in units of the noise, the money being the requests' values."""
        return Decisions(self.shape, self.money, self.logit, self.mu, self.offered, self.log_odds)

    def rows(self, index: npt.NDArray[Any]) -> Given:
        """Some of the decisions."""
        kept = {name: getattr(self, name)[index] for name in self._fields[1:] if getattr(self, name) is not None}
        return self._replace(shape=(len(index),), **kept)

    def prices(self, compensation: npt.ArrayLike) -> Given:
        """Check proposed prices of these decisions: the same, the money being the compensations.

        Raises
        ------
        InputError
            If they are not one finite number per request of each decision, or beyond any float.
        """
        c = _per_request("compensation", real("compensation", compensation))
        wanted = (*self.shape, self.money.shape[1])
        try:
            c = np.broadcast_to(c, wanted).reshape(self.money.shape)
        except ValueError:
            raise InputError(f"compensation has shape {c.shape}; the decisions are {wanted}") from None
        return self.at(c, "compensation")

    def at(self, money: Floats, name: str = "money") -> Given:
        """Return the same with other money (S, n) in the place of this."""
        return self._within(name, self.shape, money, self.utility, self.outside_utility, self.mu, self.offered)


def by_label(requests: Mapping[str, Any], decisions: Mapping[str, Any]) -> list[Any]:
    """Bring what is labelled into one order, that of the first argument that is; all else stays as it is, by place.

    Parameters
    ----------
    requests : dict of str to array_like
        Arguments (..., n): the index of a Series, and the columns of a DataFrame, are the requests' labels.
    decisions : dict of str to array_like
        Arguments (...): their index, and that of a DataFrame of ``requests``, are the decisions' labels.

    Returns
    -------
    list
        The arguments of both, in the order given.

    Raises
    ------
    InputError
        If labels are not the same, or stand there twice and in another order.

    Examples
    --------
    >>> import pandas as pd
    >>> value, utility = pd.Series({"a": 5.0, "b": 6.0}), pd.Series({"b": -2.0, "a": -1.0})
    >>> [one.tolist() for one in by_label({"value": value, "utility": utility}, {})]
    [[5.0, 6.0], [-1.0, -2.0]]
    """
    found = {**requests, **decisions}
    if not any(labelled(one) for one in found.values()):
        return list(found.values())
    import pandas as pd

    axes: dict[str, dict[int, Any]] = {name: {} for name in found}  # of each argument, where the two labels stand
    for name, one in found.items():
        if labelled(one) and getattr(one, "ndim", 0) == 2:
            axes[name] = {0: one.index, 1: one.columns}
        elif labelled(one):
            axes[name] = {1 if name in requests else 0: one.index}
    for kind in (0, 1):
        places: dict[str, Any] = {
            name: pd.Series(np.arange(len(axes[name][kind])), axes[name][kind]) if kind in axes[name] else None
            for name, one in found.items()
            if one is not None and (kind == 0 or name in requests)
        }
        n = next((len(one) for one in places.values() if one is not None), 0)
        rows = Rows.of(n, **places)
        for name, one in places.items():
            if one is None:
                continue
            order = np.asarray(rows.take(name, one))
            if not np.array_equal(order, np.arange(len(order))):
                along = 1 if kind == 1 and found[name].ndim == 2 else 0
                found[name] = found[name].iloc[:, order] if along else found[name].iloc[order]
    return list(found.values())


def largest(x: Floats) -> float:
    """Largest magnitude, NaN if there is one, 0 of nothing."""
    return max(float(x.max(initial=0.0)), -float(x.min(initial=0.0)))


def _per_request(name: str, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an array with the requests last; InputError if it has none."""
    if array.ndim == 0:
        raise InputError(f"{name} is a single number; give an array whose last axis holds the requests")
    return array
