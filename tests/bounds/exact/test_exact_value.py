"""The exact value of small models: against brute force, by simulation, and by its certificate."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize

from optkit import simulate
from optkit.basics.errors import InputError, SolverError
from optkit.bounds import Bound, full_information
from optkit.bounds.bound import prove
from optkit.bounds.exact.exact_value import ExactSolution, exact_value, solve_exactly
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.exact.states import state_space
from optkit.models.pricing import optimal_prices
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.state import State

SCARCE = SmallModel(
    horizon=10, reward=[30.0, 45.0, 38.0], penalty=[-4.0, -10.0, -6.0], lifetime=[3, 2, 1],
    utility=[[-10.0, -18.0, -8.0], [-20.0, -9.0, -12.0]], mu=[2.0, 4.0], outside_utility=[0.0, 1.0], share=[0.4, 0.6],
    arrivals=[0.35, 0.25, 0.2], workers=[0.6, 0.4],
)  # fmt: skip
"""Three types of different lifetimes, two groups, more requests than workers: what the tests of structure take."""

CHOOSY = SmallModel(
    horizon=10, reward=[50.0, 45.0], penalty=[-4.0, -10.0], lifetime=[4, 4], utility=[[-5.0, -35.0], [-35.0, -10.0]],
    mu=[2.0, 4.0], outside_utility=[0.0, 1.0], share=[0.4, 0.6], arrivals=[0.3, 0.3], workers=[0.3, 0.7],
)  # fmt: skip
"""Each group dislikes one type: to wait for the other group's workers is worth some 5 % of the value."""


def profit_of_best_prices(value, utility, mu):
    """Expected profit and gradient by the definition of the logit model, maximised over c >= 0 by L-BFGS-B."""
    value, utility = np.array(value), np.array(utility)

    def loss(c):
        top = max(0.0, ((utility + c) / mu).max())
        weight = np.exp((utility + c) / mu - top)
        p = weight / (np.exp(-top) + weight.sum())
        profit = p @ (value - c)
        return -profit, -p * ((value - c - profit) / mu - 1.0)

    starts = (np.maximum(value - 1.5 * mu, 0.0), np.zeros(value.size))
    found = [
        minimize(loss, c, jac=True, bounds=[(0, None)] * value.size, options={"gtol": 1e-11, "ftol": 1e-15})
        for c in starts
    ]
    return -min(one.fun for one in found)


def brute_force(m, joint):
    """Solve a model request by request, from the definitions: no multisets, tables, or closed form."""
    K, T, D = len(m.reward), m.horizon, len(m.mu)

    @cache
    def after(step, waiting, queue):
        """Value of requests (type, last step) that wait after the decision of a step."""
        if step == T - 1:
            return 0.0
        t, total = step + 1, 0.0
        for (count, p), (joined, p_joined) in product(joint, enumerate(m.workers)):
            new = [(k, min(t + m.lifetime[k], T - 1)) for k in range(K) for _ in range(count[k])]
            present = tuple(sorted([*waiting, *new]))
            if queue + joined == 0:
                best = rest(t, present, 0)
            else:
                best = sum(m.share[d] * offer(t, present, min(queue + joined - 1, m.queue), d) for d in range(D))
            total += p * p_joined * best
        return total

    @cache
    def rest(t, present, queue):
        """Value after the decision, penalties of the step included."""
        lost = sum(m.penalty[k] for k, last in present if last == t)
        return lost + after(t, tuple(r for r in present if r[1] > t), queue)

    @cache
    def offer(t, present, queue, d):
        """Value with a worker of group d there."""
        stay = rest(t, present, queue)
        go = [m.reward[k] + rest(t, present[:i] + present[i + 1 :], queue) for i, (k, _) in enumerate(present)]
        if not go:
            return stay
        outside = m.outside_by_group[d]
        return stay + profit_of_best_prices(
            np.array(go) - stay, [m.utility[d, k] - outside for k, _ in present], m.mu[d]
        )

    return after(-1, (), 0), after


def independent(arrivals):
    """List what independent types can do in one step, with probabilities."""
    return [
        (count, float(np.prod([row[c] for row, c in zip(arrivals, count, strict=True)])))
        for count in product(*(range(len(row)) for row in arrivals))
    ]


def random_model(seed):
    """A model of one or two types in two or three steps, with everything else drawn; and its arrivals as a list."""
    rng = np.random.default_rng(seed)
    K, D, T = int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(2, 4))
    most = 2 if K == 1 else 1
    arrivals = rng.dirichlet(np.ones(most + 1), K)
    joint = independent(arrivals)
    dependent = rng.random() < 0.3
    if dependent:
        # Something always comes: what is left of a state after a decision need not be a state itself.
        joint = [(count, p) for (count, _), p in zip(joint[1:], rng.dirichlet(np.ones(len(joint) - 1)), strict=True)]
    model = SmallModel(
        horizon=T,
        reward=rng.uniform(5, 20, K),
        penalty=-rng.uniform(0, 5, K),
        lifetime=rng.integers(0, 3, K),
        utility=rng.uniform(-10, 3, (D, K)),  # some requests are liked without pay: c >= 0 binds
        mu=rng.uniform(0.5, 4, D),
        workers=rng.dirichlet(np.ones(3)),
        arrivals=None if dependent else arrivals,
        joint_arrivals=joint if dependent else None,
        outside_utility=rng.uniform(-2, 2, D),
        share=rng.dirichlet(np.ones(D)),
        queue=int(rng.integers(0, 3)),
    )
    return model, joint


@dataclass(frozen=True)
class ExactValueFunction:
    """The exact post-decision values, for a policy; ``queue`` (B, T) where the model has one."""

    solution: ExactSolution
    queue: np.ndarray | None = None

    def opportunity_cost(self, state: State) -> np.ndarray:
        """Look the waiting requests up, (b, w)."""
        length = 0 if self.queue is None else self.queue[state.instance, state.step]
        return self.solution.opportunity_cost(state.step, state.pickup, state.steps_left, state.offered, length)


@pytest.fixture(scope="module")
def scarce():
    """The exact value of the model that most tests look at, and its tables."""
    return exact_value(SCARCE)


@pytest.fixture(scope="module")
def tables():
    return solve_exactly(SCARCE)


def mean_and_error(x):
    return x.mean(), x.std(ddof=1) / np.sqrt(x.size)


def test_one_step_is_one_decision():
    """Two copies of one type and one of the other: the optimum of the three single requests, each with its noise."""
    model = SmallModel(
        horizon=1, reward=[20.0, 12.0], penalty=[-3.0, -1.0], lifetime=[5, 0], utility=[[-6.0, 1.0]], mu=[2.0],
        outside_utility=0.5, joint_arrivals=[((2, 1), 1.0)], workers=[0.3, 0.0, 0.7],
    )  # fmt: skip
    best = optimal_prices([23.0, 23.0, 13.0], [-6.0, -6.0, 1.0], 2.0, outside_utility=0.5).profit
    assert exact_value(model).value == pytest.approx(-7.0 + 0.7 * best, abs=1e-12)


def test_two_steps_by_hand():
    """One request that waits one step: the second step's optimum is the first step's opportunity cost."""
    model = SmallModel(
        horizon=2, reward=[20.0], penalty=[-3.0], lifetime=[1], utility=[[-6.0]], mu=[1.5],
        joint_arrivals=[((1,), 1.0)], workers=[0.5, 0.5],
    )  # fmt: skip

    def profit(values):
        return optimal_prices(values, np.full(len(values), -6.0), 1.5).profit

    one, two = (0.5 * profit([23.0] * n) - 3.0 * n for n in (1, 2))  # the second step's own request joins in
    value = two + 0.5 * profit([20.0 - (two - one)])
    solution = solve_exactly(model)
    assert solution.value == pytest.approx(value, abs=1e-11)  # rounded up by a few units in the last place of each sum
    assert solution.states == 3  # one open request; then one or two
    assert solution.post_decision_value(0, [0], [1]) == pytest.approx(two, abs=1e-11)
    assert solution.opportunity_cost(0, [[0]], [[1]]) == pytest.approx(two - one, abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_random_models_agree_with_brute_force(seed):
    """Values, post-decision values and opportunity costs; 1e-9 is what L-BFGS-B may leave."""
    model, joint = random_model(seed)
    value, after = brute_force(model, joint)
    solution = solve_exactly(model)
    assert solution.value == pytest.approx(value, abs=1e-9)
    steps_left = solution.space.kind[:, 1]
    for step, layer in enumerate(solution.space.layers):
        for row in layer.waiting[:6]:
            kinds = np.repeat(np.arange(row.size), row)
            types, left = solution.space.kind[kinds, 0], steps_left[kinds]
            for queue in range(model.queue + 1):
                requests = tuple(sorted(zip(types.tolist(), (step + left).tolist(), strict=True)))
                expected = after(step, requests, queue)
                assert solution.post_decision_value(step, types, left, queue=queue) == pytest.approx(expected, abs=1e-9)


def test_brute_force_sees_every_feature():
    """The random models between them have queues, dependent arrivals, two groups, and identical requests."""
    models = [random_model(seed)[0] for seed in range(15)]
    assert {m.queue for m in models} == {0, 1, 2}
    assert {m.mu.size for m in models} == {1, 2}
    assert {m.joint_arrivals is None for m in models} == {True, False}
    assert any(layer.count.max(initial=0) > 1 for m in models for layer in state_space(m).layers)


def test_opportunity_costs_are_differences_of_values():
    """Row by row, padding and requests without steps left being 0."""
    solution = solve_exactly(SCARCE)
    rng = np.random.default_rng(4)
    left = rng.integers(0, 3, (50, 3)) % (SCARCE.lifetime[[0, 1, 1]])
    types = np.broadcast_to([0, 1, 1], left.shape)
    left[:, 2] = np.where(left[:, 1] == left[:, 2], 0, left[:, 2])  # at most one request of a type comes in a step
    member = rng.random(left.shape) < 0.8
    cost = solution.opportunity_cost(4, types, left, member)
    value = solution.post_decision_value(4, types, left, member)
    assert cost.shape == left.shape
    for i in range(3):
        fewer = member & (np.arange(3) != i)
        assert value - solution.post_decision_value(4, types, left, fewer) == pytest.approx(cost[:, i], abs=1e-12)
    assert (cost[~member | (left == 0)] == 0).all()
    assert (cost != 0).sum() > 30
    nested = solution.opportunity_cost(4, types.reshape(5, 10, 3), left.reshape(5, 10, 3), member.reshape(5, 10, 3))
    assert (nested.reshape(50, 3) == cost).all()


@pytest.mark.slow
def test_the_optimal_policy_earns_the_exact_value_and_others_less():
    """500 instances through the simulator: the mean within 4 standard errors; paired losses beyond 4 of theirs."""
    solution = solve_exactly(CHOOSY)
    days = CHOOSY.sample(500, seed=1)
    best = simulate(days, PostDecisionPricing(value_function=ExactValueFunction(solution))).reward
    mean, error = mean_and_error(best)
    assert abs(mean - solution.value) <= 4 * error
    for worse in (PostDecisionPricing(), RewardPercentage(0.5)):
        reward = simulate(days, worse).reward
        loss, loss_error = mean_and_error(best - reward)
        assert loss > 4 * loss_error
        assert solution.value - reward.mean() > 4 * error, "the test could not tell these policies from the best"


@pytest.mark.slow
@pytest.mark.parametrize("queue", [1, 3])
def test_with_a_queue_the_policy_that_sees_it_earns_the_exact_value(queue):
    """Workers come in pairs or not at all and wait in optkit's own queue; 4 standard errors over 500 instances."""
    model = replace(CHOOSY, workers=np.array([0.75, 0.0, 0.25]), queue=queue)
    draws = [model.draw(child) for child in np.random.SeedSequence(2).spawn(500)]
    solution = solve_exactly(model)
    policy = PostDecisionPricing(value_function=ExactValueFunction(solution, np.array([draw.queue for draw in draws])))
    mean, error = mean_and_error(simulate([draw.instance for draw in draws], policy).reward)
    assert abs(mean - solution.value) <= 4 * error
    without = solve_exactly(replace(model, queue=0)).value  # the second of a pair leaves
    assert solution.value - without > 10 * error, "the test could not tell the queue from none"


@pytest.mark.slow
@pytest.mark.parametrize("queue", [0, 2])
def test_full_information_is_worth_more(queue):
    """The mean full-information bound over 150 instances lies above the exact value by 4 standard errors."""
    model = replace(SCARCE, workers=np.array([0.6, 0.2, 0.2]), queue=queue)
    mean, error = mean_and_error(np.array([full_information(day).value for day in model.sample(150, seed=3)]))
    assert mean - 4 * error > exact_value(model).value


def test_independent_types_are_a_special_case_of_joint_arrivals():
    """The same distribution given as a list of combinations, one of them split in two."""
    joint = independent([[0.65, 0.35], [0.75, 0.25], [0.8, 0.2]])
    joint = [(joint[0][0], 0.5 * joint[0][1]), *joint[1:], (joint[0][0], 0.5 * joint[0][1])]
    same = replace(SCARCE, arrivals=None, joint_arrivals=joint)
    assert exact_value(same).value == pytest.approx(exact_value(SCARCE).value, rel=1e-12)
    assert exact_value(replace(same, horizon=1), limit=8).solver.details["states"] == 8


def test_two_types_alike_are_one_type_that_comes_more_often():
    """Requests that agree in everything but their type's number are priced as alternatives of their own."""
    alike = SmallModel(
        horizon=5, reward=[30.0] * 2, penalty=[-5.0] * 2, lifetime=[2] * 2, utility=[[-12.0] * 2], mu=[2.0],
        workers=[0.5, 0.5], arrivals=[0.3, 0.4],
    )  # fmt: skip
    merged = SmallModel(
        horizon=5, reward=[30.0], penalty=[-5.0], lifetime=[2], utility=[[-12.0]], mu=[2.0], workers=[0.5, 0.5],
        arrivals=[[0.42, 0.46, 0.12]],
    )  # fmt: skip
    assert exact_value(merged).value == pytest.approx(exact_value(alike).value, rel=1e-12)
    assert exact_value(merged).solver.details["states"] < exact_value(alike).solver.details["states"]


def test_without_workers_all_penalties_are_paid_and_without_requests_nothing():
    nobody = exact_value(replace(SCARCE, workers=np.array([1.0]))).value
    assert nobody == pytest.approx(10 * (0.35 * -4 + 0.25 * -10 + 0.2 * -6), abs=1e-10)
    assert exact_value(replace(SCARCE, arrivals=[0.0, 0.0, 0.0])).value == 0.0


@pytest.mark.slow
def test_more_workers_or_a_longer_queue_are_worth_more():
    """Limit cases and monotonicity: who may wait is of use only if workers come in groups."""
    values = [exact_value(replace(SCARCE, workers=np.array([1 - p, 0.0, p]), queue=2)).value for p in (0.2, 0.5, 0.8)]
    assert values == sorted(values)
    values = [exact_value(replace(SCARCE, workers=np.array([0.8, 0.0, 0.2]), queue=q)).value for q in (0, 1, 2, 9, 10)]
    assert values[:4] == sorted(values[:4])
    assert values[4] == pytest.approx(values[3], abs=1e-9)  # in 10 steps at most 9 wait who will still be seen
    single = [exact_value(replace(SCARCE, queue=q)).value for q in (0, 3)]
    assert single[1] == pytest.approx(single[0], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("queue", [0, 2])
def test_the_certificate_proves_the_value_from_both_sides(queue):
    """The bound is the value itself; the policy in the tables earns it up to rounding of some hundred money."""
    model = replace(SCARCE, queue=queue, workers=np.array([0.6, 0.2, 0.2]))
    bound = exact_value(model)
    assert isinstance(bound, Bound)
    assert (bound.kind, bound.solver.status) == ("exact", "certified")
    verdict = prove(bound, model)
    assert verdict.bound == bound.value
    assert verdict.residual == 0
    assert 0 <= verdict.gap <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("mu", [1e-6, 1.0, 1e3])
def test_the_certificate_holds_for_any_money_and_any_noise(scale, mu):
    model = replace(
        SCARCE, horizon=4, reward=scale * SCARCE.reward, penalty=scale * SCARCE.penalty,
        utility=scale * SCARCE.utility, mu=np.array([mu, 2 * mu]),
    )  # fmt: skip
    bound = exact_value(model)
    verdict = prove(bound, model)
    assert 0 <= verdict.gap <= 1e-11 * (50 * scale + mu) * 4  # rounding of the money in play


def lowered(certificate, name, step, where, by):
    tables = [np.array(table) for table in getattr(certificate, name)]
    tables[step][where] -= by
    return replace(certificate, **{name: tuple(tables)})


@pytest.mark.slow
@pytest.mark.parametrize("by", [1e-6, 0.1, 50.0])
def test_a_lowered_profit_proves_no_less(scarce, by):
    """A bound on one decision's profit that is too small fails its dual, and is raised until it does not."""
    forged = lowered(scarce.certificate, "profit", 4, (17, 0, 1), by)
    assert forged.check(SCARCE).bound >= scarce.value + 0.3 * by
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(scarce, certificate=forged, value=scarce.value - by), SCARCE)


@pytest.mark.slow
@pytest.mark.parametrize("by", [1e-3, 0.1, 50.0, -50.0])
@pytest.mark.parametrize("where", [0, 5, slice(None)])
def test_changed_values_never_prove_less_than_the_truth(scarce, by, where):
    forged = lowered(scarce.certificate, "value", 4, where, by)
    verdict = forged.check(SCARCE)
    assert verdict.bound >= scarce.value - 1e-9
    assert verdict.attained <= scarce.value + 1e-9
    with pytest.raises(SolverError, match="claimed"):
        prove(replace(scarce, certificate=forged, value=scarce.value - 1e-3), SCARCE)


def test_tables_that_are_all_too_low_prove_the_truth(scarce):
    """Lowered by the same amount up to a step, they agree with each other, and fall short at the step that follows."""
    value = tuple(table - 50.0 * (step <= 4) for step, table in enumerate(scarce.certificate.value))
    verdict = replace(scarce.certificate, value=value).check(SCARCE)
    assert verdict.bound == pytest.approx(scarce.value, abs=1e-9)  # rounding of sums of some hundred money
    assert verdict.attained == pytest.approx(scarce.value, abs=1e-9)


def test_looser_tables_are_a_looser_bound(scarce):
    """Profits that are too high, with values to match, still prove what they say."""
    certificate = scarce.certificate
    steps = np.arange(SCARCE.horizon)[::-1]
    loose = replace(
        certificate,
        profit=tuple(table + 1.0 for table in certificate.profit),
        value=tuple(table + float(left) for table, left in zip(certificate.value, steps, strict=True)),
    )
    verdict = loose.check(SCARCE)
    assert verdict.bound == pytest.approx(scarce.value + 0.4 * SCARCE.horizon, abs=6.1)
    assert scarce.value < verdict.bound < np.inf
    assert verdict.attained < scarce.value


def test_tables_of_another_model_and_tables_with_nan_are_refused(scarce):
    certificate = scarce.certificate
    for other in (replace(SCARCE, lifetime=[3, 3, 3]), replace(SCARCE, horizon=9), replace(SCARCE, queue=1)):
        with pytest.raises(InputError, match=r"another model's"):
            certificate.check(other)
    with pytest.raises(InputError, match="NaN"):
        lowered(certificate, "value", 3, 0, np.nan).check(SCARCE)


def test_the_limit_is_passed_on():
    """The message counts, names the limit and says what to change; the record counts the states."""
    states = exact_value(SCARCE).solver.details["states"]
    assert solve_exactly(SCARCE, limit=states).states == states
    with pytest.raises(InputError, match=f"more than {states - 1} states .* shorter-lived types, .* raise limit="):
        exact_value(SCARCE, limit=states - 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((10, [0], [1]), "step = 10"),
        ((-1, [0], [1]), "step = -1"),
        ((4, [3], [1]), "no request of type 3 has 1 steps left"),
        ((4, [-1], [1]), "no request of type -1"),
        ((4, [0], [4]), "no request of type 0 has 4 steps left"),
        ((4, [0], [99]), "has 99 steps left"),
        ((9, [0], [1]), "1 of type 0 with 1 left"),
        ((4, [0, 0], [1, 1]), "can wait after step 4: 2 of type 0 with 1 left"),
        ((4, [0] * 300, [1] * 300), "300 of type 0"),
        ((4, [0], [1], None, 1), r"queue has lengths outside 0..0"),
        ((4, [0.5], [1]), r"request_type\[0\] = 0.5 is not a whole number"),
        ((4, [0, 1], [1, 1, 1]), "do not fit"),
        ((4, 0, 1), "do not fit"),
        ((4, [[0], [0]], [1], None, [0, 0, 0]), "do not fit"),
    ],
)
def test_a_set_that_cannot_wait_is_refused_in_one_line(tables, arguments, message):
    for function in (tables.post_decision_value, tables.opportunity_cost):
        with pytest.raises(InputError, match=message) as caught:
            function(*arguments)
        assert "\n" not in str(caught.value)


def test_nothing_waiting_has_a_value_and_no_costs():
    solution = solve_exactly(SCARCE)
    empty = solution.post_decision_value(4, [], [])
    assert empty == solution.post_decision_value(4, [0], [1], [False])
    assert empty == solution.certificate.value[4][0, 0]  # no requests: the first row in the order of bytes
    assert solution.opportunity_cost(4, np.zeros((2, 0), int), np.zeros((2, 0), int)).shape == (2, 0)
    assert solution.post_decision_value(9, [], []) == 0.0
