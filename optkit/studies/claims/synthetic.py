"""Results 1 and 3 of the paper beside ours: synthetic scenarios, one group of workers or three."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from optkit.studies.claims.parts import BEST, RULES, Claim, Ratios, Tables, beats_rules, claim, interval, lag, settled


def homogeneous_claims(tables: Tables) -> Iterator[Claim]:
    """Compare the study of workers who are alike; see :func:`optkit.studies.claims.verdicts.claims`."""
    if "rows" not in tables:
        return
    names = ("I.1", "I.2", "I.3")
    paper = "I.1: 92.9 against 85.5 (PP); I.2: 94.7 against 88.6 (PP); I.3: 88.5 against 86.1 (FP)"
    yield from beats_rules(1, tables, {"I.1": 7.4, "I.2": 6.1, "I.3": 2.4}, paper)
    yield from lag(1, tables, names, "-2.2, -1.4 and -4.7 on I.1, I.2 and I.3")
    ratios = Ratios(tables)
    if all(ratios.has(one, "Linear, true MNL") for one in names):
        by = {one: ratios.mean(one, "Linear, true MNL") for one in names}
        steps = [ratios.between(*pair, "Linear, true MNL") for pair in (("I.2", "I.1"), ("I.1", "I.3"))]
        holds = by["I.2"] > by["I.1"] > by["I.3"]
        told = ", ".join(f"{one} {value:.1f}" for one, value in by.items())
        told += f"; I.2 less I.1 {interval(steps[0])}, I.1 less I.3 {interval(steps[1])}"
        why = (
            "Where requests abound, both clairvoyant and policy choose among many: how much foresight is worth there "
            "depends on how much requests differ, and so on the weights."
        )
        yield claim(
            1,
            "With the true preferences the ratio falls with the rate of requests: I.2 above I.1 above I.3.",
            "I.1 95.1, I.2 96.1, I.3 93.2",
            told,
            holds,
            "" if holds else why,
            # One step that surely goes the other way contradicts the order, whatever the other does.
            settled(steps) or any(step.high < 0 for step in steps),
        )


def heterogeneous_claims(tables: Tables) -> Iterator[Claim]:
    """Compare the study of three groups of workers; see :func:`optkit.studies.claims.verdicts.claims`."""
    if "rows" not in tables:
        return
    yield from beats_rules(3, tables, {"II": 9.1}, "89.5 against 80.4 (FP)")
    yield from lag(3, tables, ("II",), "-3.1")
    ratios = Ratios(tables)
    single = next((n for n in ("Linear, single MNL, paper's data",) if n in ratios.wide.columns), None)
    if single is None or not ratios.has("II", *RULES, BEST):
        return
    against = ratios.gain("II", single, ratios.rule("II"))
    loss = ratios.gain("II", single, BEST)
    more = (
        f", re-estimated {ratios.mean('II', 'Linear, single MNL'):.1f} %"
        if ratios.has("II", "Linear, single MNL")
        else ""
    )
    told = (
        f"{ratios.mean('II', single):.1f} %{more}; against the better rule {interval(against)}, "
        f"against one model a group {interval(loss)}"
    )
    holds = loss.mean < 0 and (against.high if against.high == against.high else against.mean) < 0
    why = (
        "A single model with prices that are optimal for it is a better rule than PP and FP, if its level is right: "
        "with the level learned from rejections it believes in a noisier, average worker and pays for that."
    )
    yield claim(
        3,
        "One model for all groups loses much, and falls below the rules.",
        "75.5: -4.9 against FP, -14.0",
        told,
        holds,
        "" if holds else why,
    )
    if "estimation" in tables:
        frame = tables["estimation"].groupby(["choice", "group"])["rmse"].mean().unstack()
        told = "; ".join(f"{name}: {', '.join(f'{x:.1f}' for x in row)}" for name, row in frame.iterrows())
        separate = frame.loc["paper"].mean() if "paper" in frame.index else np.nan
        holds = "single-paper" in frame.index and bool(frame.loc["single-paper"].mean() > separate)
        yield claim(
            3,
            "Separate models are nearer to the groups' utilities (RMSE, groups 1 to 3).",
            "single: 1.8, 12.7, 11.7; separate: 2.2, 12.9, 3.2",
            told,
            holds,
        )
