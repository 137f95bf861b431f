"""Reading an instance set, and checking all of it."""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from optkit.basics.errors import DataError, InstanceError
from optkit.basics.folders import set_aside
from optkit.basics.printable import listed
from optkit.basics.strict_json import object_of
from optkit.basics.tables.text import reading
from optkit.instances.clock import Clock
from optkit.instances.instance import Instance
from optkit.instances.storage.schema import (
    COLUMNS,
    FORMAT,
    LABELS,
    REMEDY,
    SCHEMA,
    Columns,
    damaged,
    is_number,
    read_bytes,
    seal,
    table_schema,
)


def load_instances(folder: str | os.PathLike[str]) -> list[Instance]:
    """Read an instance set that :func:`optkit.instances.storage.save_instances` wrote, and check all of it.

    Parameters
    ----------
    folder : path
        The folder of the set.

    Returns
    -------
    list of Instance
        Equal to those that were written.

    Raises
    ------
    DataError
        If a file is missing, damaged, truncated, or from a newer optkit, or if an instance breaks a rule of
        :class:`~optkit.instances.instance.Instance`; the message names the file and the remedy.

    Examples
    --------
    >>> import tempfile
    >>> from optkit import scenario
    >>> from optkit.instances.storage import save_instances
    >>> days = scenario("I.2", seed=0).sample(2, seed=1)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     load_instances(save_instances(f"{place}/days", days)) == days
    True
    """
    place, document = Path(folder), read_description(folder)
    records = document["instances"]
    tables = {table: _read_table(place / f"{table}.parquet", document) for table in COLUMNS}
    n, J = (np.array([record[size] for record in records], dtype=np.int64) for size in ("requests", "workers"))
    one = np.ones_like(n)
    _check_index(place / "requests.parquet", tables["requests"], ("request", n), ("", one), n)
    _check_index(place / "workers.parquet", tables["workers"], ("worker", J), ("", one), J)
    stored = {"none": 0 * J, "dense": J * n, "sparse": -one}
    pairs = np.array([stored[record["noise"]][b] for b, record in enumerate(records)], dtype=np.int64)
    _check_index(place / "noise.parquet", tables["noise"], ("worker", J), ("request", n), pairs)
    for name, column, count in (("features", "feature", "features"), ("utility", "utility", "groups")):
        matrix = np.array([tables["requests"][f"{column}_{c}"] for c in range(document[count])])
        tables["requests"][name] = matrix.reshape(document[count], n.sum()).T
    names = {name: document.get(name) for name in ("group_names", "feature_names")}
    starts = {table: np.searchsorted(tables[table]["instance"], np.arange(len(records) + 1)) for table in tables}
    return [
        _instance(place, b, record, names, {t: slice(starts[t][b], starts[t][b + 1]) for t in tables}, tables)
        for b, record in enumerate(records)
    ]


def read_description(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Read and check ``scenario.json`` alone: the settings and sizes of a set, without its tables.

    Parameters
    ----------
    folder : path
        The folder of the set.

    Returns
    -------
    dict
        The file's content, see :mod:`optkit.instances.storage.schema`.

    Raises
    ------
    DataError
        If the folder or the file is missing, damaged, of another format, or from a newer optkit.

    Examples
    --------
    >>> import tempfile
    >>> from optkit import scenario
    >>> from optkit.instances.storage import save_instances
    >>> source = scenario("I.2", seed=0)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = save_instances(f"{place}/days", source.sample(2, seed=1), scenario=source.describe())
    ...     read_description(folder)["scenario"]["name"]
    'I.2'
    """
    place = Path(folder)
    path = place / "scenario.json"
    if not place.is_dir():
        aside = set_aside(place)
        if aside is not None:
            raise DataError(f"{place} is missing: a save was interrupted; the set is {aside}: move it back")
        raise DataError(f"{place} is not a folder: give the folder of an instance set, made by save_instances")
    raw = read_bytes(path)
    try:
        document = object_of(raw)
    except ValueError as error:
        raise damaged(path, f"is not a JSON object as it should be ({error})") from None
    if document.get("format") != FORMAT:
        raise DataError(f"{path} has format {document.get('format')!r}, not {FORMAT!r}: give an instance set's folder")
    schema: Any = document.get("schema")
    if not is_number(schema, whole=True) or schema < 1:
        raise damaged(path, f"has schema {schema!r}, which is no version")
    if schema > SCHEMA:
        newer = f"was written by a newer optkit (schema {schema}; this one reads up to {SCHEMA})"
        raise DataError(f"{path} {newer}: upgrade optkit")
    if "sha256" in document and document["sha256"] != seal(raw, document["sha256"]):
        raise damaged(path, "was changed or damaged (its sha256 differs; after an edit, delete that entry)")
    _check_document(path, document)
    return document


def _check_document(path: Path, document: dict[str, Any]) -> None:
    for key, kind in (("scenario", dict), ("features", int), ("groups", int), ("files", dict), ("instances", list)):
        value = document.get(key)
        if not isinstance(value, kind) or (
            isinstance(value, int) and (type(value) is bool or not 0 <= value < 100_000)
        ):
            raise damaged(path, f"has no valid entry {key!r}")

    if document["schema"] > 1:
        columns, known = document.get("columns"), [name for names in LABELS.values() for name in names]
        if not isinstance(columns, dict) or any(
            name not in known or kind not in ("string", "int64") for name, kind in columns.items()
        ):
            raise damaged(path, "has no valid entry 'columns'")
        for key, count in (("group_names", "groups"), ("feature_names", "features")):
            names = document.get(key)
            if names is not None and not (isinstance(names, list) and len(names) == document[count]):
                raise damaged(path, f"has no valid entry {key!r}")

    def per_group(value: Any) -> bool:
        return isinstance(value, list) and len(value) == document["groups"] and all(map(is_number, value))

    for b, record in enumerate(document["instances"]):
        if not (
            isinstance(record, dict)
            and all(is_number(record.get(key), whole=True) for key in ("horizon", "requests", "workers"))
            and per_group(record.get("mu"))
            and (is_number(record.get("outside_utility")) or per_group(record.get("outside_utility")))
            and record.get("noise") in ("none", "dense", "sparse")
            and (document["schema"] == 1 or _right_labels(record, document["columns"]))
        ):
            raise damaged(path, f"has an incomplete or wrong record of instance {b}")


def _right_labels(record: dict[str, Any], columns: dict[str, str]) -> bool:
    labels, clock = record.get("labels"), record.get("clock")
    return (
        isinstance(labels, dict)
        and all(
            name in columns and kind in ("text", "number") and (kind, columns[name]) != ("text", "int64")
            for name, kind in labels.items()
        )
        and (clock is None or Clock.describes(clock))
    )


def _read_table(path: Path, document: dict[str, Any]) -> Columns:
    """Return the columns of one table by name, after checking its bytes, its columns and its row count."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    wanted = table_schema(path.stem, document["features"], document["groups"], document.get("columns"))
    stated = document["files"].get(path.name)
    if stated is None and path.stem == "noise":
        return {field.name: np.zeros(0, field.type.to_pandas_dtype()) for field in wanted}
    if not isinstance(stated, dict):
        raise damaged(path.with_name("scenario.json"), f"does not list {path.name}")
    raw = read_bytes(path)
    if hashlib.sha256(raw).hexdigest() != stated.get("sha256"):
        raise damaged(path, "is damaged or truncated (its sha256 is not that in scenario.json)")
    with reading(path, REMEDY, text=False):
        file = pq.ParquetFile(pa.BufferReader(raw))
        names = Counter(file.schema_arrow.names)
        have = {field.name: field.type for field in file.schema_arrow}
        # Columns of one's own are ignored, but not more features or groups than are declared.
        alien = [name for name in names if name not in wanted.names and re.fullmatch(r"(feature|utility)_\d+", name)]
        if alien:
            raise damaged(path, f"has a column {alien[0]!r}, beyond the features and groups of scenario.json")
        for field in wanted:
            if field.name not in have:
                raise damaged(path, f"has no column {field.name!r} among {listed(have)}")
            if names[field.name] > 1:
                raise damaged(path, f"has the column {field.name!r} twice")
            if have[field.name] != field.type:
                raise damaged(path, f"has {have[field.name]} in column {field.name!r}, not {field.type}")
        data = file.read(columns=wanted.names)
    if data.num_rows != stated.get("rows"):
        raise damaged(path, f"has {data.num_rows} rows, scenario.json says {stated.get('rows')}")
    for field in wanted:
        if data.column(field.name).null_count and not field.nullable:
            raise damaged(path, f"has empty cells in column {field.name!r}")
    labels = LABELS.get(path.stem, {})
    return {
        name: np.array(data.column(name).to_pylist(), dtype=object) if name in labels else data.column(name).to_numpy()
        for name in wanted.names
    }


def _check_index(
    path: Path,
    columns: Columns,
    outer: tuple[str, npt.NDArray[np.int64]],
    inner: tuple[str, npt.NDArray[np.int64]],
    rows: npt.NDArray[np.int64],
) -> None:
    """Check a table's index: known instances, ``rows`` of each (-1: any number), sorted, in range, no duplicates.

    ``outer`` and ``inner`` name an index column and give its size per instance; right counts then leave no gap.
    """
    instance, (name, height), (nested, width) = columns["instance"], outer, inner
    unknown = (instance < 0) | (instance >= rows.size)
    if unknown.any():
        raise damaged(path, f"has an unknown instance {instance[unknown.argmax()]} in row {unknown.argmax()}")
    counts = np.bincount(instance, minlength=rows.size)
    short = (counts != rows) & (rows >= 0)
    if short.any():
        b = short.argmax()
        raise damaged(path, f"has {counts[b]} rows of instance {b}, which scenario.json says has {rows[b]}")
    first = np.cumsum(height * width) - height * width
    i, j = columns[name], columns[nested] if nested else np.zeros_like(instance)
    wrong = (i < 0) | (i >= height[instance]) | (j < 0) | (j >= width[instance])
    wrong[1:] |= np.diff(first[instance] + i * width[instance] + j) <= 0
    if wrong.any():
        raise damaged(path, f"is out of order, repeats itself or leaves the index range in row {wrong.argmax()}")


def _instance(
    place: Path, b: int, record: dict[str, Any], names: dict[str, Any], at: dict[str, slice], tables: dict[str, Columns]
) -> Instance:
    requests, workers, pairs = ({name: c[at[t]] for name, c in tables[t].items()} for t in COLUMNS)
    own = {"requests": requests, "workers": workers}
    labels: dict[str, Any] = {
        field: _labels(own[table][column], record["labels"][column])
        for table, fields in LABELS.items()
        for column, field in fields.items()
        if column in record.get("labels", {})
    }
    n, J, kind = record["requests"], record["workers"], record["noise"]
    noise: Any = None
    if kind == "dense":
        noise = pairs["noise"].reshape(J, n)
    elif kind == "sparse":
        starts = np.searchsorted(pairs["worker"], np.arange(J + 1))
        noise = sparse.csr_array((pairs["noise"], pairs["request"], starts), shape=(J, n))
    outside, clock = workers["outside_noise"], record.get("clock")
    if kind == "none" and not np.isnan(outside).all():
        raise damaged(place / "workers.parquet", f"has outside_noise in instance {b}, whose noise is not realised")
    try:
        return Instance(
            horizon=record["horizon"],
            **{c: requests[c] for c in ("arrival", "expiry", "reward", "penalty", "pickup", "dropoff")},
            features=requests["features"],
            worker_step=workers["step"],
            worker_group=workers["group"],
            utility=requests["utility"].T,
            mu=np.array(record["mu"], dtype=np.float64),
            outside_utility=record["outside_utility"],
            noise=noise,
            outside_noise=None if noise is None else outside,
            group_names=names["group_names"],
            feature_names=names["feature_names"],
            clock=None if clock is None else Clock.read(clock),
            **labels,
        )
    except (InstanceError, ValueError) as error:
        raise DataError(f"{place}: instance {b} breaks a rule: {error}") from error


def _labels(column: npt.NDArray[Any], kind: str) -> list[Any]:
    """Return labels as they were given: a number among text is written as text."""
    return [int(x) if kind == "number" and x is not None else x for x in column.tolist()]
