r"""What a platform believes of its workers: utilities and noise scale per group, with their standard errors.

The index of an offer is (w'x + c)/mu (paper section 3.4). A conditional logit with the outside option estimates
theta = (a, b) = (w/mu, 1/mu); with w = a/b, mu = 1/b and the Jacobian

.. math:: \partial w / \partial a = \mu I, \quad \partial w / \partial b = -\mu w,
          \quad \partial \mu / \partial b = -\mu^2

the delta method carries the covariance of theta to that of (w, mu) (``docs/explanation/estimation.md``).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from optkit.basics.arrays import Floats, Ints, flag, read_document, real, text_names, whole_number, write_document
from optkit.basics.errors import DataError, InputError
from optkit.models.preferences.attributes import Attributes

FORMAT, VERSION = "optkit preferences", 1

WRITTEN = ("attributes", "weights", "scale", "pooled", "covariance", "group_names")
"""Entries of a file beside what says what it is."""

MOST_PLACES = 10_001
"""Places that a log of offers may number."""


@dataclass(frozen=True, eq=False)
class Preferences:
    """Mean utilities w'x and noise scales mu of worker groups; a choice model for post-decision pricing.

    The utility of rejecting is 0: the level of the utility is relative to it.

    Attributes
    ----------
    attributes : Attributes
        What x consists of.
    weights : (G, p) float
        w of each model, in money.
    scale : (G,) float
        mu of each model, in money.
    covariance : tuple of (p + 1, p + 1) float, or empty
        Covariance of (w, mu) of each model; empty where the preferences are not estimates.
    pooled : bool
        One model for all groups (single MNL); otherwise model d is that of group d (Multi MNL).
    results : tuple
        The estimation results, statsmodels style, one per model; empty where the preferences are not estimates.
    group_names : tuple of str or None
        What the groups are called.
    """

    attributes: Attributes
    weights: Floats
    scale: Floats
    covariance: tuple[Floats, ...] = ()
    pooled: bool = False
    results: tuple[Any, ...] = field(default=(), repr=False)
    group_names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        flag("pooled", self.pooled)
        G, p = np.shape(self.weights)
        if p != len(self.attributes.columns) or np.shape(self.scale) != (G,):
            raise InputError(f"weights {np.shape(self.weights)} do not fit {len(self.attributes.columns)} columns")
        if not (np.isfinite(self.weights).all() and np.isfinite(self.scale).all() and (self.scale > 0).all()):
            raise InputError("preferences must be finite, and every mu positive")
        if self.pooled and G != 1:
            raise InputError(f"pooled preferences have one model for all groups, and there are {G}")
        if self.covariance:
            if len(self.covariance) != G or any(np.shape(one) != (p + 1, p + 1) for one in self.covariance):
                raise InputError(f"covariance needs {G} matrices of {p + 1} by {p + 1}, one for each model")
            if not all(np.isfinite(one).all() and _may_be_covariance(one) for one in self.covariance):
                raise InputError("covariance has a negative variance, differs from its transpose, or holds no numbers")
        if self.group_names is not None and not self.pooled and len(self.group_names) != G:
            raise InputError(f"{len(self.group_names)} names of groups for {G} models")
        if self.group_names is not None:
            text_names("group_names", self.group_names)

    def __repr__(self) -> str:
        groups = "all groups alike" if self.pooled else f"groups {', '.join(self.group_names or ())}"
        groups = groups if self.pooled or self.group_names else f"{len(self.scale)} group(s)"
        return f"Preferences({groups}, columns {', '.join(self.attributes.columns)}, mu {self.scale.round(4).tolist()})"

    def _repr_html_(self) -> str:
        return f"<p>Preferences, in money</p>{self.table().to_html(max_rows=20, index=False)}"

    def model_of(self, group: Ints) -> Ints:
        """Return the number of the model that speaks for each worker group.

        Raises
        ------
        InputError
            If a group is unknown.
        """
        if self.pooled:
            return np.zeros_like(group)
        unknown = (group < 0) | (group >= len(self.scale))
        if unknown.any():
            raise InputError(f"worker group {int(group[unknown][0])} is unknown; there are 0..{len(self.scale) - 1}")
        return group

    def utility_of(self, features: Floats, pickup: Ints, dropoff: Ints, group: Ints) -> Floats:
        """Mean utility of requests of shape (..., k), (...), (...) to workers of a group that broadcasts to (...)."""
        x = self.attributes.matrix(features, pickup, dropoff)
        return np.asarray((x * self.weights[self.model_of(group)]).sum(axis=-1))

    def standard_error(self, features: Floats, pickup: Ints, dropoff: Ints, group: int) -> Floats:
        """Return the delta-method standard error of the mean utility of n requests to one group, (n,), in money.

        Raises
        ------
        InputError
            If the preferences are no estimates.
        """
        if not self.covariance:
            raise InputError("these preferences are no estimates: they have no standard errors")
        x = self.attributes.matrix(features, pickup, dropoff)
        C = self.covariance[int(self.model_of(np.array([group]))[0])][:-1, :-1]
        # What is known exactly may come to less than 0 by rounding.
        return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", x, C, x), 0.0)))

    def called(self, groups: Sequence[str] | None, features: Sequence[str] | None) -> Preferences:
        """Return these preferences with groups and features in the order of such names; as they are without names.

        Parameters
        ----------
        groups, features : sequence of str or None
            What the instances call them.

        Raises
        ------
        InputError
            If a group or a feature has a name that these preferences do not know.
        """
        nameless = tuple(f"feature_{k}" for k in range(len(self.attributes.names)))
        mine = None if self.attributes.names == nameless else self.attributes.names
        order, columns = np.arange(len(self.scale)), np.arange(len(self.attributes.columns))
        if groups is not None and self.group_names is not None and not self.pooled:
            order = _places("groups", self.group_names, groups)
        names = self.attributes.names
        if features is not None and mine is not None:
            found = _places("features", mine, features)
            if found.size != len(mine):
                raise InputError(
                    f"the preferences know the features {', '.join(mine)}, and there are {', '.join(features)}"
                )
            columns, names = np.concatenate([found, columns[found.size :]]), tuple(features)
        same = order.size == len(self.scale) and (order == np.arange(order.size)).all()
        if same and (columns == np.arange(columns.size)).all():
            return self
        both = np.append(columns, columns.size)  # mu comes last
        covariance = tuple(self.covariance[g][np.ix_(both, both)] for g in order) if self.covariance else ()
        called = None if self.group_names is None else tuple(self.group_names[g] for g in order)
        return Preferences(
            replace(self.attributes, names=names), self.weights[np.ix_(order, columns)], self.scale[order], covariance,
            self.pooled, group_names=called if not self.pooled else self.group_names,
        )  # fmt: skip

    def of_instances(self, instances: Sequence[Any]) -> Preferences:
        """Return these preferences as instances call groups and features; see :meth:`called`.

        Raises
        ------
        InputError
            If a name is unknown, or instances differ in their names.
        """
        names = {(one.group_names, one.feature_names) for one in instances}
        if len(names) > 1:
            raise InputError("the instances call groups or features differently: price them apart")
        return self if not names else self.called(*names.pop())

    def _seen_in(self, state: Any) -> Preferences:
        batch = getattr(state, "batch", None)
        return self if batch is None else self.of_instances(getattr(batch, "instances", ()))

    # The choice model's protocol; a state is optkit.simulation.state.State or anything with the same arrays.
    def utility(self, state: Any) -> Floats:
        """Believed mean utility of each open request to the worker, (b, w), money."""
        safe_pickup = np.where(state.offered, state.pickup, 0)
        safe_dropoff = np.where(state.offered, state.dropoff, 0)
        return self._seen_in(state).utility_of(state.features, safe_pickup, safe_dropoff, state.group[:, None])

    def mu(self, state: Any) -> Floats:
        """Believed noise scale of each worker, (b,), money."""
        own = self._seen_in(state)
        return np.asarray(own.scale[own.model_of(state.group)])

    def outside_utility(self, state: Any) -> Floats:
        """Zeros, (b,): utilities are relative to rejecting."""
        return np.zeros(len(state.group))

    def to_dict(self) -> dict[str, Any]:
        """Attributes, weights and scales as plain data; not the estimation results."""
        places = {name: int(getattr(self.attributes, name)) for name in ("pickups", "dropoffs")}
        columns = {"names": list(self.attributes.names), **places, "reference": bool(self.attributes.reference)}
        weights, scale, *covariance = (np.asarray(x).tolist() for x in (self.weights, self.scale, *self.covariance))
        believed = {"weights": weights, "scale": scale, "pooled": bool(self.pooled)}
        named = {} if self.group_names is None else {"group_names": list(self.group_names)}
        return {"attributes": columns, **believed, "covariance": covariance, **named}

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> Preferences:
        """Make preferences again from :meth:`to_dict`.

        Raises
        ------
        InputError
            If the data are incomplete or do not fit together.
        """
        try:
            _known("preferences", plain, (*WRITTEN, "format", "version", "sha256"))
            columns = dict(plain["attributes"])
            _known("attributes", columns, ("names", "pickups", "dropoffs", "reference"))
            for place in ("pickups", "dropoffs"):
                whole_number(place, columns.get(place, 1), least=1, most=MOST_PLACES)
            attributes = Attributes(text_names("names", columns.pop("names")), **columns)
            weights, scale = (real(name, plain[name]) for name in ("weights", "scale"))
            covariance = tuple(real("covariance", one, accept="any") for one in plain["covariance"])
            named = plain.get("group_names")
            called = None if named is None else text_names("group_names", named)
            pooled = flag("pooled", plain["pooled"])
            return cls(attributes, weights, scale, covariance, pooled, group_names=called)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"preferences cannot be read: {error}") from None

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the preferences as JSON, whole or not at all; not the estimation results.

        Raises
        ------
        OptkitError
            If the disk refuses.
        """
        return write_document(path, self.to_document(), "preferences")

    def to_document(self) -> dict[str, Any]:
        """Return what :meth:`save` writes, as plain data."""
        return {"format": FORMAT, "version": VERSION, **self.to_dict()}

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Preferences:
        """Read preferences that :meth:`save` or ``optkit fit --out FOLDER`` wrote.

        Raises
        ------
        DataError
            If the file cannot be read, is not such a file, or was changed since; who edits one takes its entry
            ``sha256`` out.

        Examples
        --------
        >>> import tempfile
        >>> believed = Preferences(Attributes(("km",)), np.array([[-1.5, -4.0]]), np.array([2.0]))
        >>> with tempfile.TemporaryDirectory() as place:
        ...     Preferences.load(believed.save(f"{place}/preferences.json")).weights.tolist()
        [[-1.5, -4.0]]
        """
        plain = read_document(path, FORMAT, VERSION, "preferences of optkit")
        try:
            return cls.from_dict(plain)
        except InputError as error:
            raise DataError(f"{os.fspath(path)}: {error}") from None

    def table(self) -> Any:
        """Return a DataFrame with one row per model and parameter: ``estimate`` and ``standard_error``, in money.

        Standard errors are NaN where the preferences are no estimates.
        """
        import pandas as pd

        rows = []
        for g, (w, mu) in enumerate(zip(self.weights, self.scale, strict=True)):
            error = np.sqrt(np.diag(self.covariance[g])) if self.covariance else np.full(len(w) + 1, np.nan)
            for name, value, se in zip((*self.attributes.columns, "mu"), (*w, mu), error, strict=True):
                label = "all" if self.pooled else g if self.group_names is None else self.group_names[g]
                rows.append({"group": label, "parameter": name, "estimate": value})
                rows[-1]["standard_error"] = se
        return pd.DataFrame(rows)


def _known(what: str, plain: dict[str, Any], names: Sequence[str]) -> None:
    """Refuse an entry that means nothing: it may be a slip of one that does."""
    strange = [name for name in plain if name not in names]
    if strange:
        raise InputError(f"{what} have an entry {strange[0]!r}; there are {', '.join(names)}")


def _may_be_covariance(one: Floats) -> bool:
    """Whether a matrix is symmetric and has no negative variance in any direction, but for rounding."""
    room = 1e-9 * float(np.abs(one).max(initial=0.0))
    return bool(np.abs(one - one.T).max(initial=0.0) <= room and np.linalg.eigvalsh(one).min(initial=0.0) >= -room)


def _places(what: str, mine: Sequence[str], theirs: Sequence[str]) -> Ints:
    """Return where each of their names stands among mine."""
    strange = [name for name in theirs if name not in mine]
    if strange:
        raise InputError(f"the preferences know the {what} {', '.join(mine)}, and not {', '.join(strange)}")
    return np.array([list(mine).index(name) for name in theirs], dtype=np.int64)


def from_index(a: Floats, b: float, covariance: Floats) -> tuple[Floats, float, Floats]:
    """Turn theta = (w/mu, 1/mu) and its covariance into w, mu and theirs, by the delta method.

    Examples
    --------
    >>> w, mu, C = from_index(np.array([-4.0]), 2.0, np.diag([0.01, 0.04]))
    >>> w, mu, C.round(4).tolist()
    (array([-2.]), 0.5, [[0.0425, -0.01], [-0.01, 0.0025]])
    """
    mu = 1.0 / b
    w = a * mu
    p = len(a)
    J = np.zeros((p + 1, p + 1))
    J[:p, :p] = mu * np.eye(p)
    J[:p, p] = -mu * w
    J[p, p] = -(mu**2)
    return w, mu, J @ covariance @ J.T
