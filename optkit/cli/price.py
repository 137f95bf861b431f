"""``optkit price``: one decision from a table of requests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from optkit.basics.errors import InputError
from optkit.basics.printable import listed
from optkit.cli.console import print_table, say, say_json
from optkit.cli.options import Json

SHOWN = 200
"""Rows of the table on the terminal."""

FORMS = {"exact": True, "free": False, "clip": "clip"}


def price(
    table: Annotated[Path, typer.Argument(help="CSV, JSON or parquet with a row per request, columns as below.")],
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
    of yours and certified too. A column **request** names the rows, in text as it stands in the file.
    """
    from optkit.cli.request_table import read_requests
    from optkit.models.pricing import certify, optimal_prices

    if form not in FORMS:
        raise InputError(f"--form {form} is unknown; there are {', '.join(FORMS)}")
    given = read_requests(table)
    value, utility = given.value, given.utility
    if given.ignored:
        say(f"optkit: ignored columns of {table}: {listed(given.ignored)}", err=True)
    chosen: Any = FORMS[form]
    found = optimal_prices(value, utility, mu, outside_utility=outside_utility, nonnegative=chosen)
    nonnegative = form != "free"
    facts: dict[str, Any] = {"outside_utility": outside_utility, "nonnegative": nonnegative}
    proofs = {"prices": certify(found.compensation, value, utility, mu, **facts)}
    if given.compensation is not None:
        proofs["your prices"] = certify(given.compensation, value, utility, mu, **facts)
    certificates: dict[str, Any] = {name: _plain(proof) for name, proof in proofs.items()}
    result: dict[str, Any] = {
        "requests": [
            {"request": name, "compensation": c, "acceptance": p}
            for name, c, p in zip(given.names, found.compensation.tolist(), found.acceptance.tolist(), strict=True)
        ],
        "rejection": float(found.rejection),
        "markup": float(found.markup),
        "profit": float(found.profit),
        "certificates": certificates,
    }
    # Clipped prices are not meant to be optimal; the others are, and a failed proof is a failure.
    failed = int(form != "clip" and not proofs["prices"].optimal)
    if solver is not None:
        from optkit.models.pricing_program import PricingProgram

        program = PricingProgram(len(value), nonnegative)
        solved = program.solve(value, utility, mu, outside_utility, solver=solver.upper())
        result["solver"] = {"solver": solver, "status": solved.status, "profit": solved.profit, "bound": solved.bound}
    if as_json:
        say_json(result)
        raise typer.Exit(failed)
    rows = [
        [str(r["request"]), f"{v:.4f}", f"{u:.4f}", f"{r['compensation']:.4f}", f"{r['acceptance']:.4f}"]
        for r, v, u in zip(result["requests"][:SHOWN], value, utility, strict=False)
    ]
    if len(value) > SHOWN:
        rows.append([f"and {len(value) - SHOWN} more (see --json)", "", "", "", ""])
    print_table(f"{form} prices: {table}", ["request", "value", "utility", "compensation", "acceptance"], rows)
    say(f"expected profit {found.profit:.6f}   markup {found.markup:.6f}   rejection {found.rejection:.6f}")
    for name, proof in proofs.items():
        say("", f"certificate of {'these ' if name == 'prices' else ''}{name}", *proof.summary().split("\n"))
    if solver is not None:
        say("", f"{solver}: {result['solver']['status']}, profit {solved.profit:.6f}, bound {solved.bound:.6f}")
    raise typer.Exit(failed)


def _plain(proof: Any) -> dict[str, Any]:
    numbers = ("profit", "bound", "gap", "stationarity", "infeasibility", "tolerance")
    plain: dict[str, Any] = {name: float(getattr(proof, name)) for name in numbers}
    return {"optimal": bool(proof.optimal), "undecided": bool(proof.undecided), **plain}
