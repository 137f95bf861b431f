"""The one way in: a table of any format that the kit reads."""

from __future__ import annotations

import os
from pathlib import Path

from optkit.basics.tables.csv_rows import CsvTable
from optkit.basics.tables.json_rows import JsonTable
from optkit.basics.tables.parquet_rows import ParquetTable
from optkit.basics.tables.table import Table


def open_table(
    path: str | os.PathLike[str],
    *,
    remedy: str = "give a CSV, JSON or parquet file",
    under: str | None = None,
    trailing: bool = False,
) -> Table:
    r"""Open a table: parquet if its name ends in ``.parquet``, JSON if in ``.json``, else CSV, gzipped if in ``.gz``.

    Parameters
    ----------
    path : path
        The file.
    remedy : str
        What to do about a file that cannot be read, for the error.
    under : str, optional
        JSON: the list of rows may stand under this key.
    trailing : bool
        CSV: rows may end in more commas than the header.

    Returns
    -------
    Table
        To be closed, or used in a ``with``.

    Raises
    ------
    DataError
        If the file cannot be read or is empty, a column has the name of another, or (JSON) rows differ in their keys or
        give one twice.

    Examples
    --------
    >>> import tempfile
    >>> from optkit.basics.tables.cells import labels, numbers
    >>> with tempfile.TemporaryDirectory() as place:
    ...     Path(place, "a.csv").write_text("id,km\n007,1.5\n7,2e1\n")
    ...     with open_table(f"{place}/a.csv") as table:
    ...         table.columns({"id": labels, "km": numbers})
    20
    {'id': array(['007', '7'], dtype=object), 'km': array([ 1.5, 20. ])}
    """
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix == ".parquet":
        return ParquetTable(source, remedy)
    if suffix == ".json":
        return JsonTable(source, remedy, under)
    return CsvTable(source, remedy, trailing)
