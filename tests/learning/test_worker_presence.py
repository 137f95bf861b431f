"""How likely the next worker is: against counting, at the extremes, and for queues."""

import numpy as np
import pytest

from optkit import scenario
from optkit.instances.queue import busy_steps
from optkit.learning.worker_presence import LONGEST, presence_after
from optkit.simulation.batch import Batch


def counted(seen):
    """How often each number of busy steps came before a step, and how often a worker followed, (LONGEST + 1,) each."""
    times, followed = np.zeros((2, LONGEST + 1))
    for column in seen.T:
        stretch = 0
        for worker in column:
            times[min(stretch, LONGEST)] += 1
            followed[min(stretch, LONGEST)] += worker
            stretch = stretch + 1 if worker else 0
    return times, followed


def queues(B, T=40, rate=0.5):
    """Whether a worker is seen, (T, B): Poisson workers join a queue in each step, and one of them is seen."""
    rng = np.random.default_rng(3)
    waiting, seen = np.zeros(B, int), np.zeros((T, B), bool)
    for step in range(T):
        waiting += rng.poisson(rate, B)
        seen[step] = waiting > 0
        waiting -= seen[step]
    return seen


def test_busy_steps_by_hand():
    """A stretch grows with every worker and starts again at 0; instances do not touch."""
    seen = np.array([[1, 0], [1, 1], [0, 1], [1, 1]], dtype=bool)
    assert busy_steps(seen).T.tolist() == [[1, 2, 0, 1], [0, 1, 2, 3]]


@pytest.mark.parametrize("shape", [(0, 3), (4, 0), (0, 0)])
def test_busy_steps_of_nothing(shape):
    """No steps or no instances give no stretches."""
    assert busy_steps(np.zeros(shape, bool)).shape == shape


@pytest.mark.parametrize("one", [False, True])
@pytest.mark.parametrize("shape", [(5, 4), (1, 1)])
def test_always_and_never(one, shape):
    """Who always comes is certain, who never comes is not expected, at every step and after every stretch."""
    table = presence_after(np.full(shape, one))
    assert table.shape == (shape[0], LONGEST + 1)
    assert (table == float(one)).all()


@pytest.mark.parametrize("shape", [(0, 3), (4, 0), (0, 0)])
def test_nothing_seen(shape):
    """Without steps there is no table, without instances no worker is expected."""
    table = presence_after(np.zeros(shape, bool))
    assert table.shape == (shape[0], LONGEST + 1)
    assert not table.any()


def test_memory_is_found():
    """Where the next worker depends on the stretch alone, that is found: within 0.02 of the truth with 60,000 steps.

    The rarest stretch is seen 2,000 times, for a standard error of 0.01.
    """
    rng = np.random.default_rng(0)
    truth = np.array([0.3, 0.5, 0.6, 0.7])
    T, B = 30, 2000
    seen, stretch = np.zeros((T, B), bool), np.zeros(B, int)
    for step in range(T):
        seen[step] = rng.random(B) < truth[np.minimum(stretch, 3)]
        stretch = np.where(seen[step], stretch + 1, 0)
    table = presence_after(seen)[5:]
    for k in range(4):
        assert table[:, k].mean() == pytest.approx(truth[k], abs=0.02)


def test_on_average_it_is_what_was_counted():
    """Summed over what followed a stretch, or over a step, predictions are what came: a logit's first condition.

    The penalty leaves the size of a coefficient, which is below 5, in sums of hundreds and thousands.
    """
    seen = queues(1000)
    table = presence_after(seen)
    before = np.minimum(np.concatenate([np.zeros((1, seen.shape[1]), int), busy_steps(seen)[:-1]]), LONGEST)
    predicted = table[np.arange(len(seen))[:, None], before]
    times, followed = counted(seen)
    assert times.min() > 100
    np.testing.assert_allclose(np.bincount(before.ravel(), predicted.ravel()), followed, atol=5.0)
    np.testing.assert_allclose(predicted.sum(axis=1), seen.sum(axis=1), atol=5.0)


def test_what_lies_beyond_a_horizon_says_nothing():
    """Instances that end after half of the steps change nothing at the later ones, and count fully at the earlier."""
    seen = queues(600)
    within = np.ones(seen.shape, bool)
    within[20:, 300:] = False
    cut = presence_after(seen & within, within)
    np.testing.assert_allclose((cut - presence_after(seen)).mean(axis=1), 0.0, atol=0.1)  # noise of 300 days: 0.03
    before = np.minimum(np.concatenate([np.zeros((1, seen.shape[1]), int), busy_steps(seen)[:-1]]), LONGEST)
    predicted = cut[np.arange(len(seen))[:, None], before]
    np.testing.assert_allclose((predicted * within).sum(axis=1), (seen & within).sum(axis=1), atol=5.0)
    assert not presence_after(seen, np.zeros_like(within)).any()


def test_steps_are_told_apart():
    """Where nobody comes in the first half and most do in the second, the table says so."""
    rng = np.random.default_rng(1)
    seen = rng.random((10, 500)) < np.repeat([0.02, 0.8], 5)[:, None]
    table = presence_after(seen)
    assert (table[:5, 0] < 0.1).all()
    assert (table[6:, 0] > 0.6).all()


def test_a_queue_foretells_workers():
    """Workers who queue come in runs: the longer the stretch, the likelier the next, up to noise (two SE: 0.05)."""
    by_stretch = presence_after(queues(5000))[LONGEST:].mean(axis=0)
    assert (np.diff(by_stretch) > -0.05).all()
    assert (np.diff(by_stretch[:6]) > 0.01).all()
    assert by_stretch[8] > by_stretch[0] + 0.25


@pytest.mark.slow
def test_scenarios_have_queues():
    """On 400 days of I.1 a worker follows an idle step with 0.39, many busy ones with 0.7 and more (noise 0.03)."""
    seen = Batch.of(scenario("I.1", seed=0).sample(400, seed=1)).worker_at >= 0
    by_stretch = presence_after(seen)[LONGEST:].mean(axis=0)
    assert by_stretch[0] == pytest.approx(0.39, abs=0.03)
    assert by_stretch[6:].mean() > 0.65


def test_few_days_say_little():
    """From a single day nothing is taken for certain: all probabilities lie well inside (0, 1)."""
    seen = np.arange(20)[:, None] % 3 > 0
    table = presence_after(seen)
    assert table.min() > 0.05
    assert table.max() < 0.98


@pytest.mark.slow
def test_it_is_scikit_learns_logistic_regression():
    """With its default penalty and precision, fitted to every step of every instance as a row of indicators."""
    from sklearn.linear_model import LogisticRegression

    T, seen = 6, queues(40, T=6)
    stretch = np.concatenate([np.zeros((1, 40), int), busy_steps(seen)[:-1]])
    steps = np.broadcast_to(np.arange(T)[:, None], seen.shape)
    rows = np.hstack([np.eye(T)[steps.ravel()], np.eye(LONGEST + 1)[stretch.ravel()]])
    fitted = LogisticRegression(max_iter=1000).fit(rows, seen.ravel())
    cells = np.hstack([np.repeat(np.eye(T), LONGEST + 1, axis=0), np.tile(np.eye(LONGEST + 1), (T, 1))])
    theirs = fitted.predict_proba(cells)[:, 1].reshape(T, LONGEST + 1)
    np.testing.assert_allclose(presence_after(seen), theirs, atol=1e-10)
