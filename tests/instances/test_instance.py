"""Instances: every rule is enforced with a helpful line, arrays cannot change, tables and queues become instances."""

import copy
import pickle
import warnings
from collections import deque
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse, stats

from optkit.basics.errors import InputError, InstanceError, OptkitError
from optkit.instances.account import LeftOutWarning
from optkit.instances.clock import Clock
from optkit.instances.instance import Instance, fifo_queue

BASE = {
    "horizon": 6,
    "arrival": [0, 1, 3],
    "expiry": [2, 5, 4],
    "reward": [30.0, 40.0, 50.0],
    "penalty": [-5.0, 0.0, -7.0],
    "features": [[0.2, 1.0], [0.7, 2.0], [0.1, 3.0]],
    "pickup": [0, 1, 2],
    "dropoff": [1, 0, 2],
    "worker_step": [1, 4],
    "worker_group": [1, 0],
    "utility": [[-10.0, -12.0, -14.0], [-20.0, -22.0, -24.0]],
    "mu": [1.0, 2.0],
    "outside_utility": [0.0, -3.0],
}
NOISE = {"noise": np.arange(6.0).reshape(2, 3), "outside_noise": [0.5, -0.5]}


def make(**changes):
    return Instance(**{**BASE, **changes})


def noisy(**changes):
    return make(**{**NOISE, **changes})


@st.composite
def layouts(draw, most=6):
    """Draw a random layout: horizon, request windows and worker steps; money does not matter."""
    horizon = draw(st.integers(1, 8))
    arrival = draw(st.lists(st.integers(0, horizon - 1), max_size=most))
    n = len(arrival)
    steps = sorted(draw(st.sets(st.integers(0, horizon - 1), max_size=horizon)))
    return Instance(
        horizon=horizon,
        arrival=arrival,
        expiry=[draw(st.integers(a, horizon - 1)) for a in arrival],
        reward=np.ones(n),
        penalty=-np.ones(n),
        features=np.zeros((n, 1)),
        pickup=np.zeros(n),
        dropoff=np.zeros(n),
        worker_step=steps,
        worker_group=np.zeros(len(steps)),
        utility=np.zeros((1, n)),
        mu=[1.0],
    )


# Each rule: what is changed, then the words that the message must hold: the field, the index, the remedy or the rule.
RULES = {
    "horizon is fractional": ({"horizon": 5.5}, ["horizon", "5.5", "whole number"]),
    "horizon is a bool": ({"horizon": True}, ["horizon", "whole number"]),
    "horizon is zero": ({"horizon": 0}, ["horizon", "0", "at least one step"]),
    "horizon is text": ({"horizon": "six"}, ["horizon", "whole number"]),
    "horizon is nan": ({"horizon": float("nan")}, ["horizon", "whole number"]),
    "horizon is inf": ({"horizon": float("inf")}, ["horizon", "whole number"]),
    "horizon is none": ({"horizon": None}, ["horizon", "whole number"]),
    "expiry is short": ({"expiry": [2, 5]}, ["expiry", "(2,)", "needs (3,)"]),
    "reward is short": ({"reward": [30.0, 40.0]}, ["reward", "(2,)", "needs (3,)"]),
    "penalty is long": ({"penalty": [-1.0] * 4}, ["penalty", "(4,)", "needs (3,)"]),
    "pickup is short": ({"pickup": [0]}, ["pickup", "(1,)", "needs (3,)"]),
    "dropoff is short": ({"dropoff": []}, ["dropoff", "(0,)", "needs (3,)"]),
    "features are flat": ({"features": [1.0, 2.0, 3.0]}, ["features", "(3,)", "needs (3, any)"]),
    "features are short": ({"features": [[1.0]]}, ["features", "(1, 1)", "needs (3, any)"]),
    "arrival is a table": ({"arrival": [[0, 1, 3]]}, ["arrival", "(1, 3)", "needs (3,)"]),
    "worker_group is short": ({"worker_group": [0]}, ["worker_group", "(1,)", "needs (2,)"]),
    "worker_step is a number": ({"worker_step": 1}, ["worker_step", "()", "needs (1,)"]),
    "utility is flat": ({"utility": [-1.0, -2.0, -3.0]}, ["utility", "(3,)", "needs (2, 3)"]),
    "utility lacks a group": ({"utility": [[-1.0, -2.0, -3.0]]}, ["utility", "(1, 3)", "needs (2, 3)"]),
    "mu is a table": ({"mu": [[1.0, 2.0]]}, ["mu", "(1, 2)"]),
    "outside_utility lacks a group": ({"outside_utility": [1.0]}, ["outside_utility", "(1,)", "needs (2,)"]),
    "features are ragged": ({"features": [[1.0], [1.0, 2.0], [1.0]]}, ["features"]),
    "arrival is ragged": ({"arrival": [0, [1], 3]}, ["arrival"]),
    "reward is text": ({"reward": ["a", "b", "c"]}, ["reward", "not numbers", "give floats"]),
    "reward is text that looks like numbers": ({"reward": ["1", "2", "3"]}, ["reward", "not numbers"]),
    "reward is dates": ({"reward": np.array([1, 2, 3], "M8[D]")}, ["reward", "not numbers"]),
    "arrival is dates": ({"arrival": np.array([1, 2, 3], "M8[D]")}, ["arrival", "not numbers"]),
    "utility is complex": ({"utility": np.ones((2, 3)) * 1j}, ["utility", "complex", "real"]),
    "outside_utility is text": ({"outside_utility": "low"}, ["outside_utility", "not numbers"]),
    "arrival is fractional": ({"arrival": [0, 1.5, 3]}, ["arrival[1]", "1.5", "whole number"]),
    "arrival is huge": ({"arrival": [0, 1e300, 3]}, ["arrival[1]", "1e+300"]),
    "expiry is missing": ({"expiry": [2, None, 4]}, ["expiry[1]", "nan", "drop the row or fill it in"]),
    "pickup is fractional": ({"pickup": [0, 0.5, 1]}, ["pickup[1]", "whole number"]),
    "worker_step is nan": ({"worker_step": [1.0, np.nan]}, ["worker_step[1]", "nan", "drop the row"]),
    "worker_group is fractional": ({"worker_group": [0, 0.5]}, ["worker_group[1]", "whole number"]),
    "reward is nan": ({"reward": [1.0, 2.0, np.nan]}, ["reward[2]", "nan", "drop the row or fill it in"]),
    "penalty is infinite": ({"penalty": [-1.0, -np.inf, 0.0]}, ["penalty[1]", "-inf", "drop the row"]),
    "features hold nan": ({"features": [[1, 2], [3, np.nan], [5, 6]]}, ["features[1, 1]", "nan"]),
    "utility is infinite": ({"utility": [[0, 0, 0], [0, np.inf, 0]]}, ["utility[1, 1]", "inf"]),
    "mu is nan": ({"mu": [1.0, np.nan]}, ["mu[1]", "nan"]),
    "outside_utility is nan": ({"outside_utility": np.nan}, ["outside_utility", "nan"]),
    "arrival is negative": ({"arrival": [0, -1, 3]}, ["arrival[1] = -1", "steps count from 0"]),
    "expiry before arrival": ({"expiry": [2, 0, 4]}, ["expiry[1] = 0", "before its arrival", "inclusive"]),
    "expiry at the horizon": ({"expiry": [2, 6, 4]}, ["expiry[1] = 6", "last step 5", "cut it there"]),
    "penalty is positive": ({"penalty": [-1, 2, 3]}, ["penalty[1] = 2", "positive", "<= 0"]),
    "pickup is negative": ({"pickup": [0, 0, -2]}, ["pickup[2] = -2", "count from 0"]),
    "dropoff is negative": ({"dropoff": [0, -2, 0]}, ["dropoff[1] = -2", "count from 0"]),
    "mu is zero": ({"mu": [1.0, 0.0]}, ["mu[1] = 0", "not positive", "scale"]),
    "mu is negative": ({"mu": [-1.0, 1.0]}, ["mu[0] = -1", "not positive", "scale"]),
    "mu is empty": (
        {"mu": [], "utility": np.zeros((0, 3)), "outside_utility": 0.0},
        ["mu is empty", "at least one worker group"],
    ),
    "steps are seconds since 1970": (
        {
            "horizon": 1_700_000_901,
            "arrival": [1_700_000_000, 1_700_000_100, 1_700_000_300],
            "expiry": [1_700_000_900] * 3,
            "worker_step": [1_700_000_300, 1_700_000_400],
        },
        ["before step 1,700,000,000", "steps count from 0", "subtract"],
    ),
    "steps are minutes since 1970": (
        {
            "horizon": 28_400_001,
            "arrival": [28_333_333] * 3,
            "expiry": [28_400_000] * 3,
            "worker_step": [28_333_340, 28_333_341],
        },
        ["before step 28,333,333", "steps count from 0"],
    ),
    "worker_step is negative": ({"worker_step": [-1, 4]}, ["worker_step[0] = -1", "0..5"]),
    "worker_step at the horizon": ({"worker_step": [1, 6]}, ["worker_step[1] = 6", "0..5"]),
    "worker_step repeats": ({"worker_step": [4, 4]}, ["worker_step[1] = 4", "worker_step[0] = 4", "fifo_queue"]),
    "worker_step falls": ({"worker_step": [4, 1]}, ["worker_step[1] = 1", "does not come after", "fifo_queue"]),
    "worker_group too large": ({"worker_group": [0, 2]}, ["worker_group[1] = 2", "0..1"]),
    "worker_group negative": ({"worker_group": [-1, 0]}, ["worker_group[0] = -1", "0..1"]),
    "noise alone": ({"noise": np.zeros((2, 3))}, ["noise is given without outside_noise", "with_noise(seed)"]),
    "outside noise alone": ({"outside_noise": [0, 0]}, ["outside_noise is given without noise", "with_noise(seed)"]),
    "noise transposed": ({**NOISE, "noise": np.zeros((3, 2))}, ["noise", "(3, 2)", "needs (2, 3)"]),
    "noise is nan": ({**NOISE, "noise": [[0, 0, 0], [0, np.nan, 0]]}, ["noise[1, 1]", "nan"]),
    "outside noise is short": ({**NOISE, "outside_noise": [0.0]}, ["outside_noise", "(1,)", "needs (2,)"]),
    "outside noise is infinite": ({**NOISE, "outside_noise": [0, np.inf]}, ["outside_noise[1]", "inf"]),
    "sparse noise transposed": ({**NOISE, "noise": sparse.csr_array((3, 2))}, ["noise", "(3, 2)", "(2, 3)"]),
    "sparse noise is empty": (
        {**NOISE, "noise": sparse.csr_array((2, 3))},
        ["no entry for worker 0 and request 0", "step 1", "Instance.pairs"],
    ),
    "sparse noise lacks a pair": (
        {**NOISE, "noise": sparse.csr_array(np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]))},
        ["no entry for worker 1 and request 2", "step 4", "Instance.pairs"],
    ),
    "sparse noise is nan": (
        {**NOISE, "noise": sparse.csr_array(np.array([[1.0, 1.0, 0.0], [0.0, 1.0, np.nan]]))},
        ["noise[1, 2]", "nan"],
    ),
    "sparse noise is complex": ({**NOISE, "noise": sparse.csr_array(np.ones((2, 3)) * 1j)}, ["noise", "complex"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_broken_rule(rule):
    """A broken rule is one InstanceError, one line long, that names the field, the place and the remedy."""
    changes, words = RULES[rule]
    with pytest.raises(InstanceError) as caught:
        make(**changes)
    message = str(caught.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []


def test_message_stays_on_one_line():
    """A value that prints over several lines does not break the one-line message."""
    with pytest.raises(InstanceError) as caught:
        make(horizon=np.array([[1, 2], [3, 4]]))
    assert "\n" not in str(caught.value)


def test_error_tree():
    """An InstanceError is an OptkitError and a ValueError, so either catches it."""
    assert issubclass(InstanceError, InputError)
    assert issubclass(InputError, OptkitError)
    assert issubclass(InputError, ValueError)


def test_edge_values_are_accepted():
    """Rules hold with equality where they may: one step, expiry at arrival and at the end, penalty and reward of 0."""
    edge = make(arrival=[0, 5, 3], expiry=[0, 5, 5], penalty=[0, 0, 0], reward=[0, -1, 2], worker_step=[0, 5])
    assert edge.n_requests == 3
    one = make(horizon=1, arrival=[0] * 3, expiry=[0] * 3, worker_step=[0], worker_group=[0])
    assert one.pairs()[1].tolist() == [0, 1, 2]


def test_nothing_at_all():
    """No requests and no workers is an instance, with noise of shape (0, 0)."""
    empty = Instance(3, [], [], [], [], np.zeros((0, 2)), [], [], [], [], np.zeros((1, 0)), 1.0)
    assert (empty.n_requests, empty.n_workers, empty.n_groups) == (0, 0, 1)
    assert empty.with_noise(0).noise.shape == (0, 0)
    assert [part.size for part in empty.pairs()] == [0, 0]


def test_whole_floats_count_as_integers():
    """Floats that hold whole numbers are taken as integers, as a DataFrame with gaps once filled gives them."""
    assert make(arrival=[0.0, 1.0, 3.0], worker_group=[1.0, 0.0], horizon=6.0) == make()
    assert make(arrival=[0.0, 1.0, 3.0]).arrival.dtype == np.int64


def test_one_number_for_mu():
    """One group's mu may be a plain number."""
    one = make(mu=2.0, utility=[[-1.0, -2.0, -3.0]], worker_group=[0, 0], outside_utility=0)
    assert one.mu.tolist() == [2.0]
    assert one.outside_by_group.tolist() == [0.0]


def test_frozen_and_read_only():
    """No field can be set, and no array written."""
    instance = noisy()
    with pytest.raises(FrozenInstanceError):
        instance.horizon = 7
    for field in fields(Instance):
        value = getattr(instance, field.name)
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable, field.name
            with pytest.raises(ValueError, match="read-only"):
                value[...] = 0


def test_caller_keeps_its_arrays():
    """An instance copies what it is given: later changes by the caller do not reach it, and its rules bind no one."""
    given_arrays = {
        name: np.array(value, dtype=float if name not in ("arrival", "expiry") else int)
        for name, value in {**BASE, **NOISE}.items()
        if name != "horizon"
    }
    instance = Instance(horizon=6, **given_arrays)
    for array in given_arrays.values():
        assert array.flags.writeable
        array[...] = 99
    assert instance == noisy()


def test_caller_keeps_its_sparse_noise():
    """Sparse noise with unsorted indices is copied too: the caller's arrays stay as they were, even if read-only."""
    data, indices = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1, 0, 2, 1])
    for array in (data, indices):
        array.flags.writeable = False
    instance = noisy(noise=sparse.csr_array((data, indices, np.array([0, 2, 4])), shape=(2, 3)))
    assert instance.noise.toarray().tolist() == [[2.0, 1.0, 0.0], [0.0, 4.0, 3.0]]
    assert indices.tolist() == [1, 0, 2, 1]


@pytest.mark.parametrize("again", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy], ids=["pickle", "deepcopy"])
def test_copies_are_equal_and_read_only(again):
    """A copy that came through pickle, as from another process, equals the original and is as frozen."""
    copied = again(noisy())
    assert copied == noisy()
    assert not copied.reward.flags.writeable


@pytest.mark.parametrize("name", [f.name for f in fields(Instance)])
def test_equality_sees_every_field(name):
    """Two instances are equal exactly if every field is; comparing with something else is False, not an error."""
    other = {
        "horizon": 7,
        "arrival": [0, 1, 2],
        "expiry": [2, 5, 5],
        "pickup": [0, 1, 3],
        "dropoff": [1, 0, 3],
        "worker_step": [1, 5],
        "worker_group": [0, 0],
        "noise": NOISE["noise"] + 1e-9,
        "request_id": ["a", "b", "c"],
        "worker_id": [7, 8],
        "worker_joined": [0, 1],
        "group_names": ["bike", "car"],
        "feature_names": ["weight", "travel"],
        "clock": Clock("2026-03-02T08:00:00", 15.0),
    }.get(name)
    if other is None:
        other = np.asarray({**BASE, **NOISE}[name]) * 1.5 + (name == "penalty") * -0.25
    assert noisy() == noisy()
    assert noisy(**{name: other}) != noisy()
    assert noisy() != make()
    assert noisy() != "an instance"


def test_instances_are_not_hashable():
    """Arrays make instances unhashable, as their equality demands."""
    with pytest.raises(TypeError):
        hash(make())


def test_repr_is_one_short_line():
    """The representation tells sizes and noise, not arrays."""
    assert repr(make()) == "Instance(horizon=6, requests=3, workers=2, groups=2, noise=not realised)"
    assert repr(noisy()).endswith("noise=dense)")


@pytest.mark.slow
@settings(max_examples=75, deadline=None)
@given(layouts())
def test_pairs_against_brute_force(instance):
    """pairs() lists exactly the (worker, request) with arrival <= step <= expiry, by worker, then by request."""
    expected = [
        (j, i)
        for j, step in enumerate(instance.worker_step)
        for i in range(instance.n_requests)
        if instance.arrival[i] <= step <= instance.expiry[i]
    ]
    worker, request = instance.pairs()
    assert list(zip(worker.tolist(), request.tolist(), strict=True)) == expected


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(layouts(), st.integers(0, 2**32))
def test_pair_noise_is_the_same_dense_and_sparse(instance, seed):
    """Sparse noise holds the dense noise of the compatible pairs, and other entries are dropped."""
    dense = instance.with_noise(seed)
    again = Instance(
        **{
            **{f.name: getattr(dense, f.name) for f in fields(Instance)},
            "noise": sparse.coo_array(dense.noise),
        }
    )
    assert np.array_equal(again.pair_noise(), dense.pair_noise())
    assert again.noise.nnz == again.pairs()[0].size
    assert np.array_equal(dense.pair_noise(), [dense.noise[j, i] for j, i in zip(*dense.pairs(), strict=True)])


def test_pair_noise_needs_noise():
    """Asking for noise that is not realised says how to draw it."""
    with pytest.raises(InstanceError, match="with_noise"):
        make().pair_noise()


def crowd(workers, requests, mu):
    """Make an instance where all workers of two alternating groups see all requests."""
    n = requests
    return Instance(
        horizon=workers,
        arrival=np.zeros(n),
        expiry=np.full(n, workers - 1),
        reward=np.ones(n),
        penalty=-np.ones(n),
        features=np.zeros((n, 1)),
        pickup=np.zeros(n),
        dropoff=np.zeros(n),
        worker_step=np.arange(workers),
        worker_group=np.arange(workers) % 2,
        utility=np.zeros((2, n)),
        mu=mu,
    )


@pytest.mark.parametrize("limit", [10**9, 0], ids=["dense", "sparse"])
def test_noise_is_zero_mean_gumbel(limit, monkeypatch):
    """Noise has mean 0, variance (pi mu)^2 / 6 and the Gumbel's distribution, in each group and for the outside option.

    Tolerances are 5 standard errors: sigma / sqrt(N) for the mean; for the variance sigma^2 sqrt(4.4 / N), as a Gumbel
    has kurtosis 5.4; the Kolmogorov-Smirnov test must not reject at 1e-6 (it would, if the tail were on the left).
    """
    monkeypatch.setattr("optkit.instances.instance.DENSE_NOISE_LIMIT", limit)
    mu = np.array([0.5, 3.0])
    day = crowd(3000, 10, mu).with_noise(seed=3)
    assert sparse.issparse(day.noise) == (limit == 0)
    worker = day.pairs()[0]
    for d in (0, 1):
        for drawn in (day.pair_noise()[day.worker_group[worker] == d], day.outside_noise[day.worker_group == d]):
            variance = (np.pi * mu[d]) ** 2 / 6
            assert abs(drawn.mean()) < 5 * np.sqrt(variance / drawn.size)
            assert abs(drawn.var(ddof=1) / variance - 1) < 5 * np.sqrt(4.4 / drawn.size)
            assert stats.kstest(drawn, stats.gumbel_r(-np.euler_gamma * mu[d], mu[d]).cdf).pvalue > 1e-6


@pytest.mark.parametrize("limit", [10**9, 0], ids=["dense", "sparse"])
def test_noise_follows_its_seed(limit, monkeypatch):
    """The same seed gives the same noise, another seed other noise, and everything else stays."""
    monkeypatch.setattr("optkit.instances.instance.DENSE_NOISE_LIMIT", limit)
    day = make()
    once = day.with_noise(5)
    assert once == day.with_noise(5)
    assert once == day.with_noise(np.random.default_rng(5))
    assert once != day.with_noise(6)
    assert not np.array_equal(once.outside_noise, day.with_noise(6).outside_noise)
    assert day.noise is None
    assert once.with_noise(5) == once
    assert all(np.array_equal(getattr(once, name), getattr(day, name)) for name in BASE)


def test_sparse_noise_starts_above_the_limit(monkeypatch):
    """Dense noise is drawn for as many pairs as the limit, sparse noise for one more."""
    monkeypatch.setattr("optkit.instances.instance.DENSE_NOISE_LIMIT", 6)
    assert not sparse.issparse(make().with_noise(0).noise)
    monkeypatch.setattr("optkit.instances.instance.DENSE_NOISE_LIMIT", 5)
    drawn = make().with_noise(0)
    assert sparse.issparse(drawn.noise)
    assert drawn.noise.nnz == drawn.pairs()[0].size
    assert not drawn.noise.data.flags.writeable
    assert drawn != make()
    assert "sparse" in repr(drawn)


def test_sparse_noise_keeps_stored_zeros():
    """A stored zero is a realised draw, not a missing pair."""
    worker, request = make().pairs()
    zeros = sparse.csr_array((np.zeros(worker.size), (worker, request)), shape=(2, 3))
    assert noisy(noise=zeros).pair_noise().tolist() == [0.0] * worker.size


REQUESTS = pd.DataFrame(
    {
        "arrival": [0, 1, 3],
        "expiry": [2, 5, 4],
        "reward": [30.0, 40.0, 50.0],
        "penalty": [-5.0, 0.0, -7.0],
        "pickup": [0, 1, 2],
        "dropoff": [1, 0, 2],
        "utility_0": [-10.0, -12.0, -14.0],
        "utility_1": [-20.0, -22.0, -24.0],
        "weight": [0.2, 0.7, 0.1],
        "travel": [1.0, 2.0, 3.0],
    }
)
WORKERS = pd.DataFrame({"step": [1, 4], "group": [1, 0]})
OPTIONS = {"mu": [1.0, 2.0], "outside_utility": [0.0, -3.0], "features": ["weight", "travel"]}
SIMPLE = pd.DataFrame({"arrival": [0, 1], "expiry": [2, 3], "reward": [30.0, 40.0], "utility": [-9.0, -8.0]})


def test_two_tables_make_the_instance():
    """Two tables give what their columns say, group by group; the horizon is one more than the last step."""
    assert Instance.from_frames(REQUESTS, WORKERS, **OPTIONS) == make(feature_names=("weight", "travel"))


def test_column_and_row_order_do_not_matter():
    """Utility columns go by their number, workers by their step with their group, and row labels are ignored."""
    shuffled = REQUESTS[REQUESTS.columns[::-1]].set_index(pd.Index([7, 7, 1]))
    assert Instance.from_frames(shuffled, WORKERS.iloc[::-1], **OPTIONS) == Instance.from_frames(
        REQUESTS, WORKERS, **OPTIONS
    )


def test_float_columns_with_whole_numbers():
    """Integer columns that pandas turned into floats still build the same instance."""
    floats = REQUESTS.astype({"arrival": float, "expiry": float, "pickup": float})
    assert Instance.from_frames(floats, WORKERS.astype(float), **OPTIONS) == Instance.from_frames(
        REQUESTS, WORKERS, **OPTIONS
    )


def test_optional_columns_are_zero():
    """Penalty, places and group may be left out and are then 0; one mu serves every group."""
    small = Instance.from_frames(SIMPLE, pd.DataFrame({"step": [2]}))
    assert small.penalty.tolist() == small.pickup.tolist() == small.dropoff.tolist() == [0, 0]
    assert small.worker_group.tolist() == [0]
    assert small.features.shape == (2, 0)
    both = Instance.from_frames(REQUESTS.drop(columns=["weight", "travel"]), WORKERS, mu=2.5)
    assert both.mu.tolist() == [2.5, 2.5]


@pytest.mark.parametrize(("horizon", "expected"), [(None, 10), (12, 12)])
def test_horizon_of_two_tables(horizon, expected):
    """The horizon reaches past the last worker too, unless it is given."""
    assert Instance.from_frames(SIMPLE, pd.DataFrame({"step": [9]}), horizon=horizon).horizon == expected


def test_tables_may_be_empty():
    """Tables without rows give an instance without requests or workers."""
    empty = Instance.from_frames(SIMPLE.iloc[:0], pd.DataFrame({"step": []}))
    assert (empty.horizon, empty.n_requests, empty.n_workers) == (1, 0, 0)


def test_queue_lines_workers_up_with_their_groups():
    """With queue=True arrivals become turns, groups follow their workers, and turns beyond the horizon are left out."""
    workers = pd.DataFrame({"step": [3, 1, 1, 3, 3], "group": [0, 1, 0, 1, 0]})
    requests = REQUESTS.drop(columns=["weight", "travel"])
    lined = Instance.from_frames(requests, workers, queue=True)
    assert lined.worker_step.tolist() == [1, 2, 3, 4, 5]
    assert lined.worker_group.tolist() == [1, 0, 0, 1, 0]
    with pytest.warns(LeftOutWarning, match="2 of 5 workers are left out: 2 still wait in the queue"):
        short = Instance.from_frames(SIMPLE, workers[["step"]], queue=True, horizon=4)
    assert short.worker_step.tolist() == [1, 2, 3]


def test_who_is_left_out_is_counted():
    """Whoever joins after the day, and whoever never gets a turn; nobody is told of who is seen."""
    with pytest.warns(LeftOutWarning, match="9 of 10 workers are left out: 9 still wait"):
        assert Instance.from_frames(SIMPLE, pd.DataFrame({"step": [5] * 10}), queue=True, horizon=6).n_workers == 1
    with pytest.warns(LeftOutWarning, match="2 of 3 .*: 1 join at step 6 or later and 1 still wait"):
        assert Instance.from_frames(SIMPLE, pd.DataFrame({"step": [5, 5, 9]}), queue=True, horizon=6).n_workers == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Instance.from_frames(SIMPLE, pd.DataFrame({"step": [1, 1, 9]}), queue=True, horizon=10).n_workers == 3


@pytest.mark.parametrize("name", ["penalties", "Penalty", "penalty ", "penality", "pick_up", "Dropoff"])
def test_a_misspelt_column_is_no_zero(name):
    """What may be left out counts as 0, so that a name that is nearly right must not pass."""
    with pytest.raises(InstanceError, match=f"column '{name}' and none '"):
        Instance.from_frames(SIMPLE.assign(**{name: [-1.0, -2.0]}), WORKERS[["step"]])
    with pytest.raises(InstanceError, match="the workers table has a column 'groups' and none 'group'"):
        Instance.from_frames(SIMPLE, pd.DataFrame({"step": [1], "groups": [0]}))
    with pytest.warns(LeftOutWarning, match="requests table has columns that play no part: penalties"):
        kept = Instance.from_frames(SIMPLE.assign(penalty=0.0, penalties=[-1.0, -2.0]), WORKERS[["step"]])
    assert kept.penalty.tolist() == [0.0, 0.0]


def test_crowded_steps_without_a_queue():
    """Two workers at one step are an error that names the queue as the remedy."""
    with pytest.raises(InstanceError, match="fifo_queue"):
        Instance.from_frames(SIMPLE, pd.DataFrame({"step": [1, 1]}))


TABLE_ERRORS = {
    "no expiry": (SIMPLE.drop(columns="expiry"), WORKERS[["step"]], {}, ["requests table", "'expiry'", "it has"]),
    "no utility": (SIMPLE.drop(columns="utility"), WORKERS[["step"]], {}, ["requests table", "'utility'", "it has"]),
    "no step": (SIMPLE, WORKERS[["group"]], {}, ["workers table", "'step'", "it has: group"]),
    "no feature": (SIMPLE, WORKERS[["step"]], {"features": ["size"]}, ["requests table", "'size'"]),
    "gap in the groups": (REQUESTS.drop(columns="utility_0"), WORKERS, {}, ["requests table", "'utility_0'"]),
    "mu for too many groups": (SIMPLE, WORKERS[["step"]], {"mu": [1, 2]}, ["utility", "(2, 2)"]),
    "fraction": (SIMPLE.assign(arrival=[0.5, 1]), WORKERS[["step"]], {}, ["arrival in row 0", "whole number"]),
    "missing expiry": (SIMPLE.assign(expiry=[np.nan, 3]), WORKERS[["step"]], {}, ["expiry in row 0", "nan"]),
    "missing everywhere": (SIMPLE.assign(expiry=np.nan), WORKERS[["step"]], {}, ["expiry in row 0", "nan"]),
    "missing step": (SIMPLE, pd.DataFrame({"step": [1, np.nan]}), {}, ["step", "nan"]),
    "missing step in a queue": (SIMPLE, pd.DataFrame({"step": [1, np.nan]}), {"queue": True}, ["step", "nan"]),
    "nullable step": (SIMPLE, pd.DataFrame({"step": pd.array([1, pd.NA], "Int64")}), {}, ["step", "nan"]),
    "nullable reward": (
        SIMPLE.assign(reward=pd.array([1, pd.NA], "Int64")),
        WORKERS[["step"]],
        {},
        ["reward in row 1", "nan"],
    ),
    "infinite expiry": (SIMPLE.assign(expiry=[2, np.inf]), WORKERS[["step"]], {}, ["expiry in row 1", "inf"]),
    "words for steps": (SIMPLE, pd.DataFrame({"step": ["one", "two"]}), {}, ["step", "not numbers"]),
    "words for expiries": (SIMPLE.assign(expiry=["a", "b"]), WORKERS[["step"]], {}, ["expiry", "not numbers"]),
    "words for utilities": (SIMPLE.assign(utility=["a", "b"]), WORKERS[["step"]], {}, ["utility", "not numbers"]),
    "words for features": (
        SIMPLE.assign(size=["S", "L"]),
        WORKERS[["step"]],
        {"features": ["size"]},
        ["features", "not numbers"],
    ),
    "word for mu": (SIMPLE, WORKERS[["step"]], {"mu": "one"}, ["mu", "not numbers"]),
    "times for arrivals": (
        SIMPLE.assign(arrival=pd.to_datetime(["2018-01-01", "2018-01-02"])),
        WORKERS[["step"]],
        {},
        ["arrival", "times", "expiry", "steps"],
    ),
}


@pytest.mark.parametrize("case", TABLE_ERRORS)
def test_bad_tables(case):
    """A table that cannot be an instance gives one line that names the column."""
    requests, workers, options, words = TABLE_ERRORS[case]
    with pytest.raises(InstanceError) as caught:
        Instance.from_frames(requests, workers, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 300
    assert [word for word in words if word not in message] == []


def test_a_column_beside_the_utilities():
    """A column that only begins like a utility, such as utility_note, is none of the groups."""
    with pytest.warns(LeftOutWarning, match="utility_note"):
        noted = Instance.from_frames(SIMPLE.assign(utility_note=["fine", "good"]), WORKERS[["step"]])
    assert noted.n_groups == 1


def plain_queue(arrival, horizon):
    """Serve workers in a plain queue, step by step: an independent account of paper section 2.2."""
    waiting, seen, coming = deque(), [], deque(enumerate(arrival))
    for step in range(horizon):
        while coming and coming[0][1] <= step:
            waiting.append(coming.popleft()[0])
        if waiting:
            seen.append((step, waiting.popleft()))
    return seen


@pytest.mark.slow
@settings(max_examples=75, deadline=None)
@given(st.lists(st.integers(0, 12), max_size=15), st.integers(1, 15))
def test_fifo_queue_against_a_plain_queue(arrival, horizon):
    """fifo_queue serves the same workers at the same steps as a queue worked off step by step."""
    arrival = sorted(arrival)
    step, served = fifo_queue(arrival, horizon)
    assert list(zip(step.tolist(), served.tolist(), strict=True)) == plain_queue(arrival, horizon)


@pytest.mark.parametrize(
    "arrival", [[5, 0], [0.5, 0.7], [np.nan], [[0, 1]], ["a"]], ids=["unsorted", "fractions", "nan", "table", "words"]
)
def test_fifo_queue_refuses_what_it_cannot_line_up(arrival):
    """Arrivals that are unsorted or no whole numbers are an error, never a silently wrong queue."""
    with pytest.raises(InputError):
        fifo_queue(arrival, 9)
