"""Policies, the exact value and the bounds in order, on small models: by enumeration, and by simulation."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from optkit import Instance
from optkit.bounds import full_information
from optkit.bounds.arrival.dual import arrival_dual
from optkit.bounds.arrival.exact import arrival_exact
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.policy_value import policy_value
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.exact.exact_value import ExactSolution, solve_exactly
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.exact.table import ExactTable
from optkit.bounds.penalised.charges import KeptCharges
from optkit.bounds.penalised.foresight import Foresight, join_requests
from optkit.bounds.penalised.penalized import idle_steps, penalized, penalized_program
from optkit.learning.training import train
from optkit.models.pricing import optimal_prices
from optkit.models.value.request_sets import RequestSets, ZeroSetValue


def random_model(seed: int, horizon: int | None = None, kinds: int | None = None) -> SmallModel:
    """One or two types, one to three groups of workers with their own scales; some requests are liked without pay."""
    rng = np.random.default_rng(seed)
    K, D = kinds or int(rng.integers(1, 3)), int(rng.integers(1, 4))
    return SmallModel(
        horizon=horizon or int(rng.integers(2, 6)),
        reward=rng.uniform(5, 40, K),
        penalty=-rng.uniform(0, 8, K),
        lifetime=rng.integers(0, 4, K),
        utility=rng.uniform(-25, 5, (D, K)),
        mu=rng.uniform(0.5, 6, D),
        workers=rng.dirichlet(np.ones(2)),
        arrivals=rng.dirichlet(np.ones(3 if K == 1 else 2), K),
        outside_utility=rng.uniform(-3, 3, D),
        share=rng.dirichlet(np.ones(D)),
    )


@cache
def solved(seed: int, horizon: int | None = None, kinds: int | None = None) -> ExactSolution:
    return solve_exactly(random_model(seed, horizon, kinds))


def arrivals_of(model):
    """All that may arrive in a step: numbers by type, and probabilities."""
    found = [(np.zeros(model.reward.size, int), 1.0)]
    for stream in model.streams:
        found = [
            (count + more, p * q)
            for count, p in found
            for more, q in zip(stream.count, stream.probability, strict=True)
        ]
    return found


def path_of(model, counts, groups):
    """The instance in which these requests arrive and workers of these groups come, -1 for none, step by step."""
    kind = np.array([k for count in counts for k, number in enumerate(count) for _ in range(number)], int)
    arrival = np.repeat(np.arange(len(counts)), [int(count.sum()) for count in counts])
    seen = np.flatnonzero(np.array(groups) >= 0)
    return Instance(
        horizon=model.horizon, arrival=arrival, expiry=np.minimum(arrival + model.lifetime[kind], model.horizon - 1),
        reward=model.reward[kind], penalty=model.penalty[kind], features=model.features[kind], pickup=kind,
        dropoff=0 * kind, worker_step=seen, worker_group=np.array(groups)[seen], utility=model.utility[:, kind],
        mu=model.mu, outside_utility=model.outside_utility,
    )  # fmt: skip


def foresight_of(model):
    """The model's own distribution: a pool of all that may arrive, in which the same arrives at every step."""
    nobody = [-1] * model.horizon
    pool = [path_of(model, [count] * model.horizon, nobody) for count, _ in arrivals_of(model)]
    return Foresight(1.0 - model.workers[:1], model.share, pool, weight=[p for _, p in arrivals_of(model)])


def all_paths(model):
    """Every instance that may be drawn, with its probability."""
    workers = [(-1, model.workers[0]), *((d, (1.0 - model.workers[0]) * p) for d, p in enumerate(model.share))]
    for path in product(product(arrivals_of(model), workers), repeat=model.horizon):
        counts, groups = [arrived[0] for arrived, _ in path], [worker[0] for _, worker in path]
        yield path_of(model, counts, groups), float(np.prod([a[1] * w[1] for a, w in path]))


class RandomValue:
    """Any numbers: by type and steps left, and for each pair that waits."""

    def __init__(self, seed, kinds):
        rng = np.random.default_rng(seed)
        self.by_kind, self.pair = rng.normal(0, 8, (kinds, 8)), rng.normal(0, 2)

    def value(self, sets):
        """Sum over members and pairs, (b,)."""
        count = sets.member.sum(axis=1)
        return np.where(sets.member, self._worth(sets), 0.0).sum(axis=1) + self.pair * count * (count - 1) / 2

    def opportunity_cost(self, sets):
        """Differences, (b, w)."""
        others = sets.member.sum(axis=1, keepdims=True) - 1
        return np.where(sets.member, self._worth(sets) + self.pair * others, 0.0)

    def _worth(self, sets):
        return self.by_kind[sets.requests.pickup[sets.index], np.clip(sets.steps_left, 0, 7).astype(int)]


def priced_by(value, day):
    """Optimal prices for the opportunity costs of a value function, by the definition of Lemma 1."""
    table = join_requests([day])

    def offer(step, worker, requests, open_):
        left = day.expiry[requests] > step
        sets = RequestSets(table, step, np.broadcast_to(requests, open_.shape), open_ & left)
        worth = day.reward[requests] - np.where(left, 0.0, day.penalty[requests]) - value.opportunity_cost(sets)
        group = day.worker_group[worker]
        utility = np.broadcast_to(table.utility[group, requests], open_.shape)
        return optimal_prices(worth, utility, day.mu[group], offered=open_).compensation

    return offer


def half_of_rewards(day):
    return lambda step, worker, requests, open_: np.broadcast_to(0.5 * day.reward[requests], open_.shape)


def lattice(day):
    n = day.n_requests
    return SubsetProgram(day, stages(day), np.zeros(n), np.ones(n, bool))


def charged_values(bound, offers):
    """What policies earn on the bound's instance, less its own charges: their means are those of the policies."""
    proof = bound.certificate
    program, charges = (
        penalized_program(proof.charges.instance, proof.tracked, proof.multipliers),
        KeptCharges.of(proof.charges),
    )
    return [policy_value(program, offer, charges) - charges.idle(idle_steps(program)) for offer in offers]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(36))
def test_with_the_exact_value_function_every_path_is_worth_the_exact_value(seed):
    """Two drawn paths of each model. 1e-8 covers sums of some hundred money; 1e-11 is what is seen."""
    solution = solved(seed)
    value, foresight = ExactTable(solution), foresight_of(solution.model)
    for day in solution.model.sample(2, seed=seed):
        bound = penalized(day, value, foresight)
        assert bound.value == pytest.approx(solution.value, abs=1e-8)
        assert abs(bound.certificate.check(day).gap) <= 1e-8


@pytest.mark.slow
def test_the_models_differ():
    """Between them they have what may go wrong: groups, several requests at once, days of all lengths."""
    models = [solved(seed).model for seed in range(36)]
    assert {m.mu.size for m in models} == {1, 2, 3}
    assert {m.reward.size for m in models} == {1, 2}
    assert {m.horizon for m in models} == {2, 3, 4, 5}
    assert any((m.lifetime == 0).any() for m in models)


def small_enough(seed):
    """A model whose paths can all be listed: 64 of three steps, or 144 of two with two types and two groups."""
    rng = np.random.default_rng(seed)
    K, D, T = (1, 1, 3) if seed % 2 else (2, 2, 2)
    return SmallModel(
        horizon=T, reward=rng.uniform(20, 40, K), penalty=-rng.uniform(0, 8, K), lifetime=rng.integers(1, 3, K),
        utility=rng.uniform(-25, 5, (D, K)), mu=rng.uniform(0.5, 6, D), workers=rng.dirichlet([4, 6]),
        arrivals=rng.uniform(0.3, 0.8, K), outside_utility=rng.uniform(-3, 3, D), share=rng.dirichlet([3] * D),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_the_chain_by_enumeration_of_all_paths(seed):
    """Means over all paths, without any simulation: policies <= exact <= penalised, arrival information <= dual."""
    model = small_enough(seed)
    solution, foresight = solve_exactly(model), foresight_of(model)
    exact, other, free = ExactTable(solution), RandomValue(seed, model.reward.size), ZeroSetValue()
    mean, total = (
        dict.fromkeys(("optimal", "myopic", "random", "half", "zero V", "random V", "arrivals", "dual"), 0.0),
        0,
    )
    for day, p in all_paths(model):
        program = lattice(day)
        mean["optimal"] += p * policy_value(program, priced_by(exact, day))
        mean["myopic"] += p * policy_value(program, priced_by(free, day))
        mean["random"] += p * policy_value(program, priced_by(other, day))
        mean["half"] += p * policy_value(program, half_of_rewards(day))
        mean["zero V"] += p * penalized(day, free, foresight).value
        mean["random V"] += p * penalized(day, other, foresight).value
        mean["arrivals"] += p * arrival_exact(day).value
        mean["dual"] += p * arrival_dual(day).value
        total += p
    assert total == pytest.approx(1.0, abs=1e-12)
    assert mean["optimal"] == pytest.approx(solution.value, abs=1e-9)
    for policy in ("myopic", "random", "half"):
        assert mean[policy] <= solution.value + 1e-9
    assert min(solution.value - mean[policy] for policy in ("random", "half")) > 1e-3
    for bound in ("zero V", "random V", "arrivals"):
        assert mean[bound] >= solution.value - 1e-9
    if model.horizon > 2:  # of two steps, the last knows its value
        assert mean["random V"] > solution.value + 1e-3
    # The dual is optimal to 1e-9 of the gain.
    assert mean["dual"] >= mean["arrivals"] - 1e-6


def mean_and_error(x):
    x = np.asarray(x)
    return x.mean(), x.std(ddof=1) / np.sqrt(x.size) + 1e-9  # some models leave nothing but rounding


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 106))
def test_the_chain_by_simulation(seed):
    """Six more models, 20 instances of each: on each path where it must hold, else within 4 standard errors."""
    solution = solved(seed)
    model, foresight = solution.model, foresight_of(solution.model)
    exact, other, free = ExactTable(solution), RandomValue(seed, model.reward.size), ZeroSetValue()
    best, arrivals, full = [], [], []
    for day in model.sample(20, seed=seed):
        optimal = priced_by(exact, day)
        for value in (free, other):
            bound = penalized(day, value, foresight)
            earned = charged_values(bound, [optimal, priced_by(other, day), half_of_rewards(day)])
            best.append(earned[0])
            assert bound.value >= max(earned) - 1e-9
        arrivals.append(arrival_exact(day).value)
        assert arrivals[-1] >= policy_value(lattice(day), optimal) - 1e-9
        full.append(np.mean([full_information(day.with_noise(draw)).value for draw in range(5)]))
    for charged in (best[::2], best[1::2]):
        mean, error = mean_and_error(charged)
        assert abs(mean - solution.value) <= 4 * error
    for more in (np.array(full) - arrivals, np.array(arrivals) - solution.value):
        mean, error = mean_and_error(more)
        assert mean >= -4 * error


@pytest.fixture(scope="module")
def choosy():
    """A model in which waiting for the right worker pays, and value functions trained on it, and random."""
    model = SmallModel(
        horizon=6, reward=[50.0, 45.0], penalty=[-4.0, -10.0], lifetime=[4, 4], utility=[[-5.0, -35.0], [-35.0, -10.0]],
        mu=[2.0, 4.0], outside_utility=[0.0, 1.0], share=[0.4, 0.6], arrivals=[0.3, 0.3], workers=[0.4, 0.6],
    )  # fmt: skip
    trained = train(model.sample(150, seed=1), choice="true")
    return solve_exactly(model), trained.value, [RandomValue(seed, 2) for seed in range(2)]


@pytest.mark.slow
def test_a_trained_value_function_charges_better_than_random_ones(choosy):
    """On 25 fresh instances, by what the bounds have above the optimal policy under the same charges.

    It leaves less than any other, and than no charges at all, by 4 standard errors of the difference.
    """
    solution, trained, others = choosy
    foresight, exact = foresight_of(solution.model), ExactTable(solution)
    gaps = np.zeros((4, 25))
    for k, day in enumerate(solution.model.sample(25, seed=2)):
        optimal = priced_by(exact, day)
        gaps[-1, k] = arrival_exact(day).value - policy_value(lattice(day), optimal)
        for row, value in enumerate([trained, *others]):
            bound = penalized(day, value, foresight)
            gaps[row, k] = bound.value - charged_values(bound, [optimal])[0]
    assert (gaps >= -1e-9).all()
    for worse in gaps[1:]:
        mean, error = mean_and_error(worse - gaps[0])
        assert mean > 4 * error
