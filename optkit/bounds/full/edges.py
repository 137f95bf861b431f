"""Who could serve whom, and what it would be worth: the weighted bipartite graph of an instance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse

from optkit.basics.arrays import Floats, Ints
from optkit.bounds.rounding import add_up
from optkit.instances.instance import Instance


class PairValues(NamedTuple):
    """Compatible pairs, sorted by worker and then by request, and the value of each, in money."""

    worker: Ints
    request: Ints
    value: Floats


@dataclass(frozen=True, eq=False)
class Edges:
    """The pairs worth serving, sorted by worker and then by request.

    Attributes
    ----------
    worker, request : (e,) int
        The two ends of each edge.
    value : (e,) float
        Value v_ij > 0 of letting worker j serve request i instead of letting it expire, in money.
    n_workers, n_requests : int
        Numbers of workers J and of requests n, those without any edge included.
    constant : float
        Sum of the penalties beta_i, in money: what the platform earns if nobody serves anything.
    """

    worker: Ints
    request: Ints
    value: Floats
    n_workers: int
    n_requests: int
    constant: float

    @property
    def size(self) -> int:
        """Number of edges e."""
        return self.value.size

    def dense(self) -> Floats:
        """Lay the values out as a (J, n) matrix in money; a pair that is no edge is worth 0, like being idle."""
        matrix = np.zeros((self.n_workers, self.n_requests))
        matrix[self.worker, self.request] = self.value
        return matrix

    @cached_property
    def starts(self) -> Ints:
        """Where the edges of each worker begin, (J + 1,)."""
        return np.searchsorted(self.worker, np.arange(self.n_workers + 1))

    @cached_property
    def by_request(self) -> tuple[Ints, npt.NDArray[np.int32]]:
        """The edges by request: those of i are ``order[starts[i]:starts[i + 1]]``; (n + 1,) starts and (e,) order."""
        order = np.arange(self.size, dtype=np.int32)
        shape = (self.n_workers, self.n_requests)
        columns = sparse.csr_array((order, self.request, self.starts), shape=shape).tocsc()
        return columns.indptr.astype(np.int64), columns.data

    def best_per_worker(self, score: Floats) -> Floats:
        """Largest of 0 and of the worker's entries in ``score`` (e,): the shape is (J,)."""
        best = np.zeros(self.n_workers)
        np.maximum.at(best, self.worker, score)
        return best


def pair_values(instance: Instance) -> PairValues:
    """Value of every compatible pair: of serving the request with that worker rather than not at all.

    Worker j, who sees his noise, takes request i for any compensation from
    ``c_ij = max(0, u_0 + e_0j - u_ij - e_ij)`` on, so that the pair is worth ``v_ij = r_i - beta_i - c_ij``.

    Parameters
    ----------
    instance : Instance
        With its noise realised.

    Returns
    -------
    PairValues
        ``worker``, ``request`` and ``value``, each (p,), sorted by worker and then by request; values are rounded up.

    Raises
    ------
    InstanceError
        If the noise is not realised.

    Notes
    -----
    Paper, the full-information bound; the signs are those of ``docs/explanation/bounds.md``.

    Examples
    --------
    >>> day = Instance(horizon=2, arrival=[0], expiry=[1], reward=[30.0], penalty=[-5.0], features=[[]], pickup=[0],
    ...                dropoff=[0], worker_step=[1], worker_group=[0], utility=[[-10.0]], mu=[1.0],
    ...                noise=[[2.0]], outside_noise=[0.5])
    >>> pair_values(day).value
    array([26.5])
    """
    worker, request = instance.pairs()
    # Indexing here spares `pair_noise` a second look for the pairs of an instance with dense noise.
    noise = instance.noise[worker, request] if isinstance(instance.noise, np.ndarray) else instance.pair_noise()
    group = instance.worker_group
    if instance.n_groups == 1:
        utility = instance.utility[0][request]
    else:
        utility = instance.utility.ravel()[group[worker] * instance.n_requests + request]
    lower_idle = add_up(-instance.outside_by_group[group], -np.asarray(instance.outside_noise))
    spared = add_up(add_up(utility, noise), lower_idle[worker])  # what he would pay for working, if positive
    return PairValues(
        worker, request, add_up(add_up(instance.reward, -instance.penalty)[request], np.minimum(spared, 0.0))
    )


def edges(instance: Instance) -> Edges:
    """Build the bipartite graph of an instance: its compatible pairs whose value is positive.

    Parameters
    ----------
    instance : Instance
        With its noise realised.

    Raises
    ------
    InstanceError
        If the noise is not realised.
    """
    worker, request, value = pair_values(instance)
    keep = value > 0
    return Edges(
        worker[keep], request[keep], value[keep], instance.n_workers, instance.n_requests, float(instance.penalty.sum())
    )
