r"""Workers and the requests open to them as one market, and its Lagrangian dual in closed form.

The arrival-information bound (``docs/explanation/bounds.md``) is the concave program, over the probability P_ti that
the worker of step t takes request i and the probability P_t0 that he takes none,

.. math:: \max \sum_i n_i \beta_i + \sum_t q_t \sum_i P_{ti} (a_{ti} - \mu_t \ln P_{ti} + \mu_t \ln P_{t0})
   \quad \text{s.t.} \quad \sum_t q_t P_{ti} \le n_i, \quad \sum_i P_{ti} + P_{t0} = 1,

with the advantage a_ti = r_i - beta_i + u_ti - u_0t. On an instance every count n_i and every presence q_t is 1; the
fluid bound of a scenario (:mod:`optkit.bounds.fluid.bound`) has expected numbers there. A price l_i >= 0 on each of the
first constraints leaves one decision per worker, which Lemma 3 of the paper solves:

.. math:: D(l) = \sum_i n_i (\beta_i + l_i) + \sum_t q_t \mu_t y_t, \qquad
   y_t = W_0\Big(\sum_i e^{(a_{ti} - l_i)/\mu_t - 1}\Big), \qquad
   \frac{\partial D}{\partial l_i} = n_i - \sum_t q_t P_{ti}(l).

D(l) is an upper bound for *every* l >= 0, so that the multipliers alone are a proof.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, floats
from optkit.bounds.bound import Verdict
from optkit.bounds.rounding import EPS, sum_up
from optkit.instances.instance import Instance
from optkit.models.pricing.closed_form import profit_ratio


@dataclass(frozen=True, eq=False)
class OpenPairs:
    """The pairs of a worker and a request that is open when he comes, sorted by worker; workers without any left out.

    Attributes
    ----------
    worker, request : (p,) int
        The two ends of each pair; the J workers with a pair are numbered 0..J-1 in the order of their steps.
    advantage : (p,) float
        a_ti, in money; ``mu_t ln n_i`` included where requests are counted.
    money : (p,) float
        Sum of the magnitudes that a_ti was computed from, for the rounding of D.
    mu : (J,) float
        Noise scale of each worker, in money.
    presence : (J,) float
        Probability q_t that the worker is there.
    count : (n,) float
        Expected number n_i of such requests.
    constant : float
        ``sum n_i beta_i``: what is earned if nothing is served, in money, rounded up.

    Examples
    --------
    >>> from optkit import scenario
    >>> market = OpenPairs.of(scenario("I.1", seed=0).sample(1, seed=1)[0])
    >>> nothing_charged = np.zeros(market.count.size)
    >>> ratio, acceptance = market.respond(nothing_charged)
    >>> bool((market.served(acceptance) > 1).any())  # several workers would take the same request
    True
    """

    worker: Ints
    request: Ints
    advantage: Floats
    money: Floats
    mu: Floats
    presence: Floats
    count: Floats
    constant: float

    @classmethod
    def of(cls, instance: Instance, presence: Floats | None = None, count: Floats | None = None) -> OpenPairs:
        """The market of one instance, noise or not.

        Parameters
        ----------
        instance : Instance
            Who could serve whom.
        presence, count : (J,), (n,) float, optional
            Probability of each worker, and expected number of each request, positive; 1 unless given. Requests of a
            kind compete with each other too: n_i of them are together worth ``mu ln n_i`` more to a worker.
        """
        worker, request = instance.pairs()
        group = instance.worker_group
        utility = instance.utility.ravel()[group[worker] * instance.n_requests + request]
        outside = instance.outside_by_group[group][worker]
        earned = (instance.reward - instance.penalty)[request]
        met = np.bincount(worker, minlength=instance.n_workers) > 0
        advantage = earned + (utility - outside)
        money = (np.abs(instance.reward) - instance.penalty)[request] + np.abs(utility) + np.abs(outside)
        constant = sum_up(instance.penalty.tolist())
        if count is not None:
            choice = instance.mu[group][worker] * np.log(count)[request]
            advantage, money = advantage + choice, money + np.abs(choice)
            constant = sum_up(np.nextafter(count * instance.penalty, np.inf).tolist())
        return cls(
            (np.cumsum(met) - 1)[worker],
            request,
            advantage,
            money,
            instance.mu[group[met]],
            np.ones(int(met.sum())) if presence is None else presence[met],
            np.ones(instance.n_requests) if count is None else count,
            constant,
        )

    @property
    def size(self) -> int:
        """Number of pairs p."""
        return self.worker.size

    @cached_property
    def starts(self) -> Ints:
        """Where the pairs of each worker begin, (J,); never empty pieces, as :meth:`numpy.ufunc.reduceat` demands."""
        return np.searchsorted(self.worker, np.arange(self.mu.size))

    @cached_property
    def by_request(self) -> tuple[npt.NDArray[np.intp], Ints, Ints]:
        """The pairs by request: order (p,), the requests that have pairs (m,), and where each one's begin (m,)."""
        order = np.argsort(self.request, kind="stable")
        met, starts = np.unique(self.request[order], return_index=True)
        return order, met, starts

    @cached_property
    def least_mu(self) -> Floats:
        """Smallest mu of the workers who meet each request, (n,), in money; infinite where nobody does."""
        order, met, starts = self.by_request
        least = np.full(self.count.size, np.inf)
        least[met] = np.minimum.reduceat(self.mu[self.worker][order], starts)
        return least

    def largest_by_worker(self, score: Floats) -> Floats:
        """Largest of each worker's entries in ``score`` (p,): the shape is (J,)."""
        return np.asarray(np.maximum.reduceat(score, self.starts))

    def largest_by_request(self, score: Floats) -> Floats:
        """Largest of 0 and of each request's entries in ``score`` (p,): the shape is (n,)."""
        order, met, starts = self.by_request
        best = np.zeros(self.count.size)
        best[met] = np.maximum(np.maximum.reduceat(score[order], starts), 0.0)
        return best

    def respond(self, multipliers: Floats, scale: float = 1.0) -> tuple[Floats, Floats]:
        """The workers' optima if serving request i costs l_i.

        Parameters
        ----------
        multipliers : (n,) float
            Prices l_i, in money.
        scale : float
            Factor on every mu: a smoother market with the same prices.

        Returns
        -------
        ratio : (J,) float
            y_t, the worker's expected profit in units of his mu; P_t0 = 1 / (1 + y_t).
        acceptance : (p,) float
            P_ti, by Lemma 3: y_t / (1 + y_t) times a softmax.
        """
        score = (self.advantage - multipliers[self.request]) / (scale * self.mu)[self.worker]
        top = self.largest_by_worker(score)
        weight = np.exp(score - top[self.worker])
        total = np.add.reduceat(weight, self.starts)
        ratio = profit_ratio(top + np.log(total))
        return ratio, weight * (ratio / (1.0 + ratio) / total)[self.worker]

    def served(self, acceptance: Floats) -> Floats:
        """How often each request is served in expectation, ``sum_t q_t P_ti``, (n,)."""
        return np.asarray(np.bincount(self.request, acceptance * self.presence[self.worker], self.count.size), float)

    def gain(self, multipliers: Floats, ratio: Floats, scale: float = 1.0) -> float:
        """``D(l) - sum n_i beta_i`` for the workers' ``ratio`` (J,) at these multipliers (n,), in money."""
        return float(self.count @ multipliers + scale * (self.presence * self.mu) @ ratio)

    def bound(self, multipliers: Floats) -> float:
        """D(l) for l >= 0 (n,), in money, rounded up so that it holds for the numbers of the instance.

        Each pair's advantage is raised by four roundings of the money that it is made of, so that pairs whom nobody
        wants need not be known well. What remains are one rounding of each of the k_t terms of a worker's sum, eight of
        1 + y_t for the special functions, and those of each term of the outer sum.
        """
        error = EPS * 4.0 * (self.money + multipliers[self.request])
        ratio, _ = replace(self, advantage=self.advantage + error).respond(multipliers)
        terms = np.diff(np.append(self.starts, self.size))
        charged, earned = self.count * multipliers, self.presence * self.mu * ratio
        inner = EPS * float(self.presence @ (self.mu * (terms + 8.0 * (1.0 + ratio))))
        return sum_up([self.constant, *charged.tolist(), *earned.tolist(), inner, 2.0 * EPS * float(charged.sum())])

    def feasible_gain(self, multipliers: Floats, ratio: Floats, acceptance: Floats) -> float:
        """What a feasible solution earns beyond ``sum n_i beta_i``, in money.

        The solution is the workers' response P at these multipliers, with every request that is served too often
        scaled down by f_i = n_i / sum_t q_t P_ti and the rest given to P_t0. At the optimum of a worker
        ``a_ti - mu ln P_ti + mu ln P_t0 = l_i + mu (1 + y_t)``, so that no large numbers are subtracted.
        """
        down = (self.count / np.maximum(self.served(acceptance), self.count))[self.request]
        kept = down * acceptance
        # P_0 grows by what is taken away; 1 - sum P would lose digits where P_0 is small.
        freed = np.add.reduceat(acceptance - kept, self.starts)
        markup = self.mu * (1.0 + ratio + np.log1p(freed * (1.0 + ratio)))
        per_unit = multipliers[self.request] + markup[self.worker] - self.mu[self.worker] * np.log(down)
        return float((self.presence[self.worker] * kept) @ per_unit)

    def verdict(self, multipliers: npt.ArrayLike) -> Verdict:
        """What multipliers (n,) prove here.

        Raises
        ------
        InputError
            If there are not n of them, or one is NaN or infinite.
        """
        given = floats("multipliers", multipliers, self.count.shape)
        prices = np.maximum(given, 0.0)
        residual = float(np.max(prices - given, initial=0.0))
        if not self.size:
            with np.errstate(over="ignore"):  # then the bound is infinite
                charged = (1.0 + 2.0 * EPS) * self.count * prices
            return Verdict(sum_up([self.constant, *charged.tolist()]), self.constant, residual)
        with np.errstate(over="ignore", invalid="ignore"):
            attained = self.constant + self.feasible_gain(prices, *self.respond(prices))
            return Verdict(self.bound(prices), attained if np.isfinite(attained) else -np.inf, residual)


@dataclass(frozen=True, eq=False)
class MultiplierCertificate:
    """A price l_i >= 0 on "request i is served at most once": a proof of an arrival-information bound.

    Whatever numbers they are, ``D(l)`` is at least what any policy earns in the mean over the workers' noise, see
    :mod:`optkit.bounds.arrival.market`; a poor choice only proves a larger bound.

    Attributes
    ----------
    multipliers : (n,) float
        l_i: what request i, served, takes away from the other workers who would serve it; in money.

    Examples
    --------
    >>> from optkit import scenario
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> free = MultiplierCertificate(np.zeros(day.n_requests)).check(day)
    >>> free.bound > free.attained
    True
    """

    proves = "arrival information"

    multipliers: Floats

    def check(self, instance: Instance) -> Verdict:
        """Recompute D(l) from the instance; its noise is not looked at.

        Returns
        -------
        Verdict
            ``bound`` is D(l), rounding included, at max(l, 0); ``attained`` is what the workers' response to l earns
            in the program after no request is served more than once; ``residual`` is how negative a multiplier is,
            in money: weak duality needs l >= 0.

        Raises
        ------
        InputError
            If there are not n multipliers, or one is NaN or infinite.
        """
        return OpenPairs.of(instance).verdict(self.multipliers)
