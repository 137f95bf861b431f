"""The states of a small model, listed step by step, and how they lead to each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import prod
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Ints
from optkit.basics.errors import InputError
from optkit.bounds.exact.small_model import SmallModel

STATE_LIMIT = 1_000_000
"""States over all steps that :func:`state_space` lists unless told otherwise: seconds of work."""

BYTES = 1 << 27
"""Memory that the lists of waiting sets may take: a row has a number for every kind. The work takes some times more."""


@dataclass(frozen=True, eq=False)
class Layer:
    """The states of one step before its decision: S multisets of open requests, with up to w different kinds in each.

    A kind is a request type with a number of steps left; M kinds, the columns of :attr:`StateSpace.kind`.

    Attributes
    ----------
    enters : tuple of (X_j, m_j) int
        Where a set leads that waited through the step before: row x of the j-th table says, for each outcome of
        stream j, the row of table j + 1; of the last, the open set.
    kind, count : (S, w) int
        The kinds that are open, and how many requests of each: 0 for padding.
    after : (S,) int
        The set in ``waiting`` that remains if nobody is served.
    after_serving : (S, w) int
        The one that remains if a request of this kind is served; as ``after`` for padding.
    waiting : (P, M) unsigned int
        Multisets that may wait after the decision, as numbers of requests of each kind, steps left counted from this
        step; sorted by their bytes.
    """

    enters: tuple[Ints, ...]
    kind: Ints
    count: Ints
    after: Ints
    after_serving: Ints
    waiting: npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class StateSpace:
    """All states that a model can reach.

    Attributes
    ----------
    layers : tuple of Layer
        One for each step; steps with the same states share theirs.
    kind : (M, 2) int
        Type and steps left of each kind.
    size : int
        Number of states over all steps: open requests before the decision, times the lengths of the queue.
    """

    layers: tuple[Layer, ...] = field(repr=False)
    kind: Ints = field(repr=False)
    size: int


def state_space(model: SmallModel, limit: int = STATE_LIMIT) -> StateSpace:
    """List the states that can be reached, step by step.

    Only how many requests of each kind (type, steps left) are open matters.

    Parameters
    ----------
    model : SmallModel
        The model.
    limit : int
        Number of states over all steps beyond which the model is refused.

    Raises
    ------
    InputError
        If there are more states than ``limit``, or so many kinds that the states take more than :data:`BYTES`.

    Examples
    --------
    >>> model = SmallModel(horizon=2, reward=[30.0], penalty=[-5.0], lifetime=[1], utility=[[-10.0]], mu=[1.0],
    ...                    arrivals=[0.5], workers=[0.6, 0.4])
    >>> space = state_space(model)
    >>> [layer.count.ravel().tolist() for layer in space.layers], space.size  # up to 1, then 2 open requests
    ([[0, 1], [0, 1, 2]], 5)
    """
    lifetime, lengths = np.minimum(model.lifetime, model.horizon - 1), model.queue + 1
    if model.horizon * lengths > limit:
        raise _too_many(model, f"by step {model.horizon - 1}", limit)
    if float(lifetime.sum()) > BYTES:
        raise _too_wide(model, "by step 0")
    of_type = np.repeat(np.arange(lifetime.size), lifetime + 1)
    kind = np.column_stack([of_type, np.arange(of_type.size) - np.searchsorted(of_type, of_type)])
    first = np.flatnonzero(kind[:, 1] == 0)
    most = sum(int(stream.count.max(initial=0)) * int(lifetime.max() + 1) for stream in model.streams)
    rows: npt.NDArray[Any] = np.zeros((1, len(kind)), dtype=np.min_scalar_type(most + 1))
    layers: list[Layer] = []
    size, taken = 0, 0
    entry, arriving = rows, np.zeros(0, dtype=np.int64)
    for step in range(model.horizon):
        column = first + np.minimum(lifetime, model.horizon - 1 - step)
        if layers and np.array_equal(rows, entry) and np.array_equal(column, arriving):
            layers.append(layers[-1])
        else:
            entry, arriving = rows, column
            room = _Room(model, f"by step {step}", limit, (limit - size) // lengths, (BYTES - taken) // rows[0].nbytes)
            layers.append(_layer(model, kind, rows, column, room))
            taken += layers[-1].waiting.nbytes
        rows = layers[-1].waiting
        size += lengths * len(layers[-1].after)
        if size > limit:
            raise _too_many(model, f"by step {step}", limit)
    return StateSpace(tuple(layers), kind, size)


class _Room(NamedTuple):
    """How many more sets may be listed: as states, and as rows that fit into the memory."""

    model: SmallModel
    when: str
    limit: int
    states: int
    rows: int

    def check(self, sets: int) -> None:
        """Raise an InputError if these are too many."""
        if sets > self.states:
            raise _too_many(self.model, self.when, self.limit)
        if sets > self.rows:
            raise _too_wide(self.model, self.when)


def _layer(model: SmallModel, kind: Ints, rows: Any, column: Ints, room: _Room) -> Layer:
    # One step nearer to expiry: the columns of a type move to the left.
    open_ = np.zeros_like(rows)
    later = np.flatnonzero(kind[:, 1] > 0)
    open_[:, later - 1] = rows[:, later]
    # Requests of a kind that nobody has yet make all combinations different; else those with one set still are.
    outcomes = prod(len(stream.count) for stream in model.streams)
    room.check(outcomes if open_[:, column].any() else outcomes * len(open_))
    enters = []
    for stream in model.streams:
        coming = np.zeros((len(stream.count), len(kind)), dtype=rows.dtype)
        coming[:, column] = stream.count
        joined = open_[:0]
        per = max(1, min(2_000_000, BYTES // open_[0].nbytes) // len(open_))  # outcomes at a time, to save memory
        for s in range(0, len(coming), per):
            new = (open_[:, None] + coming[s : s + per]).reshape(-1, len(kind))
            joined = _distinct(np.concatenate([joined, new]))
            room.check(len(joined))
        place = [find(joined, open_ + one) for one in coming]
        enters.append(np.stack(place, axis=1))
        open_ = joined
    kinds, count = _compact(open_)
    stays = open_.copy()
    stays[:, kind[:, 1] == 0] = 0
    waiting, missing = _distinct(stays), [stays]
    after_serving = np.empty(kinds.shape, dtype=np.int64)
    while missing:
        missing = []
        after = find(waiting, stays)
        for slot in range(kinds.shape[1]):
            left, served = stays.copy(), np.flatnonzero(count[:, slot])
            position = kinds[served, slot]
            left[served, position] -= kind[position, 1] > 0
            after_serving[:, slot] = find(waiting, left)
            missing += [left[after_serving[:, slot] < 0]] if (after_serving[:, slot] < 0).any() else []
        if missing:
            waiting = _distinct(np.concatenate([waiting, *missing]))
    return Layer(tuple(enters), kinds, count, after, after_serving, waiting)


def _too_many(model: SmallModel, when: str, limit: int) -> InputError:
    return InputError(
        f"the model has more than {limit} states {when} of {_of_what(model)}: take fewer or "
        "shorter-lived types, a shorter horizon, or raise limit="
    )


def _too_wide(model: SmallModel, when: str) -> InputError:
    return InputError(
        f"the model's states, with a number for each kind, take more than {BYTES >> 20} MB {when} of "
        f"{_of_what(model)}: take fewer or shorter-lived types, or a shorter horizon"
    )


def _of_what(model: SmallModel) -> str:
    kinds = int((np.minimum(model.lifetime, model.horizon - 1) + 1).sum())
    most = sum(int(stream.count.sum(axis=1).max()) for stream in model.streams)
    return (
        f"{model.horizon}, with up to {most} arrivals a step, {kinds} kinds of request (type, steps left) and "
        f"{model.queue + 1} lengths of the queue"
    )


def find(rows: npt.NDArray[Any], wanted: npt.NDArray[Any]) -> Ints:
    """Positions (b,) in sorted distinct ``rows`` (P, M) of ``wanted`` (b, M); -1 where a row is not among them.

    Examples
    --------
    >>> find(np.array([[0, 1], [2, 0]], dtype=np.uint8), np.array([[2, 0], [1, 1]])).tolist()
    [1, -1]
    """
    # No row holds the largest number of its type: clipping cannot make a wanted row one that is there.
    table, key = _keys(rows), _keys(np.minimum(wanted, np.iinfo(rows.dtype).max).astype(rows.dtype))
    at = np.minimum(np.searchsorted(table, key), len(table) - 1)
    return np.where(table[at] == key, at, -1)


def _compact(rows: npt.NDArray[Any]) -> tuple[Ints, Ints]:
    """Columns that are not 0 and what stands there, packed to the left, (S, w) each; 0 and 0 for padding."""
    row, column = np.nonzero(rows)
    slot = np.arange(row.size) - np.searchsorted(row, np.arange(len(rows)))[row]
    place, number = np.zeros((2, len(rows), int(slot.max(initial=-1)) + 1), dtype=np.int64)
    place[row, slot], number[row, slot] = column, rows[row, column]
    return place, number


def _distinct(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the different rows, sorted by their bytes."""
    return np.asarray(rows[np.unique(_keys(rows), return_index=True)[1]])


def _keys(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """One sortable key of raw bytes for each row."""
    return np.ascontiguousarray(rows).view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1])))[:, 0]
