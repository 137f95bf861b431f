"""What the claims of the studies are made of: paired differences of policies, their intervals, and verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.simulation.metrics import MeanInterval, mean_interval
from optkit.studies.tables import hopeful

if TYPE_CHECKING:
    import pandas as pd

Tables = Mapping[str, "pd.DataFrame"]
Claim = dict[str, Any]

OURS = ("Attention, paper's data", "Linear, paper's data")
"""The paper's algorithm: preferences from random offers, and a value function; the network where it is there."""

BEST, RULES = "Linear, re-estimated", ("PP", "FP")


SURE = 0.05
"""Level at which a difference between draws is taken for one."""


def claim(result: int, pattern: str, paper: str, here: str, holds: bool, why: str = "", sure: bool = True) -> Claim:
    """Return a claim with its verdict: not settled unless ``sure``."""
    verdict = ("reproduced" if holds else "contradicted") if sure else "not settled"
    return {"result": result, "pattern": pattern, "paper": paper, "here": here, "verdict": verdict, "why": why}


class Ratios:
    """Paired differences of two policies in a scenario: over worlds where there are several, else over instances."""

    def __init__(self, tables: Tables) -> None:
        keys = ["scenario", "world", "instance"]
        self.wide = hopeful(tables["rows"]).pivot_table(index=keys, columns="policy", values="ratio")

    def has(self, scenario: str, *policies: str) -> bool:
        """Whether policies have ratios in a scenario."""
        if scenario not in self.wide.index.get_level_values(0) or not set(policies) <= set(self.wide.columns):
            return False
        return bool(self.wide.loc[scenario][list(policies)].notna().any().all())

    def mean(self, scenario: str, policy: str) -> float:
        """Mean over worlds of a policy's mean ratio, per cent."""
        return float(self.wide.loc[scenario][policy].groupby("world").mean().mean())

    def gain(self, scenario: str, policy: str, against: str) -> MeanInterval:
        """Lead of one policy over another, points."""
        frame = self.wide.loc[scenario]
        # Where a cell failed, a policy has no ratios: what the others have stays comparable.
        difference = (frame[policy] - frame[against]).dropna()
        by_world = difference.groupby("world").mean()
        return mean_interval(by_world.to_numpy() if len(by_world) > 1 else difference.to_numpy())

    def rule(self, scenario: str) -> str:
        """The better of the two rules."""
        return max(RULES, key=lambda name: self.mean(scenario, name))

    def ours(self, scenario: str) -> str:
        """The paper's algorithm, as far as it is there."""
        return next(name for name in OURS if self.has(scenario, name))

    def between(self, one: str, other: str, policy: str) -> MeanInterval:
        """By how much a policy does better in a scenario than in another: paired by world, else over instances."""
        parts = [self.wide.loc[name][policy].dropna() for name in (one, other)]
        worlds = [part.groupby("world").mean() for part in parts]
        if len(difference := (worlds[0] - worlds[1]).dropna()) > 1:
            return mean_interval(difference.to_numpy())
        from scipy.stats import ttest_ind

        ends = ttest_ind(*parts, equal_var=False).confidence_interval(1 - SURE)
        mean = float(parts[0].mean() - parts[1].mean())
        return MeanInterval(mean, np.nan, float(ends.low), float(ends.high), len(parts[0]))


def interval(x: MeanInterval) -> str:
    """Write a mean with its interval, if there is one."""
    return f"{x.mean:+.2f}" if x.low != x.low else f"{x.mean:+.2f} [{x.low:+.2f}, {x.high:+.2f}]"


def settled(found: Iterable[MeanInterval], least: float = 0.0) -> bool:
    """Whether the draws say of each difference on which side of ``least`` it lies."""
    return all(one.low != one.low or one.low > least or one.high < least for one in found)


def beats_rules(result: int, tables: Tables, leads: Mapping[str, float], paper: str) -> Iterator[Claim]:
    """Claim that the learned policy beats the better rule in every scenario, and compare the lead with the paper's."""
    ratios = Ratios(tables)
    names = [one for one in leads if ratios.has(one, *RULES) and any(ratios.has(one, who) for who in OURS)]
    if not names:
        return
    gains = {one: ratios.gain(one, ratios.ours(one), ratios.rule(one)) for one in names}
    told = "; ".join(
        f"{one}: {ratios.mean(one, ratios.ours(one)):.1f} % against {ratios.mean(one, ratios.rule(one)):.1f} % "
        f"({ratios.rule(one)}), {interval(gains[one])}"
        for one in names
    )
    holds = all(gain.mean > 0 for gain in gains.values())
    why = ""
    if not all(gains[one].low <= leads[one] <= gains[one].high for one in names):
        why = (
            "The lead depends on the world's weights, which the paper does not publish: rules pay by reward, and lose "
            "the more, the more utilities differ between requests of the same reward."
        )
    yield claim(
        result,
        "The algorithm with learned preferences beats the better rule everywhere.",
        paper,
        told,
        holds,
        why,
        settled(gains.values()),
    )


def lag(result: int, tables: Tables, names: Sequence[str], paper: str) -> Iterator[Claim]:
    """Claim that learned preferences cost more than a point."""
    ratios = Ratios(tables)
    names = [one for one in names if ratios.has(one, "Linear, true MNL", "Linear, paper's data", BEST)]
    if not names:
        return
    once = {one: ratios.gain(one, "Linear, paper's data", "Linear, true MNL") for one in names}
    again = {one: ratios.gain(one, BEST, "Linear, true MNL") for one in names}
    told = "; ".join(f"{one}: {interval(once[one])}, re-estimated {interval(again[one])}" for one in names)
    holds = all(one.mean < -1.0 for one in once.values())
    why = (
        "Conditional logit on logged offers with the rejections in it finds the level of utility where there are "
        "enough of them; one more round of data, priced with the first estimate, adds rejections where they lacked."
    )
    yield claim(
        result,
        "Learned preferences cost more than a point against the true ones (Pert(0)).",
        paper,
        told,
        holds,
        "" if holds else why,
        settled(once.values(), -1.0),
    )
