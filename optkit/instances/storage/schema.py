"""Instance sets on disk: a folder of one JSON file and three tables that any language can read.

========================  ============================================================================
``scenario.json``         what the set is, how to check it, and one record per instance (UTF-8)
``requests.parquet``      one row per request
``workers.parquet``       one row per worker
``noise.parquet``         one row per realised noise; absent when no instance has any
========================  ============================================================================

``scenario.json``, schema 1:

===================  ============  ===================================================================
key                  type          meaning
===================  ============  ===================================================================
format               string        ``"optkit-instances"``
schema               integer       version of this description; a reader refuses a newer one
sha256               string        of this file with these 64 digits replaced by zeros and without carriage
                                   returns; optional: delete the entry when you edit the file
optkit               string        version of optkit that wrote the set
scenario             object        origin, settings, seeds: whatever the writer gave
features, groups     integer       k and D, the same for every instance
files                object        per table: ``sha256`` and ``rows``
instances            array         per instance: ``horizon`` (steps), ``requests`` n, ``workers`` J, ``mu`` (D
                                   numbers, money), ``outside_utility`` (number or D numbers, money),
                                   ``noise`` (``"none"``, ``"dense"`` or ``"sparse"``)
===================  ============  ===================================================================

The tables are sorted by their index columns, which count from 0; int is int64, float is float64, nothing is null
but ``outside_noise``:

=========  ===========================  =====  =======================================================
table      column                       type   meaning and unit
=========  ===========================  =====  =======================================================
requests   instance, request            int    index: every instance lists its requests 0..n-1
requests   arrival, expiry              int    first and last step to serve it, inclusive; steps 0..T-1
requests   reward, penalty              float  money; penalty <= 0
requests   pickup, dropoff              int    location index
requests   feature_0 .. feature_(k-1)   float  characteristics x of the request
requests   utility_0 .. utility_(D-1)   float  mean utility of the request to each group, money
workers    instance, worker             int    index: every instance lists its workers 0..J-1
workers    step, group                  int    step at which the worker is seen; group 0..D-1
workers    outside_noise                float  realised noise of rejecting, money; null if not realised
noise      instance, worker, request    int    index; dense: every pair, sparse: the compatible pairs
noise      noise                        float  realised noise of the pair, money
=========  ===========================  =====  =======================================================

Schema 2 keeps what users call things, and is written where an instance has such labels. ``scenario.json`` has more:

===================  ============  ===================================================================
key                  type          meaning
===================  ============  ===================================================================
columns              object        the columns of labels that the tables have, each with its type,
                                   ``"string"`` or ``"int64"``
group_names          array         D strings, or null
feature_names        array         k strings, or null
instances            array         per instance also ``labels``, an object that says of each column of
                                   labels that the instance has whether it holds ``"text"`` or
                                   ``"number"``; ``clock``, null or an object of ``start`` (ISO 8601),
                                   ``step`` (seconds) and perhaps ``zone`` (a name)
===================  ============  ===================================================================

and the tables have these columns, null in instances without:

=========  ===========================  ======  ======================================================
table      column                       type    meaning
=========  ===========================  ======  ======================================================
requests   request_id                   either  what the request is called, unique in an instance
workers    worker_id                    either  what the worker is called, unique in an instance
workers    joined                       int     step at which the worker joined the queue
=========  ===========================  ======  ======================================================
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from optkit.basics.errors import DataError

FORMAT = "optkit-instances"
SCHEMA = 2
LABELS = {"requests": {"request_id": "request_id"}, "workers": {"worker_id": "worker_id", "joined": "worker_joined"}}
"""Columns of labels in each table, and the field of an Instance that each holds."""

COLUMNS = {
    "requests": (["instance", "request", "arrival", "expiry", "pickup", "dropoff"], ["reward", "penalty"]),
    "workers": (["instance", "worker", "step", "group"], ["outside_noise"]),
    "noise": (["instance", "worker", "request"], ["noise"]),
}
ZEROS = b"0" * 64
REMEDY = "copy the folder again from its source, or write it anew with save_instances"

Columns = dict[str, npt.NDArray[Any]]


def table_schema(table: str, k: int, D: int, labels: Mapping[str, str] | None = None) -> Any:
    """Return the Arrow schema of a table with k features, D groups and columns of labels, each with its type."""
    import pyarrow as pa

    integers, floats = COLUMNS[table]
    if table == "requests":
        floats = [*floats, *(f"feature_{f}" for f in range(k)), *(f"utility_{d}" for d in range(D))]
    fields = [pa.field(name, pa.int64(), nullable=False) for name in integers]
    fields += [pa.field(name, pa.float64(), nullable=name == "outside_noise") for name in floats]
    own = [name for name in LABELS.get(table, {}) if name in (labels or {})]
    types = {"string": pa.string(), "int64": pa.int64()}
    return pa.schema(fields + [pa.field(name, types[(labels or {})[name]]) for name in own])


def seal(raw: bytes, stated: object) -> str:
    """Return the checksum of a description whose own checksum ``stated`` is blanked out."""
    blank = raw.replace(b"\r", b"").replace(str(stated).encode(errors="replace"), ZEROS, 1)
    return hashlib.sha256(blank).hexdigest()


def is_number(value: Any, *, whole: bool = False) -> bool:
    """Whether a JSON value is a number, or a whole one of at least 0."""
    return (type(value) is int and (0 if whole else -(2**63)) <= value < 2**63) or (type(value) is float and not whole)


def damaged(path: Path, what: str) -> DataError:
    """Return the error that a file is not as it was written."""
    return DataError(f"{path} {what}: {REMEDY}")


def read_bytes(path: Path) -> bytes:
    """Return the content of a file, or raise a DataError that says why not."""
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise damaged(path, "is no regular file")  # and might never end
        return path.read_bytes()
    except FileNotFoundError:
        raise damaged(path, "is missing") from None
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror}): check that it is a file you may read") from error
