"""From raw instances to a policy: preferences and the value of waiting, learned in shared rounds (paper section 3.4).

Each round simulates the current prices plus noise, refits the preferences on all offers so far unless they are given,
and fits the value function by approximate value iteration (Algorithm 1) on the sets that waited. Validation instances
choose the round and the seed, and tell whether training has led anywhere.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from optkit.basics.arrays import Floats, Ints, floats, locked, number, whole_number
from optkit.basics.errors import InputError, TrainingError
from optkit.basics.parallel import one_thread
from optkit.basics.users_code import name_of, users_code
from optkit.instances.instance import Instance
from optkit.instances.scenario import Scenario, Split
from optkit.instances.splits import training_split
from optkit.learning.beliefs import BelievedValue, believed_requests, believed_workers
from optkit.learning.offer_log import OfferLog
from optkit.learning.rounds import Learned, another_day, known_attributes, learn_preferences, refit
from optkit.learning.trained import Trained
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences
from optkit.models.value.catalogue import estimator_of
from optkit.models.value.experience import Estimator, Experience
from optkit.models.value.request_sets import SetValue
from optkit.policies import PostDecisionPricing, TrueChoice
from optkit.policies.explore import Explore
from optkit.simulation.batch import Batch
from optkit.simulation.metrics import mean_interval
from optkit.simulation.simulator import Policy, simulate
from optkit.simulation.state import State

Choice = Literal["learned", "pooled", "true"] | Preferences
"""Preferences to learn (one model a group, or one for all), the true ones, or given ones."""

MOST_SEEDS = 10_000
"""Trainings to choose from at most."""

MOODS = 4
"""Times that each validation instance is run, the workers' noise drawn anew: a cheap way to a quieter choice."""

PATIENCE = 2
"""Rounds in a row that may fall short of the best before training stops."""


@dataclass(frozen=True)
class TrainingSettings:
    """How to train.

    Attributes
    ----------
    deviations : tuple of float
        Standard deviation of the exploration noise of each round, money; the paper starts at 10 and decays.
    discount : float
        Of the future, in [0, 1]; the problem itself is undiscounted, the paper trains with 0.95.
    seeds : int
        Number of trainings to choose from, from 1 to :data:`MOST_SEEDS`.
    seed : int
        Source of the randomness.
    """

    deviations: tuple[float, ...] = (8.0, 4.0)
    discount: float = 1.0
    seeds: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        deviations = tuple(floats("deviations", self.deviations, (None,)).tolist())
        if not deviations or min(deviations) < 0:
            raise InputError(f"deviations = {self.deviations!r} must be numbers of at least 0, in money, one a round")
        checked = {
            "deviations": deviations,
            "discount": number("discount", self.discount, least=0.0, most=1.0),
            "seeds": whole_number("seeds", self.seeds, least=1, most=MOST_SEEDS),
            "seed": whole_number("seed", self.seed, least=0),
        }
        for name, plain in checked.items():
            object.__setattr__(self, name, plain)


def train(
    source: Scenario | Split | Sequence[Instance],
    value: str | Estimator = "linear",
    *,
    choice: Choice = "learned",
    learned: Learned | None = None,
    instances: int | None = None,
    checkpoint: str | Path | None = None,
    progress: Callable[[int, int], object] | None = None,
    **settings: Any,
) -> Trained:
    """Train a pricing policy.

    Parameters
    ----------
    source : Scenario, Split or sequence of Instance
        A scenario or a split train on their training instances and choose by their validation instances. Plain
        instances are all trained on, and the last round counts.
    value : str or Estimator
        The value function's form, or its name in :data:`optkit.models.value.catalogue.VALUES`: ``"linear"``,
        ``"kernel"``, or one of the following. ``"mean"`` is the mean of several light ones, and wants many instances,
        see :class:`~optkit.models.value.mean.MeanValue`. ``"attention"`` is the network trained on differences,
        ``"attention-levels"`` on the levels of Algorithm 1, with settings chosen for them; both need
        ``optkit[attention]``.
    choice : {"learned", "pooled", "true"} or Preferences
        The choice model: learned along the way by group or for all groups together, the truth, or given.
    learned : Learned, optional
        What :func:`~optkit.learning.rounds.learn_preferences` found on the same instances with the same seed, so that
        it is not found again; for a ``choice`` that is learned.
    instances : int, optional
        Train a scenario on so many instances drawn for it, :meth:`~optkit.instances.scenario.Scenario.further`, in
        place of the 480 of its split, and choose by as many more in proportion. A scenario with trips has few
        half-hours; to realise each several times is worth 0.3 to 0.5 points there.
    checkpoint : path, optional
        Folder in which each seed's outcome is kept as soon as it is there. A training that was interrupted goes on from
        it, if its settings and instances are the same.
    progress : callable, optional
        Called with the number of rounds done and their number.
    **settings
        Fields of :class:`TrainingSettings`: ``deviations``, ``discount``, ``seeds``, ``seed``.

    Returns
    -------
    Trained
        The policy, its value function and preferences, and a record of every round.

    Raises
    ------
    InputError
        If an argument is out of range, there are no instances or no requests, or several seeds have nothing to be
        chosen by.
    PolicyError
        If a value function of your own fails.
    TrainingError
        If every seed diverged, or even the best earns significantly less than the myopic policy.

    Examples
    --------
    >>> from optkit import scenario, simulate
    >>> split = scenario("I.1", seed=0, split=(200, 60, 30)).split()
    >>> trained = train(split, choice="true")
    >>> patient, myopic = (simulate(split.test, p).reward.mean() for p in (trained.policy, PostDecisionPricing()))
    >>> bool(patient > myopic)
    True
    """
    from optkit.learning.checkpoints import Checkpoint

    estimator = estimator_of(value)
    if "deviations" not in settings and hasattr(estimator, "deviations"):
        settings["deviations"] = estimator.deviations
    if "discount" not in settings and hasattr(estimator, "discount"):
        settings["discount"] = estimator.discount
    known = [f.name for f in fields(TrainingSettings)]
    for name in settings:
        if name not in known:
            raise InputError(f"no setting {name!r}; there are {', '.join(known)}")
    chosen = TrainingSettings(**settings)
    # Plain instances are trained on as they are.
    given = source if isinstance(source, Scenario | Split) else Split(source, [], [])  # type: ignore[arg-type]
    days, _, validation = training_split(given, instances)
    if chosen.seeds > 1 and not validation:
        raise InputError(f"seeds = {chosen.seeds} need validation instances to choose between them: pass a Split")
    batch = Batch.of(days)
    course = _Course(batch, Batch.of(_moods(validation, chosen.seed)), chosen, choice, learned)
    believed = choice if learned is None else learned.preferences
    kept = Checkpoint(checkpoint, asdict(chosen), estimator, believed, batch.instances, validation)
    rounds = len(chosen.deviations)
    outcomes, failures = [], []
    # Everything here is many small products, which threads only slow down.
    with one_thread():
        for number in range(chosen.seeds):
            found = kept.load(number)
            if found is None:
                one = _seeded(estimator, chosen.seed + number)
                try:
                    found = course.run(one, number, partial(_tell, progress, number * rounds, chosen.seeds * rounds))
                    kept.save(number, found)
                except TrainingError as error:
                    failures.append(error)
            if found is not None:
                outcomes.append(found)
            _tell(progress, number * rounds, chosen.seeds * rounds, rounds)
        if not outcomes:
            raise failures[0]
        best = max(outcomes, key=lambda outcome: outcome.score)
        best = replace(best, record=[row for one in outcomes for row in one.record])
        return course.checked(best, [str(error) for error in failures])


def _tell(progress: Callable[[int, int], object] | None, before: int, total: int, done: int) -> None:
    if progress is not None:
        progress(before + done, total)


def _seeded(estimator: Estimator, seed: int) -> Estimator:
    """Return a copy that is not fitted further than the original, with a seed of its own if it takes one."""
    with users_code(f"copying {name_of(estimator)} and giving it a seed", InputError):
        one = copy.deepcopy(estimator)
        if hasattr(one, "seed"):
            one.seed = seed
    return one


def _moods(validation: Sequence[Instance], seed: int) -> list[Instance]:
    return [one for mood in range(MOODS) for one in another_day(validation, seed, 1000 + mood)]


@dataclass(frozen=True)
class _Course:
    """What all seeds of a training have in common."""

    batch: Batch
    validation: Batch
    settings: TrainingSettings
    choice: Choice
    learned: Learned | None

    def __post_init__(self) -> None:
        if int(self.batch.request_start[-1]) == 0:
            raise InputError("training needs instances with requests")
        groups = {one.n_groups for one in (*self.batch.instances, *self.validation.instances)}
        if len(groups) > 1:
            told = " and ".join(map(str, sorted(groups)))
            raise InputError(f"instances have {told} worker groups: train on days of the same groups")
        if not isinstance(self.choice, Preferences) and self.choice not in ("learned", "pooled", "true"):
            raise InputError(f'choice = {self.choice!r}: take "learned", "pooled", "true", or Preferences')
        if self.learned is not None and self.choice != ("pooled" if self.learned.preferences.pooled else "learned"):
            models = "one model" if self.learned.preferences.pooled else "a model for each group"
            raise InputError(f"choice = {self.choice!r} has no use for what was learned, {models}")

    @property
    def source(self) -> dict[str, Any]:
        """What is trained on, as plain data."""
        choice = self.choice if isinstance(self.choice, str) else "given"
        told: dict[str, Any] = {"choice": choice, "instances": len(self.batch), "horizon": self.batch.horizon}
        # What tables of requests call things by.
        named = [name for name in ("group_names", "feature_names") if getattr(self.batch.instances[0], name)]
        told |= {name: list(getattr(self.batch.instances[0], name)) for name in named}
        clock = self.batch.instances[0].clock
        return told | ({} if clock is None else {"clock": clock.to_dict()})

    @cached_property
    def _learned(self) -> Learned:
        """What all seeds begin with."""
        if self.learned is not None:
            return self.learned
        return learn_preferences(self.batch.instances, pooled=self.choice == "pooled", seed=self.settings.seed)

    def run(self, estimator: Estimator, number: int, tell: Callable[[int], object]) -> Trained:
        """Train one seed and return its best round."""
        settings, seed = self.settings, 1000 * number + self.settings.seed
        offers: Offers | None = None
        preferences = self.choice if isinstance(self.choice, Preferences) else None
        if self.choice in ("learned", "pooled"):
            preferences, offers = self._learned.preferences, self._learned.offers
        policy = _policy(None, preferences)
        record: list[dict[str, Any]] = []
        best: Trained | None = None
        short = 0
        for k, deviation in enumerate(settings.deviations):
            started = time.perf_counter()
            today = Batch.of(another_day(self.batch.instances, seed, 500 + k)) if offers is not None else self.batch
            last, log = _Waiting(today), OfferLog(today.instances)
            watch = last if offers is None else lambda *seen, a=last, b=log: (a(*seen), b(*seen))
            simulate(today, Explore(policy, deviation, seed=seed + k), observe=watch)
            if offers is not None:
                offers = Offers.join([offers, log.offers()])
                preferences = refit(offers, self.choice == "pooled", known_attributes(self.batch))
            row: dict[str, Any] = {"seed": number, "round": k + 1, "deviation": deviation}
            try:
                with users_code(f"the fit of {name_of(estimator)}"):
                    estimator.fit(self._experience(preferences, last.step))
                    fitted = copy.deepcopy(estimator)
                policy = _policy(fitted, preferences)
                score = float(self._scores(policy).mean()) if len(self.validation) else float(k + 1)
            except TrainingError as error:
                record.append({**row, "score": None, "error": str(error)})
                if best is None:
                    raise
                break
            row |= {"score": score if len(self.validation) else None, "residual": getattr(estimator, "residual_", None)}
            record.append({**row, "seconds": round(time.perf_counter() - started, 3), "error": None})
            short = 0 if best is None or score >= best.score else short + 1
            if short == 0:
                best = Trained(policy, policy.value_function.value, preferences, score, record, asdict(settings))  # type: ignore[attr-defined]
            if k + 1 < len(settings.deviations):  # the last is told when the outcome is safe
                tell(k + 1)
            if short >= PATIENCE:
                break
        assert best is not None
        return best

    def checked(self, best: Trained, failures: list[str]) -> Trained:
        """Return the chosen policy, unless validation says that it is worse than not waiting at all."""
        # A checkpoint may come from a call that asked for fewer seeds.
        best = replace(best, settings=asdict(self.settings), failures=failures, source=self.source)
        if len(self.validation):
            gain = mean_interval(self._scores(best.policy), self._scores(_policy(None, best.preferences)))
            if gain.high < 0:
                raise TrainingError(
                    f"training led nowhere: on validation instances the best round earns {-gain.mean:.3g} less than "
                    f"the myopic policy (95 % interval {-gain.high:.3g} to {-gain.low:.3g}); raise ridge or give more "
                    "instances"
                )
        return best

    def _scores(self, policy: Policy) -> Floats:
        """Reward on each validation instance, averaged over the moods."""
        return np.asarray(simulate(self.validation, policy).reward.reshape(MOODS, -1).mean(axis=0))

    def _experience(self, preferences: Preferences | None, last: Ints) -> Experience:
        batch = self.batch
        owner = np.repeat(np.arange(len(batch)), np.diff(batch.request_start))
        return Experience(
            believed_requests(batch, preferences),
            believed_workers(batch, preferences),
            locked(owner),
            locked(last.copy()),
            batch.busy,
            self.settings.discount,
        )


class _Waiting:
    """An observer that notes the last step after which each request was still waiting, (N,)."""

    def __init__(self, batch: Batch) -> None:
        self.step = batch.expiry[: int(batch.request_start[-1])] - 1

    def __call__(self, state: State, _: Floats, taken: Ints) -> None:
        at = np.flatnonzero(taken >= 0)
        self.step[state.request[at, taken[at]]] = state.step - 1


def _policy(value: SetValue | None, preferences: Preferences | None) -> PostDecisionPricing:
    choice = TrueChoice() if preferences is None else preferences
    if value is None:
        return PostDecisionPricing(choice=choice)
    return PostDecisionPricing(choice=choice, value_function=BelievedValue(value, preferences))
