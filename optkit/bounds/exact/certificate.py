"""The proof of an exact value: tables of values that no policy beats, checked state by state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from optkit.basics.arrays import Floats, real
from optkit.basics.errors import InputError
from optkit.bounds.bound import Verdict
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.exact.states import Layer, StateSpace, state_space
from optkit.bounds.rounding import EPS, proven_rise, sum_up
from optkit.models.choice import softmax_with_outside
from optkit.models.decision import Decisions

_CHUNK = 1_000_000
"""Alternatives that are priced at once, for the sake of memory."""


@dataclass(frozen=True, eq=False)
class ExactCertificate:
    """Value tables that no policy beats, and bounds on the profit of every single decision.

    The proof: ``profit[t]``, or a little more (:func:`optkit.bounds.rounding.proven_rise`), bounds phi at every state
    and group, given the differences of ``value[t]``, because the dual of one decision says so; then ``value[t - 1]``
    need only be at least the expectation of F + profit. Where it falls short by at most d, adding d to that whole table
    mends it and leaves all differences as they are, so the bound is the expectation at the start plus the shortfalls of
    all steps, and the rounding of all that is computed here.

    Attributes
    ----------
    value : tuple of (P_t, Q + 1) float
        V_t by waiting requests, in the order of :attr:`optkit.bounds.exact.small_model.Layer.waiting`, and by length of
        the queue after the decision; money.
    profit : tuple of (S_t, Q + 1, D) float
        Bounds on phi by open requests, length of the queue after the decision, and group; money.
    """

    proves = "exact"

    value: tuple[Floats, ...] = field(repr=False)
    profit: tuple[Floats, ...] = field(repr=False)

    def check(self, model: SmallModel) -> Verdict:
        """Recompute everything from the model and these tables; nothing is optimised.

        Parameters
        ----------
        model : SmallModel
            Its states are listed anew.

        Returns
        -------
        Verdict
            ``bound`` is ``inf`` if the tables are so far off that floating point ends. ``attained`` is what a policy
            really earns, on average, that offers ``max(0, v_i - mu - profit)`` as these tables have it; it sees the
            queue.

        Raises
        ------
        InputError
            If a table does not have the shape that the model's states need, or holds NaN or infinity.
        """
        space, values, profits = self._space(model)
        raised: list[float] = []
        needed = earned = np.zeros((1, model.queue + 1))
        for step in reversed(range(model.horizon)):
            layer, value, profit = space.layers[step], values[step], profits[step]
            with np.errstate(over="ignore", invalid="ignore"):
                gap = float((needed - value).max())
                far = float(np.abs(value).max())
                raised.append(float(np.maximum(0.0, gap)) + 2.0 * EPS * (float(np.abs(needed).max()) + far))
                policy, rise = np.zeros(profit.shape), 0.0
                for part, group, d in decisions_of(model, space, layer, value):
                    ratio = profit[part, :, group].reshape(-1, 1) / d.mu
                    more = proven_rise(d, ratio, _error(model, d, ratio, group, far))
                    rise = float(np.maximum(rise, (d.mu * more).max(initial=0.0)))
                    ratio = ratio + more
                    price = np.maximum(0.0, d.value - d.mu * (1.0 + ratio))
                    real = _worth(model, space, layer, earned, part)
                    acceptance, _ = softmax_with_outside(
                        np.where(np.isneginf(d.advantage), -np.inf, d.logit + price / d.mu)
                    )
                    policy[part, :, group] = (acceptance * (real - price)).sum(axis=1).reshape(-1, model.queue + 1)
                raised.append(rise)
                needed = expectation(model, space, layer, value, profit)
                expired = float(layer.count.sum(axis=1).max(initial=0) * np.abs(model.penalty).max())
                money = far + float(np.abs(profit).max(initial=0.0)) + expired
                raised.append(2.0 * EPS * _sums(model, layer) * (money + sum(raised)))
                earned = expectation(model, space, layer, earned, policy)
        attained = float(earned[0, 0])
        return Verdict(sum_up([needed[0, 0], *raised]), attained if np.isfinite(attained) else -np.inf, 0.0)

    def _space(self, model: SmallModel) -> tuple[StateSpace, list[Floats], list[Floats]]:
        """Return the model's states, and the tables as floats, which are what is proven, whatever was given."""
        value, profit = (
            [real(f"{name}[{t}]", table, accept="any") for t, table in enumerate(tables)]
            for name, tables in (("value", self.value), ("profit", self.profit))
        )
        alien = InputError("the certificate's tables do not fit the states of this model: it is another model's")
        try:
            space = state_space(model, limit=sum(table.size for table in profit))
        except InputError:
            raise alien from None
        Q, D = model.queue, model.mu.size
        values = [(len(layer.waiting), Q + 1) for layer in space.layers]
        profits = [(len(layer.after), Q + 1, D) for layer in space.layers]
        if [table.shape for table in (*value, *profit)] != [*values, *profits]:
            raise alien
        if not all(np.isfinite(table).all() for table in (*value, *profit)):
            raise InputError("the certificate's tables hold NaN or infinity: they prove nothing")
        return space, value, profit


def decisions_of(
    model: SmallModel, space: StateSpace, layer: Layer, value: Floats
) -> Iterator[tuple[slice, int, Decisions]]:
    """Yield what is decided in a step: a slice of c states, a group, and its c (Q + 1) decisions."""
    lengths, w = model.queue + 1, layer.kind.shape[1]
    per = max(1, _CHUNK // (lengths * max(w, 1)))
    request_type = space.kind[:, 0]
    for start in range(0, len(layer.after), per):
        part = slice(start, start + per)
        count = np.repeat(layer.count[part], lengths, axis=0)
        kind = np.repeat(layer.kind[part], lengths, axis=0)
        v, offered = _worth(model, space, layer, value, part), count > 0
        copies = np.log(np.maximum(count, 1))
        for group in range(model.mu.size):
            relative = (model.utility[group] - model.outside_by_group[group])[request_type][kind]
            mu = np.full((len(v), 1), model.mu[group])
            advantage = np.where(offered, (v + relative) / mu + copies, -np.inf)
            yield part, group, Decisions((len(v),), v, relative / mu + copies, mu, offered, advantage)


def _error(model: SmallModel, d: Decisions, ratio: Floats, group: int, far: float) -> Floats:
    """Rounding of each request's worth and exponent, (S, n), in units of mu, where values reach ``far``, in money."""
    money = 8.0 * float(np.abs(model.reward).max() + np.abs(model.penalty).max()) + 12.0 * far
    outside = 8.0 * abs(float(model.outside_by_group[group]))
    return np.asarray(EPS * ((money + outside) / d.mu + 4.0 * np.abs(ratio) + 4.0 * np.abs(d.logit) + 8.0))


def _sums(model: SmallModel, layer: Layer) -> int:
    """Number of terms that are added up, one after the other, for an expectation."""
    outcomes = sum(stream.probability.size for stream in model.streams)
    return int(layer.count.shape[1] + 2 * (model.queue + 1) + model.mu.size + outcomes + 8)


def _worth(model: SmallModel, space: StateSpace, layer: Layer, value: Floats, part: slice) -> Floats:
    """v_i: what serving one request of each kind now is worth before paying for it, (c (Q + 1), w), money."""
    request_type, left = space.kind.T
    gain = model.reward[request_type] - np.where(left == 0, model.penalty[request_type], 0.0)
    opportunity_cost = value[layer.after[part]][:, None] - value[layer.after_serving[part]]
    v = gain[layer.kind[part]][..., None] - opportunity_cost
    c, w, lengths = v.shape
    return np.ascontiguousarray(v.swapaxes(1, 2)).reshape(c * lengths, w)


def expectation(model: SmallModel, space: StateSpace, layer: Layer, value: Floats, profit: Floats) -> Floats:
    """E[F + 1[worker] profit] over what the next step brings, by sets that waited and length of the queue, money."""
    request_type, left = space.kind.T
    penalty = np.where(left == 0, model.penalty[request_type], 0.0)
    expired = (layer.count * penalty[layer.kind]).sum(axis=1, keepdims=True)
    change, seen = model.queue_transitions()
    table = (expired + value[layer.after]) @ change.T + (profit @ np.asarray(model.share)) @ seen.T
    for stream, leads_to in zip(reversed(model.streams), reversed(layer.enters), strict=True):
        joined = np.zeros((len(leads_to), table.shape[1]))
        for outcome, p in enumerate(stream.probability):
            joined += p * table[leads_to[:, outcome]]
        table = joined
    return np.asarray(table)
