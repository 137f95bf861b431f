"""Value functions that are linear in coefficients, fitted on differences in one backward sweep.

Prices depend on a value function through opportunity costs alone, so V(S) - V(S without i) is regressed on the
difference of Lemma 1's targets with the same new arrivals after both (paper section 3.3, Algorithm 1;
``docs/explanation/values.md``). No level is needed, and one sweep over the steps suffices: the target of a step uses
the coefficients of the next.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, Self

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, Ints, number
from optkit.basics.errors import InputError, TrainingError
from optkit.models.value.parameters import Parameters
from optkit.models.value.ranked_term import RankedTerm
from optkit.models.value.request_sets import KnownRequests, RequestSets, SetValue, costs_without

LARGEST = 1e3
"""Opportunity costs beyond this many times the largest surplus are no values of waiting: training has diverged."""


class SetExperience(Protocol):
    """What value functions are fitted to; :class:`optkit.models.value.experience.Experience` from simulations."""

    @property
    def horizon(self) -> int:
        """Number of steps T."""
        ...

    @property
    def requests(self) -> KnownRequests:
        """What is known of the requests."""
        ...

    def sets(self, step: int) -> RequestSets | None:
        """Post-decision sets of a step, or None."""
        ...

    def target_differences(self, value: SetValue, step: int) -> Floats:
        """Target of each set less that of the set without each member, (b, w), money."""
        ...


class Term(Protocol):
    """A linear part of a value function: :class:`~optkit.models.value.ranked_term.RankedTerm`, or one's own.

    With a method like :meth:`~optkit.models.value.ranked_term.RankedTerm.opportunity_cost_without` it trains faster.
    """

    @property
    def size(self) -> int:
        """Number of coefficients."""
        ...

    def value(self, sets: RequestSets, theta: Floats) -> Floats:
        """Value of each set, (b,), money, for coefficients (size,)."""
        ...

    def opportunity_cost(self, sets: RequestSets, theta: Floats) -> Floats:
        """Value lost by removing each member, (b, w), money."""
        ...

    def differences(self, sets: RequestSets) -> Floats:
        """Regressors of the opportunity cost, (b, w, size)."""
        ...


class LinearInTerms(Parameters, ABC):
    r"""A value function :math:`V_t(S) = \sum_{i \in S} \beta_i + U_t(S)` with U linear in coefficients, by step.

    Were every waiting request to expire, the penalties would be its value. What serving adds, U, is the value of the
    same problem with rewards r - beta and no penalties: it depends on a request by its surplus alone.
    """

    kind: ClassVar[str]
    """Name in a file, of those classes that can be written and read again."""

    ridge: float
    memory: float
    terms_: Sequence[Term]
    coef_: Floats
    residual_: float

    @abstractmethod
    def _make_terms(self, experience: SetExperience) -> Sequence[Term]:
        """Return what the value is linear in."""

    def fit(self, experience: SetExperience, y: None = None) -> Self:
        """Fit all coefficients in one backward sweep; nothing is kept of an earlier fit.

        Parameters
        ----------
        experience : Experience
            Visited sets and their targets.
        y : None
            Targets come with the experience.

        Raises
        ------
        InputError
            If a setting is out of range.
        TrainingError
            If the opportunity costs explode. The estimator then is as it was before.
        """
        number("ridge", self.ridge, least=0.0)
        number("memory", self.memory, least=0.0, most=1.0)
        before = dict(self.__dict__)
        try:
            self.terms_ = self._make_terms(experience)
            self._sweep(experience)
        except BaseException:
            # What failed or was interrupted stays as it was.
            self.__dict__.clear()
            self.__dict__.update(before)
            raise
        return self

    def _sweep(self, experience: SetExperience) -> None:
        self.coef_ = np.zeros((experience.horizon, sum(term.size for term in self.terms_)))
        limit = LARGEST * max(1.0, float(np.abs(experience.requests.surplus).max(initial=0.0)))
        squares, count = 0.0, 0
        later: tuple[Floats, Floats] | None = None
        for step in range(experience.horizon - 2, -1, -1):
            sets = experience.sets(step)
            if sets is None:
                self.coef_[step] = self.coef_[step + 1]
                continue
            wanted = experience.target_differences(self, step) - sets.penalty
            wanted = _checked(wanted[sets.member], limit, step)
            x = np.concatenate([term.differences(sets)[sets.member] for term in self.terms_], axis=-1)
            try:
                own = x.T @ x, x.T @ wanted
                later = own if later is None else (own[0] + self.memory * later[0], own[1] + self.memory * later[1])
                self.coef_[step] = _ridge(*later, self.ridge, self.coef_[step + 1])
            except np.linalg.LinAlgError:
                raise TrainingError(f"ridge = {self.ridge} is too small for the equations of step {step}") from None
            found = _checked(x @ self.coef_[step], limit, step)
            squares, count = squares + float(((found - wanted) ** 2).sum()), count + wanted.size
        self.residual_ = float(np.sqrt(squares / max(count, 1)))

    def _parts(self, step: int) -> list[tuple[Term, Floats]]:
        if not hasattr(self, "coef_"):
            raise InputError(f"this {type(self).__name__} is not fitted: call fit first")
        if not 0 <= step < len(self.coef_):
            raise InputError(f"step {step} is beyond the {len(self.coef_)} steps that the value function was fitted on")
        ends = np.cumsum([term.size for term in self.terms_])
        return list(zip(self.terms_, np.split(self.coef_[step], ends[:-1]), strict=True))

    def value(self, sets: RequestSets) -> Floats:
        """Value of each set beyond that of the empty one, (b,), money."""
        return np.asarray(
            np.where(sets.member, sets.penalty, 0.0).sum(axis=1)
            + sum(term.value(sets, theta) for term, theta in self._parts(sets.step))
        )

    @property
    def sees_busy(self) -> bool:
        """Whether sets must say for how long workers have come without a break."""
        return any(getattr(term, "busy_knots", None) is not None for term in getattr(self, "terms_", ()))

    def predict(self, sets: RequestSets) -> Floats:
        """Return :meth:`value`, under scikit-learn's name."""
        return self.value(sets)

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """V(S) - V(S without i) for every member i, (b, w), money; 0 for padding."""
        return np.asarray(
            np.where(sets.member, sets.penalty, 0.0)
            + sum(term.opportunity_cost(sets, theta) for term, theta in self._parts(sets.step))
        )

    def opportunity_cost_without(self, sets: RequestSets, row: Ints, column: Ints) -> Floats:
        """Opportunity costs in sets ``row`` without the request at ``column``, both (r,): (r, w), money."""
        parts = [costs_without(term, sets, row, column, theta) for term, theta in self._parts(sets.step)]
        found = np.where(sets.member, sets.penalty, 0.0)[row] + sum(parts)
        found[np.arange(len(row)), column] = 0.0
        return np.asarray(found)

    def to_dict(self) -> dict[str, Any]:
        """Settings, terms and coefficients as plain data; :func:`~optkit.models.value.catalogue.value_of` reads it.

        Raises
        ------
        InputError
            If it is not fitted, or has terms or a class of the caller's own.
        """
        parts = [term for term, _ in self._parts(0)]
        if "kind" not in vars(type(self)) or not all(isinstance(term, RankedTerm) for term in parts):
            raise InputError("terms or classes of your own cannot be written to a file: nobody could read it")
        terms = [{**t.to_dict(), "features": t.features.to_dict()} for t in parts]  # type: ignore[attr-defined]
        # Arrays and NumPy's numbers become plain ones.
        settings = {name: np.asarray(value).tolist() for name, value in self.get_params().items() if name != "terms"}
        return {"kind": self.kind, "settings": settings, "terms": terms, "coef": self.coef_.tolist()}


def _checked(cost: Floats, limit: float, step: int) -> Floats:
    """Return opportunity costs, or raise a TrainingError if they are beyond the limit or no numbers."""
    if not np.abs(cost).max(initial=0.0) <= limit:
        raise TrainingError(
            f"training diverged: opportunity costs of {np.abs(cost).max():.3g} at step {step}; "
            "raise ridge, give more instances, or take a smaller discount"
        )
    return cost


def _ridge(gram: Floats, moment: Floats, ridge: float, prior: Floats) -> npt.NDArray[np.float64]:
    """Solve the normal equations of a ridge regression that is drawn to a prior."""
    if ridge == 0:
        return np.asarray(prior + np.linalg.lstsq(gram, moment - gram @ prior, rcond=None)[0])
    return np.asarray(np.linalg.solve(gram + ridge * np.eye(len(gram)), moment + ridge * prior))
