"""Refusing data that do not determine the coefficients, in words that name the columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
from scipy.linalg import qr

from optkit.basics.arrays import Bools, Floats
from optkit.basics.errors import DataError
from optkit.models.estimation.likelihood import Likelihood
from optkit.models.estimation.separation import separating_direction, supporters

CONSTANT = 1e-12
"""A column whose differences are below this share of its level never varies."""

SINGULAR = 1e-13
"""Eigenvalue of the columns' correlation below which they are collinear; its square root is a relative residual."""


class NotIdentifiedError(DataError):
    """The data do not determine the coefficients: no finite, single maximum of the likelihood exists.

    Attributes
    ----------
    direction : (k,) float
        A change of the coefficients that the likelihood does not see, or that raises it for ever.
    """

    def __init__(self, message: str, direction: Floats) -> None:
        super().__init__(message)
        self.direction = direction


def column_scale(likelihood: Likelihood) -> tuple[Floats, Floats]:
    """Return the standard deviation of each column within the sets, at equal shares, and the columns' covariance.

    Shapes (k,) and (k, k), in the columns' units; a column that never varies has 0.
    """
    information = likelihood.slopes(*likelihood.equal_shares()).information
    covariance = information / likelihood.total
    scale = np.sqrt(np.diag(covariance))
    return np.where(scale <= CONSTANT * likelihood.level, 0.0, scale), covariance


def check_columns(likelihood: Likelihood, names: Sequence[str], free: Bools) -> Floats:
    """Refuse columns that never vary within a set, and collinear ones; return the scale of each column, (k,).

    Only the free (unpenalised) columns need to be identified by the data.
    """
    scale, covariance = column_scale(likelihood)
    constant = np.flatnonzero(free & (scale == 0))
    if constant.size:
        which = ", ".join(names[int(i)] for i in constant)
        raise NotIdentifiedError(
            f"{which} never varies within a situation, so the choices say nothing about it; leave it out, or give "
            "penalty= (an intercept belongs to a model with outside_option=True)",
            np.eye(len(names))[constant[0]],
        )
    columns = np.flatnonzero(free)
    size = scale[columns]
    direction = _collinear(covariance[np.ix_(columns, columns)] / np.outer(size, size))
    if direction is not None:
        full = np.zeros(len(names))
        full[columns] = direction / size
        full /= full[np.abs(full).argmax()]
        involved = ", ".join(names[int(i)] for i in np.flatnonzero(full))
        raise NotIdentifiedError(
            f"columns {involved} are collinear: {combination(full, names)} never varies within a situation; "
            "leave one of them out, or give penalty=",
            full,
        )
    return scale


def _collinear(correlation: Floats) -> Floats | None:
    """Return a combination of standardised columns that never varies; None if there is none."""
    if not correlation.size:
        return None
    rank = int((np.linalg.eigvalsh(correlation) > SINGULAR * len(correlation)).sum())
    if rank == len(correlation):
        return None
    *_, pivots = qr(correlation, pivoting=True)
    basis, column = pivots[:rank], pivots[rank]
    direction = np.zeros(len(correlation))
    direction[basis] = -np.linalg.lstsq(correlation[np.ix_(basis, basis)], correlation[basis, column])[0]
    direction[np.abs(direction) < 1e-5] = 0.0
    direction[column] = 1.0
    return direction


def refuse_separation(
    likelihood: Likelihood, names: Sequence[str], scale: Floats, free: Bools, rejections: float | None
) -> None:
    """Raise NotIdentifiedError if the likelihood rises for ever along some direction of the free columns.

    ``rejections`` is the number of situations that chose the outside option; None if there is no such option.
    """
    direction = separating_direction(likelihood, np.where(scale > 0, scale, 1.0), free)
    if direction is None:
        return
    direction = direction / np.abs(direction).max()
    along = combination(direction, names)
    remedy = "or give penalty="
    if rejections is not None and rejections in (0, likelihood.total):
        seen = "no situation chose" if rejections == 0 else "every situation chose"
        raise NotIdentifiedError(
            f"{seen} the outside option, so the level of the utility is not identified: the likelihood rises for ever "
            f"along {along}; observe offers of which some are rejected and some are not, {remedy}",
            direction,
        )
    decided = int(supporters(likelihood, direction).sum())
    raise NotIdentifiedError(
        f"the choices are separated: the likelihood rises for ever along {along}, which explains "
        f"{decided} of {len(likelihood.sets)} choices and contradicts none; leave a column out, get more data, "
        f"{remedy}",
        direction,
    )


def refuse_flatness(information: Floats, names: Sequence[str], scale: Floats) -> NoReturn:
    """Raise NotIdentifiedError: there is no telling a maximum from a likelihood that rises for ever.

    ``information`` is scaled by ``scale`` to columns of unit deviation.
    """
    direction = np.linalg.eigh(information)[1][:, 0] / scale
    direction /= direction[np.abs(direction).argmax()]
    raise NotIdentifiedError(
        f"the choices say nothing about {combination(direction, names, 0.01)} that exceeds rounding: the likelihood is "
        "flat along it; leave a column out, get more data, or give penalty=",
        direction,
    )


def combination(direction: Floats, names: Sequence[str], least: float = 1e-6) -> str:
    """Write a linear combination in words, largest entries first, those below ``least`` of the largest left out."""
    size = np.abs(direction)
    shown = [i for i in np.argsort(-size, kind="stable") if size[i] > least * size.max()]
    words = "".join(f" {'-' if direction[i] < 0 else '+'} {size[i]:.3g} {names[i]}" for i in shown)
    return words.removeprefix(" + ").strip()
