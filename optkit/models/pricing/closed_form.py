r"""The optimal markup in closed form: Lambert's W, with and without non-negative compensations.

Everything works on ratios to mu and on logarithms, so that nothing overflows while the ratios are finite. With
a_i = v_i + u_i - u_0 and w_i = exp((u_i - u_0)/mu), a set C of requests held at compensation 0 and the others free
(``docs/explanation/nonnegative.md``):

.. math:: \frac{m}{\mu} = 1 + s + W_0\!\Big(\tfrac{1}{1+W_C} \sum_{i \notin C} e^{a_i/\mu - 1 - s}\Big), \qquad
          W_C = \sum_{i \in C} w_i, \quad s = \frac{\sum_{i \in C} w_i v_i}{\mu (1 + W_C)}

With C empty this is Lemma 3 of the paper. The functions take and return flattened arrays, see
:class:`optkit.models.decision.Decisions`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import wrightomega

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.models.decision import Decisions


@dataclass(frozen=True)
class Solution:
    """Optimum of S decisions: ``ratio`` = profit / mu (S, 1), acceptance (S, n), rejection (S, 1), held at 0 (S, n)."""

    ratio: Floats
    acceptance: Floats
    rejection: Floats
    held: Bools | None


def profit_ratio(log_total: Floats) -> Floats:
    """Optimal profit of free prices in units of mu, y = W0(sum_i exp(a_i/mu - 1)), from log sum_i exp(a_i/mu)."""
    return np.asarray(wrightomega(log_total - 1.0), dtype=np.float64)


def unconstrained(d: Decisions) -> Solution:
    """Lemma 3: profit / mu = y = W0(sum_i exp(a_i/mu - 1)), P_0 = 1 / (1 + y), P_i = y / (1 + y) softmax_i(a/mu).

    This form of P is about twice as accurate as (mu/m) exp((a_i - m)/mu), which subtracts two large numbers.
    """
    weight, total, log_total = _exp_sum(d.advantage)
    y = profit_ratio(log_total)
    rejection = 1.0 / (1.0 + y)
    return Solution(y, weight * (y * rejection / total), rejection, None)


def nonnegative(d: Decisions) -> Solution:
    """Optimum with c >= 0: compensations max(0, v_i - m), where m = mu + profit counts the requests held at 0.

    The held requests are the k of lowest value, for one k. Fixing a trial k gives a markup m_k in closed form, and with
    k' = #{v_i < m_k}: k' = k is the optimum, k' > k proves that more than k are held, k' < k that fewer are (the root
    function of the module's equation lies between its free and its held form). So each trial halves a bracket on k at
    worst, and k' itself, the natural next trial, usually ends the search at once.
    """
    free = unconstrained(d)
    value = d.value if d.offered is None else np.where(d.offered, d.value, np.inf)
    below = value < d.mu * (1.0 + free.ratio)
    touched = np.flatnonzero(below.any(axis=1))
    if touched.size == 0:
        return free
    ratio, acceptance, rejection = free.ratio, free.acceptance, free.rejection
    held = np.zeros(value.shape, dtype=bool)
    rows, value, below = touched, value[touched], below[touched]
    rank = np.empty(value.shape, dtype=np.intp)
    np.put_along_axis(rank, np.argsort(value, axis=1), np.arange(value.shape[1])[None, :], axis=1)
    low, high = np.zeros(rows.size, dtype=np.intp), below.sum(axis=1)
    k, natural = high.copy(), True
    while rows.size:
        part = d.rows(rows)
        hold = rank < k[:, None]
        trial = _with_held(part, hold)
        implied = (value < part.mu * (1.0 + trial.ratio)).sum(axis=1)
        low, high = (
            np.where(implied > k, k + 1, np.maximum(low, np.minimum(implied, k))),
            np.where(implied < k, k - 1, np.minimum(high, np.maximum(implied, k))),
        )
        done = (implied == k) | (low > high)
        if (torn := (low > high) & (implied != k)).any():
            _settle(part, rank, k, implied, torn, hold, trial)
        end = rows[done]
        ratio[end], acceptance[end], rejection[end] = trial.ratio[done], trial.acceptance[done], trial.rejection[done]
        held[end] = hold[done]
        go = ~done
        natural = not natural
        k = np.where(natural, np.clip(implied, low, high), (low + high) // 2)[go]
        rows, value, rank, low, high = rows[go], value[go], rank[go], low[go], high[go]
    return Solution(ratio, acceptance, rejection, held)


def _settle(d: Decisions, rank: Ints, k: Ints, implied: Ints, torn: Bools, hold: Bools, trial: Solution) -> None:
    """Choose between k and its neighbour, where rounding makes each prove the other: a value is nearly the markup.

    The request in question has the value; the k whose markup is nearer to it is right. ``hold`` and ``trial`` are set.
    """
    s = np.flatnonzero(torn)
    other = k[s] + np.sign(implied[s] - k[s])
    part, there = d.rows(s), rank[s] < other[:, None]
    found = _with_held(part, there)
    edge = np.argmax(rank[s] == np.minimum(k[s], other)[:, None], axis=1)[:, None]
    value = np.take_along_axis(part.value, edge, axis=1) / part.mu - 1.0
    nearer = (np.abs(value - found.ratio) < np.abs(value - trial.ratio[s]))[:, 0]
    to = s[nearer]
    hold[to] = there[nearer]
    for name in ("ratio", "acceptance", "rejection"):
        getattr(trial, name)[to] = getattr(found, name)[nearer]


def _with_held(d: Decisions, hold: Bools) -> Solution:
    """Optimum of the module's equation for one set of held requests, right or wrong; the others' prices are free."""
    share, outside, log_outside = _held_shares(d, hold)
    s = (share * d.value).sum(axis=1, keepdims=True) / d.mu
    weight, total, log_total = _exp_sum(np.where(hold, -np.inf, d.advantage))
    # log(1 + W_C) = -log_outside, the log-share of the outside option against the held requests.
    free = log_total - 1.0 + log_outside
    y = profit_ratio(log_total + log_outside - s)
    # y + log y = free - s: where held requests ruin more than a float tells apart from y, s + y would cancel.
    ratio = np.where(y > 1.0, free - np.log(np.maximum(y, 1.0)), s + y)
    rest = 1.0 / (1.0 + y)
    return Solution(ratio, share * rest + weight * (y * rest / total), outside * rest, hold)


def dual_slack(d: Decisions, ratio: Floats, nonnegative: bool) -> Floats:
    r"""How far a bound R = mu * ratio satisfies the dual constraint, in logarithms; >= 0 certifies R, (S, 1).

    For every price c_i >= 0, ``w_i e^{c_i/mu} (v_i - c_i - R)`` is at most its value at ``c_i = max(0, v_i - mu - R)``.
    Hence any R with ``sum_i max_c w_i e^{c/mu} (v_i - c - R) <= R`` bounds the profit of every price vector: multiply
    by P_0 and add up. Without the sign constraint this is ``mu sum_i exp((a_i - R)/mu - 1) <= R``, the dual of
    ``docs/explanation/bounds.md``, "Arrival information". Divided by mu (1 + W_C): ``Y + s <= R/mu``, so the slack is
    ``log(R/mu - s) - log Y``.
    """
    if nonnegative:
        hold = d.value < d.mu * (1.0 + ratio)
        if d.offered is not None:
            hold &= d.offered
        share, _, log_outside = _held_shares(d, hold)
        s = (share * d.value).sum(axis=1, keepdims=True) / d.mu
        log_total = _exp_sum(np.where(hold, -np.inf, d.advantage))[2]
        log_y, rest = log_total - 1.0 - ratio + log_outside, ratio - s
    else:
        log_y, rest = _exp_sum(d.advantage)[2] - 1.0 - ratio, ratio
    with np.errstate(divide="ignore"):
        log_rest = np.log(np.maximum(rest, 0.0))
    # exp(log_y) is 0 in floating point where log_y is below -745; then any R >= mu s is feasible.
    return np.where(log_y < -745.0, np.where(rest >= 0, 1.0, -1.0), log_rest - np.where(log_y < -745.0, 0.0, log_y))


def _held_shares(d: Decisions, hold: Bools) -> tuple[Floats, Floats, Floats]:
    """Shares of the held requests (S, n) and of the outside option (S, 1) among them, and the latter's logarithm."""
    logit = np.where(hold, d.logit, -np.inf)
    top = np.maximum(logit.max(axis=1, keepdims=True, initial=0.0), 0.0)
    weight = np.exp(logit - top)
    total = weight.sum(axis=1, keepdims=True) + np.exp(-top)
    return weight / total, np.exp(-top) / total, -top - np.log(total)


def _exp_sum(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Row-wise exponentials relative to the largest entry, their sum (1 for an empty row), the log of the full sum."""
    top = x.max(axis=1, keepdims=True, initial=-np.inf)
    if x.shape[1] and np.isfinite(top).all():
        weight = np.exp(x - top)
        total = weight.sum(axis=1, keepdims=True)
        return weight, total, top + np.log(total)
    empty = np.isneginf(top)
    weight = np.exp(x - np.where(empty, 0.0, top))
    total = np.where(empty, 1.0, weight.sum(axis=1, keepdims=True))
    return weight, total, np.where(empty, -np.inf, top + np.log(total))
