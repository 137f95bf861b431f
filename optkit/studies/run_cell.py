"""What a cell computes: a pure function of its description, of the instances it names, and of nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from optkit.basics.arrays import Floats, Ints
from optkit.basics.errors import DataError, InputError
from optkit.basics.seeds import Stream, stream
from optkit.bounds import arrival_information, full_information
from optkit.bounds.bound import prove
from optkit.gap.charging import scenario_charging
from optkit.gap.report import gap_report
from optkit.instances.catalogue import scenario
from optkit.instances.instance import Instance
from optkit.instances.scenario import Scenario, Split
from optkit.learning.perturbation import perturb, true_preferences
from optkit.learning.rounds import Learned, learn_once, learn_preferences
from optkit.learning.training import train
from optkit.models.preferences.preferences import Preferences
from optkit.policies import PostDecisionPricing
from optkit.policies.tuning import tune_formula, tune_reward_percentage
from optkit.simulation.batch import Batch
from optkit.simulation.simulator import Policy, simulate
from optkit.studies.cells import Cell, Kind, Place
from optkit.studies.grids import digest_of
from optkit.studies.policies import CHOICES, POLICIES, Spec

Result = dict[str, Any]


def run_cell(cell: Cell, trips: tuple[str, ...] | None = None) -> Result:
    """Work a cell out.

    Parameters
    ----------
    cell : Cell
        What to work out.
    trips : tuple of str, optional
        Files of trip records, for the scenarios of New York; the cell's place holds their digest.

    Returns
    -------
    dict
        Plain data, without times: the same wherever and whenever it is worked out.

    Raises
    ------
    OptkitError
        If the cell cannot be worked out.

    Examples
    --------
    >>> place = {"scenario": "I.2", "world": 0, "set": {"horizon": 15, "split": [20, 4, 4]}}
    >>> result = run_cell(Cell("policy", place, {"policy": "PP", "seed": 0}))
    >>> sorted(result)
    ['margin', 'paid', 'reward', 'score', 'served']
    """
    source = _source(cell.place, trips)
    return _WORK[cell.kind](source, _split(source), cell.settings)


def _name(place: Place) -> tuple[Any, ...]:
    settings = tuple((name, tuple(v) if isinstance(v, list) else v) for name, v in place.get("set", {}).items())
    if unknown := set(place) - {"scenario", "world", "set", "trips", "mode", "fraction"}:
        raise DataError(f"this optkit does not know {', '.join(sorted(unknown))} of a study: update it")
    selection = tuple((name, place[name]) for name in ("mode", "fraction") if name in place)
    return (place["scenario"], place["world"], settings + selection, place.get("trips"))


def _source(place: Place, trips: tuple[str, ...] | None) -> Scenario:
    return _scenario(_name(place), trips)


@lru_cache(maxsize=2)
def _scenario(name: tuple[Any, ...], trips: tuple[str, ...] | None) -> Scenario:
    key, world, settings, digest = name
    if digest is not None and digest_of(trips or ()) != digest:
        raise DataError("the trip files here are not those that the study was planned with: start it again")
    return scenario(
        key, seed=world, trips=list(trips or ()) or None if key.startswith("nyc") else None, **dict(settings)
    )


@lru_cache(maxsize=2)
def _split(source: Scenario) -> Split:
    return source.split()


@lru_cache(maxsize=4)
def _learned(source: Scenario, once: bool, pooled: bool, seed: int) -> Learned:
    """Return what is learned from the training instances: cells that this process works out share it."""
    days = _split(source).train
    if once:
        return learn_once(days, pooled=pooled, seed=seed)
    return learn_preferences(days, pooled=pooled, seed=seed, begun=_learned(source, True, pooled, seed))


def _bounds(source: Scenario, split: Split, settings: dict[str, Any]) -> Result:
    """Full- and arrival-information bounds of the test instances, and by how much their certificates fall short."""
    found: dict[str, list[float]] = {"full": [], "lagrangian": [], "arrival": []}
    gaps = dict.fromkeys(found, 0.0)
    for day in split.test:
        made = {
            "full": full_information(day),
            "lagrangian": arrival_information(day, "lagrangian"),
            "arrival": arrival_information(day),
        }
        for kind, bound in made.items():
            found[kind].append(bound.value)
            gaps[kind] = max(gaps[kind], prove(bound, day).gap)
    sizes = {
        "penalty": [float(day.penalty.sum()) for day in split.test],
        "requests": [day.n_requests for day in split.test],
        "workers": [day.n_workers for day in split.test],
    }
    return {**found, **sizes, "certificate_gap": gaps}


def _utilities(source: Scenario, split: Split, settings: dict[str, Any]) -> Result:
    """True utilities of the test instances' requests by group, once for each kind of request with its number."""
    return _requests(source, split.test)[0]


def _policy(source: Scenario, split: Split, settings: dict[str, Any]) -> Result:
    """Reward of a policy on each test instance, after training with a seed, and the score that validation gives it."""
    if settings["policy"] not in POLICIES:
        raise InputError(f"no policy {settings['policy']!r}; there are {', '.join(POLICIES)}")
    spec = POLICIES[settings["policy"]]
    policy = _trained(source, split, spec, int(settings["seed"]))
    score = float(simulate(split.validation, policy).reward.mean()) if split.validation else None
    outcome = simulate(split.test, policy)
    result: Result = {
        "score": score,
        "reward": outcome.reward.tolist(),
        "margin": outcome.margin.tolist(),
        "served": outcome.served.tolist(),
        "paid": np.nansum(outcome.compensation, axis=1).tolist(),
    }
    if settings.get("detail"):
        result |= _details(split.test, outcome.accepted, outcome.compensation, source)
    return result


def _trained(source: Scenario, split: Split, spec: Spec, seed: int) -> Policy:
    if spec.rule is not None:
        tuned = tune_reward_percentage(split.train) if spec.rule == "PP" else tune_formula(split.train)
        return tuned.policy
    if spec.value is None:
        if spec.choice == "true":
            return PostDecisionPricing()
        return PostDecisionPricing(choice=_preferences(source, spec.choice, seed))
    if spec.choice == "true":
        return train(split, spec.value, choice="true", seed=seed).policy
    if spec.choice == "learned":
        learned = _learned(source, False, False, seed)
        return train(split, spec.value, choice="learned", learned=learned, seed=seed).policy
    return train(split, spec.value, choice=_preferences(source, spec.choice, seed), seed=seed).policy


def _preferences(source: Scenario, choice: str, seed: int) -> Preferences:
    if choice not in CHOICES or choice == "true":
        raise InputError(f"choice = {choice!r} is not learned")
    return _learned(source, choice.endswith("paper"), choice.startswith("single"), seed).preferences


def _details(test: Sequence[Instance], accepted: Ints, compensation: Floats, source: Scenario) -> Result:
    """What workers got beyond their burden, and which pairs of places were served."""
    shape = (source.settings.pickups, source.settings.dropoffs)
    asked, served = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    over = []
    for day, took, paid in zip(test, accepted, compensation, strict=True):
        worker = np.flatnonzero(took >= 0)
        request = took[worker]
        np.add.at(asked, (day.pickup, day.dropoff), 1)
        np.add.at(served, (day.pickup[request], day.dropoff[request]), 1)
        over.append(paid[worker] + day.utility[day.worker_group[worker], request])
    return {"over": np.round(np.concatenate(over), 6).tolist(), "asked": asked.tolist(), "taken": served.tolist()}


def _estimate(source: Scenario, split: Split, settings: dict[str, Any]) -> Result:
    """Errors of learned utilities on the test instances' requests, true less estimated, by group."""
    learned = _preferences(source, settings["choice"], int(settings["seed"]))
    error, means = _errors(source, split.test, learned)
    return {"error": error, **means}


def _errors(source: Scenario, test: Sequence[Instance], believed: Preferences) -> tuple[list[list[float]], Result]:
    told, where = _requests(source, test)
    groups = np.arange(source.settings.groups)[:, None]
    error = np.array(told["utility"]) - believed.utility_of(*where, groups)
    weight = np.array(told["count"], dtype=float)
    rmse = np.sqrt((error**2 * weight).sum(axis=1) / weight.sum())
    mbe = (error * weight).sum(axis=1) / weight.sum()
    return np.round(error, 6).tolist(), {"rmse": rmse.tolist(), "mbe": mbe.tolist()}


def _requests(source: Scenario, test: Sequence[Instance]) -> tuple[Result, tuple[Floats, Ints, Ints]]:
    """Return the kinds of requests that were seen, each once: type, places, utility by group, and how often."""
    batch = Batch.of(test)
    n = int(batch.request_start[-1])
    table = np.column_stack([batch.features[:n], batch.pickup[:n], batch.dropoff[:n]])
    _, first, count = np.unique(table, axis=0, return_index=True, return_counts=True)
    features, pickup, dropoff = batch.features[first], batch.pickup[first], batch.dropoff[first]
    m = source.settings.characteristics
    kind = np.abs(features[:, None, :m] - source.world.kinds[None]).sum(axis=2).argmin(axis=1)
    told = {
        "type": kind.tolist(),
        "pickup": pickup.tolist(),
        "dropoff": dropoff.tolist(),
        "count": count.tolist(),
        "utility": np.round(batch.utility[:, first], 9).tolist(),
    }
    return told, (features, pickup, dropoff)


def _perturbed(source: Scenario, split: Split, settings: dict[str, Any]) -> Result:
    """Reward of a policy that believes perturbed preferences, and how far these are off in the mean."""
    groups = settings.get("groups")
    # Directions of their own for each choice of groups: the same one for all would say the same thing three times.
    who = 0 if groups is None else 1 + sum(1 << group for group in groups)
    rng = np.random.default_rng(stream(int(settings["draw"]), Stream.BELIEFS, who))
    believed = perturb(true_preferences(source), settings["epsilon"], rng, groups=groups)
    # No validation: who believes what is wrong does not know it, and training is not to be refused for it.
    policy = train(split.train, settings["value"], choice=believed, seed=int(settings["seed"])).policy
    outcome = simulate(split.test, policy)
    _, means = _errors(source, split.test, believed)
    return {"reward": outcome.reward.tolist(), "served": outcome.served.tolist(), **means}


def _gap(source: Scenario, split: Split, settings: dict[str, Any]) -> Result:
    """The certified gap of the myopic and the charging policy, as :func:`optkit.gap.report.gap_report` finds it."""
    charging = scenario_charging(source)
    report = gap_report(
        split.test,
        {"Myopic, true MNL": PostDecisionPricing(), "Charging, true MNL": charging.policy},
        value=charging.value,
        foresight=charging.foresight,
        assumptions=charging.assumptions,
        known_process=True,
    )
    told = report.to_dict()
    for row in told["bounds"]:
        row.pop("seconds")
    return told


_WORK: dict[Kind, Callable[[Scenario, Split, dict[str, Any]], Result]] = {
    "bounds": _bounds,
    "utilities": _utilities,
    "policy": _policy,
    "estimate": _estimate,
    "perturbed": _perturbed,
    "gap": _gap,
}
