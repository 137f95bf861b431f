"""The proof of the full-information bound: a matching, and the prices that show none is better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optkit.basics.arrays import Floats, Ints, ints, real
from optkit.basics.errors import InputError
from optkit.bounds.bound import Verdict
from optkit.bounds.full.edges import edges, pair_values
from optkit.bounds.full.shadow_prices import repair
from optkit.bounds.rounding import sum_up
from optkit.instances.instance import Instance

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class AssignmentCertificate:
    """A matching of requests to workers, and shadow prices.

    The prices prove the bound: with ``y = max(request_dual, 0)`` and ``z_j = max(0, max_i (v_ij - y_i))``, every
    matching earns at most ``sum beta_i + sum y_i + sum z_j``, whatever numbers y came from. The matching shows that
    the bound is reached.

    Attributes
    ----------
    worker, request : (m,) int
        The pairs that are matched.
    request_dual : (n,) float
        y: what the bound would lose if the request had not come, except for its penalty; in money.
    worker_dual : (J,) float
        z: what the bound would lose if the worker had not come; in money. It is a comment: :meth:`check` recomputes
        the best z for the given y, so that a wrong one cannot do harm.

    Examples
    --------
    >>> from optkit.bounds import full_information
    >>> day = Instance(horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[], []], pickup=[0, 1], dropoff=[1, 0], worker_step=[1],
    ...                worker_group=[0], utility=[[-10.0, -12.0]], mu=[1.0], noise=[[0.0, 0.0]], outside_noise=[0.0])
    >>> full_information(day).certificate.check(day)
    Verdict(bound=23.0, attained=23.0, residual=0.0)
    """

    proves = "full information"

    worker: Ints
    request: Ints
    request_dual: Floats
    worker_dual: Floats

    def check(self, instance: Instance) -> Verdict:
        """Recompute everything from the instance.

        Parameters
        ----------
        instance : Instance
            With its noise realised.

        Returns
        -------
        Verdict
            ``residual`` is how often too often a request or a worker is used, at least 1 if a pair never meets;
            ``attained`` is ``-inf`` then, because what is no matching earns nothing.

        Raises
        ------
        InputError
            If a length does not fit the instance, or a price is NaN.
        InstanceError
            If the noise is not realised.
        """
        n, J = instance.n_requests, instance.n_workers
        prices = self._prices(n)
        worker, request = (ints(name, getattr(self, name), None) for name in ("worker", "request"))
        if worker.shape != request.shape or worker.ndim != 1:
            raise InputError(f"worker has shape {worker.shape} and request {request.shape}: give one of each per pair")
        y, z = repair(edges(instance), prices)
        bound = sum_up([*instance.penalty.tolist(), *y.tolist(), *z.tolist()])

        pairs = pair_values(instance)
        inside = (worker >= 0) & (worker < J) & (request >= 0) & (request < n)
        key, wanted = pairs.worker * n + pairs.request, (worker * n + request)[inside]
        at = np.searchsorted(key, wanted)
        meets = bool(inside.all() and (at < key.size).all() and (key[at] == wanted).all())
        overuse = max(np.bincount(side[inside]).max(initial=1) - 1 for side in (worker, request))
        residual = max(float(overuse), float(not meets))
        attained = -np.inf if residual else float(instance.penalty.sum()) + float(pairs.value[at].sum())
        return Verdict(bound=bound, attained=attained, residual=residual)

    def shadow_prices(self, instance: Instance) -> tuple[pd.Series, pd.Series]:
        """Return what the bound would lose, at most, without each request, and without each worker, in money.

        Parameters
        ----------
        instance : Instance
            That the bound is of; its identifiers label the two series, if it has any.

        Returns
        -------
        requests, workers : Series of n and J floats
            ``request_dual`` where positive, and the best workers' prices for it, worked out anew. With the penalties
            they add up to what :meth:`check` proves.

        Raises
        ------
        InputError, InstanceError
            As :meth:`check`.

        Examples
        --------
        >>> from optkit import full_information, scenario
        >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
        >>> bound = full_information(day)
        >>> requests, workers = bound.certificate.shadow_prices(day)
        >>> bool(abs(requests.sum() + workers.sum() + day.penalty.sum() - bound.value) < 1e-9 * bound.value)
        True
        """
        import pandas as pd

        y, z = repair(edges(instance), self._prices(instance.n_requests))
        requests = pd.Series(y, index=instance.request_id, name="request")
        return requests, pd.Series(z, index=instance.worker_id, name="worker")

    def _prices(self, n: int) -> Floats:
        """Return the requests' prices (n,), or refuse what are none."""
        prices = real("request_dual", self.request_dual, accept="any")
        if prices.shape != (n,) or np.isnan(prices).any():
            raise InputError(f"request_dual has shape {prices.shape}: give each of the {n} requests a number, not NaN")
        return prices
