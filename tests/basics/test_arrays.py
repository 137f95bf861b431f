"""The one checker of whole numbers, of numbers, of arrays and of masks: what each takes, and what it refuses."""

import datetime
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit.basics.arrays import count, floats, ints, is_finite, mask, number, real, whole_number
from optkit.basics.errors import DataError, InputError, InstanceError

pytestmark = pytest.mark.filterwarnings("error")

MASKED = np.ma.masked_array([1.0, 2.0], [False, True])
STRANGE = {
    "complex": np.array([1 + 2j, 3]),
    "complex list": [1.0, 2j],
    "text": ["1", "2"],
    "text among numbers": [1.0, "2"],
    "text as objects": np.array(["1", 2.0], dtype=object),
    "bytes": [b"1", b"2"],
    "a word": "ab",
    "dates": np.array([1, 2], "M8[D]"),
    "time spans": np.array([1, 2], "m8[D]"),
    "dates as objects": [datetime.date(2020, 1, 1), datetime.date(2020, 1, 2)],
    "a Series of dates": pd.Series(pd.to_datetime(["2020-01-01", "2020-01-02"])),
    "spans as objects": np.array([np.timedelta64(1), 2.0], dtype=object),
    "masked": MASKED,
    "masked, nothing hidden": np.ma.masked_array([1.0, 2.0]),
    "rows that are masked": [MASKED, MASKED],
    "the masked constant": [1.0, np.ma.masked],
    "booleans": [True, False],
    "a boolean among numbers": [1.0, True],
    "a boolean deep among numbers": [[1.0, 2.0], [0.5, np.True_]],
    "booleans as objects": np.array([True, 1.0], dtype=object),
    "categories": pd.Series([1, 2], dtype="category"),
    "ragged": [[1.0], [1.0, 2.0]],
    "records": np.zeros(2, [("a", float)]),
    "a dict": {"a": 1.0},
    "a set": {1.0, 2.0},
    "nothing": None,
    "gaps": [1.0, None],
    "pandas' gap": pd.Series([1.0, None], dtype="Float64"),
    "NaN": [1.0, np.nan],
    "infinity": [1.0, np.inf],
    "a whole number beyond floats": [1, 10**400],
}
TAKEN = {
    "floats": ([1.0, 2.0], [1.0, 2.0]),
    "ints": ([1, 2], [1.0, 2.0]),
    "a tuple": ((1, 2.0), [1.0, 2.0]),
    "small floats": (np.array([1, 2], np.float32), [1.0, 2.0]),
    "bytes as numbers": (np.array([1, 2], np.uint8), [1.0, 2.0]),
    "a Series": (pd.Series([1.0, 2.0], index=[7, 9]), [1.0, 2.0]),
    "a nullable Series": (pd.Series([1, 2], dtype="Int64"), [1.0, 2.0]),
    "exact numbers": ([Decimal("0.5"), Fraction(1, 4)], [0.5, 0.25]),
    "none at all": ([], []),
}


@pytest.mark.slow
@pytest.mark.parametrize("given_", STRANGE.values(), ids=STRANGE)
@pytest.mark.parametrize("error", [InputError, InstanceError, DataError])
@pytest.mark.parametrize(
    "check", [real, lambda *a, **k: floats(*a, (None,), **k), lambda *a, **k: ints(*a, (None,), **k)]
)
def test_what_is_no_array_of_numbers_is_refused_by_name_in_one_line(given_, error, check):
    with pytest.raises(error, match=r"^pay") as caught:
        check("pay", given_, error=error)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("given_", "numbers"), TAKEN.values(), ids=TAKEN)
def test_numbers_of_every_make_are_floats(given_, numbers):
    assert real("pay", given_).tolist() == numbers
    found = floats("pay", given_, (None,))
    assert (found.tolist(), found.dtype, found.flags.writeable) == (numbers, np.float64, False)


def test_an_array_of_floats_is_passed_through_by_real_and_copied_by_floats():
    given_ = np.array([1.0, 2.0])
    assert real("pay", given_) is given_
    kept = floats("pay", given_, (2,))
    given_[0] = 9.0
    assert kept.tolist() == [1.0, 2.0]


def test_the_first_entry_that_is_wrong_is_named():
    for wrong, words in (
        ([[1.0, 2.0], [np.nan, np.inf]], r"pay\[1, 0\] is nan"),
        (np.array([1.0, "x"], dtype=object), r"pay\[1\] is 'x'"),
        (np.float64("nan"), "pay is nan"),
    ):
        with pytest.raises(InputError, match=words):
            real("pay", wrong)
    with pytest.raises(InputError, match=r"step\[1\] = 1.5 is not a whole number"):
        ints("step", [1, 1.5], (2,))


def test_infinities_pass_only_where_they_are_asked_for():
    assert real("utility", [-np.inf, 1.0], accept="-inf").tolist() == [-np.inf, 1.0]
    for wrong in ([np.inf], [np.nan], [-np.inf, np.nan]):
        with pytest.raises(InputError, match="not a finite number"):
            real("utility", wrong, accept="-inf")
    assert np.isnan(real("offer", [np.nan, np.inf], accept="any")[0])
    with pytest.raises(InputError, match="text"):
        real("offer", ["1"], accept="any")


def test_flags_are_numbers_only_where_characteristics_are_asked_for():
    assert floats("express", [True, False], (2,), flags=True).tolist() == [1.0, 0.0]
    assert floats("express", np.array([True, 2.0], dtype=object), (2,), flags=True).tolist() == [1.0, 2.0]


def test_shapes():
    assert count("pay", [[1, 2], [3, 4]]) == 4
    for shape in ((3,), (2, None), ()):
        with pytest.raises(InputError, match=r"pay has shape \(2,\); it needs"):
            floats("pay", [1.0, 2.0], shape)
    assert floats("pay", 2.0, ()) == 2.0


# Whole numbers ------------------------------------------------------------------------------------------------------

WHOLE = st.one_of(st.integers(-(2**53), 2**53), st.integers(-(2**31), 2**31 - 1).map(np.int32), st.just(np.array(3)))


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=60)
@given(WHOLE)
def test_a_whole_number_of_any_make_is_itself(value):
    for made in (value, float(value), np.float64(value)):
        found = whole_number("n", made)
        assert (found, type(found)) == (int(value), int)


@pytest.mark.parametrize(
    "value",
    [
        True, False, np.True_, np.array(True), 0.5, np.nan, np.inf, 1e300, "3", b"3", None, [3], np.array([3]), 3 + 0j,
        Decimal(3), np.timedelta64(3), np.datetime64("2020"), np.ma.masked, np.ma.masked_array(3), {3},
        datetime.date(2020, 1, 1),
    ],
)  # fmt: skip
@pytest.mark.parametrize("error", [InputError, DataError])
def test_what_is_no_whole_number_is_refused(value, error):
    with pytest.raises(error, match=r"^n = .* is not a whole number$") as caught:
        whole_number("n", value, error=error)
    assert "\n" not in str(caught.value)


def test_whole_numbers_out_of_range_are_refused_with_the_range():
    assert [whole_number("n", n, least=1, most=3) for n in (1, 3)] == [1, 3]
    with pytest.raises(InputError, match="n = 0 is not a whole number of at least 1 and at most 3"):
        whole_number("n", 0, least=1, most=3)
    with pytest.raises(InputError, match="n = 4 is not a whole number of at most 3"):
        whole_number("n", 4, most=3)


@pytest.mark.parametrize("wrong", [2**63, 2.0**53 + 2, 1.5, -(2.0**60)])
def test_whole_numbers_of_an_array_fit_64_bits_exactly(wrong):
    with pytest.raises(InputError, match="whole number"):
        ints("step", np.array([1, wrong]), (2,))
    assert ints("step", np.array([2**63 - 1], np.uint64), (1,)).tolist() == [2**63 - 1]


# Numbers ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [True, np.True_, np.array(True), "1", None, 1 + 0j, np.nan, np.inf, -np.inf, [1.0], np.array([1.0]), 10**400,
     np.timedelta64(3), np.ma.masked, np.datetime64("2020")],
)  # fmt: skip
def test_what_is_no_number_is_refused(value):
    with pytest.raises(InputError, match=r"^mu = .* is not a finite number$"):
        number("mu", value)
    assert not is_finite(value)


def test_numbers_in_range():
    assert [number("mu", x) for x in (1, 2.5, np.float32(0.5), np.int8(3), np.array(1.5))] == [1.0, 2.5, 0.5, 3.0, 1.5]
    with pytest.raises(InputError, match=r"mu = 0 is not a finite number above 0"):
        number("mu", 0, above=0.0)
    with pytest.raises(InputError, match=r"share = 1.5 is not a finite number of at least 0 and at most 1"):
        number("share", 1.5, least=0.0, most=1.0)


# Masks --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given_",
    [
        [True, False],
        np.array([True, False]),
        pd.Series([True, False], index=[5, 3]),
        pd.Series([True, False], dtype="boolean"),
        np.array([True, np.False_], dtype=object),
    ],
)
def test_true_and_false_of_every_make_are_a_mask(given_):
    found = mask("offered", given_, (2,))
    assert (found.tolist(), found.dtype) == ([True, False], bool)


@pytest.mark.parametrize(
    "given_",
    [
        [1, 0], [0, 2], [2, -1], [1.0, np.nan], [True, np.nan], [True, None], ["True", "False"], "yes", 1, 0.5, None,
        np.array([1, 0], np.uint8), pd.Series(["True", "False"]), pd.Series([True, None], dtype="boolean"),
        pd.Series([True, np.nan], dtype=object), np.ma.masked_array([True, False], [False, True]),
        np.ma.masked_array([True, False]), [True, np.ma.masked], [1j, 0j], np.array([1, 2], "M8[D]"), {"a": True},
        [[True], [True, False]],
    ],
)  # fmt: skip
def test_what_is_no_mask_is_refused(given_):
    with pytest.raises(InputError, match=r"^offered") as caught:
        mask("offered", given_)
    assert "\n" not in str(caught.value)


def test_a_mask_of_nothing_and_of_another_shape():
    assert mask("offered", []).shape == (0,)
    with pytest.raises(InputError, match=r"offered has shape \(1,\); it needs \(2,\)"):
        mask("offered", [True], (2,))
