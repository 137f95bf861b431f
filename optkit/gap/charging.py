"""What a penalised bound charges with: the distribution of what is to come, and a value function, from other instances.

Charges have mean zero for everybody who does not foresee, if the distribution is that of the instances and if neither
it nor the value function was made from the instances that are bounded. So all that is drawn here is drawn apart from
the scenario's splits and samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import real
from optkit.basics.errors import InputError
from optkit.basics.seeds import Stream, stream
from optkit.bounds.penalised.charge_fit import fit_linear_charges
from optkit.bounds.penalised.foresight import LONGEST, Foresight, fifo_presence
from optkit.bounds.penalised.linear_charges import LinearCharges
from optkit.instances.instance import Instance
from optkit.instances.new_york.trip_scenario import TripScenario
from optkit.instances.scenario import Scenario
from optkit.instances.world import check_sample, poisson_instance
from optkit.learning.training import train
from optkit.learning.worker_rates import WorkerRates
from optkit.models.value import LinearValue
from optkit.models.value.experience import Estimator
from optkit.models.value.request_sets import SetValue
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import Policy

TRAINING, MOST = 75_000, 5_000
"""Requests that the value function is trained on, in at most so many instances: on I.2, where an instance has 15 of
them, 5,000 instances leave three quarters of the gap that 1,500 leave, and 12,000 gain little more."""

POOL = 7_200
"""Instances from which arrivals are drawn that might have come instead: enough of their own for each of 120."""


@dataclass(frozen=True, eq=False)
class Charging:
    """A value function, a distribution, and what was taken for granted.

    Attributes
    ----------
    value : SetValue
        V of :mod:`optkit.bounds.penalised.charges`.
    foresight : Foresight
        What nobody knows of the next step.
    policy : callable
        The policy that prices by V: a good one.
    assumptions : tuple of str
        What the bound rests on, in words.
    learned : WorkerRates or None
        What workers were learned as, if they were.
    """

    value: SetValue
    foresight: Foresight
    policy: Policy
    assumptions: tuple[str, ...]
    learned: WorkerRates | None = None


def charging_value(groups: int = 1) -> LinearValue:
    """Return the estimator that charged best of those tried: knots for every low rank, and in the busy stretch.

    Parameters
    ----------
    groups : int
        Number of worker groups; with several there is a term for each.

    Returns
    -------
    LinearValue
        Not fitted yet.

    Examples
    --------
    >>> charging_value().busy_knots, charging_value(groups=3).by_group
    ((0.0, 1.0, 3.0, 8.0), True)
    """
    rank, busy = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0), (0.0, 1.0, 3.0, 8.0)
    several = groups > 1
    return LinearValue(rank_knots=rank, busy_knots=busy, by_group=several, ridge=10.0 if several else 1.0)


def scenario_charging(
    source: Scenario,
    *,
    training: int | None = None,
    pool: int | None = None,
    draws: int = 8,
    estimator: Estimator | None = None,
) -> Charging:
    """Charge for foresight in a scenario: its process is known, and further instances can be drawn.

    In the scenarios with trips the requests of one instance depend on each other, because weeks differ, and nobody
    knows how. There only workers are charged for, and the value function is trained on the split's training half-hours.

    Parameters
    ----------
    source : Scenario
        From :func:`optkit.scenario`.
    training, pool : int
        Numbers of instances to draw: for the value function, by default by :data:`TRAINING`, and for arrivals, by
        default :data:`POOL`.
    draws : int
        Arrival sets per step, see :class:`~optkit.bounds.penalised.foresight.Foresight`.
    estimator : Estimator, optional
        Another value function to be fitted; :func:`charging_value` by default.

    Returns
    -------
    Charging
        For arrivals and workers alike; in a scenario with trips for workers only.

    Raises
    ------
    InputError
        If a number is out of range.
    TrainingError
        If training diverges.

    Examples
    --------
    >>> from optkit import scenario
    >>> charging = scenario_charging(scenario("I.2", seed=0), training=60, pool=30)
    >>> len(charging.foresight.arrivals), round(charging.foresight.nothing, 3)
    (30, 0.741)
    """
    rate, groups = source.settings.worker_rate, source.settings.groups
    one = charging_value(groups) if estimator is None else estimator
    workers = f"workers join the queue at {rate:g} a step (Poisson), of {groups} equally likely group(s)"
    share, presence = np.full(groups, 1.0 / groups), fifo_presence(rate, max(LONGEST, source.settings.horizon))
    pool = POOL if pool is None else pool
    if training is None:
        training = min(MOST, round(TRAINING / max(1.0, source.settings.request_rate * source.settings.horizon)))
    fitted = train(source.further("train", training), one, choice="true")
    if isinstance(source, TripScenario):
        foresight, own = Foresight(presence, share), len(source.episodes_of("train"))
        told = f"value function: trained on {training} realisations of the split's {own} training half-hours"
        return Charging(
            fitted.value, foresight, fitted.policy, (workers, "requests: nothing is assumed, nor charged for", told)
        )
    check_sample(source.settings, pool)
    # Their noise plays no part.
    seeds = stream(source.seed, Stream.POOL).spawn(pool)
    others = tuple(poisson_instance(source.settings, source.world, np.random.default_rng(one)) for one in seeds)
    nothing = float(np.exp(-source.settings.request_rate))
    foresight = Foresight(presence, share, others, nothing, draws=draws)
    requests = f"requests arrive at {source.settings.request_rate:g} a step (Poisson), as in {pool} other instances"
    told = f"value function: trained on {training} other instances"
    return Charging(fitted.value, foresight, fitted.policy, (workers, requests, told))


def scenario_linear_charges(source: Scenario, instances: Sequence[Instance] | None = None) -> LinearCharges:
    """Fit linear charges to a scenario's training instances, or to others of it that are not bounded.

    Its workers are charged for, and how many requests arrive; with trips, whose numbers depend on each other, workers
    alone.

    Examples
    --------
    >>> from optkit import scenario
    >>> scenario_linear_charges(scenario("I.2", seed=0, split=(30, 10, 0))).theta.shape
    (2, 2, 3)
    """
    groups, rate = source.settings.groups, source.settings.worker_rate
    presence = fifo_presence(rate, max(LONGEST, source.settings.horizon))
    workers = Foresight(presence, np.full(groups, 1.0 / groups))
    requests = None if isinstance(source, TripScenario) else source.settings.request_rate
    return fit_linear_charges(source.split().train if instances is None else instances, workers, requests)


def worker_charging(
    instances: Sequence[Instance],
    rate: npt.ArrayLike | WorkerRates,
    share: npt.ArrayLike | None = None,
    *,
    estimator: Estimator | None = None,
) -> Charging:
    """Charge for foresight of workers only, whose process is taken to be known, or was learned.

    Parameters
    ----------
    instances : sequence of Instance
        To train the value function on; none of those to be bounded.
    rate : float, (T,) float or WorkerRates
        Mean number of workers who join the queue in a step (Poisson), one for each step if it changes; one is seen a
        step, and leaves. Or what :func:`optkit.learning.worker_rates.learn_worker_rates` learned from days that are
        not bounded.
    share : (D,) float, optional
        Probability of each group; needed if there are several, and shares were not learned.
    estimator : Estimator, optional
        As in :func:`scenario_charging`.

    Returns
    -------
    Charging
        With the assumption on the workers in words.

    Raises
    ------
    InputError
        If there are several groups and no shares, or a number is out of range.

    Examples
    --------
    >>> from optkit import scenario
    >>> charging = worker_charging(scenario("I.2", seed=0).sample(60, seed=1), rate=0.5)
    >>> charging.assumptions[1]
    'requests: nothing is assumed, nor charged for'
    """
    batch = Batch.of(instances)
    groups = batch.groups
    given = "given " if share is not None else ""
    if isinstance(rate, WorkerRates):
        learned: WorkerRates | None = rate
        presence, share = rate.presence, rate.share if share is None else share
        rates = f"rates learned from {rate.days} other days, {rate}"
    else:
        learned, steady = None, np.ndim(rate) == 0
        presence = fifo_presence(rate, max(LONGEST, batch.horizon) if steady else None)
        rates = f"{float(np.asarray(rate)):g} a step" if steady else "rates given for each step"
    if share is None and groups > 1:
        raise InputError(f"there are {groups} groups of workers: their shares must be given, for example 0.3,0.7")
    shares = np.ones(1) if share is None else real("share", share)
    if shares.shape != (groups,):
        raise InputError(f"{shares.size} shares for {groups} groups of workers: give one for each")
    foresight = Foresight(presence, shares)
    fitted = train(instances, charging_value(groups) if estimator is None else estimator, choice="true")
    of_groups = "" if groups == 1 else f", of groups with {given}shares {', '.join(f'{s:g}' for s in shares)}"
    told = (
        f"workers are assumed to join a queue at {rates} (Poisson){of_groups}; else no penalised bound holds",
        "requests: nothing is assumed, nor charged for",
        f"value function: trained on {len(instances)} other instances",
    )
    return Charging(fitted.value, foresight, fitted.policy, told, learned)
