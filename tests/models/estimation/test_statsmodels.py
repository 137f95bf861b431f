"""The estimator behaves like a model of statsmodels: names, formulas, tables, tests, predictions, pickles."""

import numpy as np
import pandas as pd
import pytest
from statsmodels.base.model import LikelihoodModel, LikelihoodModelResults

from optkit.basics.errors import InputError
from optkit.models.estimation import ConditionalLogit, EstimationWarning

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def offers():
    """300 offers of two to four jobs, with an outside option; unordered index, labels as strings."""
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(300), rng.integers(2, 5, 300))
    n = len(groups)
    kind = rng.choice(["ride", "parcel"], n)
    data = pd.DataFrame(
        {"pay": rng.uniform(2, 8, n), "time": rng.uniform(0, 3, n), "kind": kind}, index=range(7, n + 7)
    )
    utility = data["pay"] - 2 * data["time"] - (kind == "parcel") - 2 + rng.gumbel(size=n)
    best, idle = np.full(300, -np.inf), rng.gumbel(size=300)
    np.maximum.at(best, groups, utility)
    data["taken"] = ((utility == best[groups]) & (best > idle)[groups]).astype(int)
    data["worker"] = [f"w{g}" for g in groups]
    return data


@pytest.fixture(scope="module")
def fitted(offers):
    return ConditionalLogit(offers["taken"], offers[["pay", "time"]], offers["worker"], outside_option=True).fit()


def test_model_and_results_are_those_of_statsmodels(fitted):
    assert isinstance(fitted.model, LikelihoodModel)
    assert isinstance(fitted._results, LikelihoodModelResults)


def test_names_of_a_dataframe_reach_everything(fitted):
    for series in (fitted.params, fitted.bse, fitted.tvalues, fitted.pvalues):
        assert list(series.index) == ["pay", "time"]
    assert list(fitted.cov_params().columns) == ["pay", "time"]
    assert list(fitted.conf_int().index) == ["pay", "time"]
    assert fitted.model.endog_names == "taken"
    text = fitted.summary().as_text()
    for word in ("taken", "pay", "time", "No. Situations:", "300", "Outside Chosen:", "nonrobust"):
        assert word in text
    assert "tabular" in fitted.summary().as_latex()
    assert "x1" in ConditionalLogit([1, 0] * 30, np.arange(60.0) ** 2 % 7, np.arange(60) // 2).fit().summary().as_text()


def test_statistics_follow_their_definitions(fitted):
    k, n = 2, 300
    assert fitted.nobs == n
    assert fitted.df_resid == n - k
    assert fitted.aic == pytest.approx(2 * k - 2 * fitted.llf, rel=1e-15)
    assert fitted.bic == pytest.approx(k * np.log(n) - 2 * fitted.llf, rel=1e-15)
    assert fitted.prsquared == pytest.approx(1 - fitted.llf / fitted.llnull, rel=1e-15)
    assert fitted.prsquared_adj == pytest.approx(1 - (fitted.llf - k) / fitted.llnull, rel=1e-15)
    assert fitted.tvalues.to_numpy() == pytest.approx((fitted.params / fitted.bse).to_numpy(), rel=1e-15)
    assert (
        -300 * np.log(5) < fitted.llnull < -300 * np.log(3)
    )  # equal shares of two to four jobs and the outside option
    assert fitted.bse.to_numpy() ** 2 == pytest.approx(np.diag(fitted.cov_params()), rel=1e-14)


def test_a_formula_is_its_columns(offers):
    formula = ConditionalLogit.from_formula(
        "taken ~ pay + time + C(kind)", offers, groups="worker", outside_option=True
    ).fit()
    by_hand = offers[["pay", "time"]].assign(ride=(offers["kind"] == "ride") * 1.0, one=1.0)
    columns = ConditionalLogit(offers["taken"], by_hand, offers["worker"], outside_option=True).fit()
    assert list(formula.params.index) == ["Intercept", "C(kind)[T.ride]", "pay", "time"]
    # Both searches end within 1e-10 standard errors.
    assert formula.params.to_numpy() == pytest.approx(
        columns.params[["one", "ride", "pay", "time"]].to_numpy(), rel=1e-8
    )
    assert formula.llf == pytest.approx(columns.llf, rel=1e-13)


def test_a_formula_sees_the_variables_of_its_caller(offers):
    def double(x):
        return 2 * x

    half = ConditionalLogit.from_formula("taken ~ 0 + double(pay)", offers, groups="worker", outside_option=True).fit()
    whole = ConditionalLogit.from_formula("taken ~ 0 + pay", offers, groups="worker", outside_option=True).fit()
    assert 2 * half.params.iloc[0] == pytest.approx(whole.params.iloc[0], rel=1e-9)


def test_a_formula_takes_columns_a_subset_and_a_boolean_choice(offers):
    data = offers.assign(taken=offers["taken"] == 1, known=0.5 * offers["time"], times=2.0, open=True)
    some = data["worker"].isin([f"w{i}" for i in range(200)])
    options = {"groups": "worker", "weights": "times", "available": "open", "offset": "known", "outside_option": True}
    results = ConditionalLogit.from_formula("taken ~ 0 + pay", data, subset=some, **options).fit()
    part = offers[some.to_numpy()]
    plain = ConditionalLogit(
        part["taken"], part[["pay"]], part["worker"], True, offset=0.5 * part["time"], weights=np.full(200, 2.0)
    ).fit()
    assert results.params.iloc[0] == pytest.approx(plain.params.iloc[0], rel=1e-12)
    assert results.nobs == 400
    new = data[~some].assign(open=False)
    assert (results.predict(new) == 0).all()


def test_weights_of_a_series_are_matched_by_label(offers):
    weights = pd.Series({f"w{i}": 1.0 + i % 3 for i in reversed(range(300))})
    columns = offers[["pay", "time"]]
    named = ConditionalLogit(offers["taken"], columns, offers["worker"], True, weights=weights).fit()
    rows = ConditionalLogit(
        offers["taken"], columns, offers["worker"], True, weights=offers["worker"].map(weights)
    ).fit()
    assert (named.params == rows.params).all()


def test_predictions_of_new_sets(fitted, offers):
    own = fitted.predict()
    assert (own.index == offers.index).all()
    swapped = offers.loc[offers.index[:6], ["time", "pay"]]
    again = fitted.predict(swapped, groups=offers["worker"].iloc[:6], available=[True] * 6)
    # Columns are matched by name; the first sets are complete, the last may not be.
    first = offers["worker"].iloc[:6] == "w0"
    assert again[first].to_numpy() == pytest.approx(own.iloc[:6][first].to_numpy(), rel=1e-14)
    one = fitted.predict(np.array([[5.0, 1.0], [5.0, 1.0], [9.0, 9.0]]), groups=["a", "a", "a"], available=[1, 1, 0])
    assert fitted.predict(np.ones((0, 2)), groups=[]).shape == (0,)
    assert (fitted.predict(np.ones((2, 2)), groups=["a", "b"], available=[0, 0]) == 0).all()
    weight = np.exp(5 * fitted.params["pay"] + fitted.params["time"])
    assert one == pytest.approx([weight / (1 + 2 * weight)] * 2 + [0.0], rel=1e-14)


def test_predictions_from_a_formula_find_the_situations_by_themselves(offers):
    results = ConditionalLogit.from_formula("taken ~ np.log(pay) + time", offers, groups="worker", outside_option=True)
    results = results.fit()
    assert results.predict(offers).to_numpy() == pytest.approx(results.predict().to_numpy(), rel=1e-14)
    assert (results.predict(offers).index == offers.index).all()


def test_hypotheses_are_tested_by_name(fitted):
    assert float(fitted.t_test("pay = 0").tvalue.squeeze()) == pytest.approx(fitted.tvalues["pay"], rel=1e-12)
    restriction = np.array([[2.0, 1.0]])
    wald = fitted.wald_test("2 * pay + time = 0", scalar=True)
    value = (restriction @ fitted.params.to_numpy()).item() ** 2
    assert wald.statistic == pytest.approx(
        value / (restriction @ fitted.cov_params() @ restriction.T).to_numpy().item()
    )
    both = fitted.wald_test(np.eye(2), scalar=True)
    b = fitted.params.to_numpy()
    assert both.statistic == pytest.approx(b @ np.linalg.inv(fitted.cov_params().to_numpy()) @ b)


def test_robust_errors_reach_the_tests(offers):
    model = ConditionalLogit(offers["taken"], offers[["pay", "time"]], offers["worker"], outside_option=True)
    robust = model.fit(cov_type="HC0")
    assert float(robust.t_test("pay = 0").sd.squeeze()) == pytest.approx(robust.bse["pay"], rel=1e-12)
    assert "HC0" in robust.summary().as_text()
    assert (robust.bse != model.fit().bse).all()


def test_results_survive_a_pickle(fitted, offers, tmp_path):
    fitted.save(tmp_path / "fit.pickle")
    loaded = type(fitted).load(tmp_path / "fit.pickle")
    assert (loaded.params == fitted.params).all()
    assert loaded.summary().tables[1].as_text() == fitted.summary().tables[1].as_text()
    loaded.remove_data()
    new = loaded.predict(np.ones((2, 2)), groups=[0, 0])
    assert new == pytest.approx(fitted.predict(np.ones((2, 2)), groups=[0, 0]), rel=1e-15)


def test_a_penalised_fit_says_so(offers):
    columns = offers[["pay", "time"]]
    results = ConditionalLogit(offers["taken"], columns, offers["worker"], True, penalty={"pay": 3.0}).fit()
    assert "conditional on the penalty" in results.summary().as_text()
    assert abs(results.params["pay"]) < 1


def test_data_of_any_numeric_kind_are_the_same(offers, fitted):
    columns = offers[["pay", "time"]].assign(cheap=offers["pay"] < 3, rank=np.arange(len(offers)) % 5)
    frame = ConditionalLogit(offers["taken"] == 1, columns, offers["worker"], True).fit()
    array = ConditionalLogit(list(offers["taken"]), columns.to_numpy(float), list(offers["worker"]), True).fit()
    assert frame.params.to_numpy() == pytest.approx(array.params, rel=1e-12)


def test_disp_prints_a_line(fitted, capsys):
    fitted.model.fit(disp=True)
    assert "terminated successfully" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r, d: r.predict(d[["pay"]], groups=d["worker"]), "exog has no column time"),
        (lambda r, d: r.predict(np.ones((2, 3)), groups=[0, 0]), "one column for each of pay, time"),
        (lambda r, d: r.predict(np.ones((2, 2))), "groups is missing"),
        (lambda r, d: r.predict(np.array([[1.0, np.nan]]), groups=[0]), "column time is nan in row 0"),
        (
            lambda r, d: r.predict(np.ones((2, 2)), groups=[0, 0], available=[1, 2]),
            "available is 2 in row 1",
        ),
        (lambda r, d: r.predict(np.ones((2, 2)), groups=[0]), "1 labels for 2 rows"),
        (lambda r, d: r.model.fit(cov_type="HC7"), "cov_type = 'HC7' is unknown"),
        (lambda r, d: r.model.fit(start_params=[1.0]), r"start_params, of shape \(1,\), is not 2 finite numbers"),
        (lambda r, d: ConditionalLogit.from_formula("taken ~ 0 + pay", d, groups="team"), "'team' is not a column"),
        (lambda r, d: ConditionalLogit.from_formula("kind ~ 0 + pay", d, groups="worker"), "multiple columns"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(fitted, offers, call, words):
    with pytest.raises(InputError, match=words) as caught:
        call(fitted, offers)
    assert "\n" not in str(caught.value)


def test_warnings_point_at_the_line_that_fits(offers):
    few = offers[offers["worker"].isin([f"w{i}" for i in range(15)])]
    model = ConditionalLogit(few["taken"], few[["pay", "time"]], few["worker"], outside_option=True)
    with pytest.warns(EstimationWarning, match="15 situations are few for 2 coefficients") as caught:
        model.fit()
    assert caught[0].filename == __file__
