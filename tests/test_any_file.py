"""Readers of users' files against files of all kinds: read whole, or refused in one line."""

from collections import Counter

import pytest

from optkit.basics.tables import cells
from tests.any_file import KINDS, attempt, valid

SEEDS = 500
"""Files tried here; ``python -m tests.any_file SECONDS`` tries more."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Instance sets and policies that are as they should be."""
    return valid(tmp_path_factory.mktemp("whole"))


def tried(place, whole):
    """How often each kind of file was read, and how often refused."""
    return Counter(attempt(seed, place, whole) for seed in range(SEEDS))


@pytest.mark.slow
def test_every_file_is_read_whole_or_refused_in_one_line(tmp_path, whole):
    """Requests, offers, trips, instance sets and policies, spoiled by fixed seeds: no traceback, no row lost or merged.

    Of every kind some are read and some are refused: the test is about both.
    """
    became = tried(tmp_path, whole)
    assert {kind for kind, _ in became} == set(KINDS)
    for kind in KINDS:
        assert min(became[kind, "read"], became[kind, "refused"]) > 0, kind


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        lambda column: [str(float(one)) if one.isdigit() else one for one in column],
        lambda column: column[:-1],
        lambda column: [column[0], *column[:-1]],
    ],
    ids=["labels as numbers", "a row lost", "labels shifted"],
)
def test_a_reader_that_guesses_or_loses_rows_is_found(tmp_path, whole, monkeypatch, wrong):
    """What the other test passes is not passed whatever happens: three wrong readers of labels are found out."""
    right = cells.labels

    def labels(column):
        found = right(column)
        found[:] = (wrong(found.tolist()) + found.tolist())[: found.size]
        return found

    monkeypatch.setitem(cells.KINDS, "labels", labels)
    with pytest.raises(AssertionError):
        tried(tmp_path, whole)
