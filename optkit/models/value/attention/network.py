"""The paper's attention network as a function of sets of requests (section 3.3; appendix, neural network training).

Importing this module needs PyTorch; :mod:`optkit.models.value.attention.value` imports it when a value function is
made.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, silu

from optkit.basics.arrays import Floats, Ints
from optkit.basics.errors import InputError
from optkit.models.value.request_sets import KnownRequests, RequestSets

EMBEDDING, ATTENTION, HIDDEN, SET_INPUTS = 32, 64, 16, 3


class AttentionNetwork(nn.Module):  # type: ignore[misc]
    r"""Embedding, gate and head of the network, as printed.

    .. math:: e_i = \mathrm{swish}(A x_i + a), \quad \beta_i = \sigma(w \cdot \tanh(W e_i)), \quad
              C = \sum_i \beta_i e_i, \quad V = \mathrm{head}(C, s)

    with e_i of length 32, W 64 x 32, and a head of two layers of 16 units with swish and a linear output.
    s are the inputs that describe the whole set.

    Parameters
    ----------
    inputs : int
        Length of x_i.
    """

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.embed = nn.Linear(inputs, EMBEDDING)
        self.W = nn.Linear(EMBEDDING, ATTENTION, bias=False)
        self.w = nn.Linear(ATTENTION, 1, bias=False)
        self.layer1 = nn.Linear(EMBEDDING + SET_INPUTS, HIDDEN)
        self.layer2 = nn.Linear(HIDDEN, HIDDEN)
        self.output = nn.Linear(HIDDEN, 1)

    def terms(self, x: Tensor) -> Tensor:
        """What each request adds to the context, beta_i e_i, (m, 32)."""
        e = silu(self.embed(x))
        gate: Tensor = torch.sigmoid(self.w(torch.tanh(self.W(e))))
        return gate * e

    def head(self, context: Tensor, s: Tensor) -> Tensor:
        """Output for contexts (r, 32) and set inputs (r, 3), (r,)."""
        z = torch.cat([context, s], dim=1)
        value: Tensor = self.output(silu(self.layer2(silu(self.layer1(z)))))
        return value[:, 0]


@dataclass(frozen=True, eq=False)
class Scaling:
    """Centre and spread of the inputs, and the money that one unit of output stands for.

    Attributes
    ----------
    request_mean, request_std : (p,) float
        Of a request's inputs: features, reward, penalty, steps left, their logarithm, utility by group.
    set_mean, set_std : (3,) float
        Of a set's inputs: number of requests, steps to the most urgent deadline, step.
    unit : float
        Money per unit of output.
    """

    request_mean: Floats
    request_std: Floats
    set_mean: Floats
    set_std: Floats
    unit: float

    def of_requests(self, requests: KnownRequests, index: Ints, step: int) -> Tensor:
        """Scaled inputs of requests after the decision at a step, (m, p)."""
        x = request_inputs(requests, index, step)
        if x.shape[1] != self.request_mean.size:
            raise InputError(
                f"requests with {x.shape[1]} inputs (features and groups) do not fit a network of "
                f"{self.request_mean.size}; evaluate it on requests like those it was fitted to"
            )
        return tensor((x - self.request_mean) / self.request_std)

    def of_sets(self, inputs: Floats) -> Tensor:
        """Scaled inputs of sets, (r, 3)."""
        return tensor((inputs - self.set_mean) / self.set_std)


@dataclass(eq=False)
class FrozenAttention:
    """A network that no longer changes, as a value function of sets.

    Removing a request takes its term off the context and updates the inputs of the set, so all opportunity costs need
    one embedding of every request and one run of the small head per removal.

    Attributes
    ----------
    network : AttentionNetwork
    scaling : Scaling
    empty_is_zero : bool
        Whether the output for the empty set at the same step is taken off, so that nothing waiting is worth nothing.
    """

    network: AttentionNetwork
    scaling: Scaling
    empty_is_zero: bool
    _last: tuple[KnownRequests, int, Ints, Tensor] | None = field(default=None, init=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the table when copied: it holds on to all requests."""
        return {**self.__dict__, "_last": None}

    def value(self, sets: RequestSets) -> Floats:
        """Value of each set, (b,), money."""
        whole = self.scaling.of_sets(set_inputs(sets)[0])
        with torch.no_grad():
            v = self.network.head(self._context(sets)[0], whole)
            if self.empty_is_zero:
                nothing = self.scaling.of_sets(np.array([[0.0, 0.0, float(sets.step)]]))
                v = v - self.network.head(torch.zeros(1, EMBEDDING), nothing)
        return self._money(v)

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """V(S) - V(S without i), (b, w), money; 0 for padding."""
        whole, without = map(self.scaling.of_sets, set_inputs(sets))
        b, i = np.nonzero(sets.member)
        row = torch.from_numpy(b)
        with torch.no_grad():
            context, terms, place = self._context(sets)
            lost = self.network.head(context, whole)[row] - self.network.head(context[row] - terms[place], without)
        cost = np.zeros(sets.member.shape)
        cost[b, i] = self._money(lost)
        return cost

    def _money(self, output: Tensor) -> Floats:
        return np.asarray(self.scaling.unit * output.numpy().astype(float))

    def _context(self, sets: RequestSets) -> tuple[Tensor, Tensor, Tensor]:
        """Context of each set, (b, 32), a table of terms, and the place in it of each member, (m,), set after set."""
        known, terms = self._table(sets)
        place = torch.from_numpy(known[sets.index[sets.member]])
        return sums(terms, place, sets.member.sum(axis=1)), terms, place

    def _table(self, sets: RequestSets) -> tuple[Ints, Tensor]:
        """Place of each request in a table of terms, and that table.

        The term of a request depends on the step but not on the set. The last table is kept: targets ask about the
        same requests more than once, with and without one of them.
        """
        used = sets.index[sets.member]
        if self._last is not None:
            requests, step, place, terms = self._last
            if requests is sets.requests and step == sets.step and (place[used] >= 0).all():
                return place, terms
        flag = np.zeros(sets.requests.reward.size, dtype=bool)
        flag[used] = True
        index = np.flatnonzero(flag)
        place = np.full(flag.size, -1)
        place[index] = np.arange(index.size)
        terms = self.network.terms(self.scaling.of_requests(sets.requests, index, sets.step))
        self._last = (sets.requests, sets.step, place, terms)
        return place, terms


def sums(terms: Tensor, index: Tensor, count: npt.NDArray[np.intp]) -> Tensor:
    """Sums of ``count`` consecutive entries of ``terms[index]``, (r, 32); 0 where the count is 0."""
    if index.numel() == 0:
        return torch.zeros(len(count), EMBEDDING)
    return embedding_bag(index, terms, torch.from_numpy(np.cumsum(count) - count), mode="sum")


def request_inputs(requests: KnownRequests, index: Ints, step: int) -> Floats:
    """What a platform knows of requests that wait after a step, (m, p), before scaling."""
    left = requests.expiry[index] - float(step)
    alone = (requests.reward[index], requests.penalty[index], left, np.log(np.maximum(left, 1.0)))
    return np.column_stack([requests.features[index], *alone, requests.utility[:, index].T])


def set_inputs(sets: RequestSets) -> tuple[Floats, Floats]:
    """Number of requests, steps to the most urgent deadline (0 if there are none) and step, before scaling.

    Returns
    -------
    whole : (b, 3) float
        Of each set.
    without : (m, 3) float
        Of each set without each of its m members in turn, in the order of ``np.nonzero(sets.member)``.
    """
    count = sets.member.sum(axis=1)
    left = np.where(sets.member, sets.steps_left, np.inf)
    first, second = _two_smallest(left)
    b, i = np.nonzero(sets.member)
    # A deadline that several share stays when one of them goes: then the second smallest is the same number.
    next_ = np.where(left[b, i] == first[b], second[b], first[b])
    step = float(sets.step)

    def columns(n: npt.NDArray[np.intp], urgent: Floats) -> Floats:
        return np.column_stack([n, np.where(n > 0, urgent, 0.0), np.full(n.size, step)])

    return columns(count, first), columns(count[b] - 1, next_)


def _two_smallest(x: Floats) -> tuple[Floats, Floats]:
    padded = np.pad(x, ((0, 0), (0, max(0, 2 - x.shape[1]))), constant_values=np.inf)
    least = np.partition(padded, 1, axis=1)
    return least[:, 0], least[:, 1]


def tensor(x: Floats) -> Tensor:
    """Return single-precision numbers as a tensor."""
    return torch.from_numpy(np.ascontiguousarray(x, dtype=np.float32))
