"""Results 2 and 4 of the paper beside ours: what wrong beliefs cost, one value a draw."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from optkit.simulation.metrics import mean_interval
from optkit.studies.claims.parts import SURE, Claim, Tables, claim, interval, settled

if TYPE_CHECKING:
    import pandas as pd


def sensitivity_claims(tables: Tables) -> Iterator[Claim]:
    """Compare the study of wrong beliefs; see :func:`optkit.studies.claims.verdicts.claims`."""
    if "sensitivity" not in tables:
        return
    frame = tables["sensitivity"]
    one, two = frame[frame["scenario"] == "I.1"], frame[frame["scenario"] == "II"]
    if len(one):
        yield from _falls(2, one, "I.1")
        yield from _signs(2, one, "I.1")
    if len(two):
        everyone = two[two["group"] == "all"]
        yield from _falls(4, everyone, "II")
        yield from _groups(two)
        yield from _signs(4, two, "II")


def _falls(result: int, frame: pd.DataFrame, name: str) -> Iterator[Claim]:
    by = frame.groupby("epsilon")["ratio"].mean()
    if len(by) < 2:
        return
    # A draw is one direction, gone further as epsilon grows: a slope each, and an interval over these.
    base = frame[frame["epsilon"] == 0].groupby("world")["ratio"].mean()
    moved = frame[frame["epsilon"] > 0]
    change = (moved["ratio"] - moved["world"].map(base)) / moved["epsilon"]
    slope = mean_interval(change.groupby(moved["draw"]).mean().dropna().to_numpy())
    told = f"{name}: " + ", ".join(f"{value:.1f} at {epsilon:g}" for epsilon, value in by.items())
    told += f"; a unit of epsilon costs {interval(slope)} points over draws"
    pattern = "The ratio falls as the perturbation bound epsilon grows."
    yield claim(result, pattern, "it falls", told, slope.mean < 0, sure=settled([slope]))


def _losses(frame: pd.DataFrame) -> pd.DataFrame:
    """What each draw costs in the mean over epsilon and worlds, by group: columns ``group``, ``loss``, ``mbe``."""
    base = frame[frame["epsilon"] == 0].groupby("world")["ratio"].mean()
    moved = frame[frame["epsilon"] > 0]
    moved = moved.assign(loss=moved["world"].map(base) - moved["ratio"]).dropna(subset=["loss"])
    return moved.groupby(["group", "draw"])[["loss", "mbe"]].mean().reset_index()


def _signs(result: int, frame: pd.DataFrame, name: str) -> Iterator[Claim]:
    """Compare what over- and underestimation cost, one value a draw, and say how large the errors were."""
    draws = _losses(frame)
    over, under = draws[draws["mbe"] < 0], draws[draws["mbe"] > 0]
    if min(len(over), len(under)) < 2:
        return
    from scipy.stats import ttest_ind

    test = ttest_ind(over["loss"].to_numpy(), under["loss"].to_numpy(), equal_var=False)
    told = (
        f"{name}: overestimation (MBE {over['mbe'].mean():.1f}) costs {over['loss'].mean():.1f} points in {len(over)} "
        f"draws, underestimation (MBE {under['mbe'].mean():+.1f}) {under['loss'].mean():.1f} in {len(under)}; "
        f"p = {test.pvalue:.2g}"
    )
    yield claim(
        result,
        "Overestimated utilities cost more than underestimated ones.",
        "down to about 0 % against mild losses",
        told,
        bool(over["loss"].mean() > under["loss"].mean()),
        sure=bool(test.pvalue < SURE),
    )


def _groups(frame: pd.DataFrame) -> Iterator[Claim]:
    draws = _losses(frame)
    loss = {str(group): part["loss"].to_numpy() for group, part in draws.groupby("group") if len(part) > 1}
    every = loss.pop("all", None)
    if every is None or len(loss) < 2:
        return
    told = ", ".join(f"group {group} {interval(mean_interval(x))}" for group, x in loss.items())
    told += f"; all groups {interval(mean_interval(every))}"
    from scipy.stats import f_oneway, ttest_ind

    less = ttest_ind(every, np.concatenate(list(loss.values())), equal_var=False)
    yield claim(
        4,
        "Errors about one group cost less than errors about all.",
        "relatively robust where one group is perturbed",
        f"{told}; p = {less.pvalue:.2g}",
        bool(every.mean() > max(x.mean() for x in loss.values())),
        sure=bool(less.pvalue < SURE),
    )
    alike = f_oneway(*loss.values())
    why = "Groups differ in how attractive requests are to them, and so in what an error of a given length does."
    differ = bool(alike.pvalue < SURE)
    yield claim(
        4,
        "They cost about the same whichever group it is.",
        "similar across groups",
        f"{told}; that groups differ: p = {alike.pvalue:.2g}",
        not differ,
        why if differ else "Not to find a difference is no proof that there is none.",
        sure=differ,
    )
