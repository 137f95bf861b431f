"""One of everything that people hold in their hands: how it is made, and numbers that tell how it behaves."""

import dataclasses
import functools

import numpy as np
from scipy import sparse

from optkit import (
    acceptance_probabilities,
    arrival_information,
    certify,
    full_information,
    gap_report,
    optimal_prices,
    scenario,
    simulate,
)
from optkit.bounds import SmallModel, exact_value
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.bounds.penalised.penalized import penalized
from optkit.evaluation.comparison import compare
from optkit.learning.beliefs import BelievedValue, believed_requests, believed_workers
from optkit.learning.offer_log import OfferLog
from optkit.learning.rounds import learn_once
from optkit.learning.trained import Trained
from optkit.learning.training import train
from optkit.models.value import LinearValue
from optkit.models.value.request_sets import ZeroSetValue
from optkit.policies import Formula, PostDecisionPricing, RewardPercentage
from optkit.policies.explore import Explore, RandomOffers
from optkit.policies.tuning import tune_reward_percentage
from optkit.simulation.batch import Batch

SOURCE = scenario("II", seed=0, horizon=12)
DAYS = SOURCE.sample(6, seed=1)
HALF = RewardPercentage(0.5)
SMALL = SmallModel(
    horizon=4, reward=[30.0, 50.0], penalty=[-15.0, -15.0], lifetime=[1, 2], utility=[[-10.0, -28.0]], mu=[4.0],
    arrivals=[0.6, 0.4], workers=[0.2, 0.8],
)  # fmt: skip


def sparsely(day):
    return dataclasses.replace(day, noise=sparse.csr_array(day.noise))


def seen_state():
    seen = []
    simulate(DAYS, HALF, observe=lambda state, *_: seen.append(state))
    return seen[-1]


def earned(policy):
    return simulate(DAYS, policy).reward


def logged():
    log = OfferLog()
    simulate(DAYS, HALF, observe=log)
    return log


@functools.cache
def fitted():
    return train(DAYS, LinearValue(), choice="true").to_dict()


def trained():
    """Return a policy that has priced nothing yet, as from a file."""
    return Trained.from_dict(fitted())


def proven(bound):
    return bound.certificate.check(DAYS[0]).bound


PUBLIC = {
    "instance": (lambda: DAYS[0], lambda day: simulate(day, HALF).reward),
    "sparse instance": (lambda: sparsely(DAYS[0]), lambda day: simulate(day, HALF).reward),
    "scenario": (lambda: scenario("II", seed=0, horizon=12), lambda source: source.sample(1, seed=1)[0].reward),
    "split": (lambda: scenario("II", seed=0, horizon=12, split=(2, 1, 1)).split(), lambda split: split.test[0].reward),
    "batch": (lambda: Batch.of(DAYS), lambda batch: simulate(batch, HALF).reward),
    "sparse batch": (lambda: Batch.of([*map(sparsely, DAYS)]), lambda batch: simulate(batch, HALF).reward),
    "state": (seen_state, PostDecisionPricing()),
    "simulation": (lambda: simulate(DAYS, HALF), lambda done: done.to_frame()["compensation"].to_numpy()),
    "offer log": (logged, lambda log: log.offers().compensation),
    "known requests": (lambda: believed_requests(Batch.of(DAYS)), lambda known: known.mean_surplus),
    "workers": (lambda: believed_workers(Batch.of(DAYS)), lambda workers: workers.presence),
    "myopic": (PostDecisionPricing, earned),
    "clipped": (lambda: PostDecisionPricing(nonnegative="clip"), earned),
    "believed": (lambda: PostDecisionPricing(value_function=BelievedValue(ZeroSetValue())), earned),
    "share": (lambda: HALF, earned),
    "formula": (lambda: Formula(0.5, 1.0, -0.1, 0.1), earned),
    "random": (lambda: RandomOffers(seed=3), earned),
    "exploring": (lambda: Explore(PostDecisionPricing(), 2.0), earned),
    "trained": (trained, lambda found: earned(found.policy)),
    "trained policy": (lambda: trained().policy, earned),
    "trained value": (
        lambda: trained().value,
        lambda value: earned(PostDecisionPricing(value_function=BelievedValue(value))),
    ),
    "learned": (
        lambda: learn_once(DAYS, pooled=True),
        lambda found: earned(PostDecisionPricing(choice=found.preferences)),
    ),
    "tuned": (lambda: tune_reward_percentage(DAYS, [0.4, 0.6]), lambda found: found.table["mean_reward"].to_numpy()),
    "prices": (lambda: optimal_prices([9.0, 8.0], [-1.0, -2.0]), lambda best: best.compensation),
    "price certificate": (lambda: certify([3.0, 2.0], [9.0, 8.0], [-1.0, -2.0]), lambda proof: np.asarray(proof.gap)),
    "full information": (lambda: full_information(DAYS[0]), proven),
    "arrival information": (lambda: arrival_information(DAYS[0]), proven),
    "lagrangian": (lambda: arrival_information(DAYS[0], "lagrangian"), proven),
    "penalised": (
        lambda: penalized(DAYS[0], ZeroSetValue(), Foresight(fifo_presence(0.5), np.full(3, 1 / 3)), limit=6),
        proven,
    ),
    "exact value": (lambda: exact_value(SMALL), lambda bound: bound.certificate.check(SMALL).bound),
    "gap report": (
        lambda: gap_report(DAYS[:2], {"half": HALF}, kinds="full"),
        lambda report: report.rows.to_numpy(float),
    ),
    "comparison": (
        lambda: compare(DAYS[:2], {"half": HALF}, [full_information(day) for day in DAYS[:2]]),
        lambda found: found.table["reward"].to_numpy(),
    ),
    "probabilities": (lambda: acceptance_probabilities([3.0], [-1.0], 1.0), np.hstack),
}
"""What people hold in their hands: how it is made, and numbers that tell how it behaves."""
