"""Arguments of an estimator: numbers with their names, and penalties."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from optkit.basics.errors import InputError
from optkit.models.decision import Floats


def numbers(name: str, x: Any) -> Any:
    """Return floats: a DataFrame or Series stays one, so that statsmodels finds its names."""
    try:
        if isinstance(x, pd.DataFrame):
            for column in x.columns[[dtype != np.float64 for dtype in x.dtypes]]:
                name = f"column {column}"
                x = x.assign(**{column: x[column].astype(float)})
            return x
        return x.astype(float) if isinstance(x, pd.Series) else np.asarray(x, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} does not hold numbers; give floats, or use from_formula with C(...)") from None


def penalties_of(penalty: Any, names: list[str]) -> Floats:
    """Return the L2 penalty of each column, (k,), from a number, a sequence or a dict by name."""
    if isinstance(penalty, Mapping):
        unknown = [key for key in penalty if key not in names]
        if unknown:
            raise InputError(f"penalty names {unknown[0]!r}; the columns are {', '.join(names)}")
        penalty = [penalty.get(name, 0.0) for name in names]
    try:
        full: Floats = np.array(np.broadcast_to(np.asarray(penalty, dtype=float), len(names)))
    except (TypeError, ValueError):
        raise InputError(f"penalty is not a number, or one for each of the {len(names)} columns") from None
    bad = ~(np.isfinite(full) & (full >= 0))
    if bad.any():
        column = int(bad.argmax())
        raise InputError(f"the penalty of {names[column]} is {full[column]}; give numbers of at least 0")
    return full
