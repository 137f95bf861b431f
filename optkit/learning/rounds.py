"""Learning preferences in rounds: offer, log, fit, and offer again with what was learned."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from optkit.basics.arrays import Floats, Known, flag, number, whole_number
from optkit.basics.errors import DataError, InputError
from optkit.basics.seeds import Stream, check_seed, stream
from optkit.instances.instance import Instance
from optkit.learning.offer_log import collect
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences
from optkit.policies import PostDecisionPricing
from optkit.policies.explore import Explore, RandomOffers
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import Policy

if TYPE_CHECKING:
    import pandas as pd

RIDGE = 1e-3
"""L2 penalty of theta where offers leave the level of utility open: a prior deviation of 30 noise scales."""


WEAK = 0.25
"""Standard error of utility, in noise scales, above which it counts as weakly known: choice probabilities near one half
are then off by some six points."""


@dataclass(frozen=True)
class Learned(Known):
    """Preferences and how they were learned.

    Attributes
    ----------
    preferences : Preferences
        The last round's estimate, from all rounds' data.
    offers : Offers
        All data.
    rounds : DataFrame
        One row per round and group: ``round``, ``group``, ``situations``, ``rejections`` (so far), ``standard_error``
        (root mean square over the requests, money), ``verdict`` ("not identified" by the identification report, "weak"
        if the standard error exceeds :data:`WEAK` noise scales, "identified"), ``converged`` (of the fit), and against
        the truth ``rmse`` and ``mbe`` (money).
    converged : bool
        Whether the standard error met the tolerance in every group.
    tolerance : float
        That tolerance, in money.
    """

    preferences: Preferences
    offers: Offers
    rounds: pd.DataFrame
    converged: bool
    tolerance: float

    def __repr__(self) -> str:
        last = self.rounds.iloc[-1]
        return f"Learned({self.preferences!r}, rounds={last['round']}, verdict={last['verdict']!r})"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.rounds.to_html(max_rows=10, index=False)}"


def learn_once(instances: Sequence[Instance], *, pooled: bool = False, seed: int = 0) -> Learned:
    """Learn from the paper's data alone: one round of random offers of 40 to 85 per cent of the reward.

    Such offers often see few rejections or none, and then say little of the level of utility; the record tells.

    Parameters
    ----------
    instances : sequence of Instance
        Training instances.
    pooled : bool
        One model for all groups.
    seed : int
        Source of the randomness.

    Returns
    -------
    Learned
        With a record of one round. Errors are those of :func:`learn_preferences`.

    Examples
    --------
    >>> from optkit import scenario
    >>> learned = learn_once(scenario("I.1", seed=0).sample(60, seed=0))
    >>> learned.rounds[["round", "rejections"]].values.tolist()
    [[1, 115]]
    """
    return learn_preferences(instances, rounds=1, pooled=pooled, seed=seed)


def learn_preferences(
    instances: Sequence[Instance],
    *,
    rounds: int = 8,
    tolerance: float = 0.05,
    deviation: float = 3.0,
    pooled: bool = False,
    seed: int = 0,
    first: Policy | None = None,
    begun: Learned | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Learned:
    """Learn preferences actively: price with the current estimate plus noise, log, refit on all data so far.

    The first round makes random offers, as the paper does. Where they leave the level of utility open, the estimate
    rests on a weak penalty and believes workers too willing; the next round then pays little, sees rejections, and
    closes the gap: what is not known is what gets tried.

    Parameters
    ----------
    instances : sequence of Instance
        Training instances. Every round but the first sees them on another day: the same arrivals, the workers' noise
        drawn anew, so that no worker's mood counts twice.
    rounds : int
        Largest number of rounds, at least 1.
    tolerance : float
        Standard error of utility, root mean square over the instances' requests, at which to stop; money.
    deviation : float
        Standard deviation of the exploration noise, in money.
    pooled : bool
        One model for all groups.
    seed : int
        Source of the randomness.
    first : callable, optional
        Policy of the first round; random offers of 40 to 85 per cent of the reward by default.
    begun : Learned, optional
        What earlier rounds with these arguments found, to go on from: the same comes out as from the first round on.
    progress : callable, optional
        Called with the number of rounds done and their largest number, which is also where an early end jumps to.

    Returns
    -------
    Learned
        The preferences, all data, and a record of every round.

    Raises
    ------
    InputError
        If an argument is out of range.
    DataError
        If a group gets no offers, or its data contradict the model.

    Examples
    --------
    >>> from optkit import scenario
    >>> learned = learn_preferences(scenario("I.1", seed=0).sample(120, seed=0), rounds=3)
    >>> bool(learned.rounds["rmse"].iloc[-1] < 0.5)
    True
    """
    whole_number("rounds", rounds, least=1)
    number("tolerance", tolerance, above=0.0)
    number("deviation", deviation, least=0.0)
    flag("pooled", pooled)
    check_seed(seed)
    batch = Batch.of(instances)
    if not len(batch):
        raise InputError("learning needs at least one instance")
    attributes = known_attributes(batch)
    N = int(batch.request_start[-1])
    where = (batch.features[:N], batch.pickup[:N], batch.dropoff[:N])
    truth = batch.utility[:, :N] - np.concatenate(
        [np.repeat(_outside(one, batch.groups)[:, None], one.n_requests, axis=1) for one in batch.instances], axis=1
    )
    policy: Policy = RandomOffers(seed=seed) if first is None else first
    logs: list[Offers] = []
    rows: list[dict[str, Any]] = []
    done = 0
    if begun is not None:
        logs, rows = [begun.offers], _plain(begun.rounds)
        done = int(begun.rounds["round"].iloc[-1])
        if begun.converged or done >= rounds:
            if progress is not None:
                progress(rounds, rounds)
            return begun
        policy = Explore(PostDecisionPricing(choice=begun.preferences), deviation, seed=seed + done)
    for past in range(done, rounds):
        logs.append(collect(another_day(batch.instances, seed, past), policy))
        offers = Offers.join(logs)
        absent = sorted(set(range(batch.groups)) - set(offers.group.tolist()))
        if absent and not pooled:
            raise DataError(f"group {absent[0]} was offered nothing: learn from more instances, or with pooled=True")
        preferences = refit(offers, pooled, attributes)
        own = _round(preferences, offers, where, truth)
        rows += [{"round": past + 1, **row} for row in own]
        converged = all(row["verdict"] != "not identified" and row["standard_error"] <= tolerance for row in own)
        if progress is not None:
            progress(rounds if converged else past + 1, rounds)
        if converged:
            break
        policy = Explore(PostDecisionPricing(choice=preferences), deviation, seed=seed + past + 1)
    import pandas as pd

    return Learned(preferences, offers, pd.DataFrame(rows), converged, tolerance)


def another_day(instances: Sequence[Instance], seed: int, number: int) -> Sequence[Instance]:
    """Return the instances with the workers' noise drawn anew for round ``number``; round 0 has their own."""
    if number == 0:
        return instances
    moods = stream(seed, Stream.ROUND_NOISE, number).spawn(len(instances))
    return [one.with_noise(mood) for one, mood in zip(instances, moods, strict=True)]


def _outside(one: Instance, groups: int) -> Floats:
    full = np.zeros(groups)
    full[: one.n_groups] = one.outside_by_group
    return full


def known_attributes(batch: Batch) -> Attributes:
    """Return attributes that know every place of every request, also of those that nobody has seen yet."""
    names = batch.instances[0].feature_names if batch.instances else None
    names = names or tuple(f"feature_{f}" for f in range(batch.features.shape[1]))
    return Attributes(names, int(batch.pickup.max(initial=0)) + 1, int(batch.dropoff.max(initial=0)) + 1)


def refit(offers: Offers, pooled: bool, attributes: Attributes) -> Preferences:
    """Fit preferences without a penalty, or with a weak one where the data leave something open."""
    from statsmodels.tools.sm_exceptions import ConvergenceWarning

    from optkit.models.estimation import EstimationWarning, NotIdentifiedError
    from optkit.models.preferences.fit import fit_preferences

    with warnings.catch_warnings():
        # Both are told in the record, round by round.
        warnings.simplefilter("ignore", EstimationWarning)
        warnings.simplefilter("ignore", ConvergenceWarning)
        try:
            return fit_preferences(offers, pooled=pooled, attributes=attributes)
        except NotIdentifiedError:
            return fit_preferences(offers, pooled=pooled, attributes=attributes, ridge=RIDGE)


def _round(
    preferences: Preferences, offers: Offers, where: tuple[Any, Any, Any], truth: Floats
) -> list[dict[str, Any]]:
    from optkit.models.estimation import identification
    from optkit.models.preferences.fit import utility_errors

    rows = _plain(utility_errors(preferences, *where, truth))
    reports = [identification(results) for results in preferences.results]
    for row in rows:
        group = int(row["group"])
        own = offers.take(offers.group == group)
        error = preferences.standard_error(*where, group)
        row["situations"], row["rejections"] = own.n_situations, own.n_situations - own.n_choices
        model = 0 if preferences.pooled else group
        row["standard_error"] = float(np.sqrt(np.mean(error**2)))
        row["verdict"] = "identified"
        if row["standard_error"] > WEAK * preferences.scale[model]:
            row["verdict"] = "weak"
        if reports[model].verdict == "not identified":
            row["verdict"] = "not identified"
        row["converged"] = bool(preferences.results[model].converged)
    return rows


def _plain(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in table.to_dict(orient="records")]
