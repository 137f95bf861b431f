"""``optkit price``: one decision from a table of requests."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from optkit.basics.errors import InputError
from optkit.basics.printable import listed
from optkit.cli.console import print_table, say, say_json
from optkit.cli.decisions import SHOWN, ManyDecisions, price_rows
from optkit.cli.options import Believed, Json
from optkit.cli.output import ROWS, write_rows

if TYPE_CHECKING:
    from optkit.cli.request_table import RequestTable
    from optkit.models.pricing.optimal import Pricing

CERTAIN = 1e-3
"""Share of workers who reject below which mu is suspected."""

FORMS = {"exact": True, "free": False, "clip": "clip"}


def price(
    table: Annotated[Path, typer.Argument(help="CSV, JSON or parquet with a row per request, columns as below.")],
    mu: Annotated[
        float | None, typer.Option(help="Scale of the worker's noise, in money; 1, or what the policy learned.")
    ] = None,
    outside_utility: Annotated[float, typer.Option(help="Utility of rejecting everything, in money.")] = 0.0,
    form: Annotated[
        str, typer.Option(help="exact: c >= 0; free: prices of either sign (the paper's Lemma 3); clip: the paper's.")
    ] = "exact",
    solver: Annotated[
        str | None, typer.Option(help="Also solve as a concave program with this CVXPY solver, e.g. CLARABEL.")
    ] = None,
    policy: Annotated[
        Path | None,
        typer.Option(help="File of optkit train: what waiting is worth, and what workers like, as the policy learned."),
    ] = None,
    preferences: Believed = None,
    step: Annotated[int | None, typer.Option(help="With --policy: the step at which the requests are open.")] = None,
    time: Annotated[
        str | None, typer.Option(help="With --policy: the time, such as 11:08, if days have a clock.")
    ] = None,
    group: Annotated[str | None, typer.Option(help="With --policy or --preferences: the worker's group.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write a row per request as .csv or .parquet.")] = None,
    as_json: Json = False,
) -> None:
    """Price one decision, or each of many, and prove the prices optimal.

    Columns: **utility** (money; -inf: cannot be served), and either **value** or **reward** with, if
    they apply, **penalty** (at most 0), **expires** (0 or 1, now) and **opportunity_cost**:
    value = reward - penalty * expires - opportunity_cost. A column **offered** (0 or 1) says which are on
    offer. A column **compensation** is taken as a proposal of yours and certified too. A column
    **request** names the rows, in text as it stands in the file. Rows of one **decision** are priced
    together; without this column all rows are one decision.

    With --preferences the columns are those that they were learned from, and **pickup** and **dropoff** if they know
    places, in place of **utility**.

    With --policy the columns are **reward**, **expiry** (the last step, or a time), **penalty** if there is one, what
    the policy was trained on, and **utility** if it learned no preferences; **request_id** names the rows.
    """
    from optkit.cli.request_table import read_requests
    from optkit.models.pricing import certify, optimal_prices

    if form not in FORMS:
        raise InputError(f"--form {form} is unknown; there are {', '.join(FORMS)}")
    if out is not None:
        ROWS.check(out, reads=[one for one in (table, policy, preferences) if one is not None])
    if policy is None:
        for name, x in (("step", step), ("time", time), ("group", None if preferences is not None else group)):
            if x is not None:
                raise InputError(f"--{name} {x} goes with --policy")
    if preferences is not None and policy is None:
        if outside_utility or mu is not None:
            raise InputError("--mu and --outside-utility go without --preferences, whose own they are")
        given, mu, source = _by_preferences(table, preferences, group)
    elif policy is None:
        given, source = read_requests(table), "as given" if mu is not None else "by default"
        mu = 1.0 if mu is None else mu
    else:
        if outside_utility:
            raise InputError("--outside-utility goes without --policy, whose own it is")
        given, mu, outside_utility, source = _by_policy(table, policy, preferences, step, time, group, mu)
    value, utility = given.value, given.utility
    if given.ignored:
        say(f"optkit: ignored columns of {table}: {listed(given.ignored)}", err=True)
    chosen: Any = FORMS[form]
    if given.decision is not None:
        if solver is not None or given.compensation is not None:
            what = "--solver" if solver is not None else "a column compensation"
            raise InputError(f"{what} goes with one decision, and {table} has a column decision")
        many = ManyDecisions.priced(given, mu, outside_utility, chosen)
        if as_json:
            say_json({"decisions": many.to_dict(), "mu": mu, "mu_is": source})
        else:
            many.show(f"{form} prices: {table}")
            say(f"mu {mu:g} {source}")
        _suspect(many.prices.rejection, mu)
        if out is not None:
            write_rows(price_rows(given, many.rows(many.prices.compensation), many.rows(many.prices.acceptance)), out)
        raise typer.Exit(int(form != "clip" and not bool(np.all(many.proof.optimal))))
    nonnegative = form != "free"
    facts: dict[str, Any] = {"outside_utility": outside_utility, "offered": given.offered}
    found = optimal_prices(value, utility, mu, nonnegative=chosen, **facts)
    proofs = {"prices": certify(found.compensation, value, utility, mu, nonnegative=nonnegative, **facts)}
    if given.compensation is not None:
        proofs["your prices"] = certify(given.compensation, value, utility, mu, nonnegative=nonnegative, **facts)
    certificates: dict[str, Any] = {name: _plain(proof) for name, proof in proofs.items()}
    result: dict[str, Any] = {
        "requests": [
            {"request": name, "compensation": c, "acceptance": p}
            for name, c, p in zip(given.names, found.compensation.tolist(), found.acceptance.tolist(), strict=True)
        ],
        "mu": mu,
        "mu_is": source,
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
        solved = program.solve(value, utility, mu, solver=solver.upper(), **facts)
        result["solver"] = {"solver": solver, "status": solved.status, "profit": solved.profit, "bound": solved.bound}
    _suspect(found.rejection, mu)
    if as_json:
        say_json(result)
        _write(given, found, out)
        raise typer.Exit(failed)
    known = [x for x in (*value, *utility, mu, outside_utility) if math.isfinite(x)]
    # Four decimals suit money as people count it; in another unit they would show nothing, or too much.
    plain = 0.1 <= max(map(abs, known)) < 1e9

    def money(x: float, digits: int = 4) -> str:
        return f"{x:.{digits}f}" if plain else f"{x:.{digits + 3}g}"

    rows = [
        [str(r["request"]), money(v), money(u), money(r["compensation"]), f"{r['acceptance']:.4f}"]
        for r, v, u in zip(result["requests"][:SHOWN], value, utility, strict=False)
    ]
    if len(value) > SHOWN:
        rows.append([f"and {len(value) - SHOWN} more (see --json)", "", "", "", ""])
    print_table(f"{form} prices: {table}", ["request", "value", "utility", "compensation", "acceptance"], rows)
    profit, markup = money(float(found.profit), 6), money(float(found.markup), 6)
    say(f"expected profit {profit}   markup {markup}   rejection {found.rejection:.6f}")
    say(f"priced as one decision of {len(value):,} request{'s' * (len(value) != 1)}; mu {money(mu)} {source}")
    for name, proof in proofs.items():
        say("", f"certificate of {'these ' if name == 'prices' else ''}{name}", *proof.summary().split("\n"))
    if solver is not None:
        profit, bound = money(solved.profit, 6), money(solved.bound, 6)
        say("", f"{solver}: {solved.status}, profit {profit}, bound {bound}")
    _write(given, found, out)
    raise typer.Exit(failed)


def _write(given: RequestTable, found: Pricing, out: Path | None) -> None:
    if out is not None:
        write_rows(price_rows(given, found.compensation, found.acceptance), out)


def _suspect(rejection: Any, mu: float) -> None:
    """Say it where nobody ever rejects: mu is in another unit than the money, more often than not."""
    if np.size(rejection) and bool(np.all(np.asarray(rejection) < CERTAIN)):
        why = f"nobody rejects (less than {100 * CERTAIN:g} % do): is mu = {mu:g} in the unit of the money?"
        say(f"optkit: {why}", err=True)


def _by_policy(
    table: Path,
    policy: Path,
    preferences: Path | None,
    step: int | None,
    time: str | None,
    group: str | None,
    mu: float | None,
) -> tuple[RequestTable, float, float, str]:
    """Return the requests as a policy sees them, its mu and outside utility, and where mu comes from."""
    from optkit.cli.own_tables import read_open_requests
    from optkit.cli.request_table import RequestTable
    from optkit.learning.open_requests import seen_by
    from optkit.learning.trained import Trained
    from optkit.models.preferences.preferences import Preferences

    trained = Trained.load(policy)
    if preferences is not None:
        trained = trained.believing(Preferences.load(preferences))
    frame, ignored = read_open_requests(table, trained)
    try:
        seen = seen_by(trained, frame, step=step, time=time, group=group, mu=mu)
    except InputError as error:
        raise InputError(f"{table}, priced by {policy}: {error}") from None
    learned = "as the policy learned" if preferences is None else "of the preferences"
    for note in seen.notes:
        say(f"optkit: {table}: {note}", err=True)
    offered, source = np.ones(len(seen.names), bool), learned if trained.preferences else "as given"
    if trained.preferences is None and mu is None:
        source = "by default"
    read = RequestTable(seen.names, seen.value, seen.utility, offered, None, ignored)
    return read, seen.mu, seen.outside_utility, source


def _by_preferences(table: Path, preferences: Path, group: str | None) -> tuple[RequestTable, float, str]:
    """Return the requests with the utilities that preferences tell, their mu, and where it comes from."""
    from optkit.cli.request_table import read_requests
    from optkit.instances.labels import group_of
    from optkit.models.preferences.preferences import Preferences

    believed = Preferences.load(preferences)
    number = group_of(group, believed.group_names or [str(d) for d in range(len(believed.scale))])
    mu = believed.scale[believed.model_of(np.array([number]))[0]]
    return read_requests(table, believed, number), float(mu), "of the preferences"


def _plain(proof: Any) -> dict[str, Any]:
    numbers = ("profit", "bound", "gap", "stationarity", "infeasibility", "tolerance")
    plain: dict[str, Any] = {name: float(getattr(proof, name)) for name in numbers}
    return {"optimal": bool(proof.optimal), "undecided": bool(proof.undecided), **plain}
