"""Arguments of one decision that have labels go by them, in whatever order, or are refused: everywhere alike."""

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import InputError
from optkit.models.choice import acceptance_probabilities
from optkit.models.pricing import certify, optimal_prices
from optkit.models.pricing_program import PricingProgram

N, S = 4, 3
REQUESTS, DECISIONS = list("abcd"), ["mon", "tue", "wed"]


def results(call, given):
    """Numbers that come out, requests last where there are any."""
    given = dict(given)
    if call == "acceptance":
        given["compensation"] = given.pop("value")
        return np.atleast_1d(acceptance_probabilities(**given)[0])
    if call == "prices":
        return np.atleast_1d(optimal_prices(**given).compensation)
    if call == "program":
        return PricingProgram(N).solve(**given).compensation
    given["compensation"] = given.pop("paid")
    found = certify(**given)
    return np.concatenate([np.ravel(found.profit), np.ravel(found.gap), np.ravel(found.multiplier)])


def arguments(rng, many):
    """Right arguments as pandas has them, and which of their axes are requests and decisions."""
    shape = (S, N) if many else (N,)
    of_requests = {"value": rng.uniform(0, 9, shape), "utility": rng.uniform(-5, 5, shape)}
    of_requests |= {"paid": rng.uniform(0, 5, shape), "offered": rng.random(shape) < 0.8}

    def labels(x):
        return pd.DataFrame(x, DECISIONS, REQUESTS) if many else pd.Series(x, REQUESTS)

    found = {name: labels(x) for name, x in of_requests.items()}
    if many:
        found |= {"mu": pd.Series(rng.uniform(1, 2, S), DECISIONS)}
        found |= {"outside_utility": pd.Series(rng.uniform(-1, 1, S), DECISIONS)}
    return found


def shuffled(rng, one):
    mixed = one.iloc[rng.permutation(len(one))]
    return mixed if one.ndim == 1 else mixed.iloc[:, rng.permutation(N)]


CALLS = [(call, many) for call in ("acceptance", "prices", "certify", "program") for many in (False, True)][:-1]


def needed(call, many, seed):
    given = arguments(np.random.default_rng(seed), many)
    return given if call == "certify" else {name: one for name, one in given.items() if name != "paid"}


@pytest.mark.slow
@pytest.mark.parametrize(("call", "many"), CALLS)
def test_the_same_labels_in_another_order(call, many):
    """Whichever argument is shuffled, the results are those of the order that the first of them has."""
    for seed in range(1 if call == "program" else 3):
        given = needed(call, many, seed)
        right = results(call, {name: one.to_numpy() for name, one in given.items()})
        first = "paid" if call == "certify" else "value"
        for name in given:
            if name != first:
                mixed = given | {name: shuffled(np.random.default_rng(seed), given[name])}
                np.testing.assert_array_equal(results(call, mixed), right)


@pytest.mark.slow
@pytest.mark.parametrize(("call", "many"), CALLS)
def test_other_labels(call, many):
    """Labels that are not the same, or that stand there twice and in another order, are one line that names both."""
    given = needed(call, many, 0)
    for name, one in given.items():
        for axis in range(one.ndim):
            own = list(one.axes[axis])
            for other in ([*own[:-1], "x"], list(range(len(own))), [own[0], *own[:-1]]):
                with pytest.raises(InputError, match=r"row \d is called") as caught:
                    results(call, given | {name: one.set_axis(other, axis=axis)})
                assert "\n" not in str(caught.value)


def test_what_has_no_labels_goes_by_place():
    """Lists beside a Series are in its order; a Series alone whose labels are places in another order is refused."""
    value, utility = pd.Series([5.0, 6.0, 7.0], list("cab")), [-1.0, -2.0, -3.0]
    right = optimal_prices(value.to_numpy(), utility).compensation
    np.testing.assert_array_equal(optimal_prices(value, utility).compensation, right)
    np.testing.assert_array_equal(optimal_prices(value.tolist(), pd.Series(utility, list("cab"))).compensation, right)
    with pytest.raises(InputError, match="utility has the row labels 0 to 2 in another order, and value has none"):
        optimal_prices(value.tolist(), pd.Series(utility, [2, 0, 1]))
    with pytest.raises(InputError, match="shapes do not fit"):
        optimal_prices(value, pd.Series(utility[:2], list("ca")))


STRANGE = {
    "text": ["True", "False", "True", "True"],
    "text of a CSV": pd.Series(["True", "False", "True", "True"]),
    "NaN": np.array([1.0, np.nan, 1.0, 1.0]),
    "objects with NaN": pd.Series([True, np.nan, True, True], dtype=object),
    "None": [True, None, True, True],
    "<NA>": pd.array([True, None, True, True], dtype="boolean"),
    "numbers": [1, 0, 1, 1],
    "other numbers": [2, -1, 1, 1],
    "floats": [1.0, 0.0, 1.0, 1.0],
    "positions": [0, 2],
    "masked": np.ma.masked_array([True] * 4, [False, True, False, False]),
    "complex": np.ones(4) * 1j,
    "dates": np.array([1, 0, 1, 1], "M8[D]"),
}


@pytest.mark.slow
@pytest.mark.parametrize("call", ["acceptance", "prices", "certify", "program"])
@pytest.mark.parametrize("strange", STRANGE)
def test_offered_is_a_mask(call, strange):
    """Whatever is not made of True and False is refused by all that ask what is on offer, and never taken for one."""
    given = {name: one.to_numpy() for name, one in needed(call, False, 0).items()}
    with pytest.raises(InputError, match=r"offered.* mask") as caught:
        results(call, given | {"offered": STRANGE[strange]})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("call", ["acceptance", "prices", "certify", "program"])
@pytest.mark.parametrize("name", ["value", "utility", "mu", "outside_utility", "paid"])
def test_values_are_real_numbers(call, name):
    """Complex numbers, dates and masked arrays are no money."""
    given = {key: one.to_numpy() for key, one in needed(call, False, 0).items()} | {"mu": 1.0, "outside_utility": 0.0}
    if name not in given:
        return
    right = np.asarray(given[name], dtype=float)
    for strange in (
        right + 1j,
        right.astype("M8[s]"),
        right.astype("m8[s]"),
        np.ma.masked_array(right, np.arange(right.size).reshape(right.shape) == 0),
        right.astype(str),
    ):
        with pytest.raises(InputError, match={"paid": "compensation", "value": "value|compensation"}.get(name, name)):
            results(call, given | {name: strange})
