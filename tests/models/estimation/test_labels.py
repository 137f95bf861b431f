"""Every argument that has labels finds its rows by them, in any order, or is refused; so do columns by their names."""

import copy
import pickle
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from optkit.basics.errors import DataError, InputError
from optkit.models.estimation import ConditionalLogit
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers

pytestmark = pytest.mark.filterwarnings("error")

S = 120
NAMES = ("endog", "groups", "available", "weights", "offset")


@pytest.fixture(scope="module")
def data():
    """120 situations of three rows, called r0, r3, ...; one of each is perhaps not available."""
    rng = np.random.default_rng(0)
    n = 3 * S
    d = pd.DataFrame({"pay": rng.normal(size=n), "km": rng.normal(size=n), "offset": rng.normal(size=n)})
    d["groups"] = np.repeat([f"s{i}" for i in rng.permutation(S)], 3)
    d["available"] = (np.arange(n) % 3 != 2) | (rng.random(n) < 0.5)
    d["weights"] = np.repeat(rng.integers(1, 4, S), 3)
    utility = (d.pay - d.km + d.offset + rng.gumbel(size=n)).where(d.available, -np.inf).to_numpy().reshape(S, 3)
    d["endog"] = (utility.argmax(axis=1)[:, None] == np.arange(3)).ravel().astype(int)
    return d.set_axis([f"r{i}" for i in range(0, 3 * n, 3)])


@pytest.fixture(scope="module")
def right(data):
    """The estimate of plain arrays."""
    given = {name: data[name].to_numpy() for name in NAMES}
    return ConditionalLogit(exog=data[["pay", "km"]].to_numpy(), **given).fit().params


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("way", ["class", "formula"])
def test_a_shuffled_argument_finds_its_rows(data, right, name, way):
    given = {one: data[one] for one in NAMES}
    given[name] = given[name].sample(frac=1.0, random_state=1)
    if way == "class":
        got = ConditionalLogit(exog=data[["pay", "km"]], **given).fit()
    else:
        table = data.assign(endog=given.pop("endog"))
        got = ConditionalLogit.from_formula("endog ~ pay + km", table[["endog", "pay", "km"]], **given).fit()
    assert got.params[["pay", "km"]].to_numpy() == pytest.approx(right, rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("labels", [range(3 * S), [f"r{i}" for i in range(3 * S)], ["r0"] * (3 * S)])
def test_other_labels_are_refused(data, name, labels):
    given = {one: data[one] for one in NAMES} | {name: data[name].set_axis(list(labels))}
    with pytest.raises(InputError, match=rf"{name}.* label|row \d+ is called .* in {name}") as caught:
        ConditionalLogit(exog=data[["pay", "km"]], **given)
    assert "\n" not in str(caught.value)
    if name == "endog":
        return
    table = data.drop(columns=name)
    given.pop("endog")
    with pytest.raises(InputError, match=rf"{name}.* label|row \d+ is called .* in {name}"):
        ConditionalLogit.from_formula("endog ~ pay + km", table, **given)


def test_arrays_are_taken_by_place_and_labels_must_agree_among_each_other(data, right):
    x = data[["pay", "km"]].to_numpy()
    given = {name: data[name] for name in NAMES}
    for offset in (data["offset"], data["offset"].sort_values()):
        got = ConditionalLogit(exog=x, **given | {"offset": offset}).fit().params
        assert got.to_numpy() == pytest.approx(right, rel=1e-10)
    arrays = {name: data[name].to_numpy() for name in NAMES}
    alone = data["offset"].reset_index(drop=True).sort_values()
    with pytest.raises(InputError, match="offset has the row labels 0 to 359 in another order, and exog has none"):
        ConditionalLogit(exog=x, **arrays | {"offset": alone})


def test_weights_go_by_row_or_by_situation(data, right):
    given = {name: data[name] for name in NAMES}
    by_situation = data.drop_duplicates("groups").set_index("groups")["weights"]
    for weights in (
        by_situation,
        by_situation.sample(frac=1.0, random_state=0),
        by_situation.to_numpy(),
        data["weights"],
    ):
        got = ConditionalLogit(exog=data[["pay", "km"]], **given | {"weights": weights}).fit()
        assert got.params.to_numpy() == pytest.approx(right, rel=1e-10)
    twice = pd.concat([by_situation, by_situation[["s7"]]])
    with pytest.raises(InputError, match="weights has the label 's7' twice"):
        ConditionalLogit(exog=data[["pay", "km"]], **given | {"weights": twice})
    # One row a situation, and labels of rows that are labels of situations too: which of the two is meant?
    x, groups = pd.DataFrame({"pay": [1.0, 2.0, 3.0]}), pd.Series([2, 0, 1])
    with pytest.raises(InputError, match="weights has labels that are those of rows and of situations"):
        ConditionalLogit([1, 0, 1], x, groups, True, weights=pd.Series([1.0, 2.0, 3.0]))


def test_predictions_find_their_rows(data):
    given = {name: data[name] for name in NAMES}
    fitted = ConditionalLogit(exog=data[["pay", "km"]], **given).fit()
    formula = ConditionalLogit.from_formula("endog ~ pay + km", data, **{name: name for name in NAMES[1:]}).fit()
    own = {name: data[name] for name in ("groups", "available", "offset")}
    right = fitted.predict(data, **own)
    assert right.to_numpy() == pytest.approx(fitted.predict(), rel=1e-12)
    for name in own:
        moved = own | {name: own[name].sample(frac=1.0, random_state=2)}
        assert (fitted.predict(data, **moved) == right).all()
        assert formula.predict(data, **moved).to_numpy() == pytest.approx(right.to_numpy(), rel=1e-9)
        wrong = own | {name: own[name].reset_index(drop=True)}
        for results in (fitted, formula):
            with pytest.raises(InputError, match=f"row 0 is called 'r0' in exog and 0 in {name}"):
                results.predict(data, **wrong)
    with pytest.raises(InputError, match="offset = 'offset' is not a column of exog"):
        formula.predict(data.drop(columns="offset"))


class OtherFrame:
    """A table of some other library: names of columns, and an array."""

    def __init__(self, frame):
        self.columns, self._frame = list(frame.columns), frame

    def __array__(self, dtype=None, copy=None):
        return self._frame.to_numpy(dtype=dtype)


FRAMES = {
    "pandas": lambda f: f,
    "other": OtherFrame,
    "arrow": lambda f: pa.Table.from_pandas(f, preserve_index=False),
    "dict": lambda f: {name: f[name].tolist() for name in f},
    "records": lambda f: f.to_records(index=False),
    "nullable": lambda f: f.convert_dtypes(),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FRAMES)
def test_columns_of_any_table_go_by_name(data, kind):
    given = {name: data[name] for name in NAMES}
    fitted = ConditionalLogit(exog=data[["pay", "km"]], **given).fit()
    turned = data[["km", "pay"]].assign(more=1.0)
    again = ConditionalLogit(exog=FRAMES[kind](turned[["km", "pay"]]), **given).fit()
    assert again.params[["pay", "km"]].to_numpy() == pytest.approx(fitted.params.to_numpy(), rel=1e-10)
    new = turned.reset_index(drop=True)
    got = fitted.predict(FRAMES[kind](new), groups=data["groups"].to_numpy())
    assert np.asarray(got) == pytest.approx(fitted.predict(turned, groups=data["groups"]).to_numpy(), rel=1e-14)
    with pytest.raises(InputError, match="exog has no column km; it has pay"):
        fitted.predict(FRAMES[kind](new[["pay"]]), groups=data["groups"].to_numpy())


def test_columns_may_be_called_anything_once():
    rng = np.random.default_rng(0)
    x, groups = rng.integers(-9, 9, (2 * S, 2)), np.repeat(np.arange(S), 2)
    chosen = (x @ [0.1, -0.1] + rng.gumbel(size=2 * S)).reshape(S, 2).argmax(axis=1)
    y = (chosen[:, None] == np.arange(2)).ravel()
    right = ConditionalLogit(y, x, groups).fit().params
    names = {"int": [0, 1], "tuples": [("a", 1), ("a", "y")], "self": ["self", "b"], "kinds": [0, "b"]}
    for kind, columns in names.items():
        many = isinstance(columns[0], tuple)
        frame = pd.DataFrame(x, columns=pd.MultiIndex.from_tuples(columns) if many else columns)
        for dtype in (int, "float32", bool) if kind == "int" else (int,):
            model = ConditionalLogit(y, frame.astype(dtype), groups)
            results = model.fit()
            if dtype is not bool:
                assert results.params.to_numpy() == pytest.approx(right, rel=1e-9)
            swapped = frame.astype(dtype).iloc[:, ::-1]
            assert results.predict(swapped, groups=groups).to_numpy() == pytest.approx(results.predict(), rel=1e-12)
            assert str(results.params.index[0]) in str(results.summary())
            assert model.fit(results.params).params.to_numpy() == pytest.approx(results.params.to_numpy(), rel=1e-9)
    with pytest.raises(InputError, match="exog has the column '0' twice"):
        ConditionalLogit(y, pd.DataFrame(x, columns=[0, "0"]), groups)


def test_one_alternative_or_one_column_may_be_a_series(data):
    given = {name: data[name] for name in NAMES}
    fitted = ConditionalLogit(exog=data[["pay", "km"]], **given).fit()
    one = pd.Series({"km": 1.0, "pay": 2.0})
    assert fitted.predict(one, groups=["a"]) == pytest.approx([1.0])
    single = ConditionalLogit(exog=data["pay"], **given).fit()
    assert list(single.params.index) == ["pay"]
    column, frame = (single.predict(x, groups=data["groups"]) for x in (data["pay"], data[["pay"]]))
    assert (column == frame).all()


@pytest.mark.parametrize("name", ["start_params", "penalty"])
def test_coefficients_go_by_name(data, name):
    given = {one: data[one] for one in NAMES} | {"exog": data[["pay", "km"]]}
    numbers = pd.Series({"km": 0.5, "pay": 2.0})

    def fit(value):
        options = {name: value}
        penalty = options.pop("penalty", 0.0)
        return ConditionalLogit(**given, penalty=penalty).fit(**options).params.to_numpy()

    assert fit(numbers) == pytest.approx(fit(dict(numbers)), rel=1e-14)
    assert fit(numbers) == pytest.approx(fit([2.0, 0.5]), rel=1e-14)
    with pytest.raises(InputError, match=f"{name} names 'wage'; the columns are pay, km"):
        fit(pd.Series({"wage": 1.0, "pay": 1.0}))


@pytest.mark.parametrize("name", ["situation", "compensation", "chosen", "group"])
def test_offers_made_of_columns_find_their_rows(data, name):
    """What fit_preferences is given: a log of labelled columns is matched by label, too."""
    rng, n = np.random.default_rng(3), 400
    d = pd.DataFrame({"situation": np.repeat(np.arange(n), 2)}, index=rng.permutation(2 * n))
    d["km"] = rng.uniform(1, 8, 2 * n)
    d["compensation"], d["group"] = rng.uniform(2, 12, 2 * n), 0
    utility = np.column_stack([(d.compensation - d.km).to_numpy().reshape(n, 2), np.full(n, 3.0)])
    best = (utility + rng.gumbel(size=(n, 3))).argmax(axis=1)
    d["chosen"] = (best[:, None] == np.arange(2)).ravel().astype(int)
    right = fit_preferences(Offers.from_frame(d)).weights
    zero = pd.Series(0, index=d.index)
    columns = {"features": d[["km"]], "pickup": zero, "dropoff": zero, "names": ("km",)}
    columns |= {one: d[one] for one in ("situation", "compensation", "chosen", "group")}
    moved = Offers(**columns | {name: d[name].sort_index(ascending=False)})
    assert fit_preferences(moved).weights == pytest.approx(right, rel=1e-10)
    assert fit_preferences(Offers.from_frame(OtherFrame(d.drop(columns="group")))).weights == pytest.approx(right)
    with pytest.raises(DataError, match=f"row 0 is called .* in situation|in {name}"):
        Offers(**columns | {name: d[name].set_axis(d.index + 1)})


def test_labels_survive_copies(data):
    fitted = ConditionalLogit(exog=data[["pay", "km"]], **{name: data[name] for name in NAMES}).fit()
    new = data[["km", "pay"]].iloc[:6]
    for again in (copy.deepcopy(fitted), pickle.loads(pickle.dumps(fitted))):
        got = again.predict(new, groups=data["groups"].iloc[:6].iloc[::-1])
        assert (got == fitted.predict(new, groups=data["groups"].iloc[:6])).all()


def test_combinations_of_coefficients_go_by_name(data):
    given = {name: data[name] for name in NAMES}
    fitted = ConditionalLogit(exog=data[["pay", "km"]], **given).fit()
    cov = fitted.cov_params() * np.array([[2.0, 1.0], [1.0, 1.0]])
    rng = np.random.default_rng(0)
    for _ in range(2):
        rows = rng.normal(size=(2, 2))
        right = {"pay": rows[:, 0], "km": rows[:, 1]}
        for order in (["pay", "km"], ["km", "pay"]):
            table = pd.DataFrame(right)[order]
            one, swapped = table.iloc[0], cov.loc[order, order[::-1]]
            for test in ("t_test", "wald_test", "f_test"):
                ask = getattr(fitted, test)
                assert ask(table).pvalue == pytest.approx(ask(rows).pvalue, rel=1e-9)
                assert ask(one).pvalue == pytest.approx(ask(rows[0]).pvalue, rel=1e-9)
                assert ask((table, [0.5, 1.0])).pvalue == pytest.approx(ask((rows, [0.5, 1.0])).pvalue, rel=1e-9)
                by_place = ask(rows[0], cov_p=cov.to_numpy()).pvalue
                assert ask(one, cov_p=swapped).pvalue == pytest.approx(by_place, rel=1e-9)
    assert fitted.t_test("pay = 1, km = 0").pvalue.shape == (2,)
    for strange in (
        pd.Series([1.0, 0.0]),
        pd.Series({"pay": 1.0}),
        pd.Series([1.0, 0.0, 1.0], ["pay", "km", "pay"]),
        pd.Series({"pay": 1.0, "km": 0.0, "other": 0.0}),
        pd.DataFrame({"pay": [1.0], "kilometres": [0.0]}),
        np.ones(3),
        np.ones((2, 3)),
        [np.nan, 1.0],
        [0.0, 0.0],
        [[1.0, 0.0], [0.0, 0.0]],
    ):
        for test in ("t_test", "wald_test", "f_test"):
            with pytest.raises(InputError, match="r_matrix"):
                getattr(fitted, test)(strange)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # statsmodels' own, of the rank
        with pytest.raises(InputError, match="nothing to test"):
            fitted.wald_test("pay = 0", cov_p=np.zeros((2, 2)))
