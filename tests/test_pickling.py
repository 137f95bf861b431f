"""What optkit hands out can be pickled and copied, before its use and after, as processes and caches do."""

import copy
import pickle

import numpy as np
import pytest

from tests.public import PUBLIC
from tests.reachable import arrays_within

COPIES = (lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy, copy.copy)

LEAVE_BEHIND = ("myopic", "believed", "exploring", "trained", "trained policy", "trained value")
WORLD = ("instance", "sparse instance", "batch", "sparse batch", "state", "known requests", "workers")


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLIC)
def test_a_copy_behaves_as_the_original(name):
    """Copied before and after its first use, and a copy of the copy, too."""
    make, use = PUBLIC[name]
    thing = make()
    copies = [copied(thing) for copied in COPIES]
    expected = use(thing)
    copies += [copied(copied(thing)) for copied in COPIES]
    for one in (*copies, thing):
        np.testing.assert_array_equal(use(one), expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LEAVE_BEHIND, *WORLD])
def test_what_was_worked_out_on_demand_stays_behind(name):
    """A pickle is as long after use as before: a policy does not carry the instances that it priced last."""
    make, use = PUBLIC[name]
    thing = make()
    before = len(pickle.dumps(thing))
    use(thing)
    assert len(pickle.dumps(thing)) == before


@pytest.mark.parametrize("name", WORLD)
def test_copies_of_the_world_are_read_only(name):
    """Nobody writes into a copy of it, either."""
    thing = PUBLIC[name][0]()
    for again in (copied(thing) for copied in COPIES):
        writable = [path for path, array in arrays_within(again) if array.flags.writeable]
        assert all(path.endswith(("outside_by_group", "relative_utility", "surplus")) for path in writable), (
            writable
        )  # made anew for each who asks
