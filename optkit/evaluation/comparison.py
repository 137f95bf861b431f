"""Several policies on the same instances, measured against an upper bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats, check_finite
from optkit.basics.errors import InputError, OptkitError
from optkit.bounds import Bound
from optkit.bounds.bound import prove
from optkit.instances.digest import refuse_repeated
from optkit.instances.instance import Instance
from optkit.simulation.batch import Batch
from optkit.simulation.metrics import mean_interval, performance_ratio
from optkit.simulation.simulator import Policy, named_policies, simulate

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Comparison:
    """How policies fared, instance by instance and in the mean.

    Intervals and deviations of one instance are NaN, and a ratio is ``-inf`` where nothing can be gained and the policy
    loses; all else is finite.

    Attributes
    ----------
    per_instance : DataFrame
        One row per policy and instance: ``policy``, ``instance``, ``bound`` (money),
        ``requests``, ``workers``, ``reward`` (money), ``ratio`` (per cent), ``served``, ``paid`` (money).
    table : DataFrame
        One row per policy, in the order given: mean ``ratio``, its ``std`` and confidence interval ``low``, ``high``;
        ``difference`` to the first policy, paired by instance, with ``difference_low``, ``difference_high`` and the
        ``p_value`` of a paired t-test that there is none (two-sided; 1 where no instance differs); mean ``reward``;
        ``instances`` with a finite ratio, which the means are over; ``served`` and ``margin_share``: shares of requests
        served and of their rewards kept.
    """

    per_instance: pd.DataFrame
    table: pd.DataFrame

    def __post_init__(self) -> None:
        check_finite("comparison", self.per_instance, ["ratio"])
        spread = ["std", "low", "high", "difference_low", "difference_high", "p_value"]
        alone = self.table["instances"] == 1
        check_finite("comparison", self.table[alone], spread)
        check_finite("comparison", self.table[~alone])

    def ratios(self) -> dict[str, Floats]:
        """Performance ratios by policy, each (B,), in per cent."""
        return {str(name): rows["ratio"].to_numpy() for name, rows in self.per_instance.groupby("policy", sort=False)}


def compare(
    instances: Sequence[Instance],
    policies: Mapping[str, Policy],
    bounds: Sequence[Bound],
    *,
    labels: Sequence[int] | None = None,
) -> Comparison:
    """Simulate policies on the same instances and noise, and compare them with bounds on these instances.

    Parameters
    ----------
    instances : sequence of Instance
        Their noise must be realised.
    policies : mapping from name to policy
        The first is the one that the others are paired with.
    bounds : sequence of Bound
        One per instance, of :func:`optkit.bounds.full.full_information`; their certificates are checked.
    labels : sequence of int, optional
        Numbers of the instances in the rows, if they are not 0, 1, ...

    Returns
    -------
    Comparison
        A table by policy, and rows by policy and instance.

    Raises
    ------
    InputError
        If there are no policies or instances, two instances are the same, the number of bounds differs, or one is not
        proven to be its instance's.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds import full_information
    >>> from optkit.policies import PostDecisionPricing, RewardPercentage
    >>> days = scenario("I.1", seed=0).sample(20, seed=1)
    >>> named = {"myopic": PostDecisionPricing(), "half": RewardPercentage(0.5)}
    >>> compare(days, named, [full_information(day) for day in days]).table["ratio"].round(1).tolist()
    [90.2, 57.1]
    """
    import pandas as pd

    named_policies(policies)
    if not policies or not len(instances):
        raise InputError("a comparison needs at least one policy and one instance")
    if len(bounds) != len(instances):
        raise InputError(f"{len(instances)} instances but {len(bounds)} bounds; give one bound per instance")
    batch = Batch.of(instances)
    refuse_repeated(batch.instances)
    for b, (bound, one) in enumerate(zip(bounds, batch.instances, strict=True)):
        if not isinstance(bound, Bound) or bound.kind != "full information":
            told = f"of {bound.kind}" if isinstance(bound, Bound) else f"a {type(bound).__name__}"
            raise InputError(f"bound {b} is {told}; a ratio is against full_information(instance)")
        try:
            prove(bound, one)
        except OptkitError as error:
            raise InputError(f"bound {b} is not proven to be one of instance {b}: {error}") from error
    least = np.array([one.penalty.sum() for one in instances])
    best = np.array([bound.value for bound in bounds])
    sizes = {
        "instance": np.arange(len(instances)) if labels is None else np.asarray(labels),
        "bound": best,
        "requests": [one.n_requests for one in instances],
        "workers": [one.n_workers for one in instances],
    }
    frames, rows = [], []
    first: Floats | None = None
    for name, policy in policies.items():
        outcome = simulate(batch, policy)
        ratio = performance_ratio(outcome.reward, best, least)
        first = ratio if first is None else first
        paid = np.nansum(outcome.compensation, axis=1)
        frames.append(
            pd.DataFrame(
                {"policy": name, **sizes, "reward": outcome.reward, "ratio": ratio, "served": outcome.served}
            ).assign(paid=paid)
        )
        earned = outcome.margin.sum() + paid.sum()
        rows.append(_row(name, frames[-1], first, outcome.margin.sum() / earned if earned else 0.0))
    return Comparison(pd.concat(frames, ignore_index=True), pd.DataFrame(rows))


def _row(name: str, frame: pd.DataFrame, first: Floats, margin_share: float) -> dict[str, Any]:
    # A ratio is -inf where nothing can be gained and the policy loses: no mean can hold it, the rows do.
    both = np.isfinite(frame["ratio"].to_numpy()) & np.isfinite(first)
    ratio = mean_interval(frame["ratio"].to_numpy()[both])
    difference = mean_interval(frame["ratio"].to_numpy()[both], first[both])
    return {
        "policy": name,
        "ratio": ratio.mean,
        "std": ratio.std,
        "low": ratio.low,
        "high": ratio.high,
        "difference": difference.mean,
        "difference_low": difference.low,
        "difference_high": difference.high,
        "p_value": difference.p_value,
        "reward": float(frame["reward"].mean()),
        "instances": ratio.count,
        "served": float(frame["served"].sum() / max(frame["requests"].sum(), 1)),
        "margin_share": float(margin_share),
    }
