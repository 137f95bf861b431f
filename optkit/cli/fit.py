"""``optkit fit``: learn preferences from logged offers."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optkit.basics.documents import document_text
from optkit.basics.errors import InputError
from optkit.basics.files import write_together
from optkit.basics.folders import writable_parent
from optkit.basics.plain_json import to_json
from optkit.basics.printable import printable
from optkit.cli.console import print_table, say, say_json
from optkit.cli.options import Json
from optkit.cli.output import FIT_JSON, FIT_TEXT, PREFERENCES, fit_document, fit_text

if TYPE_CHECKING:
    from optkit.models.preferences.preferences import Preferences


def fit(
    table: Annotated[Path, typer.Argument(help="Offers as parquet, CSV or JSON, one row per request shown.")],
    features: Annotated[str | None, typer.Option(help="Feature columns, by commas; the rest by default.")] = None,
    pooled: Annotated[bool, typer.Option(help="One model for all worker groups.")] = False,
    method: Annotated[str, typer.Option(help="choice, or accept-reject: the paper's logistic regression.")] = "choice",
    ridge: Annotated[float, typer.Option(help="L2 penalty of every coefficient; settles what data leave open.")] = 0.0,
    scale_penalty: Annotated[float, typer.Option(help="L2 penalty of the compensation's coefficient alone.")] = 0.0,
    robust: Annotated[bool, typer.Option(help="Sandwich standard errors.")] = False,
    cluster: Annotated[
        str | None, typer.Option(help="Column whose decisions depend on each other (the worker): clustered errors.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder to write: preferences.json, which Preferences.load reads, and the summary as text and JSON. "
            "Or a text file, for the summary alone with its JSON beside it."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Estimate workers' utilities and noise scale from what they were offered and took.

    Columns: **situation** (the decision), **compensation**, **chosen** (0 or 1; none is 1 if all were rejected), and
    the features. **group**, **pickup** and **dropoff** count from 0 and may be left out. What a situation is called is
    text: 007 and 7 are two.
    """
    from statsmodels.tools.sm_exceptions import ConvergenceWarning

    from optkit.models.estimation import EstimationWarning
    from optkit.models.preferences.fit import fit_preferences
    from optkit.models.preferences.offers import Offers

    names = None if features is None else [name.strip() for name in features.split(",")]
    if out is not None and out.suffix == ".json":
        raise InputError(
            f"--out {out}: give a folder, or the text file's name, such as fit.txt; the JSON goes beside it"
        )
    folder = out is not None and (out.is_dir() or not out.suffix)
    if out is not None:
        _check_out(out, table, folder)
    offers = Offers.load(table, names, cluster)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", EstimationWarning)
        warnings.simplefilter("always", ConvergenceWarning)
        found = fit_preferences(
            offers,
            pooled=pooled,
            method=method,  # type: ignore[arg-type]
            ridge=ridge,
            scale_penalty=scale_penalty,
            robust=robust,
        )
    ours = (EstimationWarning, ConvergenceWarning)
    told = [str(one.message) for one in caught if issubclass(one.category, ours)]
    plain = {"offers": len(offers), "situations": offers.n_situations, **_plain(found), "warnings": told}
    document = fit_document(plain)
    if as_json:
        say_json(document)
    else:
        _print(found, plain, told)
    if out is not None:
        _check_out(out, table, folder)
        text, js, learned = _files(out, folder)
        files: dict[str | os.PathLike[str], str] = {text: fit_text(_text(found, told)), js: to_json(document) + "\n"}
        if folder:
            files[learned] = document_text(found.to_document())
        write_together(files)
        if folder and not as_json:
            say(f"preferences: {learned}")


def _files(out: Path, folder: bool) -> tuple[Path, Path, Path]:
    text = out / "summary.txt" if folder else out
    return text, text.with_suffix(".json"), out / "preferences.json"


def _check_out(out: Path, table: Path, folder: bool) -> None:
    text, js, learned = _files(out, folder)
    if folder and not out.exists():
        if not (out.parent.is_dir() and writable_parent(out)):
            raise InputError(f"--out {out} cannot be made: its folder does not exist, or may not be written to")
        out.mkdir()
    FIT_TEXT.check(text, reads=[table])
    FIT_JSON.check(js, f"--out {out}: the JSON {'in' if folder else 'beside'} it,", [table])
    if folder:
        PREFERENCES.check(learned, f"--out {out}: preferences.json in it,", [table])


def _print(found: Preferences, plain: dict[str, Any], told: list[str]) -> None:
    for group, results in enumerate(found.results):
        label = _label(found, group)
        say(f"{label}, coefficients of utility / mu", *str(results.summary()).split("\n"), "")
    rows = [
        [f"{row['group']} {row['parameter']}", f"{row['estimate']:.4f}", f"{row['standard_error']:.4f}"]
        for row in plain["parameters"]
    ]
    print_table("preferences, in money", ["parameter", "estimate", "standard error"], rows)
    for group, report in enumerate(plain["identification"]):
        label = _label(found, group)
        say(f"identification of {label}: {report['verdict']}: {report['reason']}")
    for line in told:
        say(f"warning: {line}")


def _label(found: Preferences, group: int) -> str:
    names = found.group_names
    return "all groups" if found.pooled else f"group {group if names is None else names[group]}"


def _plain(found: Preferences) -> dict[str, Any]:
    from optkit.models.estimation import identification

    reports = [identification(results) for results in found.results]
    numbers = ("llf", "llnull", "aic", "bic", "prsquared", "nobs")
    return {
        "parameters": found.table().to_dict(orient="records"),
        "models": [
            {"converged": bool(results.converged), "standard_errors": results.cov_kwds["description"]}
            | {name: float(getattr(results, name)) for name in numbers}
            for results in found.results
        ],
        "identification": [
            {
                "verdict": report.verdict,
                "reason": report.reason,
                "situations": float(report.situations),
                "choices": float(report.choices),
                "rejections": float(report.rejections),
                "eigenvalues": report.eigenvalues.tolist(),
                "weakest": {str(name): float(x) for name, x in report.weakest.items()},
            }
            for report in reports
        ],
    }


def _text(found: Preferences, told: list[str]) -> str:
    from optkit.models.estimation import identification

    parts = [f"{results.summary()}\n\n{identification(results).summary()}" for results in found.results]
    lines = [*parts, found.table().to_string(index=False), *(f"warning: {line}" for line in told)]
    return "\n".join(map(printable, "\n\n".join(lines).split("\n"))) + "\n"
