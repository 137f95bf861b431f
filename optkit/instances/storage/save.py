"""Writing an instance set."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from optkit.basics.arrays import flag
from optkit.basics.errors import InputError
from optkit.basics.files import cannot_write
from optkit.basics.folders import foreign_entry, publish, set_aside
from optkit.basics.paths import resolved
from optkit.basics.plain_json import parse_object
from optkit.basics.version import __version__
from optkit.instances.instance import Instance
from optkit.instances.storage.schema import (
    COLUMNS,
    FORMAT,
    LABELS,
    SCHEMA,
    ZEROS,
    Columns,
    read_bytes,
    seal,
    table_schema,
)


def save_instances(
    folder: str | os.PathLike[str],
    instances: Iterable[Instance],
    *,
    scenario: dict[str, Any] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write an instance set as a folder; what is read back equals it exactly.

    The set is written beside ``folder``, flushed to the disk and then renamed, so that ``folder`` never holds half a
    set. Replacing takes two renames. If the machine stops between them, both sets are complete in a hidden folder
    beside ``folder``, and :func:`optkit.instances.storage.load_instances` says where.

    Parameters
    ----------
    folder : path
        Created, with its parents.
    instances : iterable of Instance
        They share the number of features and of groups; horizons, sizes and kinds of noise may differ.
    scenario : dict, optional
        Origin, settings and seeds, of plain JSON values; :func:`optkit.instances.storage.read_description` returns it
        as JSON does (tuples become lists).
    overwrite : bool
        Replace ``folder`` if it is an instance set and holds nothing else.

    Returns
    -------
    Path
        ``folder``.

    Raises
    ------
    InputError
        If ``folder`` exists and may not be replaced, the instances do not fit in one set, or ``scenario`` is not JSON.
    OptkitError
        If the disk refuses; what was there before stays.

    Examples
    --------
    >>> import tempfile
    >>> from optkit.instances.storage import load_instances, read_description
    >>> day = Instance(horizon=4, arrival=[0, 1], expiry=[2, 3], reward=[30.0, 40.0], penalty=[-5.0, -6.0],
    ...                features=[[0.2], [0.7]], pickup=[0, 1], dropoff=[1, 0], worker_step=[1, 2],
    ...                worker_group=[0, 0], utility=[[-10.0, -12.0]], mu=[1.0]).with_noise(seed=0)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = save_instances(f"{place}/monday", [day], scenario={"origin": "by hand"})
    ...     load_instances(folder) == [day], read_description(folder)["scenario"]
    (True, {'origin': 'by hand'})
    """
    flag("overwrite", overwrite)
    items = _checked(instances)
    target = resolved(folder)

    def replaceable() -> bool:
        if os.path.lexists(target):
            check_replaceable(Path(folder), overwrite)
            return True
        return False

    replaceable()
    contents = _contents(items, scenario)
    try:
        publish(target, contents, replaceable)
    except OSError as error:
        aside = set_aside(target)
        stays = f"it is {aside}: move it back" if aside else "what was there before stays"
        raise cannot_write(folder, error, stays) from error
    return Path(folder)


def _checked(instances: Iterable[Instance]) -> list[Instance]:
    if isinstance(instances, Instance):
        raise InputError("instances is a single Instance: put it into a list")
    items = list(instances)
    for b, item in enumerate(items):
        if not isinstance(item, Instance):
            raise InputError(f"instances[{b}] is a {type(item).__name__}, not an Instance")
        have, want = ((x.features.shape[1], x.n_groups) for x in (item, items[0]))
        if have != want:
            shapes = " and ".join(f"instances[{at}] has {k} and {D}" for at, (k, D) in ((b, have), (0, want)))
            raise InputError(f"{shapes} features and groups: save them as separate sets")
        for name in ("group_names", "feature_names"):
            own, first = getattr(item, name), getattr(items[0], name)
            if own != first:
                raise InputError(
                    f"instances[{b}] has {name} {_listed(own)} and instances[0] {_listed(first)}: save them as "
                    "separate sets"
                )
    return items


def _listed(names: tuple[str, ...] | None) -> str:
    return "none" if names is None else ", ".join(names)


def check_replaceable(folder: Path, overwrite: bool) -> None:
    """Raise an InputError unless an existing folder is an instance set, and nothing else, that may be overwritten."""
    if not overwrite:
        raise InputError(f"{folder} exists: choose another folder, or pass overwrite=True to replace an instance set")
    path = folder / "scenario.json"
    document = parse_object(read_bytes(path)) if path.is_file() else None
    if document is None or document.get("format") != FORMAT:
        raise InputError(f"{folder} is not an instance set, so it stays: choose another folder, or remove it yourself")
    foreign = foreign_entry(folder, (path.name, *(f"{table}.parquet" for table in COLUMNS)))
    if foreign is not None:
        raise InputError(f"{folder} also holds {foreign!r}: move that away, or choose another folder")


def _contents(items: Sequence[Instance], scenario: dict[str, Any] | None) -> dict[str, bytes]:
    """Return the bytes of every file of the set, by name."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    k, D = (items[0].features.shape[1], items[0].n_groups) if items else (0, 0)
    rows = [_rows(item) for item in items]
    labels = _label_types(items)
    contents, files = {}, {}
    for table in COLUMNS:
        schema = table_schema(table, k, D, labels)
        own = [name for name in schema.names[1:] if name not in LABELS.get(table, {})]
        columns: dict[str, Any] = {
            name: np.concatenate([row[table][name] for row in rows] or [np.zeros(0)]) for name in own
        }
        columns |= {name: _label_column(items, table, name, labels[name]) for name in schema.names if name in labels}
        counts = [row[table][schema.names[1]].size for row in rows]
        columns["instance"] = np.repeat(np.arange(len(items)), counts)
        if table == "noise" and not sum(counts):
            continue
        arrays = [pa.array(columns[field.name], field.type, from_pandas=True) for field in schema]  # NaN becomes null
        sink = pa.BufferOutputStream()  # floats gain nothing from a dictionary
        pq.write_table(pa.Table.from_arrays(arrays, schema=schema), sink, use_dictionary=COLUMNS[table][0])
        contents[f"{table}.parquet"] = data = sink.getvalue().to_pybytes()
        files[f"{table}.parquet"] = {"sha256": hashlib.sha256(data).hexdigest(), "rows": sum(counts)}
    kept = [_labels(item) for item in items]
    names = {name: getattr(items[0], name) if items else None for name in ("group_names", "feature_names")}
    # What needs no labels is written so that an optkit without them reads it.
    labelled = any(any(one.values()) for one in kept) or any(names.values())
    schema_of_set = SCHEMA if labelled else 1
    document = {"format": FORMAT, "schema": schema_of_set, "sha256": ZEROS.decode(), "optkit": __version__}
    document |= {"scenario": {} if scenario is None else scenario, "features": k, "groups": D, "files": files}
    document |= {"columns": labels, **names} if labelled else {}
    document["instances"] = [_record(item) | (more if labelled else {}) for item, more in zip(items, kept, strict=True)]
    if not isinstance(document["scenario"], dict):
        raise InputError(f"scenario is a {type(scenario).__name__}: give a dict of plain JSON values")
    try:
        raw = (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"scenario is not JSON ({error}): use plain numbers, strings, lists and dicts") from error
    contents["scenario.json"] = raw.replace(ZEROS, seal(raw, ZEROS.decode()).encode(), 1)
    return contents


def _record(item: Instance) -> dict[str, Any]:
    return {
        "horizon": item.horizon,
        "requests": item.n_requests,
        "workers": item.n_workers,
        "mu": item.mu.tolist(),
        "outside_utility": np.asarray(item.outside_utility).tolist(),
        "noise": _kind(item),
    }


def _labels(item: Instance) -> dict[str, Any]:
    """Say which columns of labels an instance has, of text or of numbers, and by which clock it runs."""
    found = {
        column: "text" if getattr(item, field).dtype == object else "number"
        for fields in LABELS.values()
        for column, field in fields.items()
        if getattr(item, field) is not None
    }
    clock = item.clock
    return {"labels": found, "clock": None if clock is None else clock.to_dict()}


def _label_types(items: Sequence[Instance]) -> dict[str, str]:
    """Return the columns of labels that any instance has: text as soon as one instance has text."""
    found: dict[str, str] = {}
    for item in items:
        for column, kind in _labels(item)["labels"].items():
            found[column] = "string" if kind == "text" else found.get(column, "int64")
    return found


def _label_column(items: Sequence[Instance], table: str, column: str, kind: str) -> list[Any]:
    """Return a column of labels over all instances, with None in those that have none."""
    values: list[Any] = []
    for item in items:
        own = getattr(item, LABELS[table][column])
        count = item.n_requests if table == "requests" else item.n_workers
        listed = [None] * count if own is None else own.tolist()
        values += [str(x) if kind == "string" and x is not None else x for x in listed]
    return values


def _kind(item: Instance) -> str:
    return "none" if item.noise is None else "sparse" if sparse.issparse(item.noise) else "dense"


def _rows(item: Instance) -> dict[str, Columns]:
    """Return the rows that one instance adds to each table, by table and column."""
    noise: Any = item.noise
    kind = _kind(item)
    if kind == "dense":
        worker, request = np.indices(noise.shape).reshape(2, -1)
        value = noise.ravel()
    elif kind == "sparse":
        worker = np.repeat(np.arange(item.n_workers), np.diff(noise.indptr))
        request, value = noise.indices, noise.data
    else:
        worker, request, value = np.zeros(0, int), np.zeros(0, int), np.zeros(0)
    names = ("arrival", "expiry", "pickup", "dropoff", "reward", "penalty")
    requests = {"request": np.arange(item.n_requests)} | {name: getattr(item, name) for name in names}
    requests |= {f"feature_{f}": x for f, x in enumerate(item.features.T)}
    requests |= {f"utility_{d}": u for d, u in enumerate(item.utility)}
    workers = {"worker": np.arange(item.n_workers), "step": item.worker_step, "group": item.worker_group}
    outside = np.full(item.n_workers, np.nan) if item.outside_noise is None else item.outside_noise
    pairs = {"worker": worker, "request": request, "noise": value}
    return {"requests": requests, "workers": workers | {"outside_noise": outside}, "noise": pairs}
