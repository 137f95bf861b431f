"""What all value functions that are linear in terms share: the backward sweep, its ridge, and how it fails."""

import numpy as np
import pytest

from optkit.basics.errors import InputError, TrainingError
from optkit.models.value import LinearValue
from optkit.models.value.features import HatFeatures
from optkit.models.value.ranked_term import RankedTerm
from optkit.models.value.request_sets import removal_differences


def test_the_ridge_draws_to_the_next_step(drawn):
    """Each step minimises squares plus ridge times the squared distance to the next step's coefficients (1e-7)."""
    experience = drawn()
    fitted = LinearValue(ridge=3.0).fit(experience)
    assert not fitted.coef_[3].any()
    squares = count = 0.0
    for step in (2, 1, 0):
        sets = experience.sets(step)
        x = np.concatenate([t.differences(sets)[sets.member] for t in fitted.terms_], axis=-1)
        y = (drawn.urgency(sets, None) - sets.penalty)[sets.member]
        root = np.sqrt(3.0)
        more = root * np.eye(x.shape[1])
        expected = np.linalg.lstsq(
            np.vstack([x, more]), np.concatenate([y, root * fitted.coef_[step + 1]]), rcond=None
        )[0]
        np.testing.assert_allclose(fitted.coef_[step], expected, atol=1e-7)
        squares += ((x @ expected - y) ** 2).sum()
        count += y.size
    assert fitted.residual_ == pytest.approx(np.sqrt(squares / count), rel=1e-9)
    stiff = LinearValue(ridge=1e12).fit(experience)
    assert np.abs(stiff.coef_).max() < 1e-6


@pytest.mark.parametrize("memory", [0.4, 1.0])
def test_memory_weighs_the_data_of_later_steps(drawn, memory):
    """The regression of a step also has the rows of the k-th step after it, with weight memory^k (1e-7)."""
    experience = drawn()
    fitted = LinearValue(ridge=3.0, memory=memory).fit(experience)
    rows = []
    for step in (2, 1, 0):
        sets = experience.sets(step)
        x = np.concatenate([t.differences(sets)[sets.member] for t in fitted.terms_], axis=-1)
        rows = [(np.sqrt(memory) * a, np.sqrt(memory) * b) for a, b in rows]
        rows.append((x, (drawn.urgency(sets, None) - sets.penalty)[sets.member]))
        a = np.vstack([*(x for x, _ in rows), np.sqrt(3.0) * np.eye(x.shape[1])])
        b = np.concatenate([*(y for _, y in rows), np.sqrt(3.0) * fitted.coef_[step + 1]])
        np.testing.assert_allclose(fitted.coef_[step], np.linalg.lstsq(a, b, rcond=None)[0], atol=1e-7)


def test_steps_that_nobody_saw_copy_the_next(drawn):
    """Where no set was visited, the coefficients are those of the next step."""
    fitted = LinearValue().fit(drawn(empty=(1,)))
    np.testing.assert_array_equal(fitted.coef_[1], fitted.coef_[2])
    assert fitted.coef_[1].any()
    assert (fitted.coef_[0] != fitted.coef_[1]).any()


def test_an_explosion_of_the_fit_itself_is_told(drawn):
    """Equations without a solution are a TrainingError too, not one of NumPy's."""
    with pytest.raises(TrainingError, match="ridge = 1e-300 is too small"):
        LinearValue(ridge=1e-300).fit(drawn(b=1))


def test_regressors_that_are_no_numbers_are_told(drawn):
    """A term that runs off where no later fit would notice, at the first step, is a TrainingError of that step."""

    class Broken(RankedTerm):
        def differences(self, sets):
            found = super().differences(sets)
            return found * np.nan if sets.step == 0 else found

    own = Broken(HatFeatures(None, [0.0, 50.0], [1.0, 10.0]), "surplus", [0.0, 4.0])
    with pytest.raises(TrainingError, match="at step 0"):
        LinearValue(terms=[own]).fit(drawn())


def test_an_interrupted_fit_leaves_no_trace(drawn):
    """Ctrl-C in the middle of a sweep leaves the last complete fit."""

    def interrupt(sets, value):
        if sets.step == 1:
            raise KeyboardInterrupt
        return drawn.urgency(sets, value)

    one = LinearValue().fit(drawn())
    coefficients = one.coef_.copy()
    with pytest.raises(KeyboardInterrupt):
        one.fit(drawn(interrupt))
    np.testing.assert_array_equal(one.coef_, coefficients)


def test_what_nobody_could_read_is_not_written(random_sets, drawn):
    """Terms or classes of one's own are no plain data: an InputError, at once."""

    class Mine(LinearValue):
        pass

    experience = drawn()

    class Constant:
        size = 1

        def differences(self, sets):
            return np.ones((*sets.member.shape, 1))

        def opportunity_cost(self, sets, theta):
            return np.where(sets.member, theta[0], 0.0)

        def value(self, sets, theta):
            return sets.member.sum(axis=1) * theta[0]

    own = LinearValue(terms=[Constant()]).fit(experience)
    sets = random_sets(0)
    np.testing.assert_allclose(own.opportunity_cost(sets), removal_differences(own.value, sets), atol=1e-10)
    for one in (own, Mine().fit(experience)):
        with pytest.raises(InputError, match="your own cannot be written"):
            one.to_dict()
