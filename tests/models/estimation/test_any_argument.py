"""Whatever an argument is, there is a result, or one line of ours that says what is wrong."""

import pytest

from tests.models.estimation.any_argument import errors


@pytest.mark.slow
def test_nothing_ends_in_an_error_of_somebody_elses():
    ours, theirs = errors(every=26)
    assert not theirs
    assert len(ours) > 50
    assert not any("\n" in line for line in ours)
