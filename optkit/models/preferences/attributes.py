"""What the index of a request is made of: its features, and a column for every location."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from optkit.basics.arrays import Floats, Ints, flag, text_names
from optkit.basics.errors import InputError


@dataclass(frozen=True)
class Attributes:
    """Columns of the regressor x: k features, one indicator per pick-up location, and one per drop-off location.

    Pick-up indicators add up to 1, so they hold the level of the utility. Drop-off indicators would do so too; to
    estimate, the first of them is left out and serves as the reference.

    Parameters
    ----------
    names : tuple of str
        Names of the k features.
    pickups, dropoffs : int
        Number of locations, at least 1. With one pick-up its column is the constant.
    reference : bool
        Leave the first drop-off out (default); the true weights of a world need all.
    """

    names: tuple[str, ...]
    pickups: int = 1
    dropoffs: int = 1
    reference: bool = True

    def __post_init__(self) -> None:
        flag("reference", self.reference)
        text_names("names", self.names)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the p columns."""
        if self.pickups == 1:
            pickup: tuple[str, ...] = ("constant",)
        else:
            pickup = tuple(f"pickup_{i}" for i in range(self.pickups))
        return (*self.names, *pickup, *(f"dropoff_{i}" for i in range(int(self.reference), self.dropoffs)))

    def matrix(self, features: Floats, pickup: Ints, dropoff: Ints) -> Floats:
        """Return the columns of requests of any leading shape: (..., k), (...) and (...) to (..., p).

        Raises
        ------
        InputError
            If the number of features or a location is not one that these attributes know.
        """
        if features.shape[-1] != len(self.names):
            raise InputError(f"requests have {features.shape[-1]} features; the preferences know {len(self.names)}")
        for name, place, known in (("pickup", pickup, self.pickups), ("dropoff", dropoff, self.dropoffs)):
            unknown = (place < 0) | (place >= known)
            if unknown.any():
                raise InputError(f"{name} {int(place[unknown][0])} is unknown; the preferences know 0..{known - 1}")
        skip = int(self.reference)
        x = np.zeros((*pickup.shape, len(self.columns)))
        k = len(self.names)
        x[..., :k] = features
        np.put_along_axis(x, k + pickup[..., None], 1.0, axis=-1)
        shown = dropoff >= skip
        at = np.where(shown, k + self.pickups + dropoff - skip, 0)[..., None]
        kept = np.where(shown[..., None], 1.0, np.take_along_axis(x, at, axis=-1))
        np.put_along_axis(x, at, kept, axis=-1)
        return x
