"""What every upper bound returns: a value, the certificate that proves it, and a record of how it was found."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from optkit.basics.arrays import Known, number
from optkit.basics.errors import InputError, OptkitError, SolverError

ROUNDING = 1e-9
"""Part of a bound that its value may differ by on another machine, whose solver and functions round otherwise."""

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Verdict(Known):
    """The outcome of checking a certificate against an instance, without trusting whoever made it.

    Attributes
    ----------
    bound : float
        The upper bound that the certificate proves, recomputed from the instance, in money.
    attained : float
        What the certificate's feasible solution earns, recomputed, in money, or less where rounding hides the rest;
        ``-inf`` if it has none.
    residual : float
        The largest violation of feasibility found in the solution, 0 if it is feasible.
    """

    bound: float
    attained: float
    residual: float

    @property
    def gap(self) -> float:
        """``bound - attained``: how far the bound may lie above the relaxation's optimum, in money."""
        return self.bound - self.attained


Subject_contra = TypeVar("Subject_contra", contravariant=True)


@runtime_checkable
class Certificate(Protocol[Subject_contra]):
    """A proof of an upper bound that anybody can check.

    Those of this package say in ``proves`` of which kind of bound they are proofs.
    """

    def check(self, subject: Subject_contra, /) -> Verdict:
        """Recompute the bound from what is bounded, an instance or a model, and this certificate alone."""
        ...


def prove(bound: Bound, subject: Any) -> Verdict:
    """Check a bound's certificate, and that it proves the value that the bound states.

    Parameters
    ----------
    bound : Bound
        Whose certificate to check.
    subject : Instance, SmallModel or FluidModel
        What is bounded.

    Returns
    -------
    Verdict
        The bound that the certificate proves, and what its solution attains.

    Raises
    ------
    SolverError
        If the certificate proves nothing or less than the bound claims, or if its solution is not feasible or attains
        more than is proven.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from optkit import scenario
    >>> from optkit.bounds import full_information
    >>> day = scenario("I.1", seed=0).sample(1, seed=1)[0]
    >>> bound = full_information(day)
    >>> prove(bound, day).bound == bound.value
    True
    >>> prove(replace(bound, value=0.9 * bound.value), day)
    Traceback (most recent call last):
    ...
    optkit.basics.errors.SolverError: the certificate proves ..., not the bound ... that is claimed
    """
    proves = getattr(bound.certificate, "proves", bound.kind)
    if proves != bound.kind:
        raise SolverError(f"the certificate proves a bound of {proves}, and the bound claims to be of {bound.kind}")
    try:
        verdict = bound.certificate.check(subject)
    except OptkitError:
        raise
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise SolverError(f"the certificate is no certificate of this bound ({error})") from error
    if not verdict.residual <= 0:
        raise SolverError(f"the certificate's solution breaks a constraint by {verdict.residual:.3g}")
    _finite(verdict.bound)
    # Penalties that are avoided cancel in the sums, and leave the rounding of so many additions.
    avoided = float(np.abs(subject.penalty * getattr(subject, "count", 1.0)).sum())
    rounding = ROUNDING * abs(bound.value) + EPS * (64.0 + 8.0 * subject.horizon) * avoided
    if not verdict.bound <= bound.value + rounding:
        claim = f"the bound {bound.value:.9g} that is claimed"
        raise SolverError(f"the certificate proves {verdict.bound:.9g}, not {claim}")
    if verdict.attained > verdict.bound + rounding:
        raise SolverError(
            f"the certificate's solution attains {verdict.attained:.9g}, more than the {verdict.bound:.9g} that nobody "
            "can exceed: one of them is wrong"
        )
    return verdict


@dataclass(frozen=True)
class SolverRecord(Known):
    """How a bound was found.

    Attributes
    ----------
    method : str
        The method that was used, also where the caller left the choice open.
    status : str
        What the solver said of itself.
    seconds : float
        Time spent, building included.
    details : dict
        Anything else worth keeping (iterations, sizes, options).
    """

    method: str
    status: str
    seconds: float
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Bound:
    """An upper bound on what any policy earns on an instance, or in the mean.

    Attributes
    ----------
    value : float
        The bound, in money; finite.
    kind : str
        What is assumed known: ``"full information"``, ...
    certificate : Certificate
        Its proof; ``certificate.check(instance)`` recomputes the bound (of a model, ``certificate.check(model)``).
    solver : SolverRecord
        How it was found.

    Raises
    ------
    SolverError
        If the value is NaN or infinite.
    """

    value: float
    kind: str
    certificate: Certificate[Any]
    solver: SolverRecord

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", _finite(self.value))

    def __repr__(self) -> str:
        return f"Bound({self.value:.10g}, {self.kind!r}, by {self.solver.method}, {self.solver.seconds:.3g} s)"

    def _repr_html_(self) -> str:
        return f"<p>{self!r}: no policy earns more; its certificate proves it</p>"


def _finite(bound: Any) -> float:
    """Return a bound as a plain float, which is what is compared, or refuse it."""
    if isinstance(bound, float) and not math.isfinite(bound):
        raise SolverError(
            f"the bound is {bound}, which bounds nothing: money, or money in units of mu, is beyond what floats hold"
        )
    try:
        return number("the bound", bound)
    except InputError:
        raise SolverError(f"the bound is {str(bound)[:40]!r}, which is no number of floats") from None
