"""Formulas: categories against a base, rows that are not available, flags, copies; errors name column and row."""

import copy
import pickle

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import InputError
from optkit.models.estimation import ConditionalLogit

pytestmark = pytest.mark.filterwarnings("error")

S = 200


@pytest.fixture(scope="module")
def data():
    """200 situations of three brands at a price."""
    rng = np.random.default_rng(0)
    n = 3 * S
    d = pd.DataFrame(
        {"price": rng.normal(size=n), "brand": rng.choice(list("abc"), n), "s": np.repeat(np.arange(S), 3)}
    )
    d["sale"], d["zone"] = rng.random(n) < 0.4, pd.Categorical(rng.integers(1, 5, n))
    utility = -d.price + d.brand.map({"a": 0.0, "b": 0.5, "c": -1.0}) + 0.5 * d.sale + rng.gumbel(size=n)
    d["choice"] = 0
    d.loc[utility.groupby(d.s).idxmax(), "choice"] = 1
    return d


def dummies(data, *columns):
    return pd.get_dummies(data[["price", *columns]], columns=list(columns), drop_first=True)


@pytest.mark.slow
@pytest.mark.parametrize("zero", ["0 + ", ""])
@pytest.mark.parametrize("columns", [("brand",), ("zone",), ("brand", "zone", "sale"), ()])
def test_one_level_is_the_base_without_an_outside_option(data, zero, columns):
    wanted = ConditionalLogit(data.choice, dummies(data, *columns), data.s).fit()
    formula = f"choice ~ {zero}price" + "".join(f" + C({name})" for name in columns)
    got = ConditionalLogit.from_formula(formula, data, groups="s").fit()
    assert got.params["price"] == pytest.approx(wanted.params["price"], rel=1e-9)
    assert sorted(got.params) == pytest.approx(sorted(wanted.params), rel=1e-8)
    assert got.llf == pytest.approx(wanted.llf, rel=1e-12)
    assert got.model.formula == formula
    new = data.iloc[6:12]
    kept = wanted.predict(dummies(data, *columns).iloc[6:12], groups=new.s).to_numpy()
    assert got.predict(new).to_numpy() == pytest.approx(kept, rel=1e-8)


def test_text_and_categories_have_one_effect_per_level(data):
    by_name = ConditionalLogit.from_formula("choice ~ price + brand + zone", data, groups="s")
    assert by_name.exog.shape[1] == 1 + 2 + 3
    for column, kind in (("brand", "str"), ("zone", "category")):
        with pytest.raises(InputError, match=rf"column {column} does not hold numbers \({kind}|object.*C\(\.\.\.\)"):
            ConditionalLogit(data.choice, data[["price", column]], data.s)
    text = data.zone.astype(str)
    for strange in (text, text.astype(object), pd.to_datetime(data.s), 1j * data.price):
        with pytest.raises(InputError, match="column zone does not hold numbers"):
            ConditionalLogit(data.choice, data[["price"]].assign(zone=strange), data.s)
    with pytest.raises(InputError, match="exog does not hold numbers"):
        ConditionalLogit(data.choice, data[["zone"]].astype(str).to_numpy(dtype=str), data.s)


def test_with_an_outside_option_a_formula_is_taken_as_it_is_written(data):
    rng = np.random.default_rng(1)
    rejected = data.assign(choice=data.choice * np.repeat(rng.random(S) < 0.8, 3))
    full = ConditionalLogit.from_formula("choice ~ 0 + price + brand", rejected, groups="s", outside_option=True).fit()
    base = ConditionalLogit.from_formula("choice ~ price + brand", rejected, groups="s", outside_option=True).fit()
    assert len(full.params) == len(base.params) == 4
    assert full.params["brand[b]"] - full.params["brand[a]"] == pytest.approx(base.params["brand[T.b]"], rel=1e-8)
    assert full.params["brand[a]"] == pytest.approx(base.params["Intercept"], rel=1e-8)


@pytest.mark.slow
def test_rows_that_are_not_available_may_hold_anything(data):
    hidden = (data.choice == 0) & (data.index % 7 == 0)
    d = data.assign(open=~hidden).set_axis([f"r{i}" for i in range(3 * S)])
    hidden = ~d.open
    d.loc[hidden, "price"], d.loc[hidden, "brand"] = np.nan, "never seen elsewhere"
    d["sale"] = d["sale"].astype("boolean").mask(hidden)
    x = dummies(d.assign(sale=d.sale.fillna(False).astype(bool)), "brand", "sale")
    right = ConditionalLogit(d.choice, x.drop(columns="brand_never seen elsewhere"), d.s, available=d.open).fit()
    for available in ("open", d.open.sample(frac=1.0, random_state=0), d.open.to_numpy(), d.open.astype(int).tolist()):
        formula = "choice ~ price + C(brand) + sale"
        got = ConditionalLogit.from_formula(formula, d, groups="s", available=available).fit()
        assert got.params["price"] == pytest.approx(right.params["price"], rel=1e-10)
        assert got.llf == pytest.approx(right.llf, rel=1e-12)
        assert got.predict().to_numpy() == pytest.approx(right.predict().to_numpy(), rel=1e-8)
        assert (got.predict().index == d.index).all()
        again = got.predict(d, **({} if isinstance(available, str) else {"available": d.open}))
        assert again.to_numpy() == pytest.approx(got.predict().to_numpy(), rel=1e-12)
    chosen = d.assign(choice=d.choice.where(d.open, 1), dear=2 * d.choice.where(d.open, 1))
    for left in ("choice", "I(dear - 1)", "I(dear / 2)"):
        with pytest.raises(InputError, match=r"row \d+ \(label 'r\d+'\) is chosen but not available"):
            ConditionalLogit.from_formula(f"{left} ~ price", chosen, groups="s", available="open")


def test_flags_that_can_be_missing_are_flags(data):
    right = ConditionalLogit.from_formula("choice ~ price + sale", data, groups="s").fit().params
    nullable = data.convert_dtypes()
    assert str(nullable.dtypes["sale"]) == "boolean"
    assert str(nullable.dtypes["s"]) == "Int64"
    for choice in ("choice", "won"):
        table = nullable.assign(won=(nullable.choice == 1).astype("boolean"))
        got = ConditionalLogit.from_formula(f"{choice} ~ price + sale", table, groups="s").fit().params
        assert got.to_numpy() == pytest.approx(right.to_numpy(), rel=1e-12)
        assert list(got.index) == list(right.index)
    plain = ConditionalLogit(table.won, table[["price", "sale"]], table.s, available=table.won.notna()).fit().params
    assert sorted(plain) == pytest.approx(sorted(right), rel=1e-9)
    gap = table.assign(sale=table.sale.mask(table.index == 5)).set_axis(table.index + 100)
    with pytest.raises(InputError, match=r"column sale is missing in row 5 \(label 105\)"):
        ConditionalLogit.from_formula("choice ~ price + sale", gap, groups="s")
    with pytest.raises(InputError, match=r"column sale is nan in row 5 \(label 105\)"):
        ConditionalLogit(gap.choice, gap[["price", "sale"]], gap.s)
    with pytest.raises(InputError, match=r"available is <NA> in row 5 \(label 105\)"):
        ConditionalLogit(gap.choice, gap[["price"]], gap.s, available=gap.sale)


@pytest.mark.slow
@pytest.mark.parametrize("columns", [["Intercept"], ["price"], ["C(brand)[T.b]"], ["C(brand)[b]"], "C(brand)[a]"])
@pytest.mark.parametrize("used", [False, True])
def test_copies_predict_as_the_original_does(data, columns, used):
    results = ConditionalLogit.from_formula("choice ~ 0 + price + C(brand)", data, drop_cols=columns, groups="s").fit()
    new = data.iloc[:6]
    right = results.predict(new)
    if used:
        results.summary(), results.llnull, results.identification(), results.t_test(np.eye(len(results.params)))
    dropped = [columns] if isinstance(columns, str) else columns
    assert not set(dropped) & set(results.params.index)
    for again in (copy.deepcopy(results), pickle.loads(pickle.dumps(results)), copy.copy(results)):
        assert again.predict(new).to_numpy() == pytest.approx(right.to_numpy(), rel=1e-14)
        assert again.model.fit().params.to_numpy() == pytest.approx(results.params.to_numpy(), rel=1e-9)


def test_a_column_to_drop_must_be_there(data):
    with pytest.raises(InputError, match=r"drop_cols names 'wage'; the columns are"):
        ConditionalLogit.from_formula("choice ~ price", data, drop_cols=["wage"], groups="s")


@pytest.mark.slow
def test_subsets_take_their_part_of_every_argument(data):
    d = data.assign(off=0.3 * data.price).set_axis([f"r{i}" for i in range(3 * S)])
    some = d.s < 100
    right = ConditionalLogit.from_formula("choice ~ price + brand", d[some], groups="s", offset="off").fit().params
    for subset in (some, some.to_numpy(), d.index[some], lambda table: table.s < 100):
        part = {"groups": d.s[some].tolist(), "offset": d.off[some].tolist()}
        for given in ({"groups": d.s, "offset": d.off.sort_values()}, part):
            got = ConditionalLogit.from_formula("choice ~ price + brand", d, subset, **given).fit().params
            assert got.to_numpy() == pytest.approx(right.to_numpy(), rel=1e-12)
    with pytest.raises(InputError, match="subset does not fit the data"):
        ConditionalLogit.from_formula("choice ~ price", d, ["nobody"], groups="s")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d: d.drop(columns="price"), "price"),
        (lambda d: d.assign(brand="z"), "z"),
        (lambda d: d.assign(price="dear"), "price"),
        (lambda d: d.assign(price=np.nan), "exog: column price is missing in row 0 .label 600."),
        (lambda d: d.to_numpy(), "the model has a formula: give a DataFrame"),
        (lambda d: d.drop(columns="s"), "groups is missing"),
        (lambda d: {"price": 1.0}, "exog is no table"),
    ],
)
def test_new_data_that_do_not_fit_the_formula_are_refused(data, spoil, words):
    results = ConditionalLogit.from_formula("choice ~ price + C(brand)", data, groups="s").fit()
    new = data.iloc[:6].set_axis(range(600, 606))
    with pytest.raises(InputError, match=words) as caught:
        results.predict(spoil(new))
    assert "\n" not in str(caught.value)
    assert results.predict(new).index.tolist() == list(range(600, 606))


def test_the_null_model_is_called_what_it_is(data):
    plain = ConditionalLogit.from_formula("choice ~ price", data, groups="s").fit()
    assert plain.llnull == pytest.approx(-S * np.log(3), rel=1e-14)
    assert "equal shares" in str(plain.summary())
    known = ConditionalLogit.from_formula("choice ~ price", data.assign(off=data.price), groups="s", offset="off").fit()
    share = np.exp(data.price) / np.exp(data.price).groupby(data.s).transform("sum")
    assert known.llnull == pytest.approx(np.log(share[data.choice == 1]).sum(), rel=1e-12)
    assert "equal shares" not in str(known.summary())
    assert "LL-Null: shares by the offset alone" in str(known.summary())
