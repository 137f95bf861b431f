"""The first policies: their prices by hand, and the two protocols through which users bring their own beliefs."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize

from optkit import Instance, scenario, simulate
from optkit.basics.errors import InputError, PolicyError
from optkit.models.pricing import optimal_prices
from optkit.policies import (
    ChoiceModel,
    Formula,
    PostDecisionPricing,
    RewardPercentage,
    TrueChoice,
    ValueFunction,
    ZeroValue,
)


def states(instances, policy=None):
    """Every state that a run visits."""
    seen = []
    simulate(instances, policy or RewardPercentage(0.6), observe=lambda state, offer, taken: seen.append(state))
    return seen


def one_state(**changes):
    """One decision at step 1 over two requests, of which the first expires now."""
    day = Instance(
        **{
            "horizon": 3,
            "arrival": [0, 1],
            "expiry": [1, 2],
            "reward": [30.0, 40.0],
            "penalty": [-5.0, -8.0],
            "features": [[0.3, 0.5], [0.4, 2.0]],
            "pickup": [0, 0],
            "dropoff": [0, 0],
            "worker_step": [1],
            "worker_group": [0],
            "utility": [[-10.0, -12.0]],
            "mu": [2.0],
            "noise": [[0.0, 0.0]],
            "outside_noise": [0.0],
            **changes,
        }
    )
    (state,) = states(day)
    return state


@pytest.fixture(scope="module")
def visited():
    """The states that eight instances of scenario II visit."""
    return states(scenario("II", seed=1).sample(8, seed=4))


@pytest.mark.parametrize(("share", "expected"), [(0.0, [0, 0]), (0.5, [15, 20]), (1.0, [30, 40]), (1.2, [36, 48])])
def test_share_of_the_reward(share, expected):
    """PP pays share times reward."""
    assert RewardPercentage(share)(one_state()).tolist() == [expected]


def test_share_of_a_negative_reward():
    """PP pays nothing for a request that earns nothing, instead of asking the worker to pay."""
    assert RewardPercentage(0.5)(one_state(reward=[-30.0, 40.0])).tolist() == [[0.0, 20.0]]


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        ((0.5,), [15.0, 20.0]),
        ((0.0, 10.0), [5.0, 20.0]),  # travel distance is the last feature: 0.5 and 2
        ((0.0, 0.0, -0.1), [0.5, 0.8]),  # penalties are negative, so a negative weight pays more
        ((0.5, 0.0, 0.1), [14.5, 19.2]),
        ((0.5, 0.0, 0.0, 0.2), [21.0, 20.0]),  # only the first request expires now
        ((0.5, 10.0, -0.1, 0.2), [15 + 5 + 0.5 + 6, 20 + 20 + 0.8]),
        ((0.0, 0.0, 0.1), [0.0, 0.0]),  # below 0 is cut
    ],
)
def test_formula_by_hand(weights, expected):
    """FP pays v1 r + v2 td + v3 beta + v4 r [expires now], at least 0 (to rounding)."""
    assert Formula(*weights)(one_state())[0] == pytest.approx(expected, rel=1e-12)


def test_formula_without_features():
    """FP works without features as long as it does not weigh the distance; then it says what is missing."""
    bare = one_state(features=np.zeros((2, 0)))
    assert Formula(0.5)(bare).tolist() == [[15.0, 20.0]]
    with pytest.raises(InputError, match=r"distance.*no features"):
        Formula(0.5, 1.0)(bare)


@pytest.mark.parametrize("share", [-0.1, float("nan")])
def test_bad_share(share):
    """A share that is negative or no number is refused when the policy is made."""
    with pytest.raises(InputError, match="share"):
        RewardPercentage(share)


@pytest.mark.parametrize("share", [float("inf"), "half"])
def test_share_that_is_no_finite_number(share):
    """An infinite share or a word is refused when the policy is made."""
    with pytest.raises(InputError, match="share"):
        RewardPercentage(share)


@pytest.mark.parametrize("position", range(4))
@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_bad_weight(position, weight):
    """A weight that is not finite is refused by name."""
    weights = [0.5, 0.0, 0.0, 0.0]
    weights[position] = weight
    with pytest.raises(InputError, match=("reward", "distance", "penalty", "expiry_boost")[position]):
        Formula(*weights)


def test_myopic_prices_state_by_state(visited):
    """The default policy posts optimal_prices of r - beta [expires now] for the true preferences, one state at a time.

    A sum over a padded row may round differently: 1e-9 relative.
    """
    policy, decisions = PostDecisionPricing(), 0
    for state in visited:
        offer = policy(state)
        for b, mask in enumerate(state.offered):
            value = np.where(state.steps_left[b] == 0, state.reward[b] - state.penalty[b], state.reward[b])[mask]
            alone = optimal_prices(value, state.utility[b][mask], state.mu[b])
            np.testing.assert_allclose(offer[b][mask], alone.compensation, rtol=1e-9, atol=1e-9)
            decisions += 1
    assert decisions > 100


def test_myopic_prices_earn_most(visited):
    """No prices that a local search finds earn more than the myopic ones in expectation (tolerance 1e-6 of money)."""

    def expected_profit(prices, value, utility, mu, outside):
        weight = np.exp(np.append((utility + prices - outside) / mu, 0.0))
        return ((weight / weight.sum())[:-1] * (value - prices)).sum()

    policy = PostDecisionPricing()
    for state in visited[::8]:
        mask = state.offered[0]
        facts = (policy.value(state)[0][mask], state.utility[0][mask], state.mu[0], state.outside_utility[0])
        ours = policy(state)[0][mask]
        best = expected_profit(ours, *facts)
        for start in (ours, 0.7 * ours, ours + 3.0):
            bounds = [(0, None)] * ours.size
            found = minimize(lambda c, facts=facts: -expected_profit(c, *facts), start, bounds=bounds)
            assert -found.fun <= best + 1e-6


def test_serving_an_expiring_request_spares_its_penalty():
    """The value of a request adds the penalty that serving it avoids, only if it expires now."""
    assert PostDecisionPricing().value(one_state()).tolist() == [[35.0, 40.0]]


@dataclasses.dataclass
class Constant:
    """A user's value function: every request that stays is worth the same to the future."""

    worth: float

    def opportunity_cost(self, state):
        """Worth where the request does not expire now."""
        return np.where(state.expiring, 0.0, self.worth)


def test_a_users_value_function(visited):
    """Opportunity costs are taken off the value, so that prices of requests that could wait fall."""
    patient, myopic = PostDecisionPricing(value_function=Constant(6.0)), PostDecisionPricing()
    assert patient.value(one_state()).tolist() == [[35.0, 34.0]]
    for state in visited:
        waiting = state.offered & ~state.expiring
        difference = myopic.value(state) - patient.value(state)
        assert np.array_equal(difference[waiting], np.full(waiting.sum(), 6.0))
        only_waiting = waiting.any(axis=1) & ~state.expiring.any(axis=1)
        lower = (patient(state) < myopic(state)) | (myopic(state) == 0)
        assert lower[only_waiting][waiting[only_waiting]].all()


def test_the_future_matters():
    """Valuing the future changes what is accepted: with an absurd opportunity cost hardly anything is paid for."""
    instances = scenario("I.1", seed=0).sample(20, seed=1)
    miser = simulate(instances, PostDecisionPricing(value_function=Constant(1e3)))
    myopic = simulate(instances, PostDecisionPricing())
    assert miser.served.sum() < 0.5 * myopic.served.sum()
    assert miser.reward.mean() < myopic.reward.mean()


class Believer:
    """A user's choice model: workers mind every request by 20 and reject nothing else."""

    def utility(self, state):
        """Utility of -20 for all."""
        return np.full(state.offered.shape, -20.0)

    def mu(self, state):
        """Noise scale of 3."""
        return np.full(state.offered.shape[0], 3.0)

    def outside_utility(self, state):
        """Outside utility of 1."""
        return np.ones(state.offered.shape[0])


def test_a_users_choice_model():
    """Prices follow the beliefs of the policy, not the truth."""
    expected = optimal_prices([35.0, 40.0], [-20.0, -20.0], 3.0, outside_utility=1.0).compensation
    np.testing.assert_allclose(PostDecisionPricing(choice=Believer())(one_state())[0], expected, rtol=1e-12)


def test_true_choice_is_the_truth():
    """TrueChoice hands out the instance's utility, mu and outside utility of the worker's group."""
    state = one_state(utility=[[1.0, 2.0], [3.0, 4.0]], mu=[5.0, 6.0], outside_utility=[7.0, 8.0], worker_group=[1])
    truth = TrueChoice()
    assert truth.utility(state).tolist() == [[3.0, 4.0]]
    assert truth.mu(state).tolist() == [6.0]
    assert truth.outside_utility(state).tolist() == [8.0]


def test_zero_value():
    """ZeroValue charges nothing."""
    assert ZeroValue().opportunity_cost(one_state()).tolist() == [[0.0, 0.0]]


def test_clipped_prices(visited):
    """With nonnegative="clip" the policy posts the paper's prices, cut at 0; they differ where a price is cut."""
    liked = {"utility": [[5.0, -12.0]], "reward": [1.0, 40.0], "expiry": [2, 2], "mu": [1.0]}
    state = one_state(**liked)
    clip, exact = PostDecisionPricing(nonnegative="clip")(state), PostDecisionPricing()(state)
    raw = optimal_prices([1.0, 40.0], [5.0, -12.0], 1.0, nonnegative=False).compensation
    assert (raw < 0).any()
    np.testing.assert_allclose(clip[0], np.maximum(raw, 0), rtol=1e-12)
    assert not np.allclose(clip, exact)
    for state in visited:
        raw = optimal_prices(
            PostDecisionPricing().value(state), state.utility, state.mu, nonnegative=False, offered=state.offered
        ).compensation
        np.testing.assert_allclose(PostDecisionPricing(nonnegative="clip")(state), np.maximum(raw, 0), rtol=1e-12)


def test_exact_prices_earn_no_less_in_a_decision(visited):
    """In expectation the exact prices never earn less than the clipped ones (up to 1e-9 of money)."""
    for state in visited:
        facts = (PostDecisionPricing().value(state), state.utility, state.mu)
        exact, clip = (optimal_prices(*facts, nonnegative=how, offered=state.offered) for how in (True, "clip"))
        assert (exact.profit >= clip.profit - 1e-9).all()


@pytest.mark.parametrize("how", ["cut", False, None])
def test_unknown_way_to_keep_prices_nonnegative(how):
    """Anything but True and "clip" is refused when the policy is made, as prices of either sign are not feasible."""
    with pytest.raises(InputError, match="nonnegative"):
        PostDecisionPricing(nonnegative=how)


def test_protocols_recognise_a_users_class():
    """An isinstance check tells whether a user's object has the methods that a policy will call."""
    assert isinstance(Believer(), ChoiceModel)
    assert isinstance(TrueChoice(), ChoiceModel)
    assert isinstance(Constant(1.0), ValueFunction)
    assert isinstance(ZeroValue(), ValueFunction)
    assert not isinstance(Constant(1.0), ChoiceModel)
    assert not isinstance(Believer(), ValueFunction)


def answering(method, answer):
    """A choice model and value function that is right but for one method, which returns or raises something."""

    def asked(self, state):
        if isinstance(answer, BaseException):
            raise answer
        return answer

    return type("Mistaken", (TrueChoice, ZeroValue), {method: asked})()


NO_BELIEFS = {
    "None": None,
    "a word": "dear",
    "a flat list": [-1.0, 1.0, 2.0],
    "too wide": np.ones((1, 3)),
    "NaN": np.array([[np.nan, 1.0]]),
    "NaN for the worker": np.array([np.nan]),
    "infinity": np.array([[1.0, np.inf]]),
    "too much": np.full((1, 2), 1e308),
    "a complex number": 1j,
    "an exception": ZeroDivisionError("mine"),
    "an exit": SystemExit(0),
}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["utility", "mu", "outside_utility", "opportunity_cost"])
@pytest.mark.parametrize("answer", NO_BELIEFS.values(), ids=NO_BELIEFS)
def test_beliefs_gone_wrong(method, answer):
    """A model that fails or answers with no such numbers is named, with the step, in one line: no silent price."""
    model = answering(method, answer)
    with pytest.raises(PolicyError, match=rf"the {method} of Mistaken, at step 1, ") as caught:
        PostDecisionPricing(choice=model, value_function=model)(one_state())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mu", [0.0, -1.0])
def test_a_noise_scale_that_is_none(mu):
    """Is a PolicyError that says what it must be."""
    with pytest.raises(PolicyError, match=rf"the mu of Mistaken, at step 1, is {mu}: it needs finite numbers above 0"):
        PostDecisionPricing(choice=answering("mu", [mu]))(one_state())


def test_a_request_that_nobody_can_serve():
    """A utility of minus infinity says so, and what stands in the padding does not matter."""
    prices = PostDecisionPricing(choice=answering("utility", np.array([[-np.inf, -12.0]])))(one_state())
    assert (
        prices[0, 1] == PostDecisionPricing(choice=answering("utility", np.array([[-1e9, -12.0]])))(one_state())[0, 1]
    )


@pytest.mark.parametrize("policy", [RewardPercentage(0.5), Formula(0.5), PostDecisionPricing()], ids=repr)
def test_policies_are_values(policy):
    """Policies compare and hash by their parameters and cannot be changed."""
    assert policy == dataclasses.replace(policy)
    assert hash(policy) == hash(dataclasses.replace(policy))
    with pytest.raises(dataclasses.FrozenInstanceError):
        policy.anything = 1
