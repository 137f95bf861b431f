"""What holds of every kind of bounds: its certificate proves it, and no policy of those tried earns more."""

import warnings

import numpy as np
import pytest

from optkit import Instance, simulate
from optkit.bounds.arrival.lattice import stages
from optkit.bounds.arrival.policy_value import policy_value
from optkit.bounds.arrival.subsets import SubsetProgram
from optkit.bounds.bound import prove
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.penalised.penalized import idle_steps, penalized_program
from optkit.gap.policy_offers import lattice_offers
from optkit.policies import PostDecisionPricing, RewardPercentage
from tests.bounds.kinds import KINDS, small_penalized

POLICIES = {
    "myopic": PostDecisionPricing(),
    "half of the reward": RewardPercentage(0.5),
    "nearly all of it": RewardPercentage(0.9),
    "nothing": RewardPercentage(0.0),
}

DRAWS = 150
"""Instances drawn from a model."""


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", KINDS)
def test_a_certificate_proves_its_bound(name, seed):
    """Exactly the value, by a solution that is feasible and attains no more."""
    kind = KINDS[name]
    subject = kind.subject(np.random.default_rng(seed))
    bound = kind.bound(subject)
    verdict = prove(bound, subject)
    assert verdict.bound == bound.value
    assert verdict.residual == 0.0
    assert -np.inf < verdict.attained <= bound.value + 1e-12 * abs(bound.value)


@pytest.mark.parametrize(("name", "seed"), [("arrival, hybrid", 200_008), ("penalised", 200_268)])
def test_nothing_overflows_in_the_open(name, seed):
    """Days on which a request is held at 0 whom workers like beyond what an exponential holds: no warning, a proof."""
    kind = KINDS[name]
    subject = kind.subject(np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(prove(kind.bound(subject), subject).bound)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", KINDS)
def test_no_policy_earns_more(name, seed):
    """Exactly where it can be computed, in the mean over the noise or on the path; else within 4 standard errors."""
    subject = KINDS[name].subject(np.random.default_rng(seed))
    bound = KINDS[name].bound(subject)
    if name == "penalised":  # its paths can be enumerated where all requests are told apart
        bound = small_penalized(subject, limit=4)
    for who, policy in POLICIES.items():
        earned, error = reward_of(policy, name, subject, bound)
        assert earned <= bound.value + 4 * error + 1e-12 * abs(bound.value), who


def reward_of(policy, name, subject, bound):
    """What a policy earns of what the bound is about, and the standard error of that."""
    if not isinstance(subject, Instance):
        days = drawn(subject, np.random.default_rng(7))
        reward = simulate(days, policy).reward
        return reward.mean(), reward.std(ddof=1) / np.sqrt(reward.size)
    if name.startswith("full"):
        return simulate(subject, policy).reward[0], 0.0
    everything, nothing = np.ones(subject.n_requests, bool), np.zeros(subject.n_requests)
    offer = lattice_offers(subject, policy)
    if not name.startswith("penalised"):
        return policy_value(SubsetProgram(subject, stages(subject), nothing, everything), offer), 0.0
    program, charges = penalized_program(subject, everything, nothing), bound.certificate.charges
    charges = charges.on(subject) if name == "penalised, lagrangian" else charges
    return policy_value(program, offer, charges) - charges.idle(idle_steps(program)), 0.0


def drawn(model, rng):
    """Instances of a model; those of a fluid one have independent steps and Poisson numbers of requests."""
    if isinstance(model, SmallModel):
        return model.sample(DRAWS, 5)
    days = []
    for _ in range(DRAWS):
        kind = np.repeat(np.arange(model.count.size), rng.poisson(model.count))
        group = np.array([rng.choice(p.size + 1, p=[*p, 1.0 - p.sum()]) for p in model.presence])
        step = np.flatnonzero(group < model.mu.size)
        day = Instance(
            horizon=model.horizon, arrival=model.arrival[kind], expiry=model.expiry[kind], reward=model.reward[kind],
            penalty=model.penalty[kind], features=np.zeros((kind.size, 0)), pickup=kind, dropoff=kind,
            worker_step=step, worker_group=group[step], utility=model.utility[:, kind], mu=model.mu,
            outside_utility=model.outside_utility,
        )  # fmt: skip
        days.append(day.with_noise(rng))
    return days
