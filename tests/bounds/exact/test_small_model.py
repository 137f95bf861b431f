"""The small explicit model: what it accepts, what it samples, and which states it can reach."""

import tracemalloc
from collections import deque
from itertools import product

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.bounds.exact import small_model, states
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.exact.states import find, state_space
from optkit.instances.instance import fifo_queue

TWO_TYPES = {
    "horizon": 4,
    "reward": [30.0, 50.0],
    "penalty": [-5.0, -8.0],
    "lifetime": [1, 2],
    "utility": [[-10.0, -12.0], [-14.0, -9.0]],
    "mu": [1.0, 2.0],
    "arrivals": [0.5, 0.2],
    "workers": [0.5, 0.3, 0.2],
    "share": [0.25, 0.75],
}


def two_types(**changes):
    return SmallModel(**{**TWO_TYPES, **changes})


def reachable(model, outcomes):
    """Open requests before each decision, as sets of sorted tuples of (type, expiry): one by one, without the kit."""
    T, open_sets = model.horizon, []
    waiting = {()}
    for t in range(T):
        new = [[(k, min(t + model.lifetime[k], T - 1)) for k in range(len(c)) for _ in range(c[k])] for c in outcomes]
        open_sets.append({tuple(sorted([*old, *some])) for old in waiting for some in new})
        after = open_sets[-1] | {one[:i] + one[i + 1 :] for one in open_sets[-1] for i in range(len(one))}
        waiting = {tuple(r for r in one if r[1] > t) for one in after}
    return open_sets


CASES = {
    "independent": ({}, list(product((0, 1), (0, 1)))),
    "several at once": ({"arrivals": [[0.5, 0.3, 0.2], [0.1, 0.9, 0.0]]}, list(product((0, 1, 2), (0, 1)))),
    "always one, of either type": (
        {"arrivals": None, "joint_arrivals": [((1, 0), 0.5), ((0, 1), 0.5)]}, [(1, 0), (0, 1)],
    ),
    "one type never comes": ({"arrivals": [0.3, 0.0]}, [(0, 0), (1, 0)]),
    "lives beyond the horizon": ({"lifetime": [9, 0]}, list(product((0, 1), (0, 1)))),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_states_are_those_that_can_be_reached(case):
    """Step by step the model lists the multisets that enumerating single requests gives, times the queue's lengths."""
    changes, outcomes = CASES[case]
    model = two_types(queue=2, horizon=5, **changes)
    space = state_space(model)
    sets = reachable(model, outcomes)
    assert space.size == 3 * sum(len(step) for step in sets)
    for t, (layer, step) in enumerate(zip(space.layers, sets, strict=True)):
        listed = {
            tuple(
                sorted(
                    (int(space.kind[m, 0]), t + int(space.kind[m, 1]))
                    for m, n in zip(kinds, count, strict=True)
                    for _ in range(n)
                )
            )
            for kinds, count in zip(layer.kind, layer.count, strict=True)
        }
        assert listed == step


def test_the_states_of_a_step_lead_to_what_waits():
    """Serving a request takes it away, and what has no steps left goes as well."""
    space = state_space(two_types(arrivals=[[0.5, 0.3, 0.2], [0.6, 0.4, 0.0]], horizon=6))
    left = space.kind[:, 1]
    for layer in space.layers:
        rows = np.zeros((len(layer.after), len(left)), dtype=int)
        np.add.at(rows, (np.arange(len(rows))[:, None], layer.kind), layer.count)
        assert (layer.waiting[layer.after] == rows * (left > 0)).all()
        state, slot = np.nonzero(layer.count)
        served = rows[state]
        served[np.arange(state.size), layer.kind[state, slot]] -= 1
        assert (layer.waiting[layer.after_serving[state, slot]] == served * (left > 0)).all()
        assert (np.where(layer.count == 0, layer.after_serving - layer.after[:, None], 0) == 0).all()
    assert space.layers[2] is space.layers[3], "in the middle of the horizon the states do not change"


def test_a_row_that_is_not_listed_is_not_found():
    """Also one with more requests than the numbers of the table can hold."""
    rows = np.array([[0, 1], [3, 0]], dtype=np.uint8)
    assert find(rows, np.array([[3, 0], [0, 1], [0, 257], [3, 3]])).tolist() == [1, 0, -1, -1]


def test_too_many_states_are_refused_by_number_limit_and_cause():
    said = (
        "more than 20 states by step 1 of 4, with up to 2 arrivals a step, 5 kinds of request.*3 lengths.*raise limit="
    )
    with pytest.raises(InputError, match=said):
        state_space(two_types(queue=2), limit=20)
    exact = state_space(two_types(queue=2)).size
    assert state_space(two_types(queue=2), limit=exact).size == exact
    with pytest.raises(InputError, match=f"more than {exact - 1} states"):
        state_space(two_types(queue=2), limit=exact - 1)


def test_a_huge_model_is_refused_before_it_fills_the_memory():
    """4^240 states: the list stops as soon as one step has more than the limit."""
    many = 20
    model = SmallModel(
        horizon=50, reward=np.ones(many), penalty=np.zeros(many), lifetime=np.full(many, 11),
        utility=np.zeros((1, many)), mu=[1.0], workers=[0.5, 0.5], arrivals=np.full((many, 4), 0.25),
    )  # fmt: skip
    with pytest.raises(InputError, match="240 kinds"):
        state_space(model)


@pytest.mark.parametrize("lifetime", [300, 3_000, 30_000])
def test_long_lifetimes_make_wide_states_that_are_refused_by_their_bytes(monkeypatch, lifetime):
    """Few states, but each a number for every step that a request may wait: that is counted, before it is there."""
    monkeypatch.setattr(states, "BYTES", 1_000_000)
    model = SmallModel(
        horizon=lifetime, reward=[30.0], penalty=[-5.0], lifetime=[lifetime], utility=[[-10.0]], mu=[1.0],
        arrivals=[0.5], workers=[0.5, 0.5],
    )  # fmt: skip
    tracemalloc.start()
    with pytest.raises(InputError, match="with a number for each kind, take more than"):
        state_space(model, limit=100_000)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20 * states.BYTES


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"arrivals": [[0.5, 0.4], [0.5, 0.5]]}, r"arrivals\[0\] adds up to 0.9"),
        ({"arrivals": [0.5, 1.2]}, r"arrivals\[1\] = 1.2 is no probability"),
        ({"arrivals": [0.5]}, r"arrivals has shape \(1,\)"),
        ({"arrivals": [[0.5, 0.5], [1.0]]}, "arrivals is ragged"),
        ({"arrivals": [[1.5, -0.5], [0.5, 0.5]]}, r"arrivals\[0\]\[1\] = -0.5 is a negative"),
        ({"arrivals": None}, "either arrivals"),
        ({"joint_arrivals": [((0, 0), 1.0)]}, "not both"),
        ({"arrivals": None, "joint_arrivals": [((0, 0), 0.5)]}, "joint_arrivals adds up to 0.5"),
        ({"arrivals": None, "joint_arrivals": []}, "joint_arrivals adds up to 0"),
        ({"arrivals": None, "joint_arrivals": [(0, 0), 1.0]}, "joint_arrivals"),
        ({"arrivals": None, "joint_arrivals": 3}, "no list of pairs"),
        ({"arrivals": None, "joint_arrivals": [((0, -1), 1.0)]}, r"joint_arrivals\[0\] = \[0.0, -1.0\]"),
        ({"arrivals": None, "joint_arrivals": [((0, 0.5), 1.0)]}, "not whole numbers"),
        ({"arrivals": None, "joint_arrivals": [((1,), 1.0)]}, r"joint_arrivals\[0\] has shape \(1,\)"),
        ({"workers": [0.5, 0.4]}, "workers adds up to 0.9"),
        ({"workers": [1.5, -0.5]}, r"workers\[1\] = -0.5 is a negative"),
        ({"workers": 0.5}, "workers has shape"),
        ({"share": [0.5, 0.6]}, "share adds up to 1.1"),
        ({"share": [1.0]}, r"share has shape \(1,\)"),
        ({"mu": [1.0, -2.0]}, r"mu\[1\] = -2 is not positive"),
        ({"mu": []}, r"mu has shape \(0,\)"),
        ({"penalty": [-5.0, 5.0]}, r"penalty\[1\] = 5 is positive"),
        ({"penalty": [-5.0]}, r"penalty has shape \(1,\)"),
        ({"reward": [30.0, float("nan")]}, r"reward\[1\] is nan"),
        ({"reward": "much"}, "reward holds text"),
        ({"lifetime": [1, -1]}, r"lifetime\[1\] = -1 is negative"),
        ({"lifetime": [1, 1.5]}, r"lifetime\[1\] = 1.5 is no whole number"),
        ({"utility": [[-10.0, -12.0]]}, r"utility has shape \(1, 2\); it needs \(2, 2\)"),
        ({"outside_utility": [0.0, 0.0, 0.0]}, r"outside_utility has shape \(3,\)"),
        ({"features": [[1.0]]}, r"features has shape \(1, 1\)"),
        ({"horizon": 0}, "horizon = 0"),
        ({"horizon": 2.5}, "horizon = 2.5 is not a whole number"),
        ({"queue": -1}, "queue = -1 is not a whole number of at least 0"),
    ],
)
def test_bad_input_is_refused_in_one_line(changes, message):
    with pytest.raises(InputError, match=message) as caught:
        two_types(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1, 0), "count = -1"),
        ((1, -3), "seed = -3"),
        ((1, 0.5), "seed"),
        ((10**12, 1), "1,000,000,000,000 instances of this model would take about .* GiB of memory"),
    ],
)
def test_a_sample_needs_a_count_and_a_seed(arguments, message):
    with pytest.raises(InputError, match=message):
        two_types().sample(*arguments)


@pytest.mark.slow
def test_a_sample_takes_about_the_memory_that_is_estimated(monkeypatch):
    """What is refused would not have fitted, and what fits is not refused: within a factor of three."""
    asked = []
    monkeypatch.setattr(small_model, "check_memory", lambda what, needed, remedy: asked.append(needed))
    for changes in ({}, {"horizon": 200, "lifetime": [2, 40]}):
        model, count = two_types(**changes), 40
        model.sample(2, seed=0)
        tracemalloc.start()
        kept = model.sample(count, seed=0)
        taken, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(kept) == count
        assert taken / 3 < asked[-1] < 3 * taken
    model.sample(0, seed=0)
    assert asked[-1] == 0.0


def test_a_sample_is_the_same_for_the_same_seed_and_grows_at_its_end():
    model = two_types()
    few, many = model.sample(3, seed=5), model.sample(6, seed=5)
    assert many[:3] == few
    assert few[0] != few[1]
    sequence = np.random.SeedSequence(5)
    assert model.sample(3, sequence) == model.sample(3, sequence) == few


def test_an_instance_has_the_money_of_its_types():
    model = two_types(horizon=30, outside_utility=[1.0, -2.0], features=[[0.1, 2.0], [0.3, 4.0]])
    day = model.sample(1, seed=1)[0]
    kind = day.pickup
    assert set(kind) == {0, 1}
    for name in ("reward", "penalty", "features"):
        assert (getattr(day, name) == getattr(model, name)[kind]).all()
    assert (day.utility == model.utility[:, kind]).all()
    assert (day.mu == model.mu).all()
    assert (day.outside_by_group == model.outside_by_group).all()
    assert (day.expiry == np.minimum(day.arrival + model.lifetime[kind], 29)).all()
    assert day.noise.shape == (day.n_workers, day.n_requests)
    indicators = two_types(horizon=30).sample(1, seed=1)[0].features
    assert (indicators == np.eye(2)[kind]).all()


def test_a_sample_has_the_probabilities_of_the_model():
    """Dependent arrivals, groups and the worker's presence: within 4.5 standard errors, some 10 comparisons."""
    joint = [((0, 0), 0.2), ((2, 1), 0.3), ((0, 1), 0.5)]
    model = two_types(horizon=40, arrivals=None, joint_arrivals=joint)
    days = model.sample(300, seed=2)
    steps = 40 * len(days)
    at = np.array([[np.bincount(day.arrival[day.pickup == k], minlength=40) for k in (0, 1)] for day in days])
    seen = np.zeros((len(days), 40), bool)
    for b, day in enumerate(days):
        seen[b, day.worker_step] = True

    def close(observed, probability, n):
        return abs(observed - probability) <= 4.5 * np.sqrt(probability * (1 - probability) / n)

    for (a, b), p in joint:
        assert close(np.mean((at[:, 0] == a) & (at[:, 1] == b)), p, steps)
    assert close(seen.mean(), 0.5, steps)
    together = (seen[:, 1:] & seen[:, :-1]).mean()  # independent: with queue=0 nobody is left from the step before
    assert close(together, 0.25, steps / 2)  # neighbours overlap, hence half the sample
    groups = np.concatenate([day.worker_group for day in days])
    assert close(groups.mean(), 0.75, groups.size)


def presence_by_queue(model):
    """P(worker seen) for every pattern of steps, from the transitions of the queue."""
    change, seen = model.queue_transitions()
    result = {}
    for pattern in product((False, True), repeat=model.horizon):
        p = np.eye(model.queue + 1)[0]
        for there in pattern:
            p = p @ (seen if there else change - seen)
        result[pattern] = p.sum()
    return result


@pytest.mark.parametrize("queue", [0, 1, 2, 20])
def test_the_queue_is_the_first_in_first_out_queue_of_the_kit(queue):
    """All sequences of joining workers, lined up by optkit's own queue, who finds it full being sent away at once."""
    model = two_types(queue=queue, workers=[0.4, 0.1, 0.2, 0.3], horizon=4)
    expected = dict.fromkeys(product((False, True), repeat=4), 0.0)
    for joined in product(range(4), repeat=4):
        line, admitted = deque(), []
        for step, number in enumerate(joined):
            for _ in range(number):
                if len(line) <= queue:  # one of those in line is seen at this step, the others wait
                    line.append(step)
                    admitted.append(step)
            if line:
                line.popleft()
        steps, _ = fifo_queue(admitted, 4)
        expected[tuple(np.isin(np.arange(4), steps).tolist())] += np.prod(model.workers[list(joined)])
    found = presence_by_queue(model)
    assert found == pytest.approx(expected, abs=1e-12)  # sums of 256 products of probabilities
    assert sum(found.values()) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("queue", [0, 2])
def test_drawn_queues_follow_the_transitions(queue):
    """Frequencies of (length before, length after, worker seen) in draws, within 4.5 standard errors."""
    model = two_types(queue=queue, workers=[0.6, 0.1, 0.1, 0.2], horizon=20)
    change, seen = model.queue_transitions()
    visits, moves = np.zeros(queue + 1), np.zeros((2, queue + 1, queue + 1))
    for child in np.random.SeedSequence(3).spawn(400):
        draw = model.draw(child)
        before = np.concatenate([[0], draw.queue[:-1]])
        there = np.isin(np.arange(20), draw.instance.worker_step)
        np.add.at(visits, before, 1)
        np.add.at(moves, (there.astype(int), before, draw.queue), 1)
    for observed, p in ((moves[1], seen), (moves[0], change - seen)):
        error = np.sqrt(p * (1 - p) / visits[:, None])
        assert (np.abs(observed / visits[:, None] - p) <= 4.5 * error + 1e-12).all()
