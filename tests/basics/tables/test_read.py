"""Tables from files: what every format has in common, and what is refused."""

import gzip
import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from optkit.basics.errors import DataError
from optkit.basics.tables.read import open_table

LABELS = [
    "007",
    "7",
    "7.0",
    "1e3",
    "1000",
    "20240101.10",
    "20240101.1",
    "NA",
    "null",
    "nan",
    "True",
    "-0",
    "0",
    " x",
    "x",
]
"""Names that a program which guesses takes for one another, or for nothing."""


def written(folder, kind, columns):
    """Write columns of text as a file of a kind."""
    path = folder / f"a.{kind}"
    frame = pd.DataFrame(columns, dtype=object)
    if kind == "parquet":
        frame.to_parquet(path, index=False)
    elif kind == "json":
        path.write_text(json.dumps(frame.to_dict("records")))
    else:
        frame.to_csv(path, index=False)
    return path


def refused(path, message, wanted=None, **options):
    """The error of opening and reading a file: one line that names it."""
    with pytest.raises(DataError, match=message) as caught, open_table(path, **options) as table:
        table.columns(wanted or dict.fromkeys(table.names, "labels"))
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)


@pytest.mark.parametrize("kind", ["csv", "csv.gz", "json", "parquet"])
def test_labels_are_text_in_every_format(tmp_path, kind):
    """What looks like a number, like nothing or like another label is read as it is written."""
    path = written(tmp_path, kind, {"id": LABELS, "km": [str(i) for i in range(len(LABELS))]})
    with open_table(path) as table:
        found = table.columns({"id": "labels", "km": "numbers"})
        assert table.rows == len(LABELS)
    assert found["id"].tolist() == LABELS
    assert found["km"].tolist() == list(range(len(LABELS)))


def test_numbers_of_json_are_labels_as_they_are_written(tmp_path):
    """1e3 and 1000 are two names though JSON calls both a number, and no digit of a long one is lost."""
    path = tmp_path / "a.json"
    path.write_text('[{"id": 1e3}, {"id": 1000}, {"id": 20240101.10}, {"id": 9007199254740993}, {"id": "7"}]')
    with open_table(path) as table:
        assert table.columns({"id": "labels"})["id"].tolist() == ["1e3", "1000", "20240101.10", "9007199254740993", "7"]


def test_labels_of_parquet_types(tmp_path):
    """Whole numbers, decimals, categories, dates and text of binary columns are labels; none is rounded."""
    table = pa.table(
        {
            "whole": pa.array([2**62 + 1, 7]),
            "decimal": pa.array(["20240101.10", "20240101.01"]).cast(pa.decimal128(12, 2)),
            "category": pa.array(["b", "a"]).dictionary_encode(),
            "date": pa.array(["2024-01-01", "2024-01-02"]).cast(pa.date32()),
            "binary": pa.array([b"007", b"7"]),
        }
    )
    pq.write_table(table, tmp_path / "a.parquet")
    with open_table(tmp_path / "a.parquet") as read:
        found = read.columns(dict.fromkeys(read.names, "labels"))
    assert {name: column.tolist() for name, column in found.items()} == {
        "whole": [str(2**62 + 1), "7"],
        "decimal": ["20240101.10", "20240101.01"],
        "category": ["b", "a"],
        "date": ["2024-01-01", "2024-01-02"],
        "binary": ["007", "7"],
    }


@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
@pytest.mark.parametrize(
    ("how", "good", "read"),
    [
        ("numbers", ["1.5", " 2e1 ", "-0.1", "007"], [1.5, 20.0, -0.1, 7.0]),
        ("flags", ["0", "1", "true", "FALSE", "1.0"], [0, 1, 1, 0, 1]),
        ("counts", ["0", "10", "7.0", " 3 "], [0, 10, 7, 3]),
    ],
)
def test_what_columns_are_read_as(tmp_path, kind, how, good, read):
    """Numbers, flags and counts from text, alike in every format, to the last bit."""
    with open_table(written(tmp_path, kind, {"a": good})) as table:
        assert table.columns({"a": how})["a"].tolist() == read


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
@pytest.mark.parametrize(
    ("how", "bad"),
    [
        *(
            ("numbers", one)
            for one in ("", "ten", "1,5", "1_000", "nan", "inf", "1e400", "0x10", "1e200", "true", "--1")
        ),
        *(("flags", one) for one in ("", "2", "yes", "0.5", "nan")),
        *(("counts", one) for one in ("", "-1", "1.5", "007", "1e2", "10001", "+7", "true", "1e400")),
        *(("labels", one) for one in ("", "  ")),
    ],
)
def test_a_cell_that_is_not_what_it_should_be_is_named_by_row(tmp_path, kind, how, bad):
    """The row below the header is row 1, in every format."""
    path = written(tmp_path, kind, {"b": ["x", "y", "z"], "a": ["1", bad, "0"]})
    refused(path, "a in row 2 is", {"a": how})


def test_cells_of_json_that_are_no_text_and_no_number(tmp_path):
    """Null, lists, objects and, where a number is due, true are refused by row; a huge whole number is not finite."""
    path = tmp_path / "a.json"
    for text in ("null", "[1]", '{"b": 1}', "true", "1" + 400 * "0", "1" * 5_000, "NaN", "-Infinity", '"\\ud800"'):
        path.write_text(f'[{{"a": 1}}, {{"a": {text}}}]')
        refused(path, "a in row 2 is", {"a": "numbers"})
    for text in ("null", "[1]", '{"b": 1}', "true", '" "'):
        path.write_text(f'[{{"a": 1}}, {{"a": {text}}}]')
        refused(path, "a in row 2 is", {"a": "labels"})


def test_numbers_of_parquet_types(tmp_path):
    """Whole numbers and decimals are numbers; dates, booleans, lists and empty cells are not."""
    good = {
        "i": pa.array([1, 2], pa.uint8()),
        "d": pa.array(["1.5", "2"]).cast(pa.decimal128(5, 2)),
        "h": pa.array([1.5, 2], pa.float16()),
    }
    pq.write_table(pa.table(good), tmp_path / "good.parquet")
    with open_table(tmp_path / "good.parquet") as table:
        found = table.columns(dict.fromkeys(table.names, "numbers"))
    assert {name: column.tolist() for name, column in found.items()} == {"i": [1, 2], "d": [1.5, 2], "h": [1.5, 2]}
    for bad, message in (
        (pa.array([None, 1]), "a in row 1 is empty"),
        (pa.array([1.0, float("nan")]), "a in row 2 is nan"),
        (pa.array([True, False]), "a in row 1 is True, not a finite number"),
        (pa.array(pd.to_datetime(["2024-01-01", "2024-01-02"])), "a in row 1 is '2024-01-01"),
        (pa.array([[1], [2]]), "a holds list<"),
        (pa.array([1, 2], pa.duration("s")), "a holds duration"),
        (pa.array([b"\xff", b"1"]), "not UTF-8|invalid UTF8|Invalid UTF8"),
        (pa.nulls(2), "a in row 1 is empty"),
    ):
        pq.write_table(pa.table({"a": bad}), tmp_path / "bad.parquet")
        refused(tmp_path / "bad.parquet", message, {"a": "numbers"})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"cannot read .* \(it is empty\)"),
        ("\n\n", r"cannot read .* \(it is empty\)"),
        ("a,b\n1,2,3\n", r"row 1 has 3 entries for 2 columns: is a name missing in the header\?"),
        ("a,b\n1,2\n\n3\n", r"row 2 has 1 entries for 2 columns: is the file complete\?"),
        ("a,b\n1,2,\n", "row 1 has 3 entries"),
        ("a,b,a\n1,2,3\n", "has the column 'a' twice"),
        ("a, a \n1,2\n", "has the column 'a' twice"),
        ('a,"a\n b","a b"\n1,2,3\n', "has the column 'a b' twice"),
        ('a,b\n1,"2\n3,4\n', r"cannot read .* \(row 1: a quotation mark is not closed\)"),
        ('a,b\n1,"2"3\n', r"cannot read .* \(row 1: "),
        ('a,"b\n', r"cannot read .* \(the first row: a quotation mark is not closed\)"),
        ("a,b\n1,\0\n", r"line 2 holds a NUL byte"),
        ("a\0,b\n1,2\n", r"line 1 holds a NUL byte"),
        ("a,b\n1," + "x" * 200_000 + "\n", "field larger than field limit"),
    ],
)
def test_csv_that_is_no_table(tmp_path, text, message):
    """A file that is empty, ragged, torn or binary is refused by line or row, never filled up, cut or shifted."""
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    refused(path, message)
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(text.encode()))
    refused(path, message)


def test_csv_as_people_have_them(tmp_path):
    """A byte-order mark, blank lines, all three ends of lines, quoted commas and breaks, and headers over two lines."""
    path = tmp_path / "a.csv"
    for end in ("\n", "\r\n", "\r"):
        rows = ['\ufeff id ,"travel\ntime"', "", '"a,""b""",1', "  ", '"c\nd",2', ""]
        path.write_bytes(end.join(rows).encode())
        with open_table(path) as table:
            assert table.names == ["id", "travel time"]
            found = table.columns({"id": "labels", "travel time": "numbers"})
        assert found["id"].tolist() == ['a,"b"', "c\nd"]
        assert found["travel time"].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ("a,b\n1,2\n".encode("utf-16"), "it is UTF-16 or UTF-32, not UTF-8"),
        ("a,b\n1,2\n".encode("utf-32"), "it is UTF-16 or UTF-32, not UTF-8"),
        ("a,b\n1,2\n".encode("utf-16-le"), "NUL byte"),
        ("a,b\n1,2\ncafé,3\n".encode("latin-1"), "line 3: byte 0xe9 is not UTF-8"),
        (b"a,b\n" + b"1,2\n" * 50_000 + b"\xff,3\n", "line 50002: byte 0xff is not UTF-8"),
        (b"PK\x03\x04" + bytes(range(256)), "cannot read"),
    ],
)
def test_other_encodings_are_refused_by_line(tmp_path, raw, message):
    """UTF-16, Latin-1 and what is no text at all: the remedy is said, and no letter is replaced."""
    for name in ("a.csv", "a.json"):
        (tmp_path / name).write_bytes(raw)
        with pytest.raises(DataError, match=message) as caught, open_table(tmp_path / name) as table:
            table.columns(dict.fromkeys(table.names, "labels"))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot read"),
        ("{", "cannot read"),
        ("[" * 200_000, r"cannot read .* \(nested too deeply\)"),
        ("7", "no list of objects"),
        ('{"a": 1}', "no list of objects"),
        ("[1]", "no list of objects"),
        ('[{"a": 1}, {"a": 2, "a": 3}]', "row 2 gives 'a' twice"),
        ('[{"a": 1}, {"a": [{"b": 2, "b": 3}]}]', "row 2 gives 'b' twice"),
        ('[{"a": 1}, {"b": 2}]', "row 2 lacks 'a', which the first has|row 2 has 'b', which the first has not"),
        ('[{"a": 1, "b": 2}, {"a": 2}]', "row 2 lacks 'b', which the first has"),
        ('[{"a": 1, " a": 2}]', "has the column 'a' twice"),
    ],
)
def test_json_that_is_no_table(tmp_path, text, message):
    """What is no list of like objects is refused by row, also where JSON alone would let the last of two win."""
    path = tmp_path / "a.json"
    path.write_text(text)
    refused(path, message)


def test_a_list_under_a_key(tmp_path):
    """The key that may hold the list holds it alone, once."""
    path = tmp_path / "a.json"
    path.write_text('{"requests": [{"a": 1}]}')
    with open_table(path, under="requests") as table:
        assert table.columns({"a": "numbers"})["a"].tolist() == [1]
    for text in ('{"requests": [{"a": 1}], "mu": 2}', '{"requests": [], "requests": []}', "{}"):
        path.write_text(text)
        refused(path, "it takes requests alone", under="requests")


def test_files_that_are_not_there_or_damaged(tmp_path):
    """Nothing, a folder, and bytes that are no parquet or gzip file: one line each."""
    for kind in ("csv", "csv.gz", "json", "parquet"):
        refused(tmp_path / f"none.{kind}", "there is no file")
        (tmp_path / f"folder.{kind}").mkdir()
        refused(tmp_path / f"folder.{kind}", "cannot read .*directory")
    for kind in ("csv.gz", "parquet"):
        path = tmp_path / f"damaged.{kind}"
        path.write_bytes(b"nothing of the kind")
        refused(path, "cannot read")
    whole = written(tmp_path, "csv.gz", {"a": [str(i) for i in range(10_000)]}).read_bytes()
    (tmp_path / "cut.csv.gz").write_bytes(whole[:-9])
    refused(tmp_path / "cut.csv.gz", "cannot read")


@pytest.mark.parametrize(("index", "names"), [(None, ["a", "b"]), ("a", ["b", "a"]), (["a", "b"], ["c", "a", "b"])])
def test_an_index_of_pandas_is_a_column(tmp_path, index, names):
    """A named index is read like a column, and told apart; one without a name is no column."""
    frame = pd.DataFrame({"a": [1, 2], "b": [3, 4], **({"c": [5, 6]} if len(names) == 3 else {})}, index=[7, 9])
    (frame if index is None else frame.set_index(index)).to_parquet(tmp_path / "a.parquet")
    with open_table(tmp_path / "a.parquet") as table:
        assert table.names == names
        assert table.index == ({"__index_level_0__"} if index is None else set(np.atleast_1d(index)))
        assert table.columns({"a": "numbers"})["a"].tolist() == [1, 2]


def test_columns_twice_in_parquet(tmp_path):
    """A parquet file may hold a name twice; nobody can tell which is meant."""
    pq.write_table(pa.Table.from_arrays([pa.array([1]), pa.array([2])], names=["a", "a"]), tmp_path / "a.parquet")
    refused(tmp_path / "a.parquet", "has the column 'a' twice")


def test_rows_are_counted_across_pieces(tmp_path):
    """Whatever the size of a piece, all rows come, in order, and an error counts from the top of the file."""
    for kind in ("csv", "parquet"):
        path = written(tmp_path, kind, {"a": [str(i) for i in range(100)]})
        for size in (1, 7, 99, 100, 101):
            with open_table(path) as table:
                from optkit.basics.tables.cells import counts, flags

                pieces = [piece["a"] for piece in table.pieces({"a": counts}, size)]
            assert np.concatenate(pieces).tolist() == list(range(100))
            with open_table(path) as table, pytest.raises(DataError, match="a in row 3 is '2'"):
                list(table.pieces({"a": flags}, size))


def test_no_rows_are_columns_of_none(tmp_path):
    """A header alone is a table without rows."""
    for kind in ("csv", "parquet"):
        with open_table(written(tmp_path, kind, {"a": [], "b": []})) as table:
            found = table.columns({"a": "labels", "b": "numbers"})
        assert [column.size for column in found.values()] == [0, 0]


def test_missing_columns_are_named_with_what_there_is(tmp_path):
    """Of many columns only some are listed; other separators than commas are noticed."""
    path = tmp_path / "a.csv"
    path.write_text(",".join(f"c{i}" for i in range(5_000)) + "\n")
    with (
        open_table(path) as table,
        pytest.raises(DataError, match=r"no column 'a' and no 'b' or 'c'; it has c0, .*more$") as caught,
    ):
        table.need("c1", "a", "b|c")
    assert len(str(caught.value)) < 700
    for text in ("a;b\n1;2\n", "a\tb\n1\t2\n"):
        path.write_text(text)
        with open_table(path) as table, pytest.raises(DataError, match="write commas between the columns"):
            table.need("a")


def test_columns_without_a_name(tmp_path):
    """Any number of columns may have no name; they are one that nobody asks for."""
    path = tmp_path / "a.csv"
    path.write_text(",a,,\n0,1,2,3\n")
    with open_table(path) as table:
        assert table.names == ["", "a"]
        assert table.columns({"a": "numbers"})["a"].tolist() == [1]
