"""``optkit price``: one decision from a table of requests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from optkit.cli.console import print_table
from optkit.cli.options import Json
from optkit.errors import DataError, InputError

if TYPE_CHECKING:
    import pandas as pd

FORMS = {"exact": True, "free": False, "clip": "clip"}


def price(
    table: Annotated[Path, typer.Argument(help="CSV or JSON with a row per request, columns as below.")],
    mu: Annotated[float, typer.Option(help="Scale of the worker's noise, in money.")] = 1.0,
    outside_utility: Annotated[float, typer.Option(help="Utility of rejecting everything, in money.")] = 0.0,
    form: Annotated[
        str, typer.Option(help="exact: c >= 0; free: prices of either sign (the paper's Lemma 3); clip: the paper's.")
    ] = "exact",
    solver: Annotated[
        str | None, typer.Option(help="Also solve as a concave program with this CVXPY solver, e.g. CLARABEL.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Price one decision and prove the prices optimal.

    Columns: **utility** (money), and either **value** or **reward** with, if they apply,
    **penalty** (at most 0), **expires** (0 or 1, now) and **opportunity_cost**:
    value = reward - penalty * expires - opportunity_cost. A column **compensation** is taken as a proposal
    of yours and certified too. A column **request** names the rows.
    """
    from optkit.models.pricing import certify, optimal_prices

    if form not in FORMS:
        raise InputError(f"--form {form} is unknown; there are {', '.join(FORMS)}")
    frame = read_requests(table)
    value, utility = frame["value"].to_numpy(), frame["utility"].to_numpy()
    chosen: Any = FORMS[form]
    found = optimal_prices(value, utility, mu, outside_utility=outside_utility, nonnegative=chosen)
    nonnegative = form != "free"
    facts: dict[str, Any] = {"outside_utility": outside_utility, "nonnegative": nonnegative}
    proofs = {"prices": certify(found.compensation, value, utility, mu, **facts)}
    if "compensation" in frame:
        proofs["your prices"] = certify(frame["compensation"].to_numpy(), value, utility, mu, **facts)
    certificates: dict[str, Any] = {name: _plain(proof) for name, proof in proofs.items()}
    result: dict[str, Any] = {
        "requests": [
            {"request": name, "compensation": c, "acceptance": p}
            for name, c, p in zip(
                frame["request"].tolist(), found.compensation.tolist(), found.acceptance.tolist(), strict=True
            )
        ],
        "rejection": float(found.rejection),
        "markup": float(found.markup),
        "profit": float(found.profit),
        "certificates": certificates,
    }
    if solver is not None:
        from optkit.models.pricing_program import PricingProgram

        solved = PricingProgram(len(frame), nonnegative).solve(value, utility, mu, outside_utility, solver=solver)
        result["solver"] = {"solver": solver, "status": solved.status, "profit": solved.profit, "bound": solved.bound}
    if as_json:
        typer.echo(json.dumps(result, indent=1))
        return
    rows = [
        [str(r["request"]), f"{v:.4f}", f"{u:.4f}", f"{r['compensation']:.4f}", f"{r['acceptance']:.4f}"]
        for r, v, u in zip(result["requests"], value, utility, strict=True)
    ]
    print_table(f"{form} prices: {table}", ["request", "value", "utility", "compensation", "acceptance"], rows)
    typer.echo(f"expected profit {found.profit:.6f}   markup {found.markup:.6f}   rejection {found.rejection:.6f}")
    for name, proof in proofs.items():
        typer.echo(f"\ncertificate of {'these ' if name == 'prices' else ''}{name}\n{proof.summary()}")
    if solver is not None:
        typer.echo(f"\n{solver}: {result['solver']['status']}, profit {solved.profit:.6f}, bound {solved.bound:.6f}")


def read_requests(path: Path) -> pd.DataFrame:
    """Read the requests of one decision: columns ``request``, ``value``, ``utility``, and ``compensation`` if given.

    Raises
    ------
    DataError
        If the file cannot be read, lacks a column, or holds something that is not a finite number.
    """
    import pandas as pd

    try:
        if path.suffix.lower() == ".json":
            content = json.loads(path.read_text())
            wrapped = isinstance(content, dict) and "requests" in content
            frame = pd.DataFrame(content["requests"] if wrapped else content)
        else:
            frame = pd.read_csv(path)
    except FileNotFoundError:
        raise DataError(f"there is no file {path}") from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        why = (str(error) or type(error).__name__).splitlines()[0]
        raise DataError(f"cannot read {path} ({why}); give a CSV or a JSON list with one row per request") from error
    frame.columns = [str(name).strip().lower() for name in frame.columns]
    missing = [name for name in ("utility",) if name not in frame]
    if "value" not in frame and "reward" not in frame:
        missing.append("value (or reward)")
    if missing:
        raise DataError(f"{path} has no column {' and no '.join(missing)}; it has {', '.join(frame.columns) or 'none'}")
    if frame.empty:
        raise DataError(f"{path} holds no requests; give one row per request")
    known = ("value", "utility", "reward", "penalty", "expires", "opportunity_cost", "compensation")
    numbers = {name: _numbers(path, frame, name) for name in known if name in frame}
    zero = np.zeros(len(frame))
    if "value" not in numbers:
        spared = numbers.get("penalty", zero) * numbers.get("expires", zero)
        numbers["value"] = numbers["reward"] - spared - numbers.get("opportunity_cost", zero)
    names = frame["request"] if "request" in frame else range(len(frame))
    columns: dict[str, Any] = {"request": list(names)}
    columns |= {name: numbers[name] for name in ("value", "utility", "compensation") if name in numbers}
    return pd.DataFrame(columns)


def _numbers(path: Path, frame: pd.DataFrame, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    import pandas as pd

    column = pd.to_numeric(frame[name], errors="coerce").to_numpy(float)
    if not np.isfinite(column).all():
        row = int((~np.isfinite(column)).argmax())
        raise DataError(f"{path}: {name} in row {row + 1} is {frame[name].iloc[row]!r}, not a finite number")
    return column


def _plain(proof: Any) -> dict[str, Any]:
    numbers = ("profit", "bound", "gap", "stationarity", "infeasibility", "tolerance")
    plain: dict[str, Any] = {name: float(getattr(proof, name)) for name in numbers}
    return {"optimal": bool(proof.optimal), **plain}
