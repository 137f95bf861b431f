"""The log of offers: what it refuses, how logs are joined, and that files give back what was saved."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pandas.testing import assert_frame_equal

from optkit.basics.errors import DataError, InputError, OptkitError
from optkit.models.preferences.offers import SCHEMA, Offers

COLUMNS = ("situation", "group", "features", "pickup", "dropoff", "compensation", "chosen")


def log(**changes):
    """Three decisions of two groups: the first takes its second offer, the second rejects, the third takes."""
    return Offers(
        **{
            "situation": [0, 0, 1, 1, 2],
            "group": [0, 0, 1, 1, 0],
            "features": [[0.1, 1.0], [0.2, 2.0], [1 / 3, 3.0], [0.4, 4.0], [0.5, 5.0]],
            "pickup": [0, 1, 2, 0, 1],
            "dropoff": [1, 0, 0, 1, 1],
            "compensation": [10.0, 12.5, 0.1, 7.0, 9.0],
            "chosen": [False, True, False, False, True],
            "names": ("size", "time"),
            **changes,
        }
    )


def assert_same(one, other):
    """All columns and names are equal, bit by bit."""
    assert one.names == other.names
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_counts_by_hand():
    """Rows, decisions and choices are what one counts, and an unnamed feature gets a number."""
    offers = log(names=())
    assert (len(offers), offers.n_situations, offers.n_choices) == (5, 3, 2)
    assert offers.names == ("feature_0", "feature_1")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"chosen": [1, 1, 0, 0, 1]}, "situation 0 has 2 choices"),
        ({"group": [0, 0, 1, 0, 0]}, "situation 1 has workers of two groups"),
        ({"compensation": [1, 2, np.nan, 4, 5]}, r"compensation\[2\] is nan"),
        ({"features": [[1.0, np.inf]] + 4 * [[0.0, 0.0]]}, r"features\[0, 1\] is inf"),
        ({"chosen": [0, 1, 0, 0, np.nan]}, r"chosen\[4\] is nan"),
        ({"chosen": [0, 2, 0, 0, 0]}, "chosen in row 1 is 2, neither 0 nor 1"),
        ({"chosen": [0, 0.5, 0, 0, 0]}, r"chosen\[1\] = 0.5 is not a whole number"),
        ({"group": [0, 0, -1, -1, 0]}, "group in row 2 is negative"),
        ({"pickup": [0, -3, 0, 0, 0]}, "pickup in row 1 is negative"),
        ({"dropoff": [0, 0, 0, 0, -1]}, "dropoff in row 4 is negative"),
        ({"pickup": [0.5, 0, 0, 0, 0]}, r"pickup\[0\] = 0.5 is not a whole number"),
        ({"compensation": list("abcde")}, "compensation holds text"),
        ({"situation": list("aabbc")}, "situation holds text"),
        ({"compensation": [1.0, 2.0]}, "compensation has shape"),
        ({"features": np.ones(5)}, "features has shape"),
        ({"names": ("one",)}, "1 names for 2 features"),
    ],
)
def test_bad_columns_are_one_line_that_names_them(changes, words):
    """Two choices, two groups, NaN, negative codes, text and wrong lengths: a DataError that names column and place."""
    with pytest.raises(DataError, match=words) as caught:
        log(**changes)
    assert "\n" not in str(caught.value)


def test_rows_of_a_situation_need_not_stand_together():
    """Checks go by the situation's number: apart or together, two choices are two choices."""
    order = [4, 0, 2, 1, 3]
    assert log().take(order).n_situations == 3
    with pytest.raises(DataError, match="situation 5 has 2 choices"):
        Offers([5, 1, 5], [0, 0, 0], np.ones((3, 1)), [0] * 3, [0] * 3, [1.0] * 3, [1, 0, 1])


def test_columns_are_copies_that_cannot_be_written():
    """Changing the arrays that were passed in changes no log, and a log's own arrays are read-only."""
    pay = np.arange(5.0)
    offers = log(compensation=pay)
    pay[0] = 99
    assert offers.compensation[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        offers.compensation[0] = 1


def test_take_by_mask_and_by_index():
    """Rows are chosen alike by mask and by index."""
    offers = log()
    assert_same(offers.take(offers.group == 1), offers.take([2, 3]))
    assert offers.take(offers.group == 1).n_choices == 0


@pytest.mark.parametrize(
    "rows",
    [
        np.ma.masked_array([True] * 5, [True, *[False] * 4]),
        np.ma.masked_array([0, 1], [True, False]),
        [True, np.ma.masked, True, True, True],
        ["True"] * 5,
        [True, np.nan, True, True, True],
        [1.0, np.nan],
        [1.0, 0.0, 1.0, 0.0, 0.0],
        [0.5],
        [True] * 4,
        [True] * 6,
        pd.Series([True] * 5, index=range(1, 6)),
        pd.Series([True] * 5, index=list("abcde")),
        pd.Series([True] * 5, index=[0, 0, 1, 2, 3]),
        pd.Series([True, pd.NA, True, True, True], dtype="boolean"),
        [True, 0, 0, 0, 0],
        [5],
        [-6],
        [10**30],
        [1 + 0j],
        np.array([0], "M8[D]"),
        [[0, 1]],
        np.ones((5, 2), bool),
        3,
        None,
        "all",
        {"a": 1},
        [[1], [1, 2]],
    ],
    ids=str,
)
def test_rows_that_are_none_are_refused(rows):
    """What hides, is missing, is no row, or is called otherwise is one line, and never taken for something else."""
    with pytest.raises(InputError, match=r"rows|the log") as caught:
        log().take(rows)
    assert "\n" not in str(caught.value)


def test_a_mask_goes_by_its_labels():
    """A mask that was sorted finds its rows again; places, slices and nothing at all are taken as they stand."""
    offers, rng = log(), np.random.default_rng(0)
    for _ in range(10):
        wanted = rng.random(5) < 0.5
        right = offers.take(np.flatnonzero(wanted))
        for same in (wanted, wanted.tolist(), wanted.astype(object), pd.Series(wanted).sample(frac=1.0)):
            assert_same(offers.take(same), right)
    assert_same(offers.take(slice(1, 3)), offers.take([1, -3]))
    assert_same(offers.take(pd.Series([1, 2], index=["a", "b"])), offers.take(np.array([1, 2], np.uint8)))
    assert len(offers.take([])) == len(offers.take(np.zeros(5, bool))) == 0


class Counted(str):
    """Text that counts how often it is compared, through the changes that a table makes to names."""

    times = 0
    __hash__ = str.__hash__

    def __eq__(self, other):
        Counted.times += 1
        return str.__eq__(self, other)

    def __str__(self):
        return self


def test_names_are_compared_once_each():
    """Many features take no longer than their number: each name is looked up, not held against all before it."""
    Counted.times, n = 0, 500
    Offers([0], [0], np.zeros((1, n)), [0], [0], [1.0], [1], names=tuple(Counted(f"km{f}") for f in range(n)))
    assert Counted.times < 4 * n
    with pytest.raises(DataError, match=r"'km3'.* is taken"):
        Offers([0], [0], np.zeros((1, 5)), [0], [0], [1.0], [1], names=("km3", "km1", "km2", "km3", "km5"))


def test_join_numbers_situations_anew():
    """Situations of two logs never merge, whatever their numbers, and all else is put end to end."""
    first, second = log(), log(situation=[0, 0, 7, 7, -2])
    joined = Offers.join([first, second])
    assert joined.n_situations == 6
    assert joined.n_choices == 4
    for part, rows in ((first, slice(0, 5)), (second, slice(5, 10))):
        same = joined.situation[rows][:, None] == joined.situation[rows]
        np.testing.assert_array_equal(same, part.situation[:, None] == part.situation)
        np.testing.assert_array_equal(joined.features[rows], part.features)
    assert not set(joined.situation[:5]) & set(joined.situation[5:])


@pytest.mark.parametrize(("parts", "words"), [([], "no offers to join"), ([log(), log(names=("a", "b"))], "different")])
def test_join_refuses(parts, words):
    """Nothing to join, or features of different names, is an InputError."""
    with pytest.raises(InputError, match=words):
        Offers.join(parts)


def test_round_trips_are_exact(tmp_path):
    """from_frame(to_frame()) and load(save()) give every bit back, and save says where it wrote."""
    offers = log()
    assert_same(Offers.from_frame(offers.to_frame()), offers)
    path = offers.save(tmp_path / "log.parquet")
    assert path == tmp_path / "log.parquet"
    assert_same(Offers.load(path), offers)


def test_round_trip_without_features_or_rows(tmp_path):
    """A log of no features, and one of no rows, survive the disk."""
    bare = log(features=np.empty((5, 0)), names=())
    assert_same(Offers.load(bare.save(tmp_path / "bare.parquet")), bare)
    empty = log().take(np.zeros(5, bool))
    assert_same(Offers.load(empty.save(tmp_path / "empty.parquet")), empty)


def test_saved_situations_keep_their_rows_together(tmp_path):
    """Numbers of situations are labels: after the disk they may differ, but they part the rows as before."""
    offers = log(situation=[9, 9, -4, -4, 3])
    back = Offers.load(offers.save(tmp_path / "log.parquet"))
    np.testing.assert_array_equal(
        back.situation[:, None] == back.situation, offers.situation[:, None] == offers.situation
    )


def test_a_users_csv_with_named_situations(tmp_path):
    """Situations may be text, columns in any order, roles missing: those are 0, and other columns are features."""
    path = tmp_path / "own.csv"
    path.write_text("size,chosen,situation,compensation,hour\n1.5,0,mon-1,10,8\n2.5,1,mon-1,11,8\n3.5,0,tue-7,5,9\n")
    offers = Offers.load(path)
    assert offers.names == ("size", "hour")
    np.testing.assert_array_equal(offers.features, [[1.5, 8], [2.5, 8], [3.5, 9]])
    np.testing.assert_array_equal(offers.situation, [0, 0, 1])
    np.testing.assert_array_equal(offers.chosen, [0, 1, 0])
    for name in ("group", "pickup", "dropoff"):
        np.testing.assert_array_equal(getattr(offers, name), 0)
    only = Offers.load(path, ["hour"])
    assert only.names == ("hour",)


def test_booleans_and_nullable_columns_are_read():
    """chosen may be True/False, and pandas' nullable types are numbers as long as nothing is missing."""
    frame = log().to_frame()
    fancy = frame.astype({"chosen": "boolean", "group": "Int64", "size": "Float64"})
    assert_same(Offers.from_frame(fancy), log())
    with pytest.raises(DataError, match="group"):
        Offers.from_frame(fancy.assign(group=pd.array([0, 0, None, 1, 0], dtype="Int64")))


def test_to_frame_by_hand():
    """The table has the documented columns in order."""
    frame = log().to_frame()
    want = ["situation", "group", "pickup", "dropoff", "size", "time", "compensation", "chosen"]
    assert list(frame.columns) == want
    assert_frame_equal(frame[["compensation"]], pd.DataFrame({"compensation": [10.0, 12.5, 0.1, 7.0, 9.0]}))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("situation,chosen,x\n1,0,2\n", "no column 'compensation'; it has situation, chosen, x"),
        ("situation,compensation,chosen,x\n,1,0,2\n", "situation in row 1 is empty"),
        ("situation,compensation,chosen,x\n1,2,0,\n", "x in row 1 is empty, not a finite number"),
        ("situation,compensation,chosen,city\n1,2,0,Bonn\n", "city in row 1 is 'Bonn', not a finite number"),
        ("situation,compensation,chosen,x\n1,2,yes,1\n", "chosen in row 1 is 'yes', neither 0 nor 1"),
        ("", "cannot read"),
        ("a,b\n1\n2,3,4\n", "no column 'situation' and no 'compensation' and no 'chosen'; it has a, b"),
    ],
)
def test_bad_csv_is_one_line_with_the_files_name(tmp_path, text, words):
    """A missing column, an empty cell, text or a damaged table: one line with the file and the column."""
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=words) as caught:
        Offers.load(path)
    assert "bad.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_feature_is_named(tmp_path):
    """A feature that was asked for and is not there is named, with those that are."""
    with pytest.raises(DataError, match="no column 'colour'; it has situation"):
        Offers.load(log().save(tmp_path / "log.parquet"), ["size", "colour"])


def test_missing_damaged_and_newer_files(tmp_path):
    """No file, a cut-off file, a folder and a file of a newer optkit each say which it is."""
    with pytest.raises(DataError, match="there is no file"):
        Offers.load(tmp_path / "none.parquet")
    with pytest.raises(DataError, match="there is no file"):
        Offers.load(tmp_path / "none.csv")
    path = log().save(tmp_path / "log.parquet")
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    with pytest.raises(DataError, match="cannot read"):
        Offers.load(path)
    path.write_bytes(whole[:4] + b"\xff" * 60 + whole[64:])
    with pytest.raises(DataError, match="cannot read"):
        Offers.load(path)
    with pytest.raises(DataError, match="cannot read"):
        Offers.load(tmp_path)
    table = pa.Table.from_pandas(log().to_frame(), preserve_index=False)
    pq.write_table(table.replace_schema_metadata({"optkit-offers": str(SCHEMA + 1)}), path)
    with pytest.raises(DataError, match="newer optkit"):
        Offers.load(path)


def test_a_write_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    """If the disk refuses half-way, the old file stands, nothing is left beside it, and one line says so."""
    path = log().save(tmp_path / "log.parquet")
    before = path.read_bytes()

    def full(table, where):
        where.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    with pytest.raises(OptkitError, match="No space left on device"):
        log(compensation=[1, 1, 1, 1, 1]).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_missing_or_in_the_way(tmp_path):
    """A target in a folder that does not exist, or that is a folder, is one line of our tree."""
    (tmp_path / "log.parquet").mkdir()
    for target in (tmp_path / "no" / "log.parquet", tmp_path / "log.parquet"):
        with pytest.raises(OptkitError, match="cannot be written"):
            log().save(target)
    assert [p.name for p in tmp_path.iterdir()] == ["log.parquet"]


def test_a_parent_that_is_a_file(tmp_path):
    """A target below a file is one line of our tree."""
    (tmp_path / "file").write_text("")
    with pytest.raises(OptkitError, match="cannot be written"):
        log().save(tmp_path / "file" / "log.parquet")


def test_a_target_without_a_name():
    """An empty path is one line of our tree."""
    with pytest.raises(OptkitError):
        log().save("")


@pytest.mark.parametrize("names", [("group", "time"), ("size", "size"), ("compensation", "time"), ("chosen", "time")])
def test_feature_names_are_unique_and_no_roles(names):
    """A feature named like a role or like another feature is refused, since no file could hold it."""
    with pytest.raises(DataError):
        log(names=names)


LABELS = {
    "day.visit": [f"20240101.{visit}" for visit in range(1, 31)],
    "leading zeros": ["007", "7"],
    "versions": ["1.1", "1.10"],
    "one e in a hash": ["1e3", "1000"],
    "date and number": [f"20240101.{visit:010d}" for visit in range(1, 301)],
    "words for nothing": ["NA", "nan", "null", "None"],
    "booleans": ["True", "TRUE", "1"],
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
@pytest.mark.parametrize("case", LABELS, ids=str)
def test_situations_with_different_names_are_different(tmp_path, kind, case):
    """As many situations as names, whatever a name looks like, in every format, and from a frame of text."""
    labels = LABELS[case]
    frame = pd.DataFrame({"situation": np.repeat(labels, 2), "km": [1.0, 2.0] * len(labels)}, dtype=object)
    frame = frame.assign(compensation=5.0, chosen=[1, 0] * len(labels))
    path = tmp_path / f"log.{kind}"
    {
        "csv": lambda: frame.to_csv(path, index=False),
        "json": lambda: frame.to_json(path, orient="records"),
        "parquet": lambda: frame.to_parquet(path, index=False),
    }[kind]()
    for offers in (Offers.load(path), Offers.from_frame(frame)):
        assert offers.n_situations == offers.n_choices == len(labels)
        np.testing.assert_array_equal(offers.situation, np.repeat(np.arange(len(labels)), 2))


def test_an_error_calls_a_situation_what_the_user_calls_it(tmp_path):
    """Two choices, or two groups: the label of the file or the frame is named, and no number that nobody knows."""
    path = tmp_path / "log.csv"
    path.write_text("situation,x,compensation,chosen\nmon,1,5,0\n007,1,5,1\n007,2,6,1\n")
    with pytest.raises(DataError, match=r"log.csv: offers: situation 007 has 2 choices"):
        Offers.load(path)
    frame = log().to_frame().assign(situation=["a", "a", "b", "b", "c"], group=[0, 0, 1, 0, 0])
    with pytest.raises(DataError, match="situation b has workers of two groups"):
        Offers.from_frame(frame)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2,0.5,0,1\n", "row 1 has 5 entries for 4 columns: is a name missing in the header"),
        ("1,2,0\n", "row 1 has 3 entries for 4 columns: is the file complete"),
        ("1,2,0,0\n1,2,x,0\n", "compensation in row 2 is 'x', not a finite number"),
        ("1,2,0,0\n1,2,1e150,0\n", "compensation in row 2 is '1e150', beyond any money"),
        ('1,2,0,0\n2,"2,0,0\n', "a quotation mark is not closed"),
    ],
)
def test_rows_are_never_shifted_or_filled_up(tmp_path, text, words):
    """A row of another width than the header, or a torn one, is refused by its number."""
    path = tmp_path / "log.csv"
    path.write_text("situation,km,compensation,chosen\n" + text)
    with pytest.raises(DataError, match=words):
        Offers.load(path)


@pytest.mark.parametrize("group", ["007", "1e0", "x", "-1", "0.5", "10001"])
def test_groups_of_a_file_are_numbers_written_in_one_way(tmp_path, group):
    """``007`` and ``7`` would be one group, and are two names: what is no plain number is refused."""
    path = tmp_path / "log.csv"
    path.write_text(f"situation,group,compensation,chosen\n1,0,5,0\n2,{group},5,0\n")
    with pytest.raises(DataError, match=r"group in row 2 is .*count from 0 without gaps"):
        Offers.load(path)


def test_an_index_is_a_column_if_it_has_a_role(tmp_path):
    """What pandas took for the index is read where it has a role or is asked for, and is no feature otherwise."""
    frame = log().to_frame()
    path = tmp_path / "log.parquet"
    for index, features in (("situation", None), ("chosen", None), ("size", ["size", "time"])):
        frame.set_index(index).to_parquet(path)
        for offers in (Offers.load(path, features), Offers.from_frame(frame.set_index(index), features)):
            assert offers.n_situations == 3
            assert sorted(offers.names) == ["size", "time"]
    for index in ("size", None):
        (frame.set_index("size") if index else frame[::-1]).to_parquet(path)
        assert Offers.load(path).names == (("time",) if index else ("size", "time"))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda f: pd.concat([f, f[["situation"]]], axis=1), "the column 'situation' twice"),
        (lambda f: pd.concat([f, f[["size"]]], axis=1), "the column 'size' twice"),
        (lambda f: f.assign(situation=[1, "1", 2, 2, 3]), "situation is 1 in row 0 and '1' in row 1"),
        (lambda f: f.assign(situation=pd.Series([1, True, 2, 2, 3], dtype=object)), "situation is 1 in row 0 and True"),
        (lambda f: f.assign(situation=[["a"]] * 5), "situation in row 0 is a list"),
        (lambda f: f.assign(situation=["a", " ", "b", "b", "c"]), "situation in row 1 is empty"),
        (lambda f: f.assign(situation=["a", None, "b", "b", "c"]), "situation in row 1 is empty"),
        (lambda f: f.T.set_index([0, 1]).T, "not a DataFrame with one row of names"),
        (lambda f: f.to_dict("list"), "the offers are a dict, not a DataFrame"),
    ],
)
def test_frames_that_are_no_log(wrong, words):
    """A column that is there twice, labels of two kinds, and what is no frame are one line, and no traceback."""
    with pytest.raises(DataError, match=words) as caught:
        Offers.from_frame(wrong(log().to_frame()))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("features", [["size", "size"], ["size", "chosen"], ["group"]])
def test_features_that_are_asked_for_twice_or_have_a_role(tmp_path, features):
    """A column is one feature or has one role."""
    for make in (
        lambda: Offers.from_frame(log().to_frame(), features),
        lambda: Offers.load(log().save(tmp_path / "l.parquet"), features),
    ):
        with pytest.raises(DataError, match="asked for as a feature twice, or has another role"):
            make()


def test_clusters_are_named_by_a_column_and_kept(tmp_path):
    """Whose decisions depend on each other: read from a frame and a file, taken, joined, saved; mixed ones refused."""
    frame = log().to_frame()
    frame["worker"] = np.where(frame.situation == frame.situation.iloc[0], "ann", "bob")
    features = list(log().names)
    offers = Offers.from_frame(frame, cluster="worker")
    assert offers.names == log().names
    assert offers.cluster.tolist() == [int(name == "bob") for name in frame.worker]
    each = Offers.from_frame(frame, features, cluster="situation").cluster
    assert [len(set(each[frame.situation == s])) for s in frame.situation.unique()] == [1] * frame.situation.nunique()
    assert len(set(each)) == frame.situation.nunique()
    frame.to_csv(tmp_path / "log.csv", index=False)
    loaded = Offers.load(tmp_path / "log.csv", cluster="worker")
    again = Offers.load(offers.save(tmp_path / "log.parquet"))
    for other in (loaded, again, offers.take(slice(None))):
        assert other.names == offers.names
        assert other.cluster.tolist() == offers.cluster.tolist()
    assert set(Offers.join([offers, offers]).cluster) == {0, 1, 2, 3}
    with pytest.raises(InputError, match="logs with clusters and logs without"):
        Offers.join([offers, log()])
    mixed = frame.assign(worker=[f"w{i}" for i in range(len(frame))])
    with pytest.raises(DataError, match=r"situation \d+ has two clusters"):
        Offers.from_frame(mixed, cluster="worker")
    for wrong, words in (("boss", "no column 'boss'"), ("group", "'group' cannot be the cluster")):
        with pytest.raises(DataError, match=words):
            Offers.from_frame(frame, cluster=wrong)
        with pytest.raises(DataError, match=words):
            Offers.load(tmp_path / "log.csv", cluster=wrong)
    with pytest.raises(DataError, match="worker in row 1 is empty"):
        Offers.from_frame(frame.assign(worker=frame.worker.where(frame.index != 1)), cluster="worker")
    with pytest.raises(DataError, match="a feature cannot be called 'cluster'"):
        Offers.from_frame(offers.to_frame())
