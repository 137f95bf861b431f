"""Tables with named columns, from whatever library they come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from optkit.basics.errors import InputError
from optkit.models.rows import labelled


def frame_of(name: str, x: Any) -> Any:
    """Return a DataFrame of anything whose columns have names, whatever library it is from; all else as it is.

    Raises
    ------
    InputError
        If two columns have one name, or what is in the columns cannot be found out.

    Examples
    --------
    >>> frame_of("exog", {"pay": [2.0, 3.0]}).columns.tolist()
    ['pay']
    """
    if not isinstance(x, pd.DataFrame):
        x = _made_frame(name, x)
    if isinstance(x, pd.DataFrame):
        if x.columns.nlevels > 1:  # as statsmodels names them, but of any kind
            flat = ["_".join(str(level) for level in c if level not in ("", None)) for c in x.columns]
            x = x.set_axis(flat, axis=1)
        names = [str(c) for c in x.columns]
        if len(set(names)) < len(names):
            double = next(c for c, times in Counter(names).items() if times > 1)
            raise InputError(f"{name} has the column {double!r} twice; leave one")
    return x


def _made_frame(name: str, x: Any) -> Any:
    fields = getattr(getattr(x, "dtype", None), "names", None)
    try:
        if isinstance(x, Mapping):
            return pd.DataFrame(dict(x))
        if fields and not labelled(x):
            return pd.DataFrame({field: x[field] for field in fields})
        if hasattr(x, "to_pandas"):
            return x.to_pandas()
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{name} is no table: {' '.join(str(error).split())}") from None
    described = getattr(x, "design_info", x)  # that is where patsy keeps the names
    names = getattr(described, "column_names", getattr(described, "columns", None))
    if names is None or callable(names) or labelled(x):
        return x
    try:
        array = np.asarray(x)
        return pd.DataFrame({c: array[:, i] for i, c in enumerate(list(names))})
    except (TypeError, ValueError, IndexError):
        kind = type(x).__name__
        raise InputError(f"{name} is a {kind} whose columns cannot be read; give a pandas DataFrame") from None
