r"""Backward induction over the subsets of open requests, for one who knows all arrivals but no worker's noise.

Who knows when every request and every worker comes needs one thing more to decide: which of the open requests are
still unserved. With :math:`W_j(S)` what worker j and all later ones add to letting the requests S expire, and
:math:`F_j(S) = W_{j+1}((S \setminus \text{expired}) \cup \text{arrived})` the same after the decision,

.. math:: W_j(S) = F_j(S) + \varphi_j(v), \qquad v_i = r_i - \beta_i - (F_j(S) - F_j(S \setminus i)), \quad i \in S,

where phi is the optimal profit of one decision (:mod:`optkit.models.pricing.closed_form`): the penalties are a
constant, and serving a request spares its own. The value is ``sum_i beta_i + W_0``. The subsets are those of
:mod:`optkit.bounds.arrival.lattice`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optkit.basics.arrays import Bools, Floats, Ints, floats, real
from optkit.basics.errors import InputError
from optkit.bounds.arrival.lattice import Stage, reachable
from optkit.bounds.rounding import EPS, TINY, sufficient_rise, sum_up
from optkit.instances.instance import Instance
from optkit.models.choice import softmax_with_outside
from optkit.models.decision import Decisions
from optkit.models.pricing import closed_form

Charge = Callable[[int, Ints], Floats]
"""``charge(step, requests)``: what knowing the next step's arrivals is charged with, (2^k,) money.

It is called once for each step after which k > 0 requests wait, from the last step to the first; entry S is for the
subset S of ``requests`` (k,) that waits, bit p of S standing for ``requests[p]``.
"""

CHUNK = 1 << 10
"""States priced at once where their alternatives are laid out one by one: the arrays stay in the cache."""

NEVER_HELD = 1e300
"""Value, in money, of a request whose price may have either sign: no markup lies above it."""

LOG_EPS = float(np.log(EPS))
LARGEST = 600.0
"""Log-odds up to which weights are summed as they are."""

LAST_DIGITS = 1e-10
"""Part of a profit that rounding may add before it is taken off what a policy is said to earn."""

ENOUGH = 1e-8
"""Rise of a table's profits, in units of mu, up to which they count as solved: rounding is far below it."""


@dataclass(frozen=True, eq=False)
class LatticeOffers:
    """Some states of a stage, with every alternative laid out in a column of its own.

    Attributes
    ----------
    decisions : Decisions
        The pricing problems, one a row.
    value : (S, k + c) float
        v_i, in money, also of requests whose price may have either sign.
    offered : (S, k + c) bool
        Which requests the state holds.
    stay, leave : (S,) and (S, k + c) int
        Where the next stage's table has the state after nobody, or the request of the column, is served.
    """

    decisions: Decisions
    value: Floats
    offered: Bools
    stay: Ints
    leave: Ints

    def prices(self, ratio: Floats) -> tuple[Floats, Floats, Floats]:
        """Best prices if the profit were mu * ratio (S, 1): compensation, acceptance (S, k + c), rejection (S, 1)."""
        d = self.decisions
        held = d.value < d.mu * (1.0 + ratio)
        compensation = np.where(held, 0.0, self.value - d.mu * (1.0 + ratio))
        odds = np.where(held, d.logit, d.advantage - 1.0 - ratio)
        return compensation, *softmax_with_outside(np.where(self.offered, odds, -np.inf))


@dataclass(frozen=True, eq=False)
class SubsetProgram:
    """The backward induction, and the check of what it found.

    Attributes
    ----------
    instance : Instance
        Requests, workers and preferences.
    stages : list of Stage
        From :func:`stages`.
    multipliers : (n,) float
        l_i, in money: what serving the request costs on top; it is paid back at the start. 0 where it is tracked.
    signed : (n,) bool
        Whose compensation must be at least 0.
    """

    instance: Instance
    stages: list[Stage]
    multipliers: Floats
    signed: Bools

    @cached_property
    def worth(self) -> Floats:
        """What serving a request once is worth before paying for it, r - beta - l, (n,), money."""
        return np.asarray(self.instance.reward - self.instance.penalty - self.multipliers)

    @cached_property
    def constant(self) -> float:
        """What is earned if nothing is ever served, sum of beta + l, money."""
        return float((self.instance.penalty + self.multipliers).sum())

    def tables(self, charge: Charge | None = None) -> list[Floats]:
        """Solve: W of every stage, (2^k,) each, in money on top of :attr:`constant`.

        Parameters
        ----------
        charge : callable, optional
            See :data:`Charge`; the stages must then be every step.

        Raises
        ------
        InputError
            If a charge has another shape than (2^k,), or an entry that is not finite.
        """
        later, found = np.zeros(1), []
        for stage in reversed(self.stages):
            found.append(self._before(stage, later))
            later = found[-1] - _charge_before(stage, charge)
        return found[::-1]

    def _before(self, stage: Stage, later: Floats) -> Floats:
        """W of a stage from F's table, both in money."""
        kept = later.take(stage.after)
        if stage.worker < 0:
            return kept
        mu, logit = self._preferences(stage)
        value = self.worth[stage.requests] / mu
        scaled = kept / mu
        total = np.zeros(stage.states)
        with np.errstate(over="ignore", divide="ignore"):
            for i, shape, loss in _losses(stage, scaled, later, mu, range(value.size)):
                total.reshape(shape)[:, -1] += np.exp(value[i] + logit[i] - loss)
            ratio = closed_form.profit_ratio(np.log(total))
        hard = np.isinf(total)
        ratio[hard] = 0.0
        reach = 1.0 + np.abs(value) + ratio.max() + (scaled.max() - scaled.min())
        signed = np.flatnonzero(self._may_be_held(stage, logit, reach))
        if signed.size:
            short, weight = np.zeros(stage.states), np.exp(np.minimum(logit, 600.0))
            for i, shape, loss in _losses(stage, scaled, later, mu, signed.tolist()):
                x = np.minimum(value[i] - loss - ratio.reshape(shape)[:, -1], 1.0)
                short.reshape(shape)[:, -1] += weight[i] * (np.exp(x - 1.0) - x)
            # One Newton step with the slope of the free form: it errs by less than step * (step + sum of w).
            step = short / (1.0 + ratio)
            with np.errstate(over="ignore"):  # then the state is a hard one
                hard |= ~(step * (step + weight[signed].sum()) <= EPS)
            ratio -= step
        for rows in _chunks(np.flatnonzero(hard)):
            ratio[rows] = closed_form.nonnegative(self.offers(stage, later, rows).decisions).ratio[:, 0]
        return np.asarray(kept + mu * ratio)

    def _preferences(self, stage: Stage) -> tuple[float, Floats]:
        """Scale mu of the worker, in money, and log-odds of the stage's requests at compensation 0, (k + c,)."""
        group = self.instance.worker_group[stage.worker]
        mu = float(self.instance.mu[group])
        return mu, (self.instance.utility[group, stage.requests] - self.instance.outside_by_group[group]) / mu

    def offers(self, stage: Stage, later: Floats, rows: Ints) -> LatticeOffers:
        """Lay out the decisions in some subsets of a stage with a worker, from the table of F."""
        mu, logit = self._preferences(stage)
        has = np.ones((rows.size, stage.requests.size), bool)
        has[:, : stage.uncertain] = rows[:, None] >> np.arange(stage.uncertain) & 1
        stay = stage.after[rows]
        leave = stay[:, None] - stage.kept * has
        value = self.worth[stage.requests] - (later[stay][:, None] - later[leave])
        logit = np.broadcast_to(logit, value.shape)
        advantage = np.where(has, value / mu + logit, -np.inf)
        bounded = np.where(self.signed[stage.requests], value, NEVER_HELD)
        d = Decisions((rows.size,), bounded, logit, np.full((rows.size, 1), mu), has, advantage)
        return LatticeOffers(d, value, has, stay, leave)

    def check(self, tables: list[Floats], charge: Charge | None = None) -> tuple[float, float]:
        """Prove a bound from tables, wherever they come from, and evaluate the policy that they imply.

        A table bounds a stage if ``R = W - F`` bounds each state's profit, for which the dual constraint of one
        decision is enough (:func:`optkit.bounds.rounding.sufficient_rise`). What a table is short of is added to all
        its states and those of earlier stages alike, where it changes nothing. The rounding of all that is computed
        here is added too, so that the bound holds for the numbers of the instance and of the tables.

        Parameters
        ----------
        tables : list of (2^k,) float
            One per stage, in money.
        charge : callable, optional
            As for :meth:`tables`.

        Returns
        -------
        bound, attained : float
            Money; infinite, and minus infinite, if the tables are so far off that floating point ends.

        Raises
        ------
        InputError
            If a table has the wrong shape or an entry that is not finite.
        """
        tables = [floats(f"the table of stage {k}", table, (None,)) for k, table in enumerate(tables)]
        if len(tables) != len(self.stages):
            raise InputError(f"{len(tables)} tables for {len(self.stages)} stages: give one per stage")
        later, earned, raised = np.zeros(1), np.zeros(1), []
        states = reachable(self.stages)
        for stage, table, rows in zip(reversed(self.stages), reversed(tables), reversed(states), strict=True):
            if table.shape != (stage.states,):
                raise InputError(
                    f"the table of step {stage.step} has shape {table.shape}; it needs {stage.states} finite numbers"
                )
            kept, after = later[stage.after], earned[stage.after]
            with np.errstate(over="ignore", invalid="ignore"):
                needed = kept
                if stage.worker >= 0:
                    mu = float(self.instance.mu[self.instance.worker_group[stage.worker]])
                    ratio = (table - kept) / mu
                    rise, profit = self._prove(stage, ratio, later, earned)
                    if not (rise[rows] <= ENOUGH).all():  # too low: the optimal profit in its place
                        ratio = np.fmax(ratio, (self._before(stage, later) - kept) / mu)
                        rise, profit = self._prove(stage, ratio, later, earned)
                    needed, after = kept + mu * (ratio + rise), after + profit
                size = sum(np.abs(x[rows]).max() for x in (needed, kept, table))
                raised.append(float(np.maximum(0.0, (needed - table)[rows].max()) + 4.0 * EPS * size))
                z = _charge_before(stage, charge)
                later, earned = table - z, after - z
                raised.append(EPS * float(np.abs(later).max()) if np.ndim(z) else 0.0)
        start = float(tables[0][0]) if tables else 0.0
        bound = sum_up([*self.instance.penalty, *self.multipliers, start, *raised])
        attained = self.constant + float(earned[0])
        return bound, attained if np.isfinite(attained) else -np.inf

    def _prove(self, stage: Stage, ratio: Floats, later: Floats, earned: Floats) -> tuple[Floats, Floats]:
        """How much profits mu * ratio must rise to be proven, in units of mu, and what their policy earns, money.

        Both for all subsets (2^k,), request by request as in :meth:`_before`, from the table of F and from that of the
        policy's own future. ``error`` covers the rounding of a request's exponent and of x, so that terms that are too
        small to count need not be known well.
        """
        mu, logit = self._preferences(stage)
        group, i = self.instance.worker_group[stage.worker], stage.requests
        value, scaled, own = self.worth[i] / mu, later.take(stage.after) / mu, earned.take(stage.after) / mu
        far = float(np.abs(later).max()) / mu
        steep = float(np.abs(ratio).max())
        money = (np.abs(self.instance.reward) + np.abs(self.instance.penalty) + self.multipliers)[i] / mu
        wish = (np.abs(self.instance.utility[group, i]) + abs(self.instance.outside_by_group[group])) / mu
        error = EPS * (8.0 * money + 12.0 * far + 4.0 * steep + 4.0 * wish + 8.0)
        signed = self._may_be_held(stage, logit, 1.0 + np.abs(value) + 2.0 * far + steep)
        lift = self._lift(stage, np.where(signed, logit, 0.0))
        one = np.exp(-lift)
        alone = (np.arange(value.size) >= stage.uncertain) & (stage.kept == 0) & ~signed
        above, below, slope, gained, doubt = (np.zeros(stage.states) for _ in range(5))
        if alone.any():  # requests that nobody's service changes anything for are one
            top = (value + logit - 1.0 + error)[alone]
            joint = top.max() + np.log(np.exp(top - top.max()).sum()) + EPS * (top.size + 4.0 + 4.0 * np.abs(top.max()))
            above += np.exp(joint - ratio + EPS * (2.0 * np.abs(joint) + 2.0 * steep) - lift)
            slope += above * np.exp(-4.0 * error[alone].max())
            doubt += 4.0 * error[alone].max() * above * (1.0 + np.abs(ratio))
        others = np.flatnonzero(~alone).tolist()
        losses = _losses(stage, scaled, later, mu, others)
        theirs = _losses(stage, own, earned, mu, others)
        for (k, shape, loss), (_, _, lost) in zip(losses, theirs, strict=True):
            x = value[k] - loss - ratio.reshape(shape)[:, -1] + error[k]
            offset = logit[k] + error[k] - 1.0 - (lift.reshape(shape)[:, -1] if lift.ndim else lift)
            sure = np.exp(-4.0 * error[k])
            if signed[k]:
                q = np.exp(np.maximum(x, 1.0) + offset)
                term = q * np.minimum(x, 1.0)
                negative = np.minimum(term, 0.0)
                above.reshape(shape)[:, -1] += term - negative
                below.reshape(shape)[:, -1] += sure * negative
            else:
                q = np.exp(x + offset)
                above.reshape(shape)[:, -1] += q
            slope.reshape(shape)[:, -1] += sure * q
            if np.ndim(loss) or np.ndim(lost):
                gained.reshape(shape)[:, -1] += q * (loss - lost)
            margin = np.abs(np.minimum(x, 1.0)) + np.abs(ratio.reshape(shape)[:, -1]) + np.abs(loss - lost)
            doubt.reshape(shape)[:, -1] += 4.0 * (error[k] + EPS) * q * margin
        # The policy: c = v - mu (1 + ratio), or 0, so that the margin is mu (ratio + min(x, 1)), and what F misjudges.
        # Where rounding may have added more than the last digits, it is taken off: the policy does earn what is left.
        doubt += (value.size + 16) * EPS * (above + np.abs(below) + np.abs(ratio) * slope + np.abs(gained))
        doubt = np.where(doubt > LAST_DIGITS * (one + slope) * (1.0 + np.abs(ratio)), doubt, 0.0)
        profit = mu * (above + below + ratio * slope + gained - doubt) / np.maximum(one + slope, TINY)
        rise = sufficient_rise(above, below, slope, ratio, value.size, one)
        if not rise.max() <= 1.0:
            # Weights beyond floats: pay is at least 0, so that nobody earns more than the best request is worth.
            most = np.zeros(stage.states)
            for k, shape, loss in _losses(stage, scaled, later, mu, range(value.size)):
                held = most.reshape(shape)[:, -1]
                np.maximum(held, value[k] - loss + error[k], out=held)
            rise = np.minimum(rise, np.maximum(most - ratio, 0.0) + 2.0 * EPS * (most + steep))
        return rise, profit

    def _may_be_held(self, stage: Stage, logit: Floats, reach: Floats) -> Bools:
        """Which requests may be held at compensation 0 with an effect beyond the rounding of R, (k + c,).

        A held request takes w (e^(x-1) - x) off the dual's left-hand side, where x = (v - R)/mu < 1 is at least
        ``-reach``. To leave that out is valid: the bound is looser.
        """
        return np.asarray(self.signed[stage.requests] & (logit + np.log(reach) > LOG_EPS))

    def _lift(self, stage: Stage, logit: Floats) -> Floats:
        """Exponent by which a state's weights are scaled down where they would overflow, (2^k,), or one 0 for all."""
        if logit.max(initial=0.0) <= LARGEST:
            return np.zeros(())
        lift = np.zeros(stage.states)
        for i, most in enumerate(logit):
            held = lift.reshape(_shape(stage, i))[:, -1]
            np.maximum(held, most, out=held)
        return lift


def _charge_before(stage: Stage, charge: Charge | None) -> Floats | float:
    """Charge for what the stage reveals, levied after the step before it: one entry per subset, in money."""
    if charge is None or not stage.uncertain:
        return 0.0
    given = charge(stage.step - 1, stage.requests[: stage.uncertain])
    z = real(f"the charge of step {stage.step - 1}", given, accept="any")
    if z.shape != (stage.states,) or not np.isfinite(z).all():
        raise InputError(
            f"the charge of step {stage.step - 1} has shape {z.shape}; its {stage.uncertain} requests need one finite "
            f"number per subset, ({stage.states},)"
        )
    return z


def _chunks(rows: Ints) -> Iterator[Ints]:
    for begin in range(0, rows.size, CHUNK):
        yield rows[begin : begin + CHUNK]


def _losses(
    stage: Stage, scaled: Floats, later: Floats, mu: float, columns: Iterable[int]
) -> Iterator[tuple[int, tuple[int, int, int], Floats | float]]:
    """Yield, per request, its column, the shape under which ``[:, -1]`` are the states that hold it, and its loss.

    The loss is ``(F(S) - F(S without it)) / mu``, the opportunity cost in units of the noise.
    """
    for i in columns:
        bit, shape = stage.kept[i], _shape(stage, i)
        if i < stage.uncertain:
            halves = scaled.reshape(shape)
            yield i, shape, halves[:, 1] - halves[:, 0] if bit else 0.0
        else:
            yield i, shape, scaled - later.take(stage.after - bit) / mu if bit else 0.0


def _shape(stage: Stage, i: int) -> tuple[int, int, int]:
    """Return the shape under which ``[:, -1]`` are the states that hold the request in column i."""
    return (-1, 2, 1 << i) if i < stage.uncertain else (1, 1, stage.states)
