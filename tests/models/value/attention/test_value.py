"""The attention network as a value function: its mathematics, its training and its arrays."""

import copy
import json
import sys
from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from optkit.basics.errors import InputError, MissingExtraError, TrainingError
from optkit.models.value.attention.settings import LEVELS, PRINTED, TUNED, AttentionSettings
from optkit.models.value.attention.value import AttentionValue
from optkit.models.value.experience import Experience, Workers
from optkit.models.value.request_sets import KnownRequests, RequestSets, SetValue, removal_differences

try:
    import torch
except ImportError:
    torch = None

needs_torch = pytest.mark.skipif(torch is None, reason="needs PyTorch: pip install 'optkit[attention]'")
SMALL = replace(TUNED, sweeps=2, passes=2, batch=64)


def drawn_requests(seed, n=200, groups=2, horizon=12):
    """Random requests, a padding entry at the end."""
    rng = np.random.default_rng(seed)
    arrival = rng.integers(0, horizon, n + 1)
    expiry = np.minimum(arrival + rng.integers(0, 8, n + 1), horizon - 1)
    money = (rng.uniform(20, 80, n + 1), -rng.uniform(0, 15, n + 1))
    places = rng.integers(0, 3, (2, n + 1))
    return KnownRequests(*money, arrival, expiry, -rng.uniform(5, 40, (groups, n + 1)), rng.random((n + 1, 3)), *places)


def drawn_experience(seed, n=200, instances=20, groups=2, horizon=12):
    """Random requests of random instances that wait until random steps."""
    rng = np.random.default_rng(seed + 1)
    requests = drawn_requests(seed, n, groups, horizon)
    owner = np.sort(rng.integers(0, instances, n))
    last = rng.integers(requests.arrival[:n] - 1, requests.expiry[:n])
    workers = Workers(np.full((horizon, 1), 0.5), np.full(groups, 1 / groups), np.ones(groups))
    return Experience(requests, workers, owner, last, np.zeros((horizon, instances), dtype=int))


def drawn_sets(seed, b=7, w=6, step=3, requests=None):
    """Random sets of requests with time left, members anywhere; the first row is empty, the second has one member."""
    rng = np.random.default_rng(seed)
    requests = drawn_requests(seed) if requests is None else requests
    open_ = np.flatnonzero((requests.expiry > step) & (requests.arrival <= step))
    index = np.stack([rng.permutation(open_)[:w] for _ in range(b)])
    member = rng.random((b, w)) < 0.6
    member[0], member[1] = False, np.arange(w) == 2
    return RequestSets(requests, step, np.where(member, index, requests.reward.size - 1), member)


@pytest.fixture(scope="module")
def fitted():
    """A value function after one round, one for each pair of settings."""
    pytest.importorskip("torch", reason="needs PyTorch: pip install 'optkit[attention]'")
    made = {}
    for name, settings in {"tuned": SMALL, "printed": replace(PRINTED, instances=5)}.items():
        made[name] = AttentionValue(settings, seed=3).fit(drawn_experience(0))
    return made


@pytest.mark.slow
@pytest.mark.parametrize("settings", ["tuned", "printed"])
@pytest.mark.parametrize("seed", range(5))
def test_opportunity_costs_are_differences_of_values(fitted, settings, seed):
    """All removals at once equal the value with less the value without.

    Numbers are in single precision: 1e-5 of the largest value.
    """
    value, sets = fitted[settings], drawn_sets(seed)
    expected, cost = removal_differences(value.value, sets), value.opportunity_cost(sets)
    assert np.abs(expected[sets.member]).max() > 0
    np.testing.assert_allclose(cost, expected, rtol=1e-5, atol=1e-5 * np.abs(value.value(sets)).max())
    assert not cost[~sets.member].any()


@pytest.mark.slow
def test_order_of_the_columns_does_not_matter(fitted):
    """A set has no order: permuted columns give the same value and permuted costs (single precision: 1e-5)."""
    value, sets = fitted["tuned"], drawn_sets(1)
    p = np.random.default_rng(0).permutation(sets.member.shape[1])
    shuffled = RequestSets(sets.requests, sets.step, sets.index[:, p], sets.member[:, p])
    tolerance = {"rtol": 1e-5, "atol": 1e-5 * np.abs(value.value(sets)).max()}
    np.testing.assert_allclose(value.value(shuffled), value.value(sets), **tolerance)
    np.testing.assert_allclose(value.opportunity_cost(shuffled), value.opportunity_cost(sets)[:, p], **tolerance)


def test_padding_does_not_matter(fitted):
    """What stands where nothing is a member is ignored."""
    value, sets = fitted["tuned"], drawn_sets(2)
    other = RequestSets(sets.requests, sets.step, np.where(sets.member, sets.index, 0), sets.member)
    assert (value.value(other) == value.value(sets)).all()
    assert (value.opportunity_cost(other) == value.opportunity_cost(sets)).all()


def test_empty_set(fitted):
    """Nothing waiting is worth nothing with our settings, and what the network says with the paper's."""
    empty = drawn_sets(0).rows(np.array([0]))
    assert fitted["tuned"].value(empty).tolist() == [0.0]
    assert fitted["printed"].value(empty)[0] != 0
    assert not fitted["tuned"].opportunity_cost(empty).any()
    none = RequestSets(empty.requests, 3, np.zeros((2, 0), dtype=int), np.zeros((2, 0), dtype=bool))
    np.testing.assert_allclose(fitted["tuned"].value(none), 0.0, atol=1e-4)  # single precision
    assert fitted["tuned"].opportunity_cost(none).shape == (2, 0)


@needs_torch
def test_inputs_of_sets_by_hand():
    """Count, most urgent deadline and step, with and without each member; a shared deadline outlives one of its two."""
    from optkit.models.value.attention.network import set_inputs

    one = np.ones(4)
    expiry = np.array([5, 5, 9, 0])
    requests = KnownRequests(one, -one, 0 * one, expiry, one[None], one[:, None], 0 * one, 0 * one)
    member = np.array([[True, True, True], [True, False, True], [False, False, True], [False, False, False]])
    whole, without = set_inputs(RequestSets(requests, 3, np.tile([0, 1, 2], (4, 1)), member))
    assert whole.tolist() == [[3, 2, 3], [2, 2, 3], [1, 6, 3], [0, 0, 3]]
    assert without.tolist() == [[2, 2, 3], [2, 2, 3], [2, 2, 3], [1, 6, 3], [1, 2, 3], [0, 0, 3]]


def test_architecture_is_the_papers(fitted):
    """Shapes of section 3.3: embedding 32, W 64 x 32, w 64, head 16 and 16; 3 inputs of a set."""
    weights = {name: array.shape for name, array in fitted["printed"].to_arrays().items() if "." in name}
    inputs = 3 + 4 + 2  # features; reward, penalty, steps left and their logarithm; groups
    assert weights == {
        "embed.weight": (32, inputs),
        "embed.bias": (32,),
        "W.weight": (64, 32),
        "w.weight": (1, 64),
        "layer1.weight": (16, 32 + 3),
        "layer1.bias": (16,),
        "layer2.weight": (16, 16),
        "layer2.bias": (16,),
        "output.weight": (1, 16),
        "output.bias": (1,),
    }


def test_network_by_hand(fitted):
    """The value is head(sum of sigmoid(w . tanh(W e)) e, s), recomputed in NumPy (single precision: 1e-4 relative)."""
    from optkit.models.value.attention.network import request_inputs, set_inputs

    value, sets = fitted["printed"], drawn_sets(4)
    a = value.to_arrays()

    def swish(z):
        return z / (1 + np.exp(-z))

    s = (set_inputs(sets)[0] - a["set_mean"]) / a["set_std"]
    expected = []
    for row, member in enumerate(sets.member):
        x = request_inputs(sets.requests, sets.index[row, member], sets.step)
        e = swish((x - a["request_mean"]) / a["request_std"] @ a["embed.weight"].T + a["embed.bias"])
        beta = 1 / (1 + np.exp(-np.tanh(e @ a["W.weight"].T) @ a["w.weight"][0]))
        z = np.concatenate([beta @ e, s[row]])
        for layer in ("layer1", "layer2"):
            z = swish(a[f"{layer}.weight"] @ z + a[f"{layer}.bias"])
        expected.append(a["output.weight"][0] @ z + a["output.bias"][0])
    np.testing.assert_allclose(value.value(sets), expected, rtol=1e-4)


@pytest.mark.slow
def test_same_seed_same_network(fitted):
    """The seed settles the result to the last digit; another seed gives another one; PyTorch's state is untouched."""
    state = torch.random.get_rng_state()
    again, other = (AttentionValue(SMALL, seed=seed).fit(drawn_experience(0)) for seed in (3, 4))
    assert torch.equal(torch.random.get_rng_state(), state)
    sets = drawn_sets(5)
    assert (again.opportunity_cost(sets) == fitted["tuned"].opportunity_cost(sets)).all()
    assert (other.opportunity_cost(sets) != fitted["tuned"].opportunity_cost(sets)).any()


def as_kind(kind, experience):
    """Return the experience as another class."""
    return kind(**{f.name: getattr(experience, f.name) for f in fields(Experience)})


class OwnTargets(Experience):
    """Experience whose targets are those of a known value function: urgent requests cost more, crowded ones less."""

    def target(self, value, step):
        """Return the known value of the sets, whatever the network says."""
        return self.known(self.sets(step))

    def target_differences(self, value, step):
        """Return the known opportunity costs."""
        return removal_differences(self.known, self.sets(step))

    @staticmethod
    def known(sets):
        """Surpluses by urgency, shrunk in crowded sets."""
        # Padding may have expired long ago.
        urgency = 1.0 / (1.0 + np.maximum(sets.steps_left, 0.0))
        worth = np.where(sets.member, sets.mean_surplus * urgency, 0.0).sum(axis=1)
        return worth / (1.0 + 0.1 * sets.member.sum(axis=1))


@pytest.mark.slow
@needs_torch
@pytest.mark.parametrize("target", ["difference", "level"])
def test_fit_learns_a_function_that_can_be_learned(target):
    """On targets that do not depend on the network the error falls below 15 % of their spread on unseen sets."""
    settings = replace(TUNED, target=target, empty_is_zero=target == "difference", sweeps=7, batch=64)
    value = AttentionValue(settings).fit(as_kind(OwnTargets, drawn_experience(0, n=1200, instances=120)))
    unseen = as_kind(OwnTargets, drawn_experience(9))
    error, spread = [], []
    for step in range(unseen.horizon):
        sets = unseen.sets(step)
        if sets is not None:
            wanted = unseen.target(None, step) if target == "level" else unseen.target_differences(None, step)
            found = value.value(sets) if target == "level" else value.opportunity_cost(sets)
            inside = sets.member if target == "difference" else slice(None)
            error.append((found - wanted)[inside].ravel())
            spread.append(wanted[inside].ravel())
    assert np.sqrt(np.square(np.concatenate(error)).mean()) < 0.15 * np.concatenate(spread).std()


@pytest.mark.slow
@needs_torch
def test_targets_come_from_the_target_network():
    """With refresh = 2 the second update regresses on the same targets as the first, the third on new ones."""
    seen = []

    class Watched(Experience):
        def target_differences(self, value, step):
            if step == 2:
                seen.append(value.value(self.sets(2)))
            return super().target_differences(value, step)

    watched = as_kind(Watched, drawn_experience(0))
    value = AttentionValue(replace(SMALL, sweeps=1, refresh=2))
    for _ in range(3):
        value.fit(watched)
    assert (seen[0] == seen[1]).all()
    assert (seen[1] != seen[2]).any()


@pytest.mark.slow
@needs_torch
def test_every_update_takes_the_instances_asked_for():
    """20 instances in parts of 8 make three updates, which together hold every set once."""
    from optkit.models.value.attention.training import VisitedSets, scaling_of

    experience = drawn_experience(0)
    visited = [sets for step in range(experience.horizon) if (sets := experience.sets(step)) is not None]
    data = VisitedSets.of(experience, visited, scaling_of(visited, True))
    parts = list(data.parts(8, np.random.default_rng(0)))
    assert [len(set(data.owner[part])) for part in parts] == [8, 8, 4]
    assert sorted(np.concatenate(parts).tolist()) == list(range(sum(map(len, visited))))
    value = AttentionValue(replace(SMALL, sweeps=2, instances=8)).fit(experience)
    assert value._training.updates == 6


@pytest.mark.slow
@needs_torch
@pytest.mark.parametrize(("decay_steps", "expected"), [(100, 1e-3 * 0.1**0.08), (None, 1e-3 * 0.1**0.75)])
def test_learning_rate_decays(decay_steps, expected):
    """Over all gradient steps, or within each round: the rate of the last of 4 steps, in round 2 of 2 x 2 passes."""
    settings = replace(SMALL, learning_rate=1e-3, decay_rate=0.1, decay_steps=decay_steps, batch=10_000)
    value, experience = AttentionValue(settings), drawn_experience(0)
    value.fit(experience).fit(experience)
    steps = value._training.gradient_steps
    assert steps == 8
    rate = value._training.optimizer.param_groups[0]["lr"]
    assert rate == pytest.approx(expected if decay_steps is None else 1e-3 * 0.1 ** ((steps - 1) / decay_steps))


@pytest.mark.slow
def test_arrays_and_json_keep_every_digit(fitted):
    """Through arrays and through JSON the values stay the same, and the file's settings and seed with them."""
    sets = drawn_sets(6)
    for value in fitted.values():
        plain = json.loads(json.dumps(asdict(value.settings)))
        by_arrays = AttentionValue.from_arrays(value.to_arrays(), plain, seed=3)
        by_json = AttentionValue.from_dict(json.loads(json.dumps(value.to_dict())))
        for found in (by_arrays, by_json, copy.deepcopy(value)):
            assert found.settings == value.settings
            assert found.seed == 3
            assert (found.value(sets) == value.value(sets)).all()
            assert (found.opportunity_cost(sets) == value.opportunity_cost(sets)).all()
        assert by_json.fit(drawn_experience(0)).residual_ > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("w.weight"), "'w.weight' of an attention value is missing"),
        (lambda a: a.update(more=np.zeros(2)), "'more' of an attention value is unknown"),
        (lambda a: a.update({"W.weight": np.zeros((64, 31))}), r"has shape \(64, 31\); it needs \(64, 32\)"),
        (lambda a: a.update({"request_mean": np.zeros(4)}), "has shape"),
        (lambda a: a.update({"unit": np.nan}), "'unit' .* is nan"),
        (lambda a: a.update({"unit": "money"}), "holds text"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(fitted, change, message):
    """Loading names the array that is wrong."""
    arrays = fitted["tuned"].to_arrays()
    change(arrays)
    with pytest.raises(InputError, match=message):
        AttentionValue.from_arrays(arrays, SMALL)


@needs_torch
def test_plain_data_that_do_not_fit_are_refused(fitted):
    """Unknown settings, missing parts and settings out of range are input errors."""
    good = fitted["tuned"].to_dict()
    for wrong in (
        {**good, "settings": {**good["settings"], "speed": 3}},
        {**good, "settings": {**good["settings"], "batch": 0}},
        {name: part for name, part in good.items() if name != "arrays"},
        {**good, "arrays": 3},
    ):
        with pytest.raises(InputError):
            AttentionValue.from_dict(wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"sweeps": 0},
        {"batch": 2.5},
        {"passes": True},
        {"learning_rate": -1.0},
        {"clip": float("nan")},
        {"discount": 1.5},
        {"deviations": ()},
        {"deviations": (-1.0,)},
        {"target": "levels"},
        {"loss": "absolute"},
    ],
)
def test_settings_out_of_range_are_refused(wrong):
    """The message names the setting."""
    with pytest.raises(InputError, match=next(iter(wrong))):
        AttentionSettings(**wrong)


@pytest.mark.slow
@needs_torch
def test_divergence_is_an_error_and_changes_nothing():
    """A learning rate that blows up raises; the value function stays what it was before."""
    value = AttentionValue(SMALL, seed=1).fit(drawn_experience(0))
    before = value.value(drawn_sets(0))
    value._training.settings = replace(SMALL, learning_rate=1e30)
    with pytest.raises(TrainingError, match="training diverged in update"):
        value.fit(drawn_experience(0))
    assert (value.value(drawn_sets(0)) == before).all()
    value._training.settings = SMALL
    again = AttentionValue(SMALL, seed=1).fit(drawn_experience(0)).fit(drawn_experience(1))
    assert (value.fit(drawn_experience(1)).value(drawn_sets(0)) == again.value(drawn_sets(0))).all()


@pytest.mark.slow
@needs_torch
def test_misuse_is_told():
    """Values before fitting, other requests than those fitted to, nothing to learn from, and seeds that are none."""
    with pytest.raises(InputError, match="not fitted"):
        AttentionValue().opportunity_cost(drawn_sets(0))
    with pytest.raises(InputError, match="not fitted"):
        AttentionValue().to_arrays()
    value = AttentionValue(SMALL).fit(drawn_experience(0))
    with pytest.raises(InputError, match=r"8 inputs .* a network of 9"):
        value.value(drawn_sets(0, requests=drawn_requests(0, groups=1)))
    with pytest.raises(InputError, match="8 inputs"):
        value.fit(drawn_experience(0, groups=1))
    gone = drawn_experience(0)
    with pytest.raises(InputError, match="nobody ever waited"):
        AttentionValue().fit(replace(gone, last=gone.requests.arrival[:-1] - 1))
    for seed in (-1, 1.5, True):
        with pytest.raises(InputError, match="seed"):
            AttentionValue(seed=seed)


@pytest.mark.slow
@needs_torch
def test_it_is_a_set_value_with_parameters():
    """It satisfies the protocol of value functions, and scikit-learn's clone starts afresh."""
    from sklearn.base import clone

    value = AttentionValue(SMALL, seed=5).fit(drawn_experience(0))
    assert isinstance(value, SetValue)
    fresh = clone(value)
    assert fresh.get_params() == {"settings": SMALL, "seed": 5}
    with pytest.raises(InputError, match="not fitted"):
        fresh.value(drawn_sets(0))
    assert value.deviations == TUNED.deviations
    assert value.discount == TUNED.discount


@pytest.mark.slow
@needs_torch
def test_patient_prices_earn_more_than_myopic_ones():
    """Trained on one scenario, the value of waiting pays on fresh instances (150 instances, paired: 3 errors clear)."""
    from optkit import scenario, simulate
    from optkit.instances.queue import busy_steps
    from optkit.learning.beliefs import BelievedValue, believed_requests, believed_workers
    from optkit.policies import PostDecisionPricing
    from optkit.simulation.batch import Batch

    drawn = scenario("I.1", seed=5, horizon=20)
    batch = Batch.of(drawn.sample(100, seed=1))
    N = int(batch.request_start[-1])
    last = batch.expiry[:N] - 1

    def look(state, _, taken):
        at = np.flatnonzero(taken >= 0)
        last[state.request[at, taken[at]]] = state.step - 1

    simulate(batch, PostDecisionPricing(), observe=look)
    owner = np.repeat(np.arange(len(batch)), np.diff(batch.request_start))
    busy = busy_steps(batch.worker_at >= 0)
    experience = Experience(believed_requests(batch), believed_workers(batch), owner, last, busy)
    value = AttentionValue(replace(TUNED, sweeps=5, batch=128)).fit(experience)
    patient = PostDecisionPricing(value_function=BelievedValue(value))
    fresh = drawn.sample(150, seed=2)
    gain = simulate(fresh, patient).reward - simulate(fresh, PostDecisionPricing()).reward
    assert gain.mean() > 3 * gain.std() / np.sqrt(gain.size)


@pytest.mark.slow
@needs_torch
def test_networks_by_their_names():
    """Each name brings its settings, and training its discount; the paper's two regress levels."""
    from optkit import scenario
    from optkit.learning.training import train
    from optkit.models.value.catalogue import estimator_of

    of = {"attention": TUNED, "attention-levels": LEVELS, "attention-printed": PRINTED}
    for name, settings in of.items():
        assert estimator_of(name).settings == settings
    days = scenario("I.1", seed=0, horizon=8).sample(2, seed=3)
    trained = train(days, "attention-printed", choice="true", deviations=(8.0,))
    assert trained.value.settings == PRINTED
    assert trained.settings["discount"] == PRINTED.discount != TUNED.discount
    assert (TUNED.target, LEVELS.target, PRINTED.target) == ("difference", "level", "level")


def test_printed_settings_are_the_papers_table():
    """The table of the appendix; the schedules that follow from 480 instances of 50 steps."""
    table = {
        "clip": 0.5,
        "loss": "huber",
        "discount": 0.95,
        "batch": 512,
        "learning_rate": 1e-5,
        "decay_rate": 1e-2,
        "decay_steps": 10_000,
        "instances": 80,
        "refresh": 5,
        "target": "level",
    }
    assert {name: getattr(PRINTED, name) for name in table} == table
    assert len(PRINTED.deviations) == 30
    assert PRINTED.deviations[:2] == pytest.approx((10.0, 10.0 - 1e-4 * 480 * 50))
    assert min(PRINTED.deviations) == 0.0


def test_without_pytorch_the_message_names_the_extra(monkeypatch):
    """Making the value function without PyTorch is one clear line."""
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'optkit\[attention\]'"):
        AttentionValue()
