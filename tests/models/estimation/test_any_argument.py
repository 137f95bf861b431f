"""Whatever an argument is, there is a result, or one line of ours that says what is wrong."""

import numpy as np
import pytest

from optkit.basics.errors import InputError
from optkit.models.estimation import ConditionalLogit
from tests.models.estimation.any_argument import BASE, BY_FORMULA, DATA, errors, fits


@pytest.mark.slow
def test_nothing_ends_in_an_error_of_somebody_elses():
    ours, theirs = errors(every=26)
    assert not theirs
    assert len(ours) > 50
    assert not any("\n" in line for line in ours)


X = DATA[["x", "z"]]
NUMBERS = {"endog": DATA.y, "exog": X, "available": DATA.a, "weights": DATA.w, "offset": DATA.o, "penalty": [0.1, 0.1]}
LABELS = {"groups": DATA.s}
ROWS = {name: value for name, value in NUMBERS.items() if name in ("available", "weights", "offset", "penalty")}
NEW = {"exog": X, "available": DATA.a, "offset": DATA.o}


def asked():
    """Every argument that is an array: where it goes, its name, a right value, and whether it holds labels."""
    for name, value in (NUMBERS | LABELS).items():
        yield "class", name, value, name in LABELS
    for name, value in (ROWS | LABELS | {"subset": DATA.a}).items():
        yield "formula", name, value, name in LABELS
    for name, value in (NEW | LABELS).items():
        yield "predict", name, value, name in LABELS
        yield "model.predict", name, value, name in LABELS
    yield "cluster", "the clusters", DATA.s // 2, True
    for method in ("fit", "loglike", "score", "score_obs", "information", "hessian", "predict"):
        yield method, "params", [0.0, 0.0], False
    for method in ("t_test", "wald_test", "f_test"):
        yield method, "r_matrix", [1.0, 0.0], False
        yield method, "cov_p", np.eye(2), False


def give(way, name, value):
    model, fitted, *_ = fits()
    if way == "class":
        return ConditionalLogit(**BASE | {name: value})
    if way == "formula":
        return ConditionalLogit.from_formula(**BY_FORMULA | {name: value})
    if way == "predict":
        if name != "params":
            return fitted.predict(**{"exog": X, "groups": DATA.s} | {name: value})
        return model.predict(value)
    if way == "model.predict":
        return model.predict(fitted.params, **{"exog": X, "groups": DATA.s} | {name: value})
    if way == "cluster":
        return model.fit(cov_type="cluster", cov_kwds={"groups": value})
    if name == "cov_p":
        return getattr(fitted, way)([1.0, 0.0], cov_p=value)
    return getattr(fitted if name == "r_matrix" else model, way)(value)


def masked(array, at):
    return np.ma.masked_array(array, np.arange(array.size).reshape(array.shape) == at)


STRANGE = {
    "masked": lambda a: masked(a, 1),
    "masked, nothing hidden": lambda a: masked(a, -1),
    "masked in a list": lambda a: [masked(a, 1)[0], np.ma.masked, *masked(a, 1)[2:]],
    "complex": lambda a: a.astype(complex),
    "dates": lambda a: a.astype(np.int64).astype("M8[D]"),
    "time spans": lambda a: a.astype(np.int64).astype("m8[s]"),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("strange", STRANGE)
def test_no_array_is_masked_complex_or_made_of_dates(strange):
    for way, name, value, labels in asked():
        if labels and "masked" not in strange:
            continue  # a day is a good name of a situation
        array = np.asarray(value)
        give(way, name, array)
        try:
            give(way, name, STRANGE[strange](array))
        except InputError as error:
            told = str(error)
        else:
            told = ""
        assert told, f"{way}: {name} was taken"
        assert "\n" not in told
