"""Charges of who does not foresee, and the penalised bound beside policies."""

import numpy as np

from optkit.gap.charge_tests import charge_test


def rows(bound, reward, charge):
    """Rows of a report with one policy."""
    return {
        i: {"bounds": {"penalised": {"value": b}}, "policies": {"half": {"reward": r, "charge": c}}}
        for i, (b, r, c) in enumerate(zip(bound, reward, charge, strict=True))
    }


def test_what_is_as_it_must_be_is_not_contradicted():
    """Charges that cancel and a bound above the policy: p-values of draws are not small more often than they may."""
    rng = np.random.default_rng(0)
    p = [
        charge_test(rows(rng.normal(11, 3, 20), rng.normal(10, 3, 20), rng.normal(0, 2, 20)), ["half"]).p
        for _ in "x" * 400
    ]
    # One in a hundred of 400 is 4; four standard errors more are 12.
    assert np.mean(np.array(p) <= 0.01) < 12 / 400


def test_a_bound_below_a_policy_is_a_contradiction():
    """Paired: the days' luck is on both sides."""
    rng = np.random.default_rng(1)
    luck = rng.normal(0, 30, 25)
    found = charge_test(rows(100 + luck - 2, 100 + luck + rng.normal(0, 1, 25), rng.normal(0, 1, 25)), ["half"])
    assert found.contradicted
    assert "below what half earns" in found.told
    apart = charge_test(rows(98 + rng.normal(0, 30, 25), 100 + luck, rng.normal(0, 1, 25)), ["half"])
    assert not apart.contradicted


def test_a_mean_charge_is_a_contradiction_either_way():
    rng = np.random.default_rng(2)
    for sign in (1, -1):
        found = charge_test(rows(np.full(25, 200.0), rng.normal(0, 1, 25), sign * rng.normal(2, 1, 25)), ["half"])
        assert found.contradicted
        assert "is charged" in found.told


def test_what_was_learned_from_few_days_has_an_error_of_its_own():
    """The same charges are no contradiction if the process was learned from a few days only."""
    rng = np.random.default_rng(3)
    some = rows(np.full(100, 200.0), rng.normal(0, 1, 100), rng.normal(0.4, 1, 100))
    assert charge_test(some, ["half"]).contradicted
    assert not charge_test(some, ["half"], learned_from=10).contradicted


def test_days_that_are_all_alike_have_no_error():
    """A bound below the policy by the same on each day is one below it; equal numbers are none."""
    assert charge_test(rows([9.0] * 5, [10.0] * 5, [0.0] * 5), ["half"]).p == 0.0
    assert charge_test(rows([10.0] * 5, [10.0] * 5, [0.0] * 5), ["half"]).p == 1.0
    assert charge_test(rows([9.0], [10.0], [1.0]), ["half"]).p == 1.0
