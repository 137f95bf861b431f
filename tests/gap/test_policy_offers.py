"""Any policy on all subsets of open requests."""

from dataclasses import replace

import numpy as np
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import PolicyError
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.policy_value import policy_value
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.gap.policy_offers import lattice_offers
from optkit.learning.training import train
from optkit.policies import PostDecisionPricing
from optkit.simulation.batch import Batch

DAY = scenario("I.2", seed=0).sample(1, seed=1)[0]
GROUPS = scenario("II", seed=0, request_rate=0.25).sample(1, seed=4)[0]


def enumerated(day, policy):
    """Mean reward over the noise."""
    program = SubsetProgram(day, stages(day), np.zeros(day.n_requests), np.ones(day.n_requests, bool))
    return policy_value(program, lattice_offers(day, policy))


def by_place(state):
    """A policy that depends on everything it is shown: places, padding, numbers of requests and the busy stretch."""
    place = np.arange(state.offered.shape[1])
    crowd = state.offered.sum(axis=1, keepdims=True)
    share = 0.1 + 0.2 / (1 + place) + 0.01 * state.busy[:, None] + 0.02 * crowd
    # Padding is worth nothing, as in the simulator, or this would differ.
    return share * state.reward + 0.01 * state.reward.sum(axis=1, keepdims=True) + 0.1 * state.group[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("day", [DAY, GROUPS], ids=["one group", "three"])
def test_enumerated_is_the_mean_of_simulated(day):
    """1,500 simulations with fresh noise agree within four standard errors, for each policy."""
    source = scenario("I.2", seed=0) if day is DAY else scenario("II", seed=0, request_rate=0.25)
    patient = train(source.sample(20, seed=2), choice="true").policy
    runs = Batch.of([day.with_noise(k) for k in range(1500)])
    for name, policy in {"by place": by_place, "myopic": PostDecisionPricing(), "patient": patient}.items():
        earned = simulate(runs, policy).reward
        assert abs(earned.mean() - enumerated(day, policy)) < 4 * earned.std() / np.sqrt(earned.size), name


def test_the_policy_sees_what_the_simulator_shows():
    """Along simulated runs, each state's offer is the one that the subset of the same requests gets."""
    seen = []
    simulate([DAY.with_noise(k) for k in range(20)], by_place, observe=lambda *what: seen.append(what[:2]))
    offer = lattice_offers(DAY, by_place)
    for state, paid in seen:
        local = state.request - state.batch.request_start[state.instance][:, None]
        for row in range(len(local)):
            held = local[row][state.offered[row]]
            asked = np.sort(held)[::-1]  # in another order
            found = offer(
                state.step, int(np.flatnonzero(DAY.worker_step == state.step)[0]), asked, np.ones((1, held.size), bool)
            )
            assert found[0][np.argsort(asked)] == pytest.approx(paid[row][state.offered[row]][np.argsort(held)])


def test_noise_is_not_looked_at():
    """Without noise the value is the same."""
    bare = replace(DAY, noise=None, outside_noise=None)
    assert enumerated(bare, by_place) == enumerated(DAY, by_place)


@pytest.mark.parametrize(
    ("policy", "says"),
    [
        (lambda state: np.zeros(3), "shape"),
        (lambda state: "dear", "the policy <lambda> returned at step .* holds text"),
        (lambda state: -1.0 - state.reward, "number >= 0"),
        (lambda state: np.nan * state.reward, "number >= 0"),
        (lambda state: 1e308 + 0.0 * state.reward, "offers 1e[+]308 for request"),
        (lambda state: 1 / 0, r"the policy <lambda>, at step \d+, failed .ZeroDivisionError"),
    ],
)
def test_bad_offers_are_refused(policy, says):
    """As in the simulator, with the step."""
    with pytest.raises(PolicyError, match=says):
        enumerated(DAY, policy)


def test_a_policy_cannot_write_into_what_it_sees():
    """What it is shown is read-only."""

    def vandal(state):
        state.request[:] = 0
        return state.reward

    with pytest.raises(PolicyError, match="read-only"):
        enumerated(DAY, vandal)
