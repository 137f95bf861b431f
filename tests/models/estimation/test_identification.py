"""The identification report: what the choices can tell, and about which combination they say least."""

import numpy as np
import pandas as pd
import pytest

from optkit.models.estimation import ConditionalLogit, EstimationWarning, identification

pytestmark = pytest.mark.filterwarnings("error")


def offers(level, situations=2000, seed=0):
    """Offers of one or two jobs at wages of one to three; the outside option is worth ``-level``."""
    rng = np.random.default_rng(seed)
    groups = np.repeat(np.arange(situations), rng.integers(1, 3, situations))
    data = pd.DataFrame({"level": 1.0, "wage": rng.uniform(1, 3, len(groups))})
    utility = level + data["wage"].to_numpy() + rng.gumbel(size=len(groups))
    best = np.full(situations, -np.inf)
    np.maximum.at(best, groups, utility)
    choice = (utility == best[groups]) & (best > rng.gumbel(size=situations))[groups]
    return ConditionalLogit(choice, data, groups, outside_option=True)


def test_balanced_data_identify_everything():
    model = offers(-2.0)
    report = identification(model)
    assert report.verdict == "identified"
    assert report.situations == report.choices + report.rejections == 2000
    assert report.rejections == model.rejections > 300
    assert report.condition_number == pytest.approx(report.eigenvalues[-1] / report.eigenvalues[0])


def test_the_report_follows_its_definition():
    """Eigenvalues of the information, each column scaled to unit deviation within the sets at equal shares."""
    model = offers(-2.0, 200)
    results = model.fit()
    report = results.identification()
    x, groups = np.asarray(model.exog), np.asarray(model.groups)
    spread = np.zeros((2, 2))
    for s in range(200):
        part = np.vstack([x[groups == s], np.zeros(2)])  # the outside option is an alternative of the set
        spread += np.cov(part.T, bias=True)
    unit = np.sqrt(np.diag(spread) / 200)
    information = model.information(results.params) / np.outer(unit, unit)
    values, vectors = np.linalg.eigh(information)
    assert report.eigenvalues == pytest.approx(values, rel=1e-8)
    assert np.abs(report.weakest.to_numpy() @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-10)
    assert report.weakest.max() == report.weakest.abs().max()  # of the two signs, the one that reads better
    assert report.weakest_error == pytest.approx(values[0] ** -0.5, rel=1e-8)
    # It is the standard error of that combination of scaled coefficients, as any other way to compute it.
    along = report.weakest.to_numpy() * unit
    assert report.weakest_error == pytest.approx(np.sqrt(along @ results.cov_params().to_numpy() @ along), rel=1e-8)


def test_offers_that_are_almost_never_rejected_leave_the_level_weak():
    model = offers(4.5, 200)
    assert model.rejections == 1
    report = identification(model)
    assert report.verdict == "weak"
    assert report.weakest.abs().idxmax() == "level"
    assert report.weakest_error > 0.5
    assert "standard error above 0.5" in report.summary()


def test_offers_that_nobody_rejects_leave_the_level_open():
    model = offers(30.0, 200)
    assert model.rejections == 0
    report = identification(model)
    assert report.verdict == "not identified"
    assert report.weakest.to_dict() == pytest.approx({"level": 1.0, "wage": 0.0})
    assert report.weakest_error == report.condition_number == np.inf
    assert "no situation chose the outside option" in report.reason
    for words in ("not identified", "200 choices, 0 rejections", "1 level", "inf"):
        assert words in report.summary()


def test_a_penalty_adds_nothing_to_what_the_data_say():
    bare, held = offers(30.0, 200), offers(30.0, 200)
    held.penalties[:] = 1.0
    assert identification(held).verdict == "not identified"
    assert identification(held).weakest.to_dict() == identification(bare).weakest.to_dict()
    with pytest.warns(EstimationWarning):
        assert identification(held.fit()).verdict == "not identified"


def test_constant_and_collinear_columns_are_the_weakest():
    rng = np.random.default_rng(0)
    x = pd.DataFrame(rng.normal(size=(300, 2)), columns=["a", "b"])
    groups = np.repeat(np.arange(100), 3)
    choice = np.zeros(300)
    choice[np.arange(100) * 3 + rng.integers(0, 3, 100)] = 1
    constant = identification(ConditionalLogit(choice, x.assign(c=groups * 1.0), groups))
    assert constant.weakest.to_dict() == pytest.approx({"a": 0.0, "b": 0.0, "c": 1.0})
    assert constant.eigenvalues[0] == 0
    twice = identification(ConditionalLogit(choice, x.assign(c=2 * x["a"]), groups))
    # In scaled coefficients, a and its double are the same column.
    assert twice.weakest.abs().to_dict() == pytest.approx({"a": 0.5**0.5, "b": 0.0, "c": 0.5**0.5}, abs=1e-6)
    assert twice.weakest["a"] * twice.weakest["c"] < 0
    assert twice.verdict == "not identified"


def test_the_report_of_a_model_is_that_of_its_results():
    model = offers(-2.0, 300)
    one, other = identification(model), identification(model.fit())
    assert one.summary() == other.summary()
