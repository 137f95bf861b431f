r"""One term of a light value function: a request counts by what it is and by how many others come before it.

.. math:: V(S) = \sum_{i \in S} x_i^\top \Theta\, h(k_i)

with features x of the request itself, and hat functions h of its rank k: the number of requests of S that come before
it, in the order of surplus or of urgency. Each settles the ties of the other, so that V does not depend on how a set is
written down. Removing a request moves up by one all that come after it, so opportunity costs follow from one reverse
cumulative sum, without evaluating n + 1 sets.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Bools, Floats, Ints, ReadOnlyArrays, floats
from optkit.basics.errors import InputError
from optkit.models.value.request_sets import RequestSets


class RequestFeatures(Protocol):
    """What counts of a request on its own."""

    @property
    def size(self) -> int:
        """Number of features q."""
        ...

    def __call__(self, sets: RequestSets) -> Floats:
        """Features of every request, (b, w, q); whatever for padding, but finite."""
        ...


@dataclass(frozen=True, eq=False)
class RankedTerm(ReadOnlyArrays):
    """Requests ranked, and what they are worth by rank (``docs/explanation/values.md``).

    Parameters
    ----------
    features : RequestFeatures
        x, q numbers per request.
    order : int or "surplus" or "urgency"
        Who comes before whom: larger surplus to a group (its number) or in the mean, or fewer steps left.
    rank_knots : (c,) float, increasing
        Knots of h.
    busy_knots : (j,) float, increasing, optional
        Theta may also depend on the busy stretch, by hat functions with these knots, in steps: workers queue, and who
        has seen many in a row will see more.

    Examples
    --------
    >>> from optkit.models.value.features import HatFeatures
    >>> features = HatFeatures(None, np.array([0.0, 100.0]), np.array([1.0, 10.0]))
    >>> RankedTerm(features, "surplus", np.array([0.0, 4.0])).size
    8
    """

    features: RequestFeatures
    order: int | str
    rank_knots: Floats
    busy_knots: Floats | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rank_knots", knots("rank_knots", self.rank_knots))
        if self.busy_knots is not None:
            object.__setattr__(self, "busy_knots", knots("busy_knots", self.busy_knots))
        if not (is_group(self.order) or self.order in ("surplus", "urgency")):
            raise InputError(f'order = {self.order!r}: take "surplus", "urgency" or the number of a group')

    @property
    def size(self) -> int:
        """Number of coefficients q * c, times j."""
        return self.features.size * self.rank_knots.size * (1 if self.busy_knots is None else self.busy_knots.size)

    def value(self, sets: RequestSets, theta: Floats) -> Floats:
        """Value of each set, (b,), money, for coefficients (size,)."""
        _, inside, weight = self._weighted(sets, theta)
        return np.asarray(np.einsum("bwk,wk->b", np.where(inside[..., None], weight, 0.0), self._hats(weight.shape[1])))

    def opportunity_cost(self, sets: RequestSets, theta: Floats) -> Floats:
        """Value lost by removing each member, (b, w), money; 0 for padding."""
        order, inside, weight = self._weighted(sets, theta)
        h = self._hats(weight.shape[1])
        weight = np.where(inside[..., None], weight, 0.0)
        own = np.einsum("bwk,wk->bw", weight, h)
        moved = np.einsum("bwk,wk->bw", weight, h - _before(h))
        return _unordered(order, np.where(inside, own + _behind(moved), 0.0))

    def opportunity_cost_without(self, sets: RequestSets, row: Ints, column: Ints, theta: Floats) -> Floats:
        """Opportunity costs in sets ``row`` without the request at ``column``, both (r,): (r, w), money.

        Who comes after it has moved up by one; no set is ranked anew. 0 for padding and for the request itself.
        """
        order, inside, weight = self._weighted(sets, theta)
        h = self._hats(weight.shape[1])
        up = _before(h)
        weight = np.where(inside[..., None], weight, 0.0)
        own, own_up = np.einsum("bwk,wk->bw", weight, h), np.einsum("bwk,wk->bw", weight, up)
        moved, moved_up = own - own_up, np.einsum("bwk,wk->bw", weight, up - _before(up))
        behind, behind_up = _behind(moved), _behind(moved_up)
        place = _unordered(order, np.broadcast_to(np.arange(order.shape[1]), order.shape))
        cost, cost_up = _unordered(order, own + behind), _unordered(order, own_up + behind_up)
        # Behind those before it there are no longer it and, at their old ranks, those that come after it.
        less = _unordered(order, moved + behind - behind_up)
        # Padding comes last and weighs nothing, so to lack it changes nothing.
        first = place[row] < place[row, column][:, None]
        found = np.where(first, cost[row] - less[row, column][:, None], cost_up[row])
        found[np.arange(len(row)), column] = 0.0
        return np.asarray(found)

    def basis(self, sets: RequestSets) -> Floats:
        """Regressors of the value, (b, size)."""
        order, inside = self._order(sets)
        x = np.where(inside[..., None], np.take_along_axis(self.features(sets), order[..., None], axis=1), 0.0)
        own = np.einsum("bwq,wk->bqk", x, self._hats(x.shape[1])).reshape(len(sets), -1)
        return self._crossed(sets, own)

    def differences(self, sets: RequestSets) -> Floats:
        """Regressors of the opportunity cost, (b, w, size): basis of each set less that without each member."""
        order, inside = self._order(sets)
        x = np.where(inside[..., None], np.take_along_axis(self.features(sets), order[..., None], axis=1), 0.0)
        h = self._hats(x.shape[1])
        own = np.einsum("bwq,wk->bwqk", x, h).reshape(*order.shape, x.shape[2] * h.shape[1])
        moved = np.einsum("bwq,wk->bwqk", x, h - _before(h)).reshape(own.shape)
        return self._crossed(sets, _unordered(order[..., None], np.where(inside[..., None], own + _behind(moved), 0.0)))

    def _busy(self, sets: RequestSets) -> Floats:
        """Hat functions of the busy stretch, (b, j)."""
        if sets.busy is None or self.busy_knots is None:
            raise InputError("this value function needs to know the busy stretch of each set: pass busy")
        return hats(sets.busy.astype(float), self.busy_knots)

    def _crossed(self, sets: RequestSets, regressors: Floats) -> Floats:
        """Regressors (b, ..., q * c) times the hat functions of the busy stretch, if these count."""
        if self.busy_knots is None:
            return regressors
        h = self._busy(sets).reshape(len(sets), *(1,) * (regressors.ndim - 2), -1, 1)
        return np.asarray((regressors[..., None, :] * h).reshape(*regressors.shape[:-1], self.size))

    def _order(self, sets: RequestSets) -> tuple[npt.NDArray[np.intp], Bools]:
        """Columns in order, members first, and which of them are members, (b, w)."""
        key = -sets.surplus_to(self.order if isinstance(self.order, int) else None)
        tie = sets.steps_left
        if self.order == "urgency":
            key, tie = tie, key
        order = np.lexsort((tie, np.where(sets.member, key, np.inf)), axis=1)
        return order, np.take_along_axis(sets.member, order, axis=1)

    def _weighted(self, sets: RequestSets, theta: Floats) -> tuple[npt.NDArray[np.intp], Bools, Floats]:
        """Order, membership, and what each request is worth at each rank knot, (b, w, c)."""
        order, inside = self._order(sets)
        if self.busy_knots is None:
            by_knot = theta.reshape(self.features.size, -1)
        else:
            by_knot = np.tensordot(self._busy(sets), theta.reshape(self.busy_knots.size, self.features.size, -1), 1)
        weight = self.features(sets) @ by_knot
        return order, inside, np.take_along_axis(weight, order[..., None], axis=1)

    def _hats(self, width: int) -> Floats:
        """Hat functions of the ranks 0..width - 1, (width, c)."""
        return self._table[:width] if width <= len(self._table) else hats(np.arange(float(width)), self.rank_knots)

    @cached_property
    def _table(self) -> Floats:
        return hats(np.arange(256.0), self.rank_knots)

    def to_dict(self) -> dict[str, Any]:
        """Order and rank knots as plain data; the features say theirs."""
        busy = None if self.busy_knots is None else self.busy_knots.tolist()
        return {"order": self.order, "rank_knots": self.rank_knots.tolist(), "busy_knots": busy}


def _before(h: Floats) -> Floats:
    """Hat functions of a request that has moved up by one."""
    return np.concatenate([h[:1], h[:-1]])


def _behind(moved: Floats) -> Floats:
    """Sum of what those after each request gain, along axis 1."""
    return np.asarray(moved[:, ::-1].cumsum(axis=1)[:, ::-1] - moved)


def _unordered(order: npt.NDArray[np.intp], x: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Put what stands in order along axis 1 back into the columns of the set."""
    found = np.empty_like(x)
    np.put_along_axis(found, order, x, axis=1)
    return found


def is_group(number: Any) -> bool:
    """Whether something can be the number of a worker group."""
    return isinstance(number, int) and not isinstance(number, bool) and number >= 0


def knots(name: str, x: npt.ArrayLike) -> Floats:
    """Return knots as an array; InputError unless they are at least two increasing numbers."""
    array = floats(name, x, (None,))
    if array.size < 2 or not (np.diff(array) > 0).all():
        raise InputError(f"{name} must be at least two increasing numbers; got {array.tolist()}")
    return array


def hats(x: Floats, knots: Floats) -> Floats:
    """Piecewise linear hat functions at x, (..., knots): between 0 and 1, adding up to 1, constant beyond the ends.

    Examples
    --------
    >>> hats(np.array([-1.0, 0.0, 2.5, 9.0]), np.array([0.0, 1.0, 4.0]))
    array([[1. , 0. , 0. ],
           [1. , 0. , 0. ],
           [0. , 0.5, 0.5],
           [0. , 0. , 1. ]])
    """
    # How far x is across each piece, from 0 to 1: a hat rises with the piece before its knot and falls with the next.
    across = np.asarray((x[..., None] - knots[:-1]) / np.diff(knots))
    np.clip(across, 0.0, 1.0, out=across)
    found = np.empty((*x.shape, knots.size))
    found[..., 0] = 1.0 - across[..., 0]
    np.subtract(across[..., :-1], across[..., 1:], out=found[..., 1:-1])
    found[..., -1] = across[..., -1]
    return found
