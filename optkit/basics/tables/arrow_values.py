"""Arrow columns as plain values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import DataError
from optkit.basics.tables.text import reading


def plain(path: Path, name: str, column: Any) -> list[Any] | npt.NDArray[Any]:
    """Return an Arrow column as plain values: numbers and booleans as they are, all else as text.

    Raises
    ------
    DataError
        If its type has no text, as a list has none, or the file is damaged.
    """
    import pyarrow as pa

    kinds = pa.types
    with reading(path, "write the table anew", text=False):
        if kinds.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        kind = column.type
        if kinds.is_null(kind):
            return [None] * len(column)
        if kinds.is_integer(kind) or kinds.is_floating(kind) or kinds.is_boolean(kind):
            if column.null_count:
                return list(column.to_pylist())
            return np.asarray(column.to_numpy(zero_copy_only=False))
        if kinds.is_nested(kind) or kinds.is_duration(kind):
            raise DataError(f"{path}: {name} holds {kind}, neither text nor numbers")
        return list(column.cast(pa.string()).to_pylist())
