"""Many full-information bounds, each proven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from optkit.basics.errors import SolverError
from optkit.bounds import Bound, full_information
from optkit.bounds.bound import prove
from optkit.instances.instance import Instance

Progress = Callable[[str, int, int], object]
"""Called with the name of the stage, the number of things done in it and their total."""


class ProvenBounds(NamedTuple):
    """Full-information bounds of instances, each with its certificate checked.

    Attributes
    ----------
    kept : list of int
        Positions of the instances that could be bounded.
    bounds : list of Bound
        Their bounds.
    failures : dict
        By position, why others could not be bounded.
    worst_gap : float
        Largest gap between bound and matching, in money.
    """

    kept: list[int]
    bounds: list[Bound]
    failures: dict[int, str]
    worst_gap: float


def proven_bounds(instances: Sequence[Instance], progress: Progress | None = None) -> ProvenBounds:
    """Bound instances with full information, and check every certificate.

    Parameters
    ----------
    instances : sequence of Instance
        Their noise must be realised.
    progress : callable, optional
        Called with "bounding", the number of instances done, and their number.

    Raises
    ------
    SolverError
        If there are instances and none could be bounded.

    Examples
    --------
    >>> from optkit import scenario
    >>> proven_bounds(scenario("I.1", seed=0).sample(3, seed=1)).kept
    [0, 1, 2]
    """
    kept, bounds, failures, worst = [], [], {}, 0.0
    for i, one in enumerate(instances):
        try:
            bound = full_information(one)
            worst = max(worst, prove(bound, one).gap)
        except SolverError as error:
            failures[i] = str(error)
        else:
            kept.append(i)
            bounds.append(bound)
        if progress is not None:
            progress("bounding", i + 1, len(instances))
    if failures and not bounds:
        raise SolverError(f"none of {len(instances)} instances could be bounded; the first: {failures[0]}")
    return ProvenBounds(kept, bounds, failures, worst)
