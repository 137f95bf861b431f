"""Rows of a table in several pieces: by label where there are labels, by place where there are none, or refused."""

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import InputError
from optkit.models.rows import Rows

pytestmark = pytest.mark.filterwarnings("error")


@pytest.mark.parametrize("seed", range(20))
def test_a_column_in_any_order_is_that_of_its_labels(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    kinds = (pd.Index(rng.permutation(100)[:n]), pd.Index([f"r{i}" for i in rng.permutation(n)]))
    labels = [*kinds, pd.MultiIndex.from_arrays(kinds)][seed % 3]
    column = pd.Series(rng.normal(size=n), index=labels)
    rows = Rows.of(n, exog=pd.DataFrame({"x": range(n)}, index=labels), offset=column)
    assert rows.owner == "exog"
    shuffled = column.iloc[rng.permutation(n)]
    assert rows.take("offset", shuffled).to_numpy().tolist() == column.tolist()
    assert rows.take("offset", column.tolist()) == column.tolist()
    if n > 1:
        with pytest.raises(InputError, match=r"is called .* in exog and .* in offset"):
            rows.take("offset", column.set_axis(labels[[*range(1, n), 1]]))


def test_labels_that_stand_twice_are_taken_as_they_stand_or_refused():
    twice = pd.Index(["a", "b", "a"])
    rows = Rows.of(3, exog=pd.DataFrame({"x": [1, 2, 3]}, index=twice))
    assert rows.take("offset", pd.Series([5, 6, 7], index=twice)).tolist() == [5, 6, 7]
    with pytest.raises(InputError, match="row 1 is called 'b' in exog and 'a' in offset"):
        rows.take("offset", pd.Series([5, 7, 6], index=["a", "a", "b"]))


def test_labels_that_may_be_places_are_refused_where_nothing_bears_them_out():
    exog, offset = np.arange(3.0), pd.Series([1.0, 2.0, 3.0], index=[2, 0, 1])
    with pytest.raises(InputError, match=r"offset has the row labels 0 to 2 in another order, and exog has none"):
        Rows.of(3, exog=exog, offset=offset)
    assert Rows.of(3, exog=exog, offset=offset, groups=offset).owner == "offset"
    assert Rows.of(3, exog=exog, offset=offset.set_axis([7, 5, 6])).owner == "offset"
    assert Rows.of(3, exog=exog).labels is None


def test_a_row_is_called_by_place_and_by_label():
    assert Rows(3).called(1) == Rows(3, pd.RangeIndex(3)).called(1) == "row 1"
    assert Rows(2, pd.Index(["x", "trip-17"])).called(1) == "row 1 (label 'trip-17')"
    assert Rows(2, pd.Index([5, 4])).called(1) == "row 1 (label 4)"
