"""The report of a study: one folder for people, spreadsheets, papers and programs."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Mapping, Sequence
from importlib import metadata
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optkit.basics.files import cannot_write
from optkit.basics.folders import ResultsFolder, publish
from optkit.basics.paths import resolved
from optkit.basics.version import versions
from optkit.plotting.files import figure_bytes, settled
from optkit.studies.cells import SCHEMA
from optkit.studies.grids import Study
from optkit.studies.policies import POLICIES
from optkit.studies.report.figures import DRAWINGS, study_figures
from optkit.studies.report.texts import CAPTIONS, LATEX, in_order, latex, long_table, shown
from optkit.studies.runner import StudyRun
from optkit.studies.tables import study_tables

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

FORMAT = "optkit study"
MOST = 200
"""Rows of a table that a report shows; of longer ones it shows the beginning."""
BEGINNING = 20
TIMES = "timings.csv"
"""The file that differs between two runs with the same results."""

FOLDER = ResultsFolder("report.json", FORMAT, "a study's report", loose=(TIMES,))

_ABOUT = {
    "homogeneous": "A homogeneous population of workers (section 5.1 of the paper).",
    "heterogeneous": "Three groups of workers, known or not (section 5.2 of the paper).",
    "sensitivity": "Preferences that are believed and wrong (sections 5.1 and 5.2 of the paper).",
    "nyc": "New York's taxi trips, with weak and with strong location preferences (section 5.3 of the paper).",
}
_DETAILS = ("rows", "over", "errors", "utilities", "pairs")


def check_report(folder: str | os.PathLike[str], study: str | None = None) -> bool:
    """Return whether a study's report is there, which may be replaced; call it before the work, not after.

    Parameters
    ----------
    folder : path
        Where the report is to be.
    study : str, optional
        Name of the study; the report of another is not replaced.

    Returns
    -------
    bool
        False where nothing is there yet.

    Raises
    ------
    InputError
        If the folder holds anything else, or cannot be made.

    Examples
    --------
    >>> check_report("no-such-folder", "nyc")
    False
    """

    def differs(told: dict[str, Any]) -> str | None:
        same = study is None or told.get("study") == study
        return None if same else f"the report of the study {told.get('study')}"

    return FOLDER.check(folder, differs)


def write_report(
    folder: str | os.PathLike[str], study: Study, run: StudyRun, claims: Sequence[Mapping[str, Any]] | None = None
) -> Path:
    """Write a study's report, whole or not at all; an earlier report of the same study in that place is replaced.

    ``report.html`` needs no other file, no network and no script. Beside it lie all tables (``NAME.csv`` and
    ``NAME.parquet``, those of :data:`optkit.studies.report.texts.LATEX` as ``NAME.tex`` too), all figures
    (``LABEL.png`` and ``LABEL.pdf``), ``report.json`` with settings, versions and checksums, and ``timings.csv`` with
    what each cell took. All files but this one are the same, byte by byte, for the same results.

    Parameters
    ----------
    folder : path
        Made with the folders above it.
    study : Study
        What was to be worked out.
    run : StudyRun
        Its cells; those that are missing are named in the report.
    claims : sequence of mapping, optional
        The paper's results beside these, one row each.

    Returns
    -------
    Path
        Of ``report.html``.

    Raises
    ------
    InputError
        If the folder holds anything but an earlier report of the study.
    OptkitError
        If the disk refuses.

    Examples
    --------
    >>> import tempfile
    >>> from optkit.studies.runner import run_cells
    >>> from optkit.studies.store import CellStore
    >>> study = Study("homogeneous", settings={"horizon": 15, "split": (20, 4, 4)}, gap=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     run = run_cells(study.cells()[:1], CellStore(f"{place}/cells"))
    ...     report = write_report(f"{place}/report", study, run)
    ...     report.name, sorted(path.name for path in report.parent.glob("bounds.*"))
    ('report.html', ['bounds.csv', 'bounds.parquet'])
    """
    check_report(folder, study.name)
    contents = report_files(study, run, claims)
    try:
        publish(resolved(folder), contents, lambda: check_report(folder, study.name))
    except OSError as error:
        raise cannot_write(folder, error, "choose another with --out") from error
    return Path(folder) / "report.html"


def report_files(study: Study, run: StudyRun, claims: Sequence[Mapping[str, Any]] | None = None) -> dict[str, bytes]:
    """Return the files of a report by name, see :func:`write_report`."""
    import pandas as pd

    tables = study_tables(run)
    if claims:
        tables["claims"] = pd.DataFrame([dict(row) for row in claims])
    figures = study_figures(tables, trips=study.trips)
    contents: dict[str, bytes] = {}
    for name, frame in tables.items():
        contents |= _table_files(name, frame)
    drawn = []
    for name, figure in figures.items():
        kinds = ("pdf", "svg", "png")
        settled(figure)
        made = {f"{name}.{kind}": figure_bytes(figure, kind, name=name, facecolor="white") for kind in kinds}
        drawn.append(_figure(name, figure, made.pop(f"{name}.svg"), list(made)))
        contents |= made
    about = _about(study, run)
    undrawn = [name for name, drawing in DRAWINGS.items() if drawing.study == study.name and name not in figures]
    contents["report.html"] = _html(study, run, tables, drawn, undrawn, about).encode()
    contents[TIMES] = _csv(_timings(run))
    told = {"study": study.name, **about, "claims": [dict(row) for row in claims or ()]}
    return FOLDER.files(contents, told)


def _csv(frame: pd.DataFrame) -> bytes:
    return frame.to_csv(index=False, lineterminator="\n").encode()


def _table_files(name: str, frame: pd.DataFrame) -> dict[str, bytes]:
    rows = io.BytesIO()
    frame.to_parquet(rows, index=False)
    made = {f"{name}.csv": _csv(frame), f"{name}.parquet": rows.getvalue()}
    return made | ({f"{name}.tex": latex(name, frame).encode()} if name in LATEX else {})


def _timings(run: StudyRun) -> pd.DataFrame:
    import pandas as pd

    columns = ["scenario", "world", "kind", "policy", "seed", "cell", "seconds"]
    rows = [
        [
            cell.place["scenario"], cell.place["world"], cell.kind, cell.settings.get("policy"),
            cell.settings.get("seed"), str(cell), round(run.found[cell.key].seconds, 3),
        ]
        for cell in run.cells
        if cell.key in run.found
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns).astype({"seed": "Int64"})


def _about(study: Study, run: StudyRun) -> dict[str, Any]:
    """What the results rest on; where files lie is no part of it."""
    digests = sorted({cell.place["trips"] for cell in run.cells if "trips" in cell.place})
    settings = {
        "scenarios": list(study.scenarios),
        "worlds": list(study.worlds),
        "training seeds": study.seeds,
        **({"draws of a belief": study.draws} if study.name == "sensitivity" else {}),
        "changed settings": {**study.settings, **study.selection},
        "certified gap": study.gap,
        "cells": len(run.cells),
        "schema of cells": SCHEMA,
    }
    packages = ("matplotlib", "pandas", *(("torch",) if find_spec("torch") else ()))
    return {
        "settings": settings | ({"digest of the trips": digests[0]} if digests else {}),
        "versions": versions() | {name: metadata.version(name) for name in packages},
        "failed": {str(cell): run.failed[cell.key] for cell in run.cells if cell.key in run.failed},
        "missing": [str(cell) for cell in run.missing if cell.key not in run.failed],
    }


def _html(
    study: Study,
    run: StudyRun,
    tables: Mapping[str, pd.DataFrame],
    figures: list[dict[str, Any]],
    undrawn: list[str],
    about: dict[str, Any],
) -> str:
    from jinja2 import Environment, StrictUndefined

    told = {name: _table(name, tables[name]) for name in in_order(list(tables))}
    claims, trainings = told.pop("claims", None), told.pop("trainings", None)
    details = [told.pop(name) for name in _DETAILS if name in told]
    proven = [told.pop(name) for name in ("bounds", "gap") if name in told]
    named = {
        "incomplete": about["failed"] or about["missing"] or undrawn or _left_out(run),
        "claims": claims, "tables": told, "figures": figures, "certificates": proven, "details": details,
        "trainings": trainings, "settings": True, "times": True,
    }  # fmt: skip
    titles = {
        "incomplete": "What is left out", "claims": "The paper's results", "tables": "Results", "figures": "Figures",
        "certificates": "Certificates", "details": "Rows", "trainings": "Trainings", "settings": "Settings",
        "times": "Times",
    }  # fmt: skip
    template = files("optkit.studies.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return page.from_string(template).render(
        study=study,
        about=_ABOUT[study.name],
        done=len(run.cells) - len(run.missing),
        total=len(run.cells),
        sections=[(name, titles[name]) for name, there in named.items() if there],
        failed=list(about["failed"].items()),
        missing=about["missing"],
        undrawn=undrawn,
        left_out=_left_out(run),
        claims=claims,
        tables=list(told.values()),
        figures=figures,
        certificates={"tables": proven, "told": _worst(tables)} if proven else None,
        details=details,
        trainings=trainings,
        settings=[(name, _plain(value)) for name, value in about["settings"].items()],
        versions=list(about["versions"].items()),
    )


def _table(name: str, frame: pd.DataFrame) -> dict[str, Any]:
    long = long_table(name, frame, MOST)
    told = shown(name, frame.head(BEGINNING) if long else frame)
    kinds = ("csv", "parquet", "tex") if name in LATEX else ("csv", "parquet")
    return {
        "name": name, "caption": CAPTIONS.get(name, ""), "headings": told.headings, "numeric": told.numeric,
        "rows": told.rows, "length": len(frame), "long": long or name in _DETAILS, "prose": name == "claims",
        "files": [f"{name}.{kind}" for kind in kinds],
    }  # fmt: skip


def _figure(name: str, figure: Figure, svg: bytes, names: list[str]) -> dict[str, Any]:
    drawing = DRAWINGS[name]
    width, height = (round(96 * side) for side in figure.get_size_inches())
    where = f"The numbers are in the table{'s' * (len(drawing.tables) > 1)} {' and '.join(drawing.tables)}."
    return {
        "name": name, "caption": drawing.caption, "alt": f"{drawing.caption} {where}", "files": names,
        "svg": base64.b64encode(svg).decode(), "width": width, "height": height,
    }  # fmt: skip


def _worst(tables: Mapping[str, pd.DataFrame]) -> str:
    if "bounds" not in tables:
        return ""
    worst = tables["bounds"]["worst_gap"].max()
    return (
        "Every bound of the first table was recomputed from its instance and its certificate, without trust in the "
        f"solver: the largest gap that a certificate leaves open is {worst:.1e} units of money."
    )


def _left_out(run: StudyRun) -> list[str]:
    policies = [cell.settings["policy"] for cell in run.cells if cell.kind == "policy"]
    if not policies or any(str(POLICIES[name].value).startswith("attention") for name in policies):
        return []
    return ["The policies with the attention network are left out: they need pip install 'optkit[attention]'."]


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, dict):
        return "; ".join(f"{name} = {_plain(one)}" for name, one in sorted(value.items())) or "none"
    return _plain(list(value)) if isinstance(value, tuple) else str(value)
