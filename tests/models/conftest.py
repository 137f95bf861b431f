"""Random sets of waiting requests, and experience made of them, for the tests of value functions."""

from collections.abc import Callable

import numpy as np
import pytest

from optkit.models.value.request_sets import KnownRequests, RequestSets


def draw_sets(seed: int, b: int = 3, w: int = 6, groups: int = 1, step: int = 2, ties: bool = True) -> RequestSets:
    """Draw b sets of up to w requests: members anywhere in a row, padding of both kinds, and many ties if asked for."""
    rng = np.random.default_rng(seed)
    N = b * w
    drawn = (
        (40 * rng.random(N), (0.0, 40.0)),
        (-10 * rng.random(N), (-10.0, 0.0)),
        (-30 * rng.random((groups, N)), (-30.0, 0.0)),
    )
    # With ties all numbers are multiples of 10, so that sums are exact and many coincide.
    money = [np.clip(10 * np.round(x / 10), *ends) if ties else x for x, ends in drawn]
    reward, penalty, utility = (np.concatenate([x, np.zeros((*x.shape[:-1], 1))], axis=-1) for x in money)
    whole = np.zeros(N + 1, dtype=np.int64)
    expiry = whole.copy()
    expiry[:N] = step + rng.integers(1, 13, N)
    requests = KnownRequests(reward, penalty, whole, expiry, utility, np.zeros((N + 1, 1)), whole, whole)
    member = rng.random((b, w)) < 0.6
    nobody = ~member & (rng.random((b, w)) < 0.5)
    index = np.where(nobody, N, rng.permutation(N).reshape(b, w))
    return RequestSets(requests, step, index, member, rng.integers(0, 15, b))


@pytest.fixture(scope="session")
def random_sets() -> Callable[..., RequestSets]:
    """Draw sets from a seed, see :func:`draw_sets`."""
    return draw_sets


class Drawn:
    """Experience of random sets and of targets that a function of them gives, for T = 4."""

    horizon = 4

    def __init__(self, target=None, groups=1, b=40, ties=False, empty=()):
        self._sets = [
            None if step in empty else draw_sets(100 + step, b, 6, groups, step=step, ties=ties) for step in range(3)
        ]
        self._target = target or self.urgency
        self.requests = next(s for s in self._sets if s is not None).requests

    def sets(self, step):
        """Random sets; None after the last step."""
        return None if step >= 3 else self._sets[step]

    def target_differences(self, value, step):
        """What the function says."""
        sets = self._sets[step]
        return np.where(sets.member, self._target(sets, value), 0.0)

    @staticmethod
    def urgency(sets, value):
        """Targets beyond the penalty that grow with surplus, and shrink with time and company."""
        worth = sets.mean_surplus / (1.0 + np.abs(sets.steps_left)) - sets.member.sum(axis=1, keepdims=True)
        return sets.penalty + worth


@pytest.fixture(scope="session")
def drawn() -> type[Drawn]:
    """Draw experience, see :class:`Drawn`."""
    return Drawn
