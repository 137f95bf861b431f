"""Every argument of the estimator, given everything: a result, or one line of ours that says what is wrong.

``python -m tests.models.estimation.any_argument`` tries all of it, in about a minute.
"""

import decimal
import sys
import warnings
from functools import cache

import numpy as np
import pandas as pd

from optkit.basics.errors import OptkitError
from optkit.models.estimation import ConditionalLogit, identification
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers

S, N = 30, 60


def values():
    """Everything but what is asked for, and some of that."""
    na, whole = pd.array([True] * N, dtype="boolean"), pd.array([1] * N, dtype="Int64")
    na[5] = whole[5] = pd.NA
    yield from (None, "nobody", 3, np.nan, True, [], [1, 2], {}, {"x": 1.0}, set(range(N)), object(), int, lambda: 1)
    yield from (
        ["a"] * N,
        [b"a"] * N,
        ["1"] * N,
        [None] * N,
        [[1], [1, 2]] * S,
        [1, "a"] * S,
        [10**400] * N,
        [pd.NaT] * N,
    )
    yield from (
        np.ones((N, 2)),
        np.ones((N, 2, 2)),
        np.ones(N) * 1j,
        np.full(N, np.inf),
        -np.ones(N),
        np.full(N, 1e200),
    )
    yield from (
        np.ma.masked_array(np.ones(N), np.arange(N) == 5),
        np.ones(N, "f2"),
        np.array(1.0),
        (i for i in range(N)),
    )
    yield from (na, pd.Series(na), pd.Series(whole), pd.Series(1.0, index=[0] * N), pd.Series(1.0, np.arange(N) + 0.5))
    yield from (pd.Series(["a", "b"] * S, dtype="category"), pd.Series(pd.date_range("2020", periods=N)))
    yield from (pd.DataFrame({"x": range(N), "k": ["a"] * N}), [decimal.Decimal("1.5")] * N, pd.interval_range(0, N))
    yield np.zeros(N, dtype=[("x", float), ("z", float)])


rng = np.random.default_rng(0)
DATA = pd.DataFrame({"x": rng.normal(size=N), "z": rng.normal(size=N), "k": rng.choice(list("ab"), N), "o": 0.1})
DATA["s"], DATA["w"], DATA["a"] = np.repeat(np.arange(S), 2), 1.0, True
DATA["y"] = ((np.arange(N) % 2) == np.repeat(rng.integers(0, 2, S), 2)).astype(int)
LOG = pd.DataFrame({"situation": DATA.s, "group": 0, "km": DATA.x, "compensation": 5.0 + rng.normal(size=N)})
LOG["chosen"] = DATA.y.where(DATA.s > 9, 0)


BASE = {"endog": DATA.y, "exog": DATA[["x", "z"]], "groups": DATA.s}
BY_FORMULA = {"formula": "y ~ x + C(k)", "data": DATA, "groups": "s", "offset": "o"}


@cache
def fits():
    """Return a model, its results, those of a formula, and a log."""
    model = ConditionalLogit(**BASE)
    return model, model.fit(), ConditionalLogit.from_formula(**BY_FORMULA).fit(), Offers.from_frame(LOG)


def calls(value):
    """Give a value to one argument after the other."""
    base, by_formula = BASE, BY_FORMULA
    for name in ("endog", "exog", "groups", "available", "weights", "offset", "penalty", "outside_option", "missing"):
        yield name, lambda name=name: ConditionalLogit(**base | {name: value}).fit()
    model, fitted, formula, offers = fits()
    for name in ("start_params", "cov_type", "cov_kwds", "maxiter", "tol", "disp"):
        yield name, lambda name=name: model.fit(**{"cov_type": "nonrobust"} | {name: value})
    yield "loglike", lambda: model.loglike(value)
    for name in ("exog", "groups", "available", "offset"):
        yield name, lambda name=name: fitted.predict(**{"exog": DATA[["x", "z"]], "groups": DATA.s} | {name: value})
        yield name, lambda name=name: formula.predict(**{"exog": DATA} | {name: value})
    for name in ("formula", "data", "subset", "drop_cols", "groups", "available", "weights", "offset"):
        yield name, lambda name=name: ConditionalLogit.from_formula(**by_formula | {name: value}).fit()
    yield "identification", lambda: identification(value)
    yield "offers", lambda: fit_preferences(value)
    for name in ("pooled", "method", "ridge", "scale_penalty", "robust", "attributes"):
        yield name, lambda name=name: fit_preferences(offers, **{name: value})
    yield "from_frame", lambda: Offers.from_frame(value)
    yield "features", lambda: Offers.from_frame(LOG, value)
    given = {name: getattr(offers, name) for name in ("situation", "group", "features", "pickup", "dropoff")}
    given |= {name: getattr(offers, name) for name in ("compensation", "chosen", "names")}
    for name in given:
        yield name, lambda name=name: Offers(**given | {name: value})
    columns = {"groups": "s", "weights": "w", "offset": "o", "available": "a"}
    for column in ("x", "k", "s", "w", "o", "a", "y"):
        try:
            table = DATA.assign(**{column: value})
        except (TypeError, ValueError, NotImplementedError, KeyError, AssertionError):  # not ours: no table
            continue
        yield column, lambda table=table: ConditionalLogit.from_formula("y ~ x + C(k)", table, **columns).fit()
        yield column, lambda table=table: formula.predict(table)


def errors(every: int = 1) -> tuple[list[str], list[str]]:
    """Try every so many-th call; return the lines of ours, and the errors of somebody else."""
    ours, theirs = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for place in range(sum(1 for _ in values())):
            value = next(v for i, v in enumerate(values()) if i == place)
            for number, (name, call) in enumerate(calls(value)):
                if (number + place) % every:
                    continue
                try:
                    call()
                except OptkitError as error:
                    ours.append(str(error))
                except Exception as error:
                    theirs.append(f"{name} = value {place}: {type(error).__name__}: {error}")
    return ours, theirs


if __name__ == "__main__":
    lines, wrong = errors()
    print(f"{len(lines)} refused in a line of ours", *wrong, sep="\n")
    sys.exit(bool(wrong))
