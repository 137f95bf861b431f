"""The mean reward of a policy given the arrivals: exact, by backward induction over what it may leave unserved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import MOST_MONEY, Bools, Floats, Ints, real
from optkit.basics.errors import InputError, PolicyError
from optkit.bounds.arrival.subsets import Charge, SubsetProgram
from optkit.models.choice import softmax_with_outside

Offer = Callable[[int, int, Ints, Bools], Floats]
"""``offer(step, worker, requests (m,), open (S, m))``: compensations (S, m), money, of S possible states at once.

Something is open in each of them.
"""

CHUNK = 1 << 13
"""States whose offers are asked for at once."""


def policy_value(program: SubsetProgram, offer: Offer, charge: Charge | None = None) -> float:
    """Mean reward of a policy over the noise, all requests and workers coming as they do in the instance, money.

    Parameters
    ----------
    program : SubsetProgram
        With all requests tracked and no multipliers: then its states are those of the process.
    offer : callable
        The policy.
    charge : callable, optional
        Subtracted along the way; the program's stages must then be every step.

    Raises
    ------
    InputError
        If the program has multipliers.
    PolicyError
        If an offer has the wrong shape, or one for an open request is negative or not finite.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.bounds.arrival.lattice import stages
    >>> day = scenario("I.2", seed=0).sample(1, seed=1)[0]
    >>> program = SubsetProgram(day, stages(day), np.zeros(day.n_requests), np.ones(day.n_requests, bool))
    >>> half = policy_value(program, lambda step, worker, requests, open_: 0.5 * day.reward[requests] * open_)
    >>> bool(day.penalty.sum() < half < program.constant + program.tables()[0][0])
    True
    """
    if program.multipliers.any():
        raise InputError("a program with multipliers forgets requests: its states are not those of a policy")
    earned = np.zeros(1)
    for stage in reversed(program.stages):
        before = earned[stage.after]
        if stage.worker >= 0:
            # Nobody is asked for prices of nothing, and only the first subset can be empty.
            empty = int(stage.uncertain == stage.requests.size)
            for start in range(empty, stage.states, CHUNK):
                rows = np.arange(start, min(start + CHUNK, stage.states))
                laid = program.offers(stage, earned, rows)
                paid = _checked(offer(stage.step, stage.worker, stage.requests, laid.offered), laid.offered, stage.step)
                odds = laid.decisions.logit + paid / laid.decisions.mu
                acceptance, _ = softmax_with_outside(np.where(laid.offered, odds, -np.inf))
                # What the offers call value is the worth of serving less what is lost of this policy's own future.
                before[rows] += np.where(laid.offered, acceptance * (laid.value - paid), 0.0).sum(axis=1)
        if charge is not None and stage.uncertain:
            before = before - charge(stage.step - 1, stage.requests[: stage.uncertain])
        earned = before
    return program.constant + float(earned[0])


def _checked(offer: npt.ArrayLike, open_: Bools, step: int) -> Floats:
    """Return compensations (S, m), 0 where nothing is open, or raise a PolicyError."""
    paid = real(f"what the policy returned at step {step}", offer, accept="any", error=PolicyError)
    if paid.shape != open_.shape:
        raise PolicyError(
            f"the policy returned shape {paid.shape} at step {step} for {open_.shape} states and requests"
        )
    wrong = open_ & ~((paid >= 0) & (paid <= MOST_MONEY))
    if wrong.any():
        s, i = np.argwhere(wrong)[0]
        raise PolicyError(f"the policy offers {paid[s, i]} at step {step}; a compensation is a finite number >= 0")
    return np.where(open_, paid, 0.0)
