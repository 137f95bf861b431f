"""The exact table as a value function."""

import numpy as np

from optkit.bounds.exact.exact_value import solve_exactly
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.exact.table import ExactTable
from optkit.models.value.request_sets import KnownRequests, RequestSets, removal_differences


def test_costs_are_differences_of_values():
    """All removals at once equal the value with less the value without (1e-12: the same table twice)."""
    model = SmallModel(
        horizon=5,
        reward=[30.0, 60.0],
        penalty=[-4.0, -9.0],
        lifetime=[2, 3],
        utility=[[-12.0, -20.0], [-25.0, -5.0]],
        mu=[3.0, 6.0],
        arrivals=[0.5, 0.3],
        workers=[0.5, 0.5],
    )
    table = ExactTable(solve_exactly(model))
    # One request of each type for each step at which it may have come, and padding.
    kind, arrival = np.array([0, 0, 1, 1, 0]), np.array([0, 1, 0, 1, 0])
    n = kind.size
    expiry = np.minimum(arrival + model.lifetime[kind], 4)
    places = (np.zeros((n, 1)), kind, np.zeros(n, np.int64))
    requests = KnownRequests(np.zeros(n), np.zeros(n), arrival, expiry, np.zeros((2, n)), *places)
    member = (np.arange(16)[:, None] >> np.arange(4) & 1).astype(bool)
    member = np.concatenate([member, np.zeros((16, 1), bool)], axis=1)
    sets = RequestSets(requests, 1, np.broadcast_to(np.arange(n), member.shape), member)
    np.testing.assert_allclose(table.opportunity_cost(sets), removal_differences(table.value, sets), atol=1e-12)
    assert (table.value(sets) != table.value(sets)[0]).any()
