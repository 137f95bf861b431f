"""The table of optkit price: what is read, and what is refused with its place."""

import json

import pandas as pd
import pytest

from optkit.basics.errors import DataError
from optkit.basics.tables import table
from optkit.cli.request_table import read_requests

NAMES = ["007", "7", "1e3", "1000", "20240101.10", "NA", "null", "True", "café"]


def written(folder, kind, frame):
    """A frame as a file of a kind."""
    path = folder / f"r.{kind}"
    if kind == "json":
        path.write_text(json.dumps(frame.to_dict("records")))
    elif kind == "under.json":
        path.write_text(json.dumps({"requests": frame.to_dict("records")}))
    else:
        frame.to_csv(path, index=False) if kind == "csv" else frame.to_parquet(path, index=False)
    return path


@pytest.mark.parametrize("kind", ["csv", "json", "under.json", "parquet"])
def test_names_and_numbers_of_every_format(tmp_path, kind):
    """Names as they are written, value as it is said or made of its parts, columns in any order and case."""
    frame = pd.DataFrame({"Utility": -10.0, " request": NAMES, "VALUE": range(len(NAMES)), "colour": "red"})
    found = read_requests(written(tmp_path, kind, frame))
    assert found.names == NAMES
    assert found.value.tolist() == list(range(len(NAMES)))
    assert found.compensation is None
    assert found.ignored == ["colour"]
    parts = pd.DataFrame({"reward": [30, 45], "penalty": [-5, -8], "expires": [0, 1], "opportunity_cost": [2, 3]})
    found = read_requests(written(tmp_path, kind, parts.assign(utility=-1.5, compensation=7)))
    assert found.value.tolist() == [28.0, 50.0]
    assert found.compensation.tolist() == [7.0, 7.0]
    assert found.names == ["0", "1"]


def test_half_a_surrogate_pair_is_a_name(tmp_path):
    """JSON can name what no encoding can write; it is a name like any other, and printed as an escape."""
    path = tmp_path / "r.json"
    path.write_text('[{"request": "\\ud800", "value": 30, "utility": -10}]')
    assert read_requests(path).names == ["\ud800"]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ('[{"value": true, "utility": -1}]', "value in row 1 is True, not a finite number"),
        ('[{"value": 1%s, "utility": -1}]' % (400 * "0"), "value in row 1 is 10+ ..., not a finite number"),
        ('[{"value": 1e400, "utility": -1}]', "value in row 1 is 1e400, not a finite number"),
        ('[{"value": 1e300, "utility": -1}]', "value in row 1 is 1e300, beyond any money"),
        ('[{"value": null, "utility": -1}]', "value in row 1 is empty"),
        ('[{"value": 1, "utility": -1, "utility": -2}]', "row 1 gives 'utility' twice"),
        ('[{"value": 1, "utility": -1}, {"utility": -1}]', "row 2 lacks 'value', which the first has"),
        ('[{"value": 1, "utility": -1, "Utility": 2}]', "'utility' twice, but for case"),
        ('[{"request": null, "value": 1, "utility": -1}]', "request in row 1 is empty: every row needs one"),
        ('[{"request": [1], "value": 1, "utility": -1}]', r"request in row 1 is \[1\], neither text nor a number"),
        ('[{"reward": 1, "expires": 2, "utility": -1}]', "expires in row 1 is 2, neither 0 nor 1"),
        ('[{"reward": 1, "penalty": 5, "utility": -1}]', "penalty in row 1 = 5 is positive"),
        ('{"requests": [], "mu": 2}', "takes requests alone"),
        ('{"a": [{"value": 1, "utility": -1}]}', "takes requests alone"),
        ("[]", "no column 'utility' and no 'value' or 'reward'; it has none"),
        ('[{"value": 1, "reward": 2, "utility": -1}]', "both value and reward"),
    ],
)
def test_json_that_says_something_else(tmp_path, rows, words):
    """Null, true, huge numbers, keys that stand twice and rows that differ are one line with row and column."""
    path = tmp_path / "r.json"
    path.write_text(rows)
    with pytest.raises(DataError, match=words) as caught:
        read_requests(path)
    assert "\n" not in str(caught.value)


class Counted(str):
    """Text that counts how often it is compared, in lower case too."""

    times = 0
    __hash__ = str.__hash__

    def __eq__(self, other):
        Counted.times += 1
        return str.__eq__(self, other)

    def lower(self):
        """Go on counting."""
        return Counted(super().lower())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
def test_columns_are_compared_a_few_times_each(tmp_path, monkeypatch, kind):
    """No name is held against all others: four times as many columns are four times as many comparisons."""
    tidy = table.tidy
    monkeypatch.setattr(table, "tidy", lambda name: Counted(tidy(name)))
    times = []
    for n in (100, 400):
        names = [f"c{i}" for i in range(n)]
        path = written(tmp_path, kind, pd.DataFrame(1, index=[0], columns=["value", "utility", *names]))
        Counted.times = 0
        assert read_requests(path).ignored == names
        times.append(Counted.times)
    assert 0 < times[1] < 6 * times[0]


def test_any_number_of_columns(tmp_path):
    """Thirty thousand columns without a meaning are named as far as they fit; two of them alike are refused."""
    path = tmp_path / "wide.csv"
    names = ["value", "utility", *(f"c{i}" for i in range(30_000))]
    path.write_text(",".join(names) + "\n" + ",".join(["30", "-10", *["1"] * 30_000]) + "\n")
    assert read_requests(path).ignored == names[2:]
    path.write_text(",".join([*names, "c7"]) + "\n")
    with pytest.raises(DataError, match="'c7' twice") as caught:
        read_requests(path)
    assert len(str(caught.value)) < 500
