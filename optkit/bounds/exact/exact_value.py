r"""The exact value of a small model by backward induction: the yardstick for bounds, policies and value functions.

Let S be the multiset of open requests before the decision at step t, q the number of workers left in the queue after
it, and :math:`V_t(R', q)` the value of what waits after it, :math:`V_{T-1} = 0`. With

.. math:: F_t(S, q) = \sum_{i \in S \text{ expires at } t} \beta_i + V_t(S \setminus \text{expiring}, q)

serving i now is worth :math:`v_i = r_i - F_t(S, q) + F_t(S \setminus i, q)` before paying for it, and

.. math:: V_{t-1}(R', q) = E\big[F_t(S, q') + 1[\text{worker of group } g] \, \phi_g(v, u_g, \mu_g, u_{0g})\big]

over the requests that join R' to make S, over q' given q, and over g; phi is the optimal profit of one decision with
c >= 0 (paper section 3.1, Lemma 1, taken before the worker is seen). The value of the model is
:math:`V_{-1}(\emptyset, 0)`.

Identical requests are one alternative: n copies with the same price have n times the weight, so that their common
log-odds grow by log n, and by symmetry and concavity the optimum prices them alike.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, Known, ints
from optkit.basics.arrays import mask as mask_of
from optkit.basics.errors import InputError
from optkit.bounds.bound import Bound, SolverRecord
from optkit.bounds.exact.certificate import ExactCertificate, decisions_of, expectation
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.exact.states import STATE_LIMIT, StateSpace, find, state_space
from optkit.models.pricing.closed_form import nonnegative


@dataclass(frozen=True, eq=False)
class ExactSolution(Known):
    """The value function of a small model, with which the optimal policy follows.

    Attributes
    ----------
    model : SmallModel
        What was solved.
    space : StateSpace
        Its states.
    value : float
        What an optimal policy earns on average, in money; rounded up, so that the certificate proves it as a bound.
    certificate : ExactCertificate
        The tables.
    """

    model: SmallModel
    space: StateSpace = field(repr=False)
    value: float
    certificate: ExactCertificate = field(repr=False)

    @property
    def states(self) -> int:
        """Number of states over all steps."""
        return self.space.size

    def post_decision_value(
        self,
        step: int,
        request_type: npt.ArrayLike,
        steps_left: npt.ArrayLike,
        member: npt.ArrayLike | None = None,
        queue: npt.ArrayLike = 0,
    ) -> Floats:
        """V_t: what sets of requests that wait after the decision will earn, together with requests yet to come.

        Parameters
        ----------
        step : int
            The step of the decision that has just been made.
        request_type, steps_left : (..., w) int
            The requests of each set, steps left counted from ``step``. One with 0 steps left waits no more and is left
            out.
        member : (..., w) bool, optional
            False for padding; whatever stands there is ignored.
        queue : int or (...) int
            Number of workers left in the queue after the decision.

        Returns
        -------
        (...) float
            Money.

        Raises
        ------
        InputError
            If a set cannot be waiting after that step.

        Examples
        --------
        >>> model = SmallModel(horizon=2, reward=[30.0], penalty=[-5.0], lifetime=[1], utility=[[-10.0]], mu=[1.0],
        ...                    arrivals=[0.5], workers=[0.6, 0.4])
        >>> solution = solve_exactly(model)
        >>> solution.post_decision_value(0, [[0], [0]], [[1], [1]], [[True], [False]]).round(3)
        array([1.015, 1.692])
        """
        sets = self._sets(step, request_type, steps_left, member, queue)
        return self._look_up(step, sets.rows, sets.queue).reshape(sets.shape[:-1])

    def opportunity_cost(
        self,
        step: int,
        request_type: npt.ArrayLike,
        steps_left: npt.ArrayLike,
        member: npt.ArrayLike | None = None,
        queue: npt.ArrayLike = 0,
    ) -> Floats:
        """Delta_i = V_t(R') - V_t(R' without i) for every request of each set, (..., w), money.

        It is 0 for padding and for requests without steps left, which wait no more. Arguments and errors are those of
        :meth:`post_decision_value`.

        Examples
        --------
        >>> model = SmallModel(horizon=2, reward=[30.0], penalty=[-5.0], lifetime=[1], utility=[[-10.0]], mu=[1.0],
        ...                    arrivals=[0.5], workers=[0.6, 0.4])
        >>> solve_exactly(model).opportunity_cost(0, [0, 0], [1, 0]).round(3)
        array([-0.676,  0.   ])
        """
        sets = self._sets(step, request_type, steps_left, member, queue)
        b, i = np.nonzero(sets.waits)
        fewer = sets.rows[b]
        fewer[np.arange(b.size), sets.column[b, i]] -= 1
        cost = np.zeros(sets.waits.shape)
        cost[b, i] = self._look_up(step, sets.rows, sets.queue)[b] - self._look_up(step, fewer, sets.queue[b])
        return cost.reshape(sets.shape)

    def _sets(
        self,
        step: int,
        request_type: npt.ArrayLike,
        steps_left: npt.ArrayLike,
        member: npt.ArrayLike | None,
        queue: npt.ArrayLike,
    ) -> _Sets:
        if not 0 <= step < self.model.horizon:
            raise InputError(f"step = {step} is not one of the model's steps 0..{self.model.horizon - 1}")
        named = {"request_type": request_type, "steps_left": steps_left, "queue": queue}
        given = [ints(name, x, None) for name, x in named.items()]
        mask = np.asarray(True) if member is None else mask_of("member", member)
        try:
            *lead, w = shape = np.broadcast_shapes(given[0].shape, given[1].shape, mask.shape)
            length = np.broadcast_to(given[2], lead).ravel()
        except ValueError:
            listed = ", ".join(str(x.shape) for x in (*given[:2], mask, given[2]))
            raise InputError(
                f"shapes {listed} of request_type, steps_left, member and queue do not fit: requests go last"
            ) from None
        kind, left, waits = (np.broadcast_to(x, shape).reshape(length.size, w) for x in (*given[:2], mask))
        waits = waits & (left > 0)
        columns = np.full((self.model.reward.size, self.model.horizon), -1)
        columns[tuple(self.space.kind.T)] = np.arange(len(self.space.kind))
        known = waits & (kind >= 0) & (kind < len(columns)) & (left < self.model.horizon)
        column = np.full(waits.shape, -1)
        column[known] = columns[kind[known], left[known]]
        if (column[waits] < 0).any():
            b, i = np.argwhere(waits & (column < 0))[0]
            raise InputError(f"no request of type {kind[b, i]} has {left[b, i]} steps left after a step of this model")
        if ((length < 0) | (length > self.model.queue)).any():
            raise InputError(f"queue has lengths outside 0..{self.model.queue}, the model's")
        rows = np.zeros((length.size, len(self.space.kind)), dtype=np.int64)
        np.add.at(rows, (np.nonzero(waits)[0], column[waits]), 1)
        return _Sets(shape, rows, column, waits, length)

    def _look_up(self, step: int, rows: Ints, queue: Ints) -> Floats:
        waiting = self.space.layers[step].waiting
        place = find(waiting, rows)
        if (place < 0).any():
            counts = zip(self.space.kind.tolist(), rows[int((place < 0).argmax())].tolist(), strict=True)
            listed = ", ".join(f"{n} of type {k} with {left} left" for (k, left), n in counts if n)
            raise InputError(f"no such requests can wait after step {step}: {listed or 'none at all'}")
        return np.asarray(self.certificate.value[step][place, queue])


class _Sets(NamedTuple):
    """b sets of waiting requests of any shape (..., w): numbers by kind (b, M); each one's column, and if it waits."""

    shape: tuple[int, ...]
    rows: Ints
    column: Ints
    waits: npt.NDArray[np.bool_]
    queue: Ints


def solve_exactly(model: SmallModel, *, limit: int = STATE_LIMIT) -> ExactSolution:
    """Solve a small model by backward induction over all of its states.

    The policy that follows is the best of those that know the model and see, besides open requests and the worker, how
    many workers wait. With ``queue=0`` nobody ever waits, so it is the best of all that :func:`optkit.simulate` takes.

    Parameters
    ----------
    model : SmallModel
        The model.
    limit : int
        Number of states over all steps beyond which the model is refused.

    Returns
    -------
    ExactSolution
        With ``value``, ``states``, ``post_decision_value`` and ``opportunity_cost``.

    Raises
    ------
    InputError
        If the model has more states than ``limit``.

    Examples
    --------
    >>> model = SmallModel(horizon=1, reward=[30.0], penalty=[0.0], lifetime=[0], utility=[[-10.0]], mu=[1.0],
    ...                    arrivals=[1.0], workers=[0.0, 1.0])
    >>> from optkit.models.pricing import optimal_prices
    >>> bool(np.isclose(solve_exactly(model).value, optimal_prices([30.0], [-10.0]).profit))
    True
    """
    space = state_space(model, limit)
    values, profits = [], []
    expected = np.zeros((1, model.queue + 1))
    for layer in reversed(space.layers):
        profit = np.zeros((len(layer.after), model.queue + 1, model.mu.size))
        for part, group, d in decisions_of(model, space, layer, expected):
            profit[part, :, group] = (d.mu * nonnegative(d).ratio).reshape(-1, model.queue + 1)
        values.append(expected)
        profits.append(profit)
        expected = expectation(model, space, layer, expected, profit)
    certificate = ExactCertificate(tuple(reversed(values)), tuple(reversed(profits)))
    return ExactSolution(model, space, certificate.check(model).bound, certificate)


def exact_value(model: SmallModel, *, limit: int = STATE_LIMIT) -> Bound:
    """Return the exact value of a small model as a bound: nobody earns more on average, and one policy earns as much.

    :func:`solve_exactly` also gives the value function, and raises the same errors.

    Parameters
    ----------
    model : SmallModel
        What is to be solved.
    limit : int
        Largest number of states.

    Returns
    -------
    Bound
        Of kind ``"exact"``. ``certificate.check(model)`` takes the model; ``solver.details`` counts the states.

    Examples
    --------
    >>> model = SmallModel(horizon=4, reward=[30.0, 50.0], penalty=[-5.0, -5.0], lifetime=[1, 2],
    ...                    utility=[[-10.0, -12.0]], mu=[1.0], arrivals=[0.5, 0.2], workers=[0.6, 0.4])
    >>> bound = exact_value(model)
    >>> round(bound.value, 3), bound.solver.details["states"]
    (19.483, 56)
    >>> verdict = bound.certificate.check(model)
    >>> verdict.bound == bound.value, bool(verdict.gap < 1e-10)
    (True, True)
    """
    started = time.perf_counter()
    solution = solve_exactly(model, limit=limit)
    layers = solution.space.layers
    details = {
        "states": solution.states,
        "largest_step": max(len(layer.after) for layer in layers) * (model.queue + 1),
        "kinds": len(solution.space.kind),
        "queue_lengths": model.queue + 1,
    }
    record = SolverRecord("backward induction", "certified", time.perf_counter() - started, details)
    return Bound(solution.value, "exact", solution.certificate, record)
