"""Logged offers: what was shown to each worker, at which compensation, and what the worker took."""

from __future__ import annotations

import os
import re
import secrets
from collections import Counter
from collections.abc import Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats, Ints, count, floats, ints, mask, open_table, unmasked
from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.models.rows import Rows, labelled

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = 1
"""Version of the file that :meth:`Offers.save` writes."""

_WHOLE = ("situation", "group", "pickup", "dropoff")
_COLUMNS = ("situation", "group", "features", "pickup", "dropoff", "compensation", "chosen")
_ROLES = {
    "situation": "labels",
    "group": "groups",
    "pickup": "counts",
    "dropoff": "counts",
    "compensation": "numbers",
    "chosen": "flags",
}
"""Columns that are no features, and what a file holds in them."""


@dataclass(frozen=True, eq=False)
class Offers:
    """One row per request shown to a worker; the rows of one decision share their situation.

    In a file the columns are these names, with ``feature_0``, ``feature_1``, ... for the features. A user's own table
    needs ``situation``, ``compensation``, ``chosen`` and the features; the rest may be left out and is then 0.

    Attributes
    ----------
    situation : (m,) int
        Number of the decision. Rows of a situation need not stand together.
    group : (m,) int
        The worker's group, the same for all rows of a situation.
    features : (m, k) float
        Characteristics of the request.
    pickup, dropoff : (m,) int
        Locations of the request.
    compensation : (m,) float
        What was offered, in money.
    chosen : (m,) bool
        Whether the worker took the request: at most one row of a situation, none if the worker rejected all.
    names : tuple of str
        Names of the features.
    cluster : (m,) int, optional
        Which decisions may depend on each other, such as all of one worker: the same for all rows of a situation.
    group_names : tuple of str, optional
        Names of the groups 0, 1, ...

    Raises
    ------
    DataError
        If a column is not made of finite numbers, a situation has two choices, groups or clusters, or lengths differ.
    """

    situation: Ints
    group: Ints
    features: Floats
    pickup: Ints
    dropoff: Ints
    compensation: Floats
    chosen: Ints
    names: tuple[str, ...] = ()
    cluster: Ints | None = None
    group_names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        try:
            m = count("situation", self.situation)
            given = {name: getattr(self, name) for name in _COLUMNS}
            given |= {} if self.cluster is None else {"cluster": self.cluster}
            rows = Rows.of(m, **given)
            for name, column in given.items():
                object.__setattr__(self, name, rows.take(name, column))
            for name in (*_WHOLE, *([] if self.cluster is None else ["cluster"])):
                object.__setattr__(self, name, ints(name, getattr(self, name), (m,)))
            chosen = floats("chosen", self.chosen, (m,), flags=True)
            object.__setattr__(self, "chosen", ints("chosen", chosen, (m,)))
            object.__setattr__(self, "features", floats("features", self.features, (m, None), flags=True))
            object.__setattr__(self, "compensation", floats("compensation", self.compensation, (m,)))
        except InputError as error:
            raise DataError(f"offers: {error}") from None
        given_names: Any = self.names
        if not isinstance(given_names, tuple | list):
            raise DataError(f"offers: names is a {type(given_names).__name__}; give a tuple of text")
        names = tuple(map(str, self.names)) or tuple(f"feature_{f}" for f in range(self.features.shape[1]))
        if len(names) != self.features.shape[1]:
            raise DataError(f"offers: {len(names)} names for {self.features.shape[1]} features")
        object.__setattr__(self, "names", tuple(names))
        taken_names = {*_WHOLE, "compensation", "chosen", "constant", "mu", "cluster"}
        for name in names:
            if name in taken_names or re.fullmatch(r"(pickup|dropoff)_\d+", name):
                raise DataError(f"offers: a feature cannot be called {name!r}: the name is taken; rename the column")
            taken_names.add(name)
        if self.group_names is not None and self.group.size and int(self.group.max()) >= len(self.group_names):
            raise DataError(f"offers: {len(self.group_names)} names of groups, and a group {int(self.group.max())}")
        absurd = np.abs(self.compensation) > 1e100
        if absurd.any():
            i = int(absurd.argmax())
            raise DataError(f"offers: compensation in row {i} is {self.compensation[i]:.3g}, beyond any money")
        for name in ("group", "pickup", "dropoff"):
            column = getattr(self, name)
            wrong = (column < 0) | (column > 10_000)
            if wrong.any():
                i = int(wrong.argmax())
                why = "negative" if column[i] < 0 else "too large"
                raise DataError(f"offers: {name} in row {i} is {why}, {column[i]}; count from 0 without gaps")
        if not np.isin(self.chosen, (0, 1)).all():
            i = int((~np.isin(self.chosen, (0, 1))).argmax())
            raise DataError(f"offers: chosen in row {i} is {self.chosen[i]}, neither 0 nor 1")
        label, place = np.unique(self.situation, return_inverse=True)
        taken = np.bincount(place, self.chosen)
        if (taken > 1).any():
            raise _SituationError(int(label[taken.argmax()]), f"has {int(taken.max())} choices; a worker takes one")
        for column, what in (
            (self.group, "workers of two groups; it shows one worker"),
            (self.cluster, "two clusters"),
        ):
            if column is None:
                continue
            one = np.zeros(label.size, np.int64)
            one[place] = column
            if (one[place] != column).any():
                i = int((one[place] != column).argmax())
                raise _SituationError(int(self.situation[i]), f"has {what}")

    def __len__(self) -> int:
        return self.situation.size

    @property
    def n_situations(self) -> int:
        """Number of decisions."""
        return int(np.unique(self.situation).size)

    @property
    def n_choices(self) -> int:
        """Number of decisions in which the worker took a request."""
        return int(self.chosen.sum())

    def take(self, rows: Any) -> Offers:
        """Return some of the rows.

        Parameters
        ----------
        rows : (m,) bool, sequence of int, or slice
            A mask, or places, from the end where negative. A log has no labels: those of a mask must be 0 to m - 1, in
            any order, and go by these.

        Returns
        -------
        Offers
            Those rows.

        Raises
        ------
        InputError
            If it is neither, of another length, or a place is out of range.
        DataError
            If a row that is a choice is taken twice.
        """
        rows = self._places(rows)
        cluster = None if self.cluster is None else self.cluster[rows]
        kept = {name: getattr(self, name)[rows] for name in _COLUMNS}
        return Offers(**kept, names=self.names, cluster=cluster, group_names=self.group_names)

    def _places(self, rows: Any) -> Ints:
        """Return which rows are meant, by their places."""
        m = len(self)
        if isinstance(rows, slice):
            return np.arange(m)[rows]
        unmasked("rows", rows)
        try:
            array = np.asarray(rows)
        except ValueError:
            raise InputError("rows is ragged; give a mask of True and False, or whole numbers") from None
        if array.dtype.kind == "b" or (array.dtype.kind == "O" and any(isinstance(x, bool) for x in array.flat)):
            if labelled(rows):
                import pandas as pd

                rows = Rows(m, pd.RangeIndex(m), "the log").take("rows", rows)
            return np.flatnonzero(mask("rows", rows, (m,)))
        if array.dtype.kind == "f" and array.size:  # 1.0 and 0.0 are rather a mask that was averaged or joined
            raise InputError("rows holds floats; give a mask of True and False, or whole numbers")
        places = ints("rows", rows, (None,))
        wrong = (places < -m) | (places >= m)
        if wrong.any():
            raise InputError(f"rows[{int(wrong.argmax())}] = {places[wrong.argmax()]} is none of {m} rows of the log")
        return places

    @classmethod
    def join(cls, parts: Sequence[Offers]) -> Offers:
        """Put logs together; situations and clusters are numbered anew, so that none of two logs are mixed up.

        Raises
        ------
        InputError
            If there are no logs, their features differ, or some have clusters and some have none.
        """
        if not parts:
            raise InputError("there are no offers to join")
        if len({part.names for part in parts}) > 1:
            raise InputError(f"logs with different features cannot be joined: {sorted({part.names for part in parts})}")
        clusters = [part.cluster for part in parts if part.cluster is not None]
        if len(clusters) not in (0, len(parts)):
            raise InputError("logs with clusters and logs without cannot be joined")
        if len({part.group_names for part in parts}) > 1:
            raise InputError("logs whose groups are called differently cannot be joined")
        columns = ("group", "features", "pickup", "dropoff", "compensation", "chosen")
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in columns}
        situation, cluster = _apart([part.situation for part in parts]), _apart(clusters) if clusters else None
        named = parts[0].group_names
        return cls(situation=situation, **joined, names=parts[0].names, cluster=cluster, group_names=named)

    def to_frame(self) -> pd.DataFrame:
        """Return the log as a table, one row per request shown."""
        import pandas as pd

        left = pd.DataFrame({name: getattr(self, name) for name in _WHOLE})
        if self.group_names is not None:
            left["group"] = np.array(self.group_names, dtype=object)[self.group]
        features = pd.DataFrame(self.features, columns=list(self.names))
        right = pd.DataFrame({"compensation": self.compensation, "chosen": self.chosen})
        if self.cluster is not None:
            right["cluster"] = self.cluster
        return pd.concat([left, features, right], axis=1)

    @classmethod
    def from_frame(cls, frame: Any, features: Sequence[str] | None = None, cluster: str | None = None) -> Offers:
        """Build a log from a table.

        Parameters
        ----------
        frame : DataFrame
            Of any library, with ``situation`` (numbers or names), ``compensation``, ``chosen`` and the features;
            ``group``, ``pickup`` and ``dropoff`` are 0 if they are missing.
        features : sequence of str, optional
            The columns that are features; all that have no other role by default.
        cluster : str, optional
            The column that says which decisions may depend on each other, such as the worker.

        Raises
        ------
        DataError
            If a column is missing or holds something that it must not.
        """
        import pandas as pd

        from optkit.models.frames import frame_of

        if not isinstance(frame, pd.DataFrame | dict):
            try:
                frame = frame_of("the table of offers", frame)
            except InputError as error:
                raise DataError(str(error)) from None
        if not isinstance(frame, pd.DataFrame) or frame.columns.nlevels > 1:
            raise DataError(f"the offers are a {type(frame).__name__}, not a DataFrame with one row of names")
        double = frame.columns[frame.columns.duplicated()]
        if len(double):
            raise DataError(f"the offers have the column {double[0]!r} twice; leave one")
        try:
            features = None if features is None else list(features)
            set(features or ())
        except TypeError:
            raise DataError("features are no list of names of columns") from None
        index = [n for n in frame.index.names if n not in frame and (n in _ROLES or n in (features or ()))]
        if index:
            frame = frame.reset_index(level=index)
        chosen = _features(list(frame.columns), features, cluster)
        wanted = ("situation", "compensation", "chosen", *chosen, *([] if cluster is None else [cluster]))
        missing = [c for c in wanted if c not in frame]
        if missing:
            have = ", ".join(map(str, frame.columns))
            raise DataError(f"the offers have no column {', '.join(map(repr, missing))}; they have {have}")
        columns: dict[str, Any] = {
            name: frame[name].to_numpy() if name in frame else np.zeros(len(frame), int)
            for name in ("group", "pickup", "dropoff", "compensation", "chosen")
        }
        columns["group"], named = _named_groups(columns["group"])
        matrix = np.empty((len(frame), len(chosen)))
        for f, name in enumerate(chosen):
            try:
                matrix[:, f] = floats(str(name), frame[name].to_numpy(), (len(frame),), flags=True)
            except InputError as error:
                raise DataError(f"offers: {error}") from None
        labels = _labels("situation", frame["situation"])
        if cluster is not None:
            columns["cluster"] = _codes(_labels(cluster, frame[cluster]))[0]
        return cls._labelled(labels, features=matrix, names=tuple(map(str, chosen)), group_names=named, **columns)

    @classmethod
    def _labelled(cls, labels: Sequence[Any], **columns: Any) -> Offers:
        """Build a log whose situations are called by labels, which errors name."""
        code, number = _codes(labels)
        try:
            return cls(situation=code, **columns)
        except _SituationError as error:
            raise _SituationError(number[error.situation], error.what) from None

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the log to a parquet file, whole or not at all; situations are read back as 0, 1, ... in their order.

        Raises
        ------
        OptkitError
            If the disk refuses.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        target = Path(path)
        if not target.name:
            raise InputError(f"{str(path)!r} names no file to write the offers to")
        table = pa.Table.from_pandas(self.to_frame(), preserve_index=False)
        marks = {} if self.cluster is None else {"optkit-cluster": "cluster"}
        table = table.replace_schema_metadata({"optkit-offers": str(SCHEMA)} | marks)
        # This package knows nothing of the disk (optkit.basics.files does the same for all others).
        staging = target.with_name(f".optkit-{os.getpid()}-{secrets.token_hex(4)}.tmp")
        try:
            pq.write_table(table, staging)
            with open(staging, "rb+") as file:
                os.fsync(file.fileno())
            os.replace(staging, target)
        except OSError as error:
            raise OptkitError(f"{target} cannot be written ({error.strerror or error})") from error
        finally:
            with suppress(OSError):
                staging.unlink(missing_ok=True)
        return target

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], features: Sequence[str] | None = None, cluster: str | None = None
    ) -> Offers:
        """Read a log from parquet, as :meth:`save` writes it, or from a user's own parquet, CSV or JSON.

        Labels of situations are text: ``007``, ``7`` and ``7.0`` are three. Of what pandas calls the index of a parquet
        file only columns with a role, and features that are asked for, are read.

        Raises
        ------
        DataError
            If the file is missing, damaged or from a newer optkit, or a column is not as it must be; rows count from 1
            below the header.
        """
        with open_table(path, "give a parquet, CSV or JSON file of offers") as table:
            schema = table.marks.get("optkit-offers", "0")
            if not schema.isdecimal() or int(schema) > SCHEMA:
                raise DataError(f"{path} was written by a newer optkit (schema {schema}): upgrade optkit")
            cluster = cluster or table.marks.get("optkit-cluster")
            try:
                chosen = _features([name for name in table.names if name not in table.index], features, cluster)
            except DataError as error:
                raise DataError(f"{path}: {error}") from None
            more = {} if cluster is None or cluster == "situation" else {cluster: "labels"}
            table.need("situation", "compensation", "chosen", *chosen, *more)
            wanted = {name: kind for name, kind in _ROLES.items() if name in table.names}
            columns = table.columns(wanted | dict.fromkeys(chosen, "numbers") | more)
            rows = table.rows
        matrix = np.column_stack([columns.pop(name) for name in chosen]) if chosen else np.empty((rows, 0))
        labels = columns.pop("situation").tolist()
        if cluster is not None:
            columns["cluster"] = _codes(columns.pop(cluster).tolist() if more else labels)[0]
        columns["group"], named = _named_groups(columns.get("group", np.zeros(rows, int)))
        zeros = {name: np.zeros(rows, int) for name in ("group", "pickup", "dropoff") if name not in columns}
        try:
            return cls._labelled(labels, features=matrix, names=tuple(chosen), group_names=named, **zeros, **columns)
        except DataError as error:
            raise DataError(f"{path}: {error}") from None


class _SituationError(DataError):
    """One decision is not as it must be; whoever knows what a person calls it says that."""

    def __init__(self, situation: Any, what: str) -> None:
        super().__init__(f"offers: situation {situation} {what}")
        self.situation, self.what = situation, what


def _named_groups(column: Any) -> tuple[Any, tuple[str, ...] | None]:
    """Return numbers of groups and their names, in the order of the alphabet; or what is no text as it is."""
    values = column.tolist() if isinstance(column, np.ndarray) and column.dtype.kind in "OU" else []
    if not any(isinstance(value, str) for value in values):
        return column, None
    wrong = next((i for i, value in enumerate(values) if not isinstance(value, str) or not value.strip()), None)
    if wrong is not None:
        raise DataError(f"offers: group in row {wrong} is {values[wrong]!r}, and others have names: give each its name")
    names = sorted(set(values))
    number = {name: g for g, name in enumerate(names)}
    return np.array([number[value] for value in values], dtype=np.int64), tuple(names)


def _features(names: list[Any], features: Sequence[str] | None, cluster: str | None) -> list[Any]:
    """Return which columns are features: those asked for, or all that have no other role."""
    if cluster in _ROLES and cluster != "situation":
        raise DataError(f"{cluster!r} cannot be the cluster: the column has another role")
    chosen = [n for n in names if n not in _ROLES and n != cluster] if features is None else list(features)
    if any(not str(name).strip() or str(name).startswith("Unnamed:") for name in chosen):
        raise DataError("the offers have a column without a name (a row number?): drop it, or name the features")
    double = {name for name, times in Counter(chosen).items() if times > 1 or name in _ROLES or name == cluster}
    if features is not None and double:
        raise DataError(f"{min(map(repr, double))} is asked for as a feature twice, or has another role")
    return chosen


def _apart(columns: Sequence[Ints]) -> Ints:
    """Number the entries of columns so that no two columns have one in common."""
    numbered, first = [], 0
    for column in columns:
        label, place = np.unique(column, return_inverse=True)
        numbered.append(place + first)
        first += label.size
    return np.concatenate(numbered)


def _codes(labels: Sequence[Any]) -> tuple[Ints, list[Any]]:
    """Number labels in order of first appearance; return the number of each, and the labels."""
    number: dict[Any, int] = {}
    code = np.array([number.setdefault(label, len(number)) for label in labels], dtype=np.int64)
    return code, list(number)


def _labels(name: str, column: Any) -> list[Any]:
    """Return labels, but none of which nobody can say whether two are the same: empty, text beside numbers, lists."""
    labels: list[Any] = column.tolist()
    empty = column.isna().to_numpy()
    for i, label in enumerate(labels):
        if empty[i] or (isinstance(label, str) and not label.strip()):
            raise DataError(f"offers: {name} in row {i} is empty")
        if not isinstance(label, Hashable):
            raise DataError(f"offers: {name} in row {i} is a {type(label).__name__}, neither text nor a number")
        for kind in (str, bool):
            if isinstance(label, kind) != isinstance(labels[0], kind):
                both = f"{labels[0]!r} in row 0 and {label!r} in row {i}"
                raise DataError(f"offers: {name} is {both}: make all of them text (dtype=str)")
    return labels
