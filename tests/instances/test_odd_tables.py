"""Spoiled tables: see :mod:`tests.instances.odd_tables`."""

from collections import Counter

import pytest

from tests.instances.odd_tables import attempt


@pytest.mark.slow
def test_no_row_is_lost_and_every_refusal_is_a_line():
    """Each of what may become of tables does, of some."""
    became = Counter(attempt(seed) for seed in range(150))
    assert min(became[what] for what in ("refused", "told", "whole")) > 5
