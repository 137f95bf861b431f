r"""A light value of waiting: every open request is worth a function of its surplus, time left and rank.

.. math:: V_t(S) = \sum_{i \in S} \theta_t \cdot [h(a_i) \otimes h(\tau_i) \otimes h(k_i)]

with hat functions h (piecewise linear, constant beyond their outer knots) of the surplus a (reward less penalty plus
mean utility), the steps left tau, and the rank k: the number of requests of S with a larger surplus. Removing a request
lowers the rank of all that come after it, so with requests sorted by surplus all opportunity costs follow from one
reverse cumulative sum, without evaluating n + 1 sets.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from optkit.errors import InputError
from optkit.instance import Floats

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RankedValue:
    """Post-decision value function of sets of requests (paper section 3.3; design section 4, "Bellman").

    Sets come as padded rows: (b, w) arrays with a mask of the members. All members have at least one step left after
    the decision.

    Attributes
    ----------
    surplus_knots, time_knots, rank_knots : (a,), (b,), (c,) float, increasing
        Knots of the hat functions, in money, steps and requests.
    coefficients : (T, a * b * c) float
        theta of each decision step, in money; zero at the last step, after which nothing waits.

    Examples
    --------
    >>> value = RankedValue([0.0, 100.0], [1.0, 10.0], [0.0, 4.0], np.ones((3, 8)))
    >>> surplus, left, member = np.array([[50.0, 20.0]]), np.array([[2.0, 2.0]]), np.array([[True, True]])
    >>> value.value(0, surplus, left, member)  # hat functions add up to 1
    array([2.])
    >>> value.opportunity_cost(0, surplus, left, member)
    array([[1., 1.]])
    """

    surplus_knots: Floats
    time_knots: Floats
    rank_knots: Floats
    coefficients: Floats
    _shape: tuple[int, int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("surplus_knots", "time_knots", "rank_knots", "coefficients"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        for name in ("surplus_knots", "time_knots", "rank_knots"):
            knots = getattr(self, name)
            if knots.ndim != 1 or knots.size < 2 or not (np.diff(knots) > 0).all():
                raise InputError(f"{name} must be at least two increasing numbers; got {knots.tolist()}")
        shape = (self.surplus_knots.size, self.time_knots.size, self.rank_knots.size)
        if self.coefficients.ndim != 2 or self.coefficients.shape[1] != np.prod(shape):
            raise InputError(f"coefficients have shape {self.coefficients.shape}; give (steps, {np.prod(shape)})")
        object.__setattr__(self, "_shape", shape)

    def value(self, step: int, surplus: Floats, steps_left: Floats, member: Bools) -> Floats:
        """Value of each set after the decision at ``step``, (b,), in money."""
        order, inside, weight = self._sorted(step, surplus, steps_left, member)
        return np.asarray(np.where(inside, self._at(weight, np.arange(order.shape[1])), 0.0).sum(axis=1))

    def opportunity_cost(self, step: int, surplus: Floats, steps_left: Floats, member: Bools) -> Floats:
        """Value lost by removing each member from its set, (b, w), in money; 0 for those that are no members."""
        order, inside, weight = self._sorted(step, surplus, steps_left, member)
        rank = np.arange(order.shape[1])
        own = np.where(inside, self._at(weight, rank), 0.0)
        promoted = np.where(inside, self._at(weight, np.maximum(rank - 1, 0)), 0.0)
        moved = own - promoted
        # What is lost with request i: its own value, and the change of everyone behind it, who moves up by one.
        behind = moved[:, ::-1].cumsum(axis=1)[:, ::-1] - moved
        cost = np.empty_like(own)
        np.put_along_axis(cost, order, np.where(inside, own + behind, 0.0), axis=1)
        return cost

    def basis_differences(self, surplus: Floats, steps_left: Floats, member: Bools) -> Floats:
        """Basis of each set less that of the set without each member, (b, w, p): the regressors of a difference.

        ``opportunity_cost(step, ...)`` is this times ``coefficients[step]``; here for fitting.
        """
        order, inside = self._order(surplus, member)
        a, tau = (np.take_along_axis(x, order, axis=1) for x in (surplus, steps_left))
        base = np.einsum("bwi,bwj->bwij", hats(a, self.surplus_knots), hats(tau, self.time_knots))
        base = np.where(inside[..., None, None], base, 0.0)
        rank = np.arange(order.shape[1], dtype=float)
        now, after = hats(rank, self.rank_knots), hats(np.maximum(rank - 1, 0), self.rank_knots)
        own = np.einsum("bwij,wk->bwijk", base, now).reshape(*order.shape, self.coefficients.shape[1])
        moved = np.einsum("bwij,wk->bwijk", base, now - after).reshape(own.shape)
        behind = moved[:, ::-1].cumsum(axis=1)[:, ::-1] - moved
        difference = np.empty_like(own)
        np.put_along_axis(difference, order[..., None], np.where(inside[..., None], own + behind, 0.0), axis=1)
        return np.asarray(difference)

    def _order(self, surplus: Floats, member: Bools) -> tuple[npt.NDArray[np.intp], Bools]:
        """Columns by decreasing surplus, members first, (b, w), and which of them are members."""
        order = np.argsort(np.where(member, -surplus, np.inf), axis=1, kind="stable")
        return order, np.take_along_axis(member, order, axis=1)

    def _sorted(
        self, step: int, surplus: Floats, steps_left: Floats, member: Bools
    ) -> tuple[npt.NDArray[np.intp], Bools, Floats]:
        """Order, membership, and what each request is worth at each rank knot, (b, w, c)."""
        order, inside = self._order(surplus, member)
        a, tau = (np.take_along_axis(x, order, axis=1) for x in (surplus, steps_left))
        theta = self.coefficients[step].reshape(self._shape)
        by_time = np.einsum("bwi,ijk->bwjk", hats(a, self.surplus_knots), theta)
        return order, inside, np.einsum("bwj,bwjk->bwk", hats(tau, self.time_knots), by_time)

    def _at(self, weight: Floats, rank: npt.NDArray[np.intp]) -> Floats:
        return np.asarray(np.einsum("bwk,wk->bw", weight, hats(rank.astype(float), self.rank_knots)))


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
    clipped = np.clip(x, knots[0], knots[-1])
    left = np.clip(np.searchsorted(knots, clipped, side="right") - 1, 0, knots.size - 2)
    share = (clipped - knots[left]) / (knots[left + 1] - knots[left])
    place = np.arange(knots.size)
    low = (place == left[..., None]) * (1.0 - share[..., None])
    return np.asarray(low + (place == left[..., None] + 1) * share[..., None])
