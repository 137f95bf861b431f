"""Bad data: each an error or a warning in one line that names the column or the situation."""

import numpy as np
import pandas as pd
import pytest
from statsmodels.tools.sm_exceptions import ConvergenceWarning

from optkit.basics.errors import DataError, InputError
from optkit.models.estimation import ConditionalLogit, EstimationWarning, NotIdentifiedError

pytestmark = pytest.mark.filterwarnings("error")

SITUATIONS = 60


def sample(truth=(1.0, -0.5), outside=False, seed=0):
    """Sixty situations of three alternatives: choice, features by name, situation."""
    rng = np.random.default_rng(seed)
    groups = np.repeat([f"s{i}" for i in range(SITUATIONS)], 3)
    x = rng.normal(size=(3 * SITUATIONS, len(truth)))
    utility = (x @ np.asarray(truth) + rng.gumbel(size=len(x))).reshape(-1, 3)
    choice = utility == utility.max(axis=1, keepdims=True)
    if outside:
        choice &= utility > rng.gumbel(size=(SITUATIONS, 1))
    return choice.ravel().astype(float), pd.DataFrame(x, columns=["pay", "time"][: len(truth)]), groups


def changed(array, row, value):
    copy = np.array(array, dtype=object if isinstance(value, str) or value is None else float)
    copy[row] = value
    return copy


def frame(x, row, value):
    return x.assign(time=changed(x["time"], row, value))


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda y, x, g: (y, frame(x, 4, np.nan), g), "column time is nan in row 4"),
        (lambda y, x, g: (y, frame(x, 4, -np.inf), g), "column time is -inf in row 4"),
        (lambda y, x, g: (y, frame(x, 4, "long"), g), "column time does not hold numbers"),
        (lambda y, x, g: (changed(y, 5, np.nan), x, g), r"y is nan in row 5 \(situation 's1'\)"),
        (lambda y, x, g: (changed(y, 5, 2.0), x, g), r"y is 2 in row 5 \(situation 's1'\); give 0 or 1"),
        (
            lambda y, x, g: (changed(y, [6, 7, 8], 1.0), x, g),
            r"situation 's2' has 3 chosen alternatives \(row 6 and row 7\)",
        ),
        (
            lambda y, x, g: (changed(y, [6, 7, 8], 0.0), x, g),
            "situation 's2' has no chosen alternative .*outside_option",
        ),
        (lambda y, x, g: (y, x, changed(g, 3, None)), "groups is missing in row 3"),
        (lambda y, x, g: (y, x, g[1:]), "groups has 179 labels for 180 rows"),
        (lambda y, x, g: (y, x, np.array([g, g]).T), r"groups has shape \(180, 2\)"),
        (lambda y, x, g: (y, x, [[1]] * 180), "groups cannot serve as labels"),
        (lambda y, x, g: (y, x, None), "groups is missing"),
        (lambda y, x, g: (y[1:], x, g), "endog has 179 entries for the 180 rows"),
        (lambda y, x, g: (y, x[[]], g), "exog has no columns"),
        (lambda y, x, g: ([], np.ones((0, 2)), []), "no rows"),
        (lambda y, x, g: (pd.Series(y, index=range(1, 181)), x, g), "row 0 is called 0 in exog and 1 in endog"),
    ],
)
def test_malformed_data_are_refused(build, words):
    with pytest.raises(InputError, match=words) as caught:
        ConditionalLogit(*build(*sample()))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"weights": np.full(SITUATIONS, -1.0)}, "weight of situation 's0' is -1"),
        ({"weights": changed(np.ones(SITUATIONS), 9, np.nan)}, "weight of situation 's9' is nan"),
        ({"weights": changed(np.ones(180), 9, 2.0)}, "weights differ within situation 's3'"),
        ({"weights": 2.0}, "weights has shape"),
        ({"weights": np.ones(7)}, "one per row .180. or one per situation"),
        ({"weights": pd.Series(1.0, index=["s0", "s1"])}, "weights has no label 's2'"),
        ({"weights": np.zeros(SITUATIONS)}, "all weights are 0"),
        ({"weights": ["a"] * 180}, "weights does not hold numbers"),
        ({"available": np.zeros(180, bool)}, "chosen but not available"),
        ({"available": [True]}, "available has shape .1,.; give True or False for each of the 180 rows"),
        ({"offset": np.ones(3)}, "offset has shape .3,."),
        ({"offset": changed(np.ones(180), 2, np.nan)}, "column offset is nan in row 2"),
        ({"offset": ["a"] * 180}, "offset does not hold numbers"),
        ({"penalty": -1.0}, "penalty of pay is -1"),
        ({"penalty": [1.0, np.inf]}, "penalty of time is inf"),
        ({"penalty": {"wage": 1.0}}, "penalty names 'wage'; the columns are pay, time"),
        ({"penalty": [1.0, 2.0, 3.0]}, "one for each of the 2 columns"),
        ({"missing": "drop"}, "would change choice sets in silence"),
    ],
)
def test_malformed_options_are_refused(options, words):
    with pytest.raises(InputError, match=words) as caught:
        ConditionalLogit(*sample(), **options)
    assert "\n" not in str(caught.value)


def test_a_missing_value_is_not_dropped_by_a_formula():
    choice, x, groups = sample()
    data = frame(x, 4, np.nan).assign(choice=choice, trip=groups)
    with pytest.raises(InputError, match=r"the formula does not fit the data.*time.* missing"):
        ConditionalLogit.from_formula("choice ~ 0 + pay + time", data, groups="trip")


def test_a_column_that_never_varies_is_named():
    choice, x, groups = sample()
    # 0.1 + 0.2 style rounding within a set is not variation.
    income = np.repeat(np.arange(SITUATIONS) * 0.1, 3) * (1 + 1e-16 * np.arange(180))
    with pytest.raises(NotIdentifiedError, match="income never varies within a situation"):
        ConditionalLogit(choice, x.assign(income=income), groups).fit()
    with pytest.raises(DataError, match=r"const never varies .*outside_option=True"):
        ConditionalLogit(choice, x.assign(const=1.0), groups).fit()


def test_collinear_columns_are_named_with_their_combination():
    choice, x, groups = sample()
    sum_of_both = x["pay"] - 2 * x["time"] + np.repeat(np.arange(SITUATIONS), 3)
    data = x.assign(noise=np.random.default_rng(1).normal(size=180), both=sum_of_both)
    with pytest.raises(NotIdentifiedError, match="columns pay, time, both are collinear") as caught:
        ConditionalLogit(choice, data, groups).fit()
    direction = caught.value.direction
    assert direction / direction[3] == pytest.approx([-1.0, 2.0, 0.0, 1.0], abs=1e-6)


def test_with_an_outside_option_the_level_of_a_situation_means_something():
    choice, x, groups = sample(outside=True)
    data = x.assign(both=x["pay"] - 2 * x["time"] + np.repeat(np.arange(SITUATIONS) / 20, 3))
    assert np.isfinite(ConditionalLogit(choice, data, groups, outside_option=True).fit().bse).all()


def test_one_column_that_decides_everything_is_named():
    choice, x, groups = sample()
    told = x.assign(told=choice + 0.1 * np.random.default_rng(2).random(180))
    with pytest.raises(NotIdentifiedError, match=r"separated: .*along 1 told, which explains 60 of 60 choices"):
        ConditionalLogit(choice, told, groups).fit()


def test_perfect_separation_by_a_combination_is_named():
    _, x, groups = sample()
    utility = (x["pay"] - 0.3 * x["time"]).to_numpy().reshape(-1, 3)
    choice = (utility == utility.max(axis=1, keepdims=True)).ravel().astype(float)
    with pytest.raises(NotIdentifiedError, match=r"separated: .* pay .* time, which explains 60 of 60") as caught:
        ConditionalLogit(choice, x, groups).fit()
    margin = (x.to_numpy() @ caught.value.direction).reshape(-1, 3)
    # Proof: along the direction, every choice is the best of its set.
    assert (margin[choice.reshape(-1, 3) == 1] == margin.max(axis=1)).all()


def test_quasi_complete_separation_by_one_situation_is_found():
    """A dummy seen only on chosen alternatives: its coefficient would be infinite, the others are fine."""
    choice, x, groups = sample()
    brand = np.zeros(180)
    brand[np.flatnonzero(choice)[[3, 40]]] = 1.0
    data = x.assign(brand=brand)
    with pytest.raises(NotIdentifiedError, match="along 1 brand, which explains 2 of 60 choices"):
        ConditionalLogit(choice, data, groups).fit()
    mixed = data.assign(pay=data["pay"] + brand, time=data["time"] - 2 * brand)
    with pytest.raises(NotIdentifiedError, match="explains 2 of 60 choices"):
        ConditionalLogit(choice, mixed, groups).fit()


def test_a_penalty_settles_what_separation_leaves_open():
    choice, x, groups = sample()
    told = x.assign(told=choice)
    with pytest.raises(NotIdentifiedError):
        ConditionalLogit(choice, told, groups, penalty={"pay": 1.0}).fit()
    assert np.isfinite(ConditionalLogit(choice, told, groups, penalty={"told": 1.0}).fit().bse).all()


def test_nearly_separated_data_have_a_large_but_finite_estimate():
    """One choice among thousands speaks against: the maximum exists, and is found."""
    pay = np.tile([1.0, 0.0], 5000)
    choice = np.tile([1.0, 0.0], 5000)
    choice[:2] = 0.0, 1.0
    results = ConditionalLogit(choice, pay, np.repeat(np.arange(5000), 2)).fit()
    assert results.params == pytest.approx([np.log(4999)], rel=1e-9)
    # The information is p (1 - p) per situation, with p = 1 / 5000.
    assert results.bse == pytest.approx([(5000 * (4999 / 5000) * (1 / 5000)) ** -0.5], rel=1e-8)


@pytest.mark.parametrize(("accept", "words"), [(True, "no situation chose"), (False, "every situation chose")])
def test_without_rejections_or_without_choices_the_level_is_not_identified(accept, words):
    choice, x, groups = sample()
    data = x.assign(one=1.0)
    with pytest.raises(NotIdentifiedError, match=f"{words} the outside option, so the level .* along .*1 one;"):
        ConditionalLogit(choice * accept, data, groups, outside_option=True).fit()
    # The level may hide in dummies that add up to 1.
    ride = np.arange(180) % 2
    with pytest.raises(NotIdentifiedError, match=r"1 ride . 1 parcel"):
        ConditionalLogit(choice, x.assign(ride=ride, parcel=1 - ride), groups, outside_option=True).fit()
    with pytest.warns(EstimationWarning, match=f"{words} the outside option.* the data know least about"):
        penalised = ConditionalLogit(choice * accept, data, groups, outside_option=True, penalty=0.1).fit()
    # The penalty is all that is known of the level: its standard error is nearly that of the penalty alone.
    assert penalised.bse["one"] > 1
    # Without the outside option, the differences between offers are identified.
    if accept:
        assert np.isfinite(ConditionalLogit(choice, x, groups).fit().bse).all()


def test_columns_that_only_the_penalty_settles_are_named():
    choice, x, groups = sample()
    model = ConditionalLogit(choice, x.assign(copy=x["pay"]), groups, penalty=1.0)
    with pytest.warns(EstimationWarning, match="the penalty alone settles .* pay, copy are collinear"):
        results = model.fit()
    assert results.params["pay"] == pytest.approx(results.params["copy"], rel=1e-9)


def test_sets_of_one_are_counted_and_change_nothing():
    choice, x, groups = sample()
    alone = pd.concat([x, pd.DataFrame({"pay": [5.0, 7.0], "time": [1.0, 2.0]})], ignore_index=True)
    model = ConditionalLogit(np.append(choice, [1, 1]), alone, [*groups, "solo", "sola"])
    with pytest.warns(EstimationWarning, match="2 situations offer nothing but what was chosen"):
        results = model.fit()
    plain = ConditionalLogit(choice, x, groups).fit()
    assert results.params.to_numpy() == pytest.approx(plain.params.to_numpy(), rel=1e-12)
    assert results.nobs == plain.nobs == SITUATIONS
    assert results.predict().iloc[-1] == 1.0


def test_only_sets_of_one_are_nothing_to_fit():
    with pytest.raises(InputError, match="nothing is left to fit"):
        ConditionalLogit([1, 1], [[1.0], [2.0]], [0, 1]).fit()


def test_too_few_situations_are_said():
    choice, x, groups = sample()
    with pytest.warns(EstimationWarning, match="15 situations are few for 2 coefficients"):
        ConditionalLogit(choice[:45], x[:45], groups[:45]).fit()


def test_a_search_that_is_cut_short_says_so():
    model = ConditionalLogit(*sample())
    with pytest.warns(ConvergenceWarning, match="stopped after 1 steps"):
        results = model.fit(maxiter=1)
    assert not results.converged
    assert "ended before the maximum" in results.summary().as_text()
    with pytest.warns(ConvergenceWarning):
        model.fit(maxiter=0, disp=True)


def test_errors_in_the_data_of_a_formula_stay_what_they_are():
    choice, x, groups = sample()
    data = x.assign(choice=changed(choice, [0, 1, 2], 0.0), trip=groups)
    with pytest.raises(InputError, match=r"^situation 's0' has no chosen alternative"):
        ConditionalLogit.from_formula("choice ~ 0 + pay", data, groups="trip")
    with pytest.raises(TypeError, match="unexpected keyword argument 'colour'"):
        ConditionalLogit.from_formula("choice ~ 0 + pay", data, groups="trip", colour="red")


def test_few_rejections_are_told():
    """Two rejections in 400 situations are few, however many choices there are: the warning counts them."""
    rng = np.random.default_rng(0)
    x = pd.DataFrame({"level": 1.0, "pay": rng.normal(size=400)})
    chosen = np.ones(400)
    chosen[[3, 7]] = 0
    with pytest.warns(EstimationWarning, match="2 rejections are few"):
        ConditionalLogit(chosen, x, np.arange(400), outside_option=True).fit()


def test_huge_features_are_refused_by_name():
    """A column of 1e160 overflows when squared: it is refused with its name, not with an error of the solver's."""
    x = pd.DataFrame({"pay": [1.0, 2.0, 1.0, 3.0], "far": [1e160, 2.0, 1.0, 4.0]})
    with pytest.raises(InputError, match="far"):
        ConditionalLogit([1, 0, 0, 1], x, [0, 0, 1, 1])


@pytest.mark.parametrize("maxiter", [-1, -(10**9), 0.5, np.nan, None, True, "100", [3], np.inf])
def test_a_number_of_steps_is_a_whole_number(maxiter):
    """Of at least 0: anything else is one line, before the search, and never a search of no steps."""
    with pytest.raises(InputError, match=r"^maxiter = .* is not a whole number of at least 0$"):
        ConditionalLogit(*sample()).fit(maxiter=maxiter)
