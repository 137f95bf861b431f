"""The open requests of a moment in a table, as a policy sees them: what each is worth now, and to whom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats, whole_number
from optkit.basics.errors import InputError
from optkit.instances.clock import Clock
from optkit.instances.columns import (
    PREFIX,
    REQUESTS,
    frame,
    identifiers_of,
    no_misspelling,
    numbers_of,
    whole_numbers_of,
)
from optkit.instances.instance import Instance
from optkit.instances.labels import group_of
from optkit.learning.moments import moment
from optkit.simulation.batch import Batch
from optkit.simulation.state import State

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class OpenRequests:
    """One decision of a policy: n requests and the worker who is there.

    Attributes
    ----------
    names : list of str
        What the requests are called.
    value, utility, opportunity_cost : (n,) float
        What serving each now is worth, what the policy believes that it is worth to the worker, and the value of
        waiting that it gives up; money.
    mu, outside_utility : float
        The worker's noise scale and utility of rejecting, as the policy believes; money.
    notes : list of str
        What was taken for granted, and what plays no part.
    """

    names: list[str]
    value: Floats
    utility: Floats
    opportunity_cost: Floats
    mu: float
    outside_utility: float
    notes: list[str]


def seen_by(
    trained: Any,
    requests: Any,
    *,
    step: int | None = None,
    time: Any = None,
    group: str | int | None = None,
    mu: float | None = None,
    busy: int = 1,
) -> OpenRequests:
    """Return the decision that a trained policy sees; see :meth:`optkit.learning.trained.Trained.price`."""
    table, told = frame("requests", requests), trained.source
    believed = trained.preferences
    if believed is not None and mu is not None:
        raise InputError("mu is the policy's own, which has learned it: leave it out")
    known = believed.attributes.names if believed is not None else None
    features = list(told.get("feature_names") or known or [c for c in table.columns if c.startswith("feature_")])
    number, names = _group(trained, group)
    wanted = [f"{PREFIX}{name}" for name in names]
    _need(table, ["reward", "expiry", *features])
    no_misspelling("requests", table, [*REQUESTS, "request", "utility", *features, *wanted])
    clock = Clock.read(told["clock"]) if "clock" in told else None
    horizon = int(told.get("horizon", 0))
    if not horizon:
        raise InputError(
            "the policy does not say how many steps its days have: train it anew, or load it from its file"
        )
    now, expiry, notes = moment(table["expiry"], step, time, clock, horizon)
    if not 0 <= now < horizon:
        raise InputError(f"step {now} is none of the {horizon} steps that the policy was trained on: 0..{horizon - 1}")
    if not len(table):
        raise InputError("there are no requests to price")
    called = next((table[name] for name in ("request_id", "request") if name in table), None)
    named = range(len(table)) if called is None else identifiers_of("request_id", called)
    gone = np.flatnonzero(expiry < now)
    if gone.size:
        row = table.index[gone[0]]
        raise InputError(
            f"expiry in row {row} is step {expiry[gone[0]]}, before step {now}: leave out what has expired"
        )
    late = int((expiry >= horizon).sum())
    if late:
        notes.append(f"{late} of {len(table)} requests are open when the day ends, and expire there")
    used = {*REQUESTS, "request", *features, *(_utilities(table, names) if believed is None else [])}
    unused = [name for name in table.columns if name not in used]
    if unused:
        notes.append(f"the requests table has columns that play no part: {', '.join(unused)}")
    groups = len(names)
    seen = np.arange(now - whole_number("busy", busy, least=1, most=now + 1) + 1, now + 1)
    n = len(table)
    day = Instance(
        horizon=horizon, arrival=np.full(n, now), expiry=np.minimum(expiry, horizon - 1),
        reward=_numbers(table, "reward"), penalty=_numbers(table, "penalty", 0.0),
        features=np.column_stack([_numbers(table, name) for name in features]) if features else np.zeros((n, 0)),
        pickup=_places(table, "pickup"), dropoff=_places(table, "dropoff"),
        worker_step=seen,
        worker_group=np.full(seen.size, number),
        utility=_utility(table, names) if believed is None else np.zeros((groups, n)),
        mu=np.full(groups, 1.0 if mu is None else mu), noise=np.zeros((seen.size, n)),
        outside_noise=np.zeros(seen.size), feature_names=tuple(features) or None,
        group_names=tuple(names) if _named(trained) else None,
    )  # fmt: skip
    one = np.zeros(1, np.int64)
    state = State(Batch.of(day), now, one, one, one + seen.size - 1, np.arange(n)[None], np.ones((1, n), bool))
    policy = trained.policy
    value = policy.value(state)[0]
    spared = np.where(state.expiring, state.penalty, 0.0)[0]
    return OpenRequests(
        names=[str(x) for x in named],
        value=value,
        utility=np.asarray(policy.choice.utility(state))[0],
        opportunity_cost=state.reward[0] - spared - value,
        mu=float(np.asarray(policy.choice.mu(state))[0]),
        outside_utility=float(np.asarray(policy.choice.outside_utility(state))[0]),
        notes=notes,
    )


def _named(trained: Any) -> list[str]:
    """Return what the groups are called, if anything."""
    believed = trained.preferences
    return list(trained.source.get("group_names") or (believed.group_names if believed is not None else None) or [])


def _group(trained: Any, group: str | int | None) -> tuple[int, list[str]]:
    """Return the number of a group, and what all are called: numbers, if nothing else."""
    told, believed = trained.source, trained.preferences
    names = _named(trained)
    many = len(names) or int(told.get("groups", 0)) or (len(believed.scale) if believed is not None else 1)
    names = names or [str(d) for d in range(many)]
    return group_of(group, names), names


def _utilities(table: pd.DataFrame, names: list[str]) -> list[str]:
    """Return the columns of true utilities: one for each group, or one for all alike."""
    columns = [f"{PREFIX}{name}" for name in names]
    there = [column for column in columns if column in table]
    if "utility" in table and there:
        raise InputError(f"the requests have columns 'utility' and {there[0]!r}: leave one out")
    if len(there) == len(columns):
        return columns
    if "utility" in table:
        return ["utility"]
    wanted = f", or {', '.join(columns)}" if len(names) > 1 else ""
    raise InputError(
        f"the policy learned no preferences: the requests need a column 'utility', what each is worth to him{wanted}"
    )


def _utility(table: pd.DataFrame, names: list[str]) -> Floats:
    """Return true utilities, (D, n)."""
    columns = _utilities(table, names)
    return np.array([_numbers(table, columns[d % len(columns)]) for d in range(len(names))])


def _need(table: pd.DataFrame, columns: list[str]) -> None:
    missing = [c for c in columns if c not in table]
    if missing:
        have = ", ".join(table.columns)
        raise InputError(f"the requests have no column {', '.join(map(repr, missing))}; they have {have}")


def _numbers(table: pd.DataFrame, name: str, default: float | None = None) -> Floats:
    if name not in table and default is not None:
        return np.full(len(table), default)
    return numbers_of(name, table[name], flags=True)


def _places(table: pd.DataFrame, name: str) -> Any:
    return whole_numbers_of(name, table[name]) if name in table else np.zeros(len(table), np.int64)
