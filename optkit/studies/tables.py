"""The tables of a study, tidy, from its finished cells: no number depends on when or where a cell was worked out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats
from optkit.simulation.metrics import MeanInterval, mean_interval, performance_ratio
from optkit.studies.cells import Cell
from optkit.studies.runner import StudyRun

if TYPE_CHECKING:
    import pandas as pd

    from optkit.studies.run_cell import Result

Row = dict[str, Any]


def study_tables(run: StudyRun) -> dict[str, pd.DataFrame]:
    """Make all tables that the finished cells allow; a cell that is missing is missing in the tables too.

    Parameters
    ----------
    run : StudyRun
        Of any study, finished or not.

    Returns
    -------
    dict of str to DataFrame
        Those with at least one row of:

        ``ratios`` : one row per scenario, world and policy (with the training seed that validation chose): mean
        performance ``ratio`` in per cent with ``std``, ``low``, ``high``; ``served``, per cent of requests;
        ``of_arrival``, per cent of the arrival-information bound; ``gain`` over the better of PP and FP, paired, with
        its interval; over ``instances``, those in which something can be gained.
        ``worlds`` : the same over worlds: mean of the worlds' means, with an interval over worlds where there are
        several, and their range.
        ``rows`` : one row per policy and test instance. ``trainings`` : one row per training seed.
        ``bounds`` : mean of each bound in ``points`` (per cent of full information) and worst certificate.
        ``gap`` : certified gaps. ``estimation`` : errors of learned utilities by group. ``errors``, ``utilities`` : one
        row per kind of request. ``sensitivity`` : one row per perturbation. ``operations`` : what workers got beyond
        their burden, how many were used, how evenly places were served. ``over`` : the same burden, one row per
        accepted request. ``pairs`` : places.

    Examples
    --------
    >>> from optkit.studies.store import Stored
    >>> cell = Cell("estimate", {"scenario": "I.1", "world": 0}, {"choice": "paper", "seed": 0})
    >>> run = StudyRun([cell], {cell.key: Stored({"error": [[0.5]], "rmse": [0.5], "mbe": [0.5]}, seconds=1.0)})
    >>> list(study_tables(run))
    ['estimation']
    """
    import pandas as pd

    rows = list(_rows(run))
    made: dict[str, list[Row]] = {
        "ratios": list(_ratios(rows)),
        "worlds": [],
        "rows": rows,
        "trainings": list(_trainings(run)),
        "bounds": list(_bounds(run)),
        "gap": list(_gap(run)),
        "estimation": list(_estimation(run)),
        "errors": list(_errors(run)),
        "utilities": list(_utilities(run)),
        "sensitivity": list(_sensitivity(run)),
        "operations": list(_operations(run)),
        "over": list(_over(run)),
        "pairs": list(_pairs(run)),
    }
    made["worlds"] = list(_worlds(made["ratios"]))
    return {name: pd.DataFrame(table) for name, table in made.items() if table}


def hopeful(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of those instances in which every policy has a finite ratio: what means are taken over.

    A ratio is -inf where nothing can be gained and a policy loses: no mean can hold it, the table ``rows`` does.

    Parameters
    ----------
    rows : DataFrame
        The table ``rows``.

    Returns
    -------
    DataFrame
        Some of its rows, in their order.

    Examples
    --------
    >>> import pandas as pd
    >>> rows = {"scenario": "I.1", "world": 0, "policy": ["FP", "PP"] * 2, "instance": [0, 0, 1, 1]}
    >>> rows |= {"ratio": [90.0, 80.0, 100.0, -np.inf], "of_arrival": [95.0, 85.0, 100.0, -np.inf]}
    >>> hopeful(pd.DataFrame(rows))["instance"].unique().tolist()
    [0]
    """
    import pandas as pd

    finite = pd.Series(np.isfinite(rows["ratio"] + rows["of_arrival"]), rows.index)
    return rows[finite.groupby([rows["scenario"], rows["world"], rows["instance"]]).transform("all")]


def _where(cell: Cell) -> Row:
    return {"scenario": cell.place["scenario"], "world": cell.place["world"]}


def _bounds_of(run: StudyRun) -> dict[tuple[str, int], Result]:
    return {(c.place["scenario"], c.place["world"]): result for c, result in run.results("bounds")}


def _chosen(run: StudyRun) -> Iterator[tuple[Cell, Result]]:
    """Yield each policy's cell with the best validation score; the first of several that are as good."""
    best: dict[tuple[str, int, str], tuple[Cell, Result]] = {}
    for cell, result in run.results("policy"):
        name = (cell.place["scenario"], cell.place["world"], cell.settings["policy"])
        if name not in best or _score(result) > _score(best[name][1]):
            best[name] = (cell, result)
    yield from best.values()


def _score(result: Result) -> float:
    return -np.inf if result["score"] is None else float(result["score"])


def _ratio(result: Result, bounds: Result, kind: str = "full") -> Floats:
    return performance_ratio(result["reward"], bounds[kind], bounds["penalty"], in_the_mean=kind != "full")


def _rows(run: StudyRun) -> Iterator[Row]:
    bounds = _bounds_of(run)
    for cell, result in _chosen(run):
        against = bounds.get((cell.place["scenario"], cell.place["world"]))
        if against is None:
            continue
        columns = zip(
            result["reward"], _ratio(result, against), _ratio(result, against, "arrival"),
            result["served"], result["paid"], against["requests"], against["workers"], strict=True,
        )  # fmt: skip
        about = {**_where(cell), "policy": cell.settings["policy"], "seed": cell.settings["seed"]}
        for number, (reward, ratio, arrival, served, paid, requests, workers) in enumerate(columns):
            yield {
                **about, "instance": number, "reward": reward, "ratio": ratio, "of_arrival": arrival,
                "served": served, "paid": paid, "requests": requests, "workers": workers,
            }  # fmt: skip


def _ratios(rows: list[Row]) -> Iterator[Row]:
    import pandas as pd

    if not rows:
        return
    for (scenario, world), place in hopeful(pd.DataFrame(rows)).groupby(["scenario", "world"], sort=False):
        by_policy = dict(iter(place.groupby("policy", sort=False)))
        rules = [name for name in ("PP", "FP") if name in by_policy]
        best = max(rules, key=lambda name: by_policy[name]["ratio"].mean(), default=None)
        for name, frame in by_policy.items():
            ratio = mean_interval(frame["ratio"].to_numpy())
            row = {
                "scenario": scenario, "world": world, "policy": name, "seed": int(frame["seed"].iloc[0]),
                "instances": ratio.count, "ratio": ratio.mean, "std": ratio.std, "low": ratio.low, "high": ratio.high,
                "of_arrival": float(frame["of_arrival"].mean()),
                "served": 100.0 * float(frame["served"].sum() / max(frame["requests"].sum(), 1)),
            }  # fmt: skip
            if best is not None and name not in rules:
                gain = mean_interval(frame["ratio"].to_numpy(), by_policy[best]["ratio"].to_numpy())
                row |= {"rule": best, "gain": gain.mean, "gain_low": gain.low, "gain_high": gain.high}
            yield row


def _worlds(ratios: list[Row]) -> Iterator[Row]:
    import pandas as pd

    if not ratios:
        return
    for (scenario, policy), frame in pd.DataFrame(ratios).groupby(["scenario", "policy"], sort=False):
        over = mean_interval(frame["ratio"].to_numpy())
        yield {
            "scenario": scenario, "policy": policy, "worlds": over.count, "ratio": over.mean, "low": over.low,
            "high": over.high, "least": float(frame["ratio"].min()), "most": float(frame["ratio"].max()),
            "std": float(frame["std"].mean()), "of_arrival": float(frame["of_arrival"].mean()),
            "gain": float(frame["gain"].mean()) if "gain" in frame else np.nan,
        }  # fmt: skip


def _trainings(run: StudyRun) -> Iterator[Row]:
    bounds, chosen = _bounds_of(run), {cell.key for cell, _ in _chosen(run)}
    for cell, result in run.results("policy"):
        against = bounds.get((cell.place["scenario"], cell.place["world"]))
        if against is not None:
            ratio = float(_ratio(result, against).mean())
            about = {**_where(cell), "policy": cell.settings["policy"], "seed": cell.settings["seed"]}
            yield {**about, "validation_reward": result["score"], "ratio": ratio, "chosen": cell.key in chosen}


def _bounds(run: StudyRun) -> Iterator[Row]:
    for cell, result in run.results("bounds"):
        least = np.array(result["penalty"])
        worth = float((np.array(result["full"]) - least).mean())
        for kind, worst in result["certificate_gap"].items():
            value = np.array(result[kind])
            points = 100.0 * float((value - least).mean()) / worth if worth > 0 else np.nan
            yield {**_where(cell), "bound": kind, "money": float(value.mean()), "points": points, "worst_gap": worst}


def _gap(run: StudyRun) -> Iterator[Row]:
    for cell, result in run.results("gap"):
        points = {row["kind"]: row for row in result["bounds"]}
        earned = {row["policy"]: row for row in result["policies"]}
        for row in result["gaps"]:
            if row["bound"] == result["best"]["bound"]:
                bound, policy = points[row["bound"]], earned[row["policy"]]
                yield {
                    **_where(cell), "policy": row["policy"], "bound": row["bound"],
                    "bound_points": bound["points"], "policy_points": policy["points"],
                    "gap": row["points"], "gap_low": row["points_low"], "gap_high": row["points_high"],
                    "at_most": row["claim"], "instances": result["instances"], "failures": len(result["failures"]),
                }  # fmt: skip


def _estimation(run: StudyRun) -> Iterator[Row]:
    for cell, result in run.results("estimate"):
        for group, (rmse, mbe) in enumerate(zip(result["rmse"], result["mbe"], strict=True)):
            yield {**_where(cell), "choice": cell.settings["choice"], "group": group + 1, "rmse": rmse, "mbe": mbe}


def _errors(run: StudyRun) -> Iterator[Row]:
    kinds = {(c.place["scenario"], c.place["world"]): result for c, result in run.results("utilities")}
    for cell, result in run.results("estimate"):
        told = kinds.get((cell.place["scenario"], cell.place["world"]))
        if told is not None:
            for row in _requests(told, result["error"], "error"):
                yield {**_where(cell), "choice": cell.settings["choice"], **row}


def _utilities(run: StudyRun) -> Iterator[Row]:
    for cell, result in run.results("utilities"):
        for row in _requests(result, result["utility"], "utility"):
            yield {**_where(cell), **row}


def _requests(told: Result, value: list[list[float]], name: str) -> Iterator[Row]:
    for group, values in enumerate(value):
        places = zip(told["type"], told["pickup"], told["dropoff"], told["count"], values, strict=True)
        for kind, pickup, dropoff, count, one in places:
            where = {"type": kind + 1, "pickup": pickup + 1, "dropoff": dropoff + 1}
            yield {"group": group + 1, **where, "count": count, name: one}


def _sensitivity(run: StudyRun) -> Iterator[Row]:
    bounds = _bounds_of(run)
    for cell, result in run.results("perturbed"):
        against = bounds.get((cell.place["scenario"], cell.place["world"]))
        if against is None:
            continue
        groups = cell.settings.get("groups")
        mbe = float(np.mean(result["mbe"] if groups is None else [result["mbe"][g] for g in groups]))
        yield {
            **_where(cell), "group": "all" if groups is None else str(groups[0] + 1),
            "epsilon": cell.settings["epsilon"], "draw": cell.settings["draw"],
            "ratio": float(_ratio(result, against).mean()), "mbe": mbe,
        }  # fmt: skip


def _operations(run: StudyRun) -> Iterator[Row]:
    bounds = _bounds_of(run)
    for cell, result in _chosen(run):
        against = bounds.get((cell.place["scenario"], cell.place["world"]))
        if "over" not in result or against is None:
            continue
        paid = np.array(result["over"], dtype=float)  # for each request served; none where nobody was
        over = mean_interval(paid) if paid.size else MeanInterval(np.nan, np.nan, np.nan, np.nan, 0)
        used = mean_interval(100.0 * np.array(result["served"]) / np.maximum(against["workers"], 1))
        rate = _rates(result)
        spread = 100.0 * float(np.nanstd(rate) / np.nanmean(rate)) if np.nansum(rate) > 0 else np.nan
        yield {
            **_where(cell), "policy": cell.settings["policy"], "over": over.mean, "over_low": over.low,
            "over_high": over.high, "utilised": used.mean, "utilised_low": used.low, "utilised_high": used.high,
            "acceptance_cv": spread,
        }  # fmt: skip


def _over(run: StudyRun) -> Iterator[Row]:
    for cell, result in _chosen(run):
        for one in result.get("over", ()):
            yield {**_where(cell), "policy": cell.settings["policy"], "over": one}


def _rates(result: Result) -> Floats:
    """Share of the requests between two places that were served, (pick-ups, drop-offs); NaN where nobody asked."""
    asked, taken = np.array(result["asked"], dtype=float), np.array(result["taken"], dtype=float)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(asked > 0, taken / asked, np.nan))


def _pairs(run: StudyRun) -> Iterator[Row]:
    mean: dict[tuple[str, int], dict[tuple[int, int], float]] = {}
    for cell, told in run.results("utilities"):
        weight = np.array(told["count"], dtype=float)
        utility, pair = np.array(told["utility"]).mean(axis=0), list(zip(told["pickup"], told["dropoff"], strict=True))
        place = mean.setdefault((cell.place["scenario"], cell.place["world"]), {})
        for one in sorted(set(pair)):
            own = np.array([p == one for p in pair])
            place[one] = float((utility * weight)[own].sum() / weight[own].sum())
    for cell, result in _chosen(run):
        if "asked" not in result:
            continue
        utilities = mean.get((cell.place["scenario"], cell.place["world"]), {})
        for (p, d), rate in np.ndenumerate(_rates(result)):
            yield {
                **_where(cell), "policy": cell.settings["policy"], "pickup": p + 1, "dropoff": d + 1,
                "asked": result["asked"][p][d], "served": 100.0 * float(rate), "utility": utilities.get((p, d), np.nan),
            }  # fmt: skip
