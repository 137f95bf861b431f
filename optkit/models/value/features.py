"""What counts of a waiting request on its own: its surplus and the steps it has left, as hat or kernel features."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from optkit.basics.arrays import Floats, number, real
from optkit.basics.errors import InputError
from optkit.models.value.ranked_term import hats, is_group, knots
from optkit.models.value.request_sets import KnownRequests, RequestSets

_ONE_AT_A_TIME = Lock()  # the number of BLAS threads is the process's, and is put back as it was found


@dataclass(frozen=True, eq=False)
class HatFeatures:
    """Products of hat functions of the surplus and of the steps left, (b, w, a * b).

    Parameters
    ----------
    group : int or None
        Whose surplus; None for the mean over the groups.
    surplus_knots, time_knots : (a,), (b,) float, increasing
        In money and in steps.

    Examples
    --------
    >>> HatFeatures(None, np.array([0.0, 50.0]), np.array([1.0, 3.0, 10.0])).size
    6
    """

    group: int | None
    surplus_knots: Floats
    time_knots: Floats

    def __post_init__(self) -> None:
        for name in ("surplus_knots", "time_knots"):
            object.__setattr__(self, name, knots(name, getattr(self, name)))
        if not (self.group is None or is_group(self.group)):
            raise InputError(f"group = {self.group!r}: take the number of a group, or None for the mean over all")

    @property
    def size(self) -> int:
        """Number of features."""
        return self.surplus_knots.size * self.time_knots.size

    def __call__(self, sets: RequestSets) -> Floats:
        """Features of every request, (b, w, size)."""
        surplus = sets.surplus_to(self.group)
        x = hats(surplus, self.surplus_knots)[..., :, None] * hats(sets.steps_left, self.time_knots)[..., None, :]
        return np.asarray(x.reshape(*surplus.shape, self.size))

    def to_dict(self) -> dict[str, Any]:
        """Plain data that :func:`features_of` understands."""
        spots = {"surplus_knots": self.surplus_knots.tolist(), "time_knots": self.time_knots.tolist()}
        return {"kind": "hats", "group": self.group, **spots}


@dataclass(frozen=True, eq=False)
class KernelFeatures:
    r"""Nystroem features of a Gaussian kernel on (surplus by group, logarithm of the steps left), (b, w, m).

    With landmarks z and K their kernel matrix, the features :math:`K^{-1/2} \kappa(z, x)` have the kernel
    :math:`\kappa(x, x')` as their inner products wherever x or x' is a landmark.

    Parameters
    ----------
    center, scale : (D + 1,) float
        Standardisation of the coordinates, which come by group, then time.
    landmarks : (m, D + 1) float
        Standardised.
    gamma : float
        The kernel is exp(-gamma * squared distance).

    Examples
    --------
    >>> KernelFeatures(np.zeros(2), np.ones(2), np.array([[0.0, 0.0], [1.0, 1.0]]), 0.5).size
    2
    """

    center: Floats
    scale: Floats
    landmarks: Floats
    gamma: float

    def __post_init__(self) -> None:
        for name in ("center", "scale", "landmarks"):
            object.__setattr__(self, name, real(name, getattr(self, name)))
        width = self.center.size
        if self.landmarks.ndim != 2 or self.landmarks.shape[1] != width or self.scale.shape != (width,):
            raise InputError(f"landmarks {self.landmarks.shape}, scale {self.scale.shape} and center ({width},) differ")
        object.__setattr__(self, "gamma", number("gamma", self.gamma, above=0.0))
        if not (self.scale > 0).all():
            raise InputError("every scale must be positive")
        # Other threads, other digits: one, as in training, so that a file prices as the trained policy did.
        with _ONE_AT_A_TIME, threadpool_limits(limits=1):
            values, vectors = np.linalg.eigh(self._kernel(self.landmarks))
            root = (vectors / np.sqrt(np.maximum(values, 1e-10))) @ vectors.T
        object.__setattr__(self, "_root", root)

    @property
    def size(self) -> int:
        """Number of features."""
        return len(self.landmarks)

    def _kernel(self, x: Floats) -> Floats:
        z = self.landmarks
        square = (x**2).sum(axis=-1)[..., None] + (z**2).sum(axis=1) - 2.0 * (x @ z.T)
        return np.asarray(np.exp(-self.gamma * np.maximum(square, 0.0)))

    def __call__(self, sets: RequestSets) -> Floats:
        """Features of every request, (b, w, m)."""
        groups = sets.requests.surplus.shape[1]
        if groups + 1 != self.center.size:
            raise InputError(
                f"the value function knows {self.center.size - 1} worker groups; these requests have {groups}"
            )
        x = (coordinates(sets) - self.center) / self.scale
        return np.asarray(self._kernel(x) @ self._root)  # type: ignore[attr-defined]

    def to_dict(self) -> dict[str, Any]:
        """Plain data that :func:`features_of` understands."""
        arrays = {name: getattr(self, name).tolist() for name in ("center", "scale", "landmarks")}
        return {"kind": "kernel", "gamma": self.gamma, **arrays}


def coordinates(sets: RequestSets) -> Floats:
    """Surplus by group and the logarithm of one plus the steps left, (b, w, D + 1)."""
    # Padding may have expired long ago.
    time = np.log1p(np.maximum(sets.steps_left, 0.0))
    return np.concatenate([sets.surplus, time[..., None]], axis=-1)


def surplus_knots(requests: KnownRequests, count: int, group: int | None, known: int) -> Floats:
    """Spread knots evenly over the surplus of the first ``known`` requests, 3 to 97 per cent quantile."""
    surplus = requests.mean_surplus[:known] if group is None else requests.surplus[:known, group]
    low, high = np.quantile(surplus, [0.03, 0.97])
    return np.linspace(low, max(high, low + 1e-6), count)


def features_of(plain: dict[str, Any]) -> HatFeatures | KernelFeatures:
    """Make features again from their plain data.

    Raises
    ------
    InputError
        If the data are not of a known kind or incomplete.

    Examples
    --------
    >>> one = HatFeatures(0, np.array([0.0, 9.0]), np.array([1.0, 4.0]))
    >>> features_of(one.to_dict()).to_dict() == one.to_dict()
    True
    """
    kinds: dict[str, type[HatFeatures] | type[KernelFeatures]] = {"hats": HatFeatures, "kernel": KernelFeatures}
    try:
        return kinds[plain["kind"]](**{name: value for name, value in plain.items() if name != "kind"})
    except InputError:
        raise
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f"request features cannot be read: {error!r}") from None
