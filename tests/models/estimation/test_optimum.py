"""A result is the estimate, by proof, or there is none: hard choices against a reference of 50 digits."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest
from statsmodels.tools.sm_exceptions import ConvergenceWarning

from optkit.basics.errors import SolverError
from optkit.models.estimation import ConditionalLogit, NotIdentifiedError
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers
from tests.models.estimation.fifty_digits import outcome


@pytest.mark.slow
def test_hard_choices_are_estimated_or_refused():
    """Scales from 1e-6 to 1e6, offsets to 1e5, any start and tolerance: refused, or the reference's estimate."""
    found = Counter(outcome(seed, most_sets=30) for seed in range(45))
    assert min(found["right"], found["refused"]) >= 15


@pytest.mark.parametrize(("seed", "ends"), [(200260, "refused"), (201230, "right"), (202096, "right")])
def test_flat_spots_on_the_way_are_crossed(seed, ends):
    """Offsets so large that the likelihood is a chain of straight pieces, without curvature to follow but at kinks."""
    assert outcome(seed, most_sets=40) == ends


@pytest.mark.slow
def test_separation_is_refused_at_any_tolerance():
    """In each set the larger x is chosen: Albert and Anderson (1984), no estimate, however near is near enough."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(100, 2))
    chosen = x.argmax(axis=1)[:, None] == np.arange(2)
    model = ConditionalLogit(chosen.ravel(), x.reshape(-1, 1), np.repeat(np.arange(100), 2))
    for tolerance in (0.0, 1e-10, 1e-6, 1e-4, 1e-3, 1e-2, 1.0, 1e300):
        for start in (None, [3.0], [-1e6], [1e12], [1e99]):
            with pytest.raises(NotIdentifiedError, match="separated"):
                model.fit(start, tol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 1e2, 1e4, 1e6])
@pytest.mark.parametrize("steep", ["offset", "column"])
def test_a_dummy_that_is_never_chosen_is_refused_beside_anything(scale, steep):
    rng, S = np.random.default_rng(0), 300
    first = rng.normal(size=2 * S)
    offset = scale * rng.normal(size=2 * S) if steep == "offset" else None
    if steep == "column":  # half of the situations offer nearly the same, so that a finite steep coefficient exists
        pairs = first.reshape(S, 2)
        near = rng.random(S) < 0.5
        pairs[near, 1] = pairs[near, 0] + rng.normal(size=near.sum()) / scale
    dummy = (np.arange(2 * S) % 2 == 1) & (rng.random(2 * S) < 0.3)
    utility = scale * first + (0.0 if offset is None else offset) + rng.gumbel(size=2 * S)
    utility[dummy] = -1e12
    choice = (utility.reshape(S, 2).argmax(axis=1)[:, None] == np.arange(2)).ravel()
    groups = np.repeat(np.arange(S), 2)
    with pytest.raises(NotIdentifiedError, match=r"separated: .* along -?\s?1 x2"):
        ConditionalLogit(choice, np.column_stack([first, dummy]), groups, offset=offset).fit()
    if offset is not None and scale > 1e2:
        return  # choices between sums of such noise are all but certain: they leave the slope open as well
    # Without the dummy, and where it decides nothing, the estimate is there.
    kept = ~np.isin(groups, groups[dummy])
    rest = ConditionalLogit(choice[kept], first[kept], groups[kept], offset=None if offset is None else offset[kept])
    results = rest.fit()
    assert abs(results.params[0] - scale) < 4 * results.bse[0]


@pytest.mark.parametrize("noise", [1.0, 1e-3])
def test_preferences_for_what_nobody_ever_takes_are_refused(noise):
    """Requests with stairs are never taken: whatever the noise of the workers, how bad stairs are is not known."""
    rng, n = np.random.default_rng(5), 400
    km, pay = rng.uniform(1, 8, (n, 2)), rng.uniform(2, 12, (n, 2))
    stairs = (rng.random((n, 2)) < 0.3) & (np.arange(2) == 1)
    near = rng.random(n) < 0.7
    pay[near] = 3 + 1.2 * km[near] + noise * rng.normal(size=(near.sum(), 2))
    shock = rng.gumbel(-noise * np.euler_gamma, noise, (n, 3))
    best = (np.column_stack([-3 - 1.2 * km + pay - 1e9 * stairs, np.zeros(n)]) + shock).argmax(axis=1)
    columns = {"km": km.ravel(), "stairs": stairs.ravel() * 1.0, "compensation": pay.ravel()}
    taken = (best[:, None] == np.arange(2)).ravel()
    log = pd.DataFrame({"situation": np.repeat(np.arange(n), 2), **columns, "chosen": taken})
    with pytest.raises(NotIdentifiedError, match=r"separated: .* along -?\s?1 stairs"):
        fit_preferences(Offers.from_frame(log))
    without = log[log.groupby("situation")["stairs"].transform("max") == 0].drop(columns="stairs")
    known = fit_preferences(Offers.from_frame(without))
    assert known.scale[0] == pytest.approx(noise, rel=0.5)


def test_a_likelihood_that_is_flat_to_the_last_digit_is_refused():
    """Choices that an offset of 1e4 explains in full say nothing, although nothing is separated."""
    rng = np.random.default_rng(0)
    x, offset = rng.normal(size=200), 1e4 * np.tile([1.0, -1.0], 100)
    model = ConditionalLogit(np.tile([1, 0], 100), x, np.repeat(np.arange(100), 2), offset=offset)
    with pytest.raises(NotIdentifiedError, match="nothing about 1 x1 that exceeds rounding"):
        model.fit()
    assert np.isfinite(ConditionalLogit(model.endog, x, model.groups, offset=offset, penalty=1.0).fit().bse).all()


def test_a_search_cut_short_on_a_flat_spot_is_an_error():
    """At coefficients of 0 the offset drowns everything; to stop there leaves no standard errors, which are not NaN."""
    rng = np.random.default_rng(0)
    x, choice = rng.normal(size=200), np.tile([1, 0], 100)
    x, choice = np.column_stack([x, choice]), np.where(rng.random(100) < 0.7, 1, 0)
    choice = np.column_stack([choice, 1 - choice]).ravel()
    model = ConditionalLogit(choice, x, np.repeat(np.arange(100), 2), offset=-1e5 * x[:, 1])
    assert model.fit().params[1] == pytest.approx(1e5, abs=2.0)
    with (
        pytest.warns(ConvergenceWarning),
        pytest.raises(SolverError, match=r"cut short after 0 steps, .* raise maxiter"),
    ):
        model.fit(maxiter=0)
