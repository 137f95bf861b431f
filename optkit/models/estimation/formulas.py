"""Formulas: what statsmodels makes of them, and what of it a conditional logit uses."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from statsmodels.formula.formulatools import handle_formula_data

from optkit.basics.arrays import Ints, unmasked
from optkit.basics.errors import InputError, OptkitError
from optkit.models.estimation.choices import mask_of_rows
from optkit.models.frames import frame_of
from optkit.models.rows import Rows

INTERCEPT = "Intercept"


class UnknownColumnError(InputError):
    """A column that is to be left out is not there."""


@dataclass(frozen=True)
class Made:
    """Where a formula's design comes from.

    Attributes
    ----------
    columns : dict of str to str
        Columns of the data that hold an argument.
    labels : pandas.Index
        Of all rows.
    used : (m,) int
        Those of the rows that the formula was evaluated on: the available ones.
    dropped : tuple of str
        Columns that are left out.
    frame : pandas.DataFrame
        All rows of the data.
    """

    columns: dict[str, str]
    labels: Any
    used: Ints
    dropped: tuple[str, ...]
    frame: pd.DataFrame

    def design(self, endog: Any, exog: pd.DataFrame) -> tuple[Any, pd.DataFrame]:
        """Return choices and columns of all rows; those that are not available are not chosen, and hold NaN."""
        names = list(exog.columns)
        if unknown := [name for name in self.dropped if name not in (*names, INTERCEPT)]:
            raise UnknownColumnError(f"drop_cols names {unknown[0]!r}; the columns are {', '.join(names)}")
        kept = [i for i, name in enumerate(names) if name not in self.dropped]
        x = np.full((len(self.labels), len(kept)), np.nan)
        y = np.zeros(len(self.labels))
        x[self.used], y[self.used] = np.asarray(exog, dtype=float)[:, kept], np.asarray(endog, dtype=float).ravel()
        name = next(iter(endog.columns)) if hasattr(endog, "columns") else endog.name
        columns = pd.DataFrame(x, index=self.labels, columns=[names[i] for i in kept])
        return pd.Series(y, index=self.labels, name=name), columns


def prepared(
    formula: Any, data: Any, subset: Any, drop_cols: Any, given: dict[str, Any], outside: bool, depth: Any
) -> tuple[Made, pd.DataFrame, dict[str, Any]]:
    """Return where the design comes from, the rows to evaluate the formula on, and the arguments of all rows.

    ``given`` are arguments, or names of columns; ``depth`` is how many calls up the formula's variables are.
    """
    data = frame_of("data", data)
    if not isinstance(data, pd.DataFrame):
        raise InputError(f"data is a {type(data).__name__}; give a DataFrame")
    if data.empty:
        raise InputError("there are no rows; give at least one situation")
    columns = {key: value for key, value in given.items() if isinstance(value, str)}
    whole = Rows(len(data), data.index, "data")
    for key, value in given.items():
        if key in columns:
            given[key] = column_of(data, key, columns[key])
        elif not (key == "weights" and hasattr(value, "iloc") and not whole.has(value)):  # those go by situation
            given[key] = whole.take(key, value)
    if subset is not None:
        place = _places(data, subset)
        given = {key: _cut(value, place, len(data)) for key, value in given.items()}
        data = data.iloc[place]
    mask = mask_of_rows("available", given["available"], Rows(len(data), data.index, "data"))
    used = np.arange(len(data)) if mask is None else np.flatnonzero(mask)
    left = str(formula).partition("~")[0].strip()
    if mask is not None:
        _refuse_chosen(left, data, np.flatnonzero(~mask), depth)
    table = _plain(data.iloc[used])
    if left in table and table[left].dtype == bool:  # a formula would make two columns of it
        table = table.assign(**{left: table[left].astype(float)})
    dropped = [] if drop_cols is None else [drop_cols] if isinstance(drop_cols, str) else _names(drop_cols)
    dropped += [] if outside else [INTERCEPT]
    return Made(columns, data.index, used, tuple(dropped), data), table, given


def column_of(data: pd.DataFrame, key: str, column: str, name: str = "the data") -> pd.Series:
    """Return the column of the data that holds an argument."""
    if column not in data:
        raise InputError(f"{key} = {column!r} is not a column of {name}")
    return data[column]


def evaluated(results: Any, data: Any, used: Ints) -> np.ndarray[Any, Any]:
    """Return the columns of a fitted formula for new data: (m, k), NaN in rows that are not used.

    Raises
    ------
    InputError
        If a variable is missing, or a level was not there when the model was fitted.
    """
    # Places instead of labels: a row with a missing value is left out, and found again by its place.
    table = _plain(data.iloc[used]).reset_index(drop=True)
    model, rows = results.model, Rows(len(data), data.index)
    x = np.full((len(data), model.k_params), np.nan)
    if not len(used):
        return x
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            full, _ = results._transform_predict_exog(table)
        except Exception as error:
            for column in _variables(model.formula, table):
                fitted = getattr(model.data, "frame", table)  # gone after remove_data
                if _is_number(fitted[column]) and not _is_number(table[column]):
                    raise InputError(f"column {column} of exog does not hold numbers, as it did in the fit") from None
            raise translated(error, model.formula, table, rows, used, "exog") from error
    if gone := np.flatnonzero(np.isnan(full).any(axis=1)).tolist():
        for column in _variables(model.formula, table):
            if pd.isna(table[column].iloc[gone[0]]):
                where = rows.called(int(used[gone[0]]))
                raise InputError(f"the formula does not fit exog: column {column} is missing in {where}")
    for one in told:
        if "categories outside" in str(one.message):  # one of the engines makes zeros of them, with a warning
            raise InputError(f"the formula does not fit exog: {' '.join(str(one.message).split())}")
    spec = getattr(model, "model_spec", None) or getattr(model.data, "model_spec", None) or model.data.design_info
    names = list(spec.column_names)
    x[used] = full[:, [names.index(name) for name in model.exog_names]]
    return x


def translated(
    error: Exception, formula: Any, table: pd.DataFrame, rows: Rows, used: Ints, name: str = "the data"
) -> Exception:
    """Return what to raise for an error of the engine of formulas over the ``used`` rows."""
    if isinstance(error, OptkitError | MemoryError | RecursionError):
        return error
    words = " ".join((getattr(error, "message", None) or str(error)).split("error message returned by")[-1].split())
    words = re.sub(r"^(patsy|formulaic) is: ", "", words)
    if re.search("missing|null|nan", words.lower()):
        for column in _variables(formula, table):
            if gone := np.flatnonzero(table[column].isna()).tolist():
                where = rows.called(int(used[gone[0]]))
                return InputError(f"the formula does not fit {name}: column {column} is missing in {where}")
    origin = getattr(error, "origin", None)  # where patsy puts the variable in question
    where = f" ({origin.relevant_code()})" if origin is not None else ""
    return InputError(f"the formula does not fit {name}{where}: {words}")


def _names(drop_cols: Any) -> list[str]:
    unmasked("drop_cols", drop_cols)
    try:
        return [str(name) for name in drop_cols]
    except TypeError:
        raise InputError(f"drop_cols is a {type(drop_cols).__name__}; give a list of names of columns") from None


def _variables(formula: Any, data: pd.DataFrame) -> list[Any]:
    """Return the columns that a formula names."""
    return [c for c in data.columns if re.search(rf"(?<!\w){re.escape(str(c))}(?!\w)", str(formula))]


def _is_number(column: pd.Series) -> bool:
    return bool(pd.api.types.is_numeric_dtype(column.dtype))


def _places(data: pd.DataFrame, subset: Any) -> Ints:
    subset = subset(data) if callable(subset) else subset
    unmasked("subset", subset)
    try:
        found = pd.Series(np.arange(len(data)), index=data.index).loc[subset]
    except (KeyError, IndexError, TypeError, ValueError, NotImplementedError, pd.errors.IndexingError) as error:
        raise InputError(f"subset does not fit the data: {' '.join(str(error).split())}") from None
    return np.atleast_1d(np.asarray(found))


def _cut(value: Any, place: Ints, n: int) -> Any:
    if value is None or not hasattr(value, "__len__") or len(value) != n:
        return value
    if hasattr(value, "iloc"):
        return value.iloc[place]
    return value[place] if isinstance(value, np.ndarray) else [value[i] for i in place]


def _refuse_chosen(left: str, data: pd.DataFrame, hidden: Ints, depth: Any) -> None:
    """Refuse a row that is chosen but not available; whatever else such a row holds is let be."""
    table = _plain(data.iloc[hidden]).set_axis(hidden, axis=0)
    if left in table:
        chosen = table[left] == 1
    else:
        try:
            (endog, _), *_ = handle_formula_data(table, None, f"{left} ~ 1", depth=depth, missing="drop")
        except Exception:
            return
        chosen = endog.iloc[:, -1] == 1
    if chosen.any():
        row = Rows(len(data), data.index).called(int(np.asarray(chosen.index[chosen])[0]))
        raise InputError(f"{row} is chosen but not available")


def _plain(data: pd.DataFrame) -> pd.DataFrame:
    """Return columns that can be missing as NumPy's: the engines of formulas know no others."""
    made = {}
    for place, kind in enumerate(data.dtypes):
        column = data.iloc[:, place]
        if not isinstance(kind, pd.api.extensions.ExtensionDtype):
            continue
        gaps = bool(column.isna().any())
        if pd.api.types.is_bool_dtype(kind):
            made[place] = column.astype(object).where(column.notna(), None) if gaps else column.astype(bool)
        elif pd.api.types.is_integer_dtype(kind) and not gaps:
            made[place] = column.astype(np.int64)
        elif pd.api.types.is_numeric_dtype(kind):
            made[place] = pd.Series(column.to_numpy(dtype=float, na_value=np.nan), index=data.index)
    columns = {place: made.get(place, data.iloc[:, place]) for place in range(data.shape[1])}
    return pd.DataFrame(columns, index=data.index).set_axis(data.columns, axis=1) if made else data
