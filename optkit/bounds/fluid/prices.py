"""Bid prices: what waiting requests are worth at the optimum of a scenario's fluid bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Known
from optkit.basics.errors import InputError
from optkit.bounds.bound import Bound
from optkit.bounds.fluid.bound import FluidCertificate, FluidModel

ENOUGH = 1e-12
"""How far above 1 the logarithm of a request's expected services may end."""

NEWTON = 100
"""Most Newton steps for a price: a logarithm of exponentials is convex and nearly linear, and a few will do."""


@dataclass(frozen=True, eq=False)
class FluidPrices(Known):
    r"""Bid prices: what a request that waits is worth to the workers who are still to come, at the fluid optimum.

    If serving it costs l, workers take it ``M(l) = sum_{s > t, d} q_sd P_sd(l)`` times, where their profits y_sd are
    the market's. The least l >= 0 with M(l) <= 1 sees to it that it is served once at most, and

    .. math:: \beta + l + \sum_{s > t, d} q_{sd} \mu_d P_{sd}(l)

    is the derivative of the fluid bound with respect to the number of such requests: the penalty that is due anyway,
    what being served is worth above that, and the choice that one more request gives to the workers.

    Attributes
    ----------
    log_rate : (T, D) float
        ``ln q_sd - 1 - y_sd - ln(1 + y_sd)``: a request with advantage a is served at step s by group d, per unit,
        ``exp((a - l)/mu_d + log_rate)`` times; ``-inf`` where nobody comes.
    mu, outside_utility : (D,) float
        Of the groups, in money.

    Examples
    --------
    >>> from optkit.bounds.fluid.bound import fluid_bound
    >>> model = FluidModel(3, [0], [2], [30.0], [-5.0], [[-10.0]], [1.0], [[0.0], [0.8], [0.8]], [1.0])
    >>> prices = FluidPrices.of(model, fluid_bound(model))
    >>> [prices.opportunity_cost(step, 30.0, -5.0, [-10.0], 2 - step).round(2) for step in (0, 1, 2)]
    [np.float64(17.82), np.float64(17.13), np.float64(0.0)]
    """

    log_rate: Floats
    mu: Floats
    outside_utility: Floats

    @classmethod
    def of(cls, model: FluidModel, bound: Bound) -> FluidPrices:
        """Prices of a model's fluid bound.

        Raises
        ------
        InputError
            If the bound is not a fluid bound of the model's K classes.
        """
        if not isinstance(bound.certificate, FluidCertificate):
            raise InputError(f"the bound is of kind {bound.kind!r}: prices need a fluid bound")
        bound.certificate.check(model)
        market = model.market()
        ratio = np.zeros(model.presence.shape)
        if market.size:
            come, gone = (np.bincount(at, minlength=model.horizon + 1) for at in (model.arrival, model.expiry + 1))
            open_at = np.cumsum(come - gone)[:-1] > 0
            ratio[(model.presence > 0) & open_at[:, None]] = market.respond(bound.certificate.multipliers)[0]
        with np.errstate(divide="ignore"):
            log_rate = np.log(model.presence) - 1.0 - ratio - np.log1p(ratio)
        return cls(log_rate, model.mu, np.asarray(model.outside_utility))

    def opportunity_cost(
        self,
        step: int,
        reward: npt.ArrayLike,
        penalty: npt.ArrayLike,
        utility: npt.ArrayLike,
        steps_left: npt.ArrayLike,
    ) -> Floats:
        """What is lost if a request is served now and not later.

        Parameters
        ----------
        step : int
            The current step t.
        reward, penalty : (...) float
            Money.
        utility : (D, ...) float
            Mean utility to each group, in money.
        steps_left : (...) int
            Steps after this one in which the request can still be served; those beyond the horizon do not count.

        Returns
        -------
        (...) float
            Money; 0 for requests that expire now, and the penalty for those whom nobody can serve any more.
        """
        due, wish = np.asarray(penalty, float), np.asarray(utility, float)
        earned, left, _ = np.broadcast_arrays(
            np.asarray(reward, float) - due, np.asarray(steps_left, np.int64), wish[0]
        )
        ahead = np.logaddexp.accumulate(self.log_rate[step + 1 :], axis=0)
        ahead = np.concatenate([np.full((1, self.mu.size), -np.inf), ahead])
        rate = np.moveaxis(ahead[np.clip(left, 0, len(ahead) - 1)], -1, 0)
        mu, outside = (x.reshape(-1, *(1,) * left.ndim) for x in (self.mu, self.outside_utility))
        log_served = (earned + wish - outside) / mu + rate
        price = np.zeros(log_served.shape[1:])
        for _ in range(NEWTON):
            often = np.logaddexp.reduce(log_served - price / mu, axis=0)
            if not (often > ENOUGH).any():
                break
            share = np.exp(log_served - price / mu - np.where(often > 0, often, np.inf))
            price = price + np.where(often > 0, often / np.where(often > 0, (share / mu).sum(axis=0), 1.0), 0.0)
        choice = (mu * np.exp(log_served - price / mu)).sum(axis=0)
        return np.asarray(np.where(left > 0, due + price + choice, 0.0))[()]
