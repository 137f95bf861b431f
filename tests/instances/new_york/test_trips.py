"""Trip records: what is kept, what is counted, and what is refused."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import DataError
from optkit.instances.new_york.trips import BAD, ELSEWHERE, REGIONS, UNASKED, manhattan_zones, read_trips

OFFICIAL = (
    "4 12 13 24 41 42 43 45 48 50 68 74 75 79 87 88 90 100 103 104 105 107 113 114 116 120 125 127 128 137 140 141 "
    "142 143 144 148 151 152 153 158 161 162 163 164 166 170 186 194 202 209 211 224 229 230 231 232 233 234 236 237 "
    "238 239 243 244 246 249 261 262 263"
)
"""TLC's location ids of the borough Manhattan."""

BATTERY, TIMES_SQUARE, CENTRAL_PARK, YORKVILLE, AIRPORT = 12, 230, 43, 263, 132


def table(*rows: tuple) -> pd.DataFrame:
    """Rows of (pick-up, drop-off, from, to) under TLC's names, beside columns that nobody reads."""
    names = ["tpep_pickup_datetime", "tpep_dropoff_datetime", "PULocationID", "DOLocationID"]
    frame = pd.DataFrame(list(rows), columns=names)
    return frame.assign(VendorID=1, store_and_fwd_flag="N", total_amount=12.5)


def good(n: int = 40) -> pd.DataFrame:
    start = pd.Timestamp("2018-03-05 11:00:07") + pd.to_timedelta(np.arange(n) * 97, unit="s")
    zones = [BATTERY, TIMES_SQUARE, CENTRAL_PARK, YORKVILLE]
    ends = start + pd.to_timedelta(300 + 11 * np.arange(n) % 3600, unit="s")
    return table(*zip(start, ends, np.resize(zones, n), np.resize(zones[::-1], n), strict=True))


def written(frame: pd.DataFrame, path: Path) -> Path:
    if path.suffix == ".parquet":
        frame.to_parquet(path)
    else:
        frame.to_csv(path, index=False)
    return path


def test_every_zone_of_manhattan_has_one_of_four_regions() -> None:
    zones = manhattan_zones()
    assert list(zones.columns) == ["LocationID", "zone", "region"]
    assert zones["LocationID"].tolist() == [int(i) for i in OFFICIAL.split()]
    assert set(zones["region"]) == {1, 2, 3, 4}
    assert zones["zone"].str.len().min() > 0


@pytest.mark.parametrize(
    ("zone", "region"),
    [
        *[("Battery Park", 1), ("Alphabet City", 1), ("West Village", 1), ("Union Sq", 2), ("Gramercy", 2)],
        *[("Clinton West", 2), ("Midtown North", 2), ("Lincoln Square East", 3), ("Lenox Hill West", 4)],
        *[("Central Park", 3), ("Central Harlem", 3), ("Inwood", 3), ("East Harlem North", 4), ("Roosevelt Island", 4)],
        *[("Randalls Island", 4), ("Governor's Island/Ellis Island/Liberty Island", 1)],
    ],
)
def test_a_zone_is_in_the_region_that_the_rule_says(zone: str, region: int) -> None:
    named = manhattan_zones().query("zone == @zone")
    assert set(named["region"]) == {region}


def test_a_trip_is_read_as_it_is_written(tmp_path: Path) -> None:
    path = written(table(("2018-03-05 11:00:07", "2018-03-05 11:12:37", BATTERY, YORKVILLE)), tmp_path / "a.csv")
    trips = read_trips(path)
    assert trips.frame.to_dict("records") == [
        {"pickup_time": pd.Timestamp("2018-03-05 11:00:07"), "pickup": 0, "dropoff": 3, "travel_time": 12.5}
    ]
    assert (trips.rows, sum(trips.report.values()), trips.files) == (1, 0, ("a.csv",))


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.CSV", "a.parquet"])
def test_every_format_gives_the_same_trips(tmp_path: Path, name: str) -> None:
    expected = read_trips(written(good(), tmp_path / "reference.parquet"))
    pd.testing.assert_frame_equal(read_trips(written(good(), tmp_path / name)).frame, expected.frame)


def _green(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.rename(columns=lambda name: name.replace("tpep", "lpep"))


def _shouted(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.rename(columns=lambda name: f" {name.upper()} ")


def _american(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(**{c: frame[c].dt.strftime("%m/%d/%Y %I:%M:%S %p") for c in frame.columns[:2]})


def _zoned(frame: pd.DataFrame) -> pd.DataFrame:
    first, last = frame.columns[:2]
    stamped = frame[last].astype(str) + np.resize(["-05:00", "Z"], len(frame))
    return frame.assign(**{first: frame[first].dt.tz_localize("UTC"), last: stamped})


def _floating(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.astype({"PULocationID": float, "DOLocationID": float})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["b.csv", "b.parquet"])
@pytest.mark.parametrize("change", [_green, _shouted, _american, _zoned, _floating])
def test_dialects_of_the_records_give_the_same_trips(tmp_path: Path, change, name: str) -> None:
    expected = read_trips(written(good(), tmp_path / "a.parquet"))
    pd.testing.assert_frame_equal(read_trips(written(change(good()), tmp_path / name)).frame, expected.frame)


def test_bad_rows_are_counted_once_each_under_their_first_reason(tmp_path: Path) -> None:
    start, end = "2018-03-05 11:00:00", "2018-03-05 11:10:00"
    bad = {
        "missing value": [(None, end, 12, 12), (start, None, 12, 12), (start, end, None, 12), ("junk", end, 12, None)],
        "unreadable date": [("junk", end, 12, 12), (start, "2018-02-30 11:00:00", 12, 0)],
        "unknown zone": [(start, end, 0, 12), (start, end, 12, 266), (start, end, 12.5, 12), (start, end, "x", 12)],
        "drop-off not after pick-up": [(start, start, 12, 12), (end, start, 12, AIRPORT)],
        "longer than two hours": [(start, "2018-03-05 13:00:01", 12, 12)],
        "implausible date": [("2008-12-31 23:59:59", "2009-01-01 00:10:00", 12, 12)] * 3,
        ELSEWHERE: [(start, end, AIRPORT, 12), (start, end, 12, 264), (start, end, 265, 1)],
    }
    fine = [(start, end, 12, 12), (start, "2018-03-05 13:00:00", 12, 43)]
    rows = [*fine, *(row for rows in bad.values() for row in rows)]
    trips = read_trips(written(table(*rows), tmp_path / "a.csv"))
    assert trips.report == {reason: len(rows) for reason, rows in bad.items()}
    assert tuple(trips.report) == (*BAD, ELSEWHERE)
    assert trips.rows == len(rows) == len(trips.frame) + sum(trips.report.values())


@pytest.mark.parametrize(
    ("name", "kept"), [("yellow_tripdata_2018-03.csv", 1), ("green_tripdata_2018_x.csv", 2), ("tripdata.csv", 4)]
)
def test_a_date_outside_the_month_in_the_files_name_is_implausible(tmp_path: Path, name: str, kept: int) -> None:
    days = ["2018-03-31 23:59:00", "2018-04-01 00:00:00", "2017-12-31 23:00:00", "2019-01-01 00:00:00"]
    rows = [(day, str(pd.Timestamp(day) + pd.Timedelta("5min")), 12, 12) for day in days]
    trips = read_trips(written(table(*rows), tmp_path / name))
    assert (len(trips.frame), trips.report["implausible date"]) == (kept, 4 - kept)


def test_several_files_and_a_folder_of_them_are_read_together(tmp_path: Path) -> None:
    whole = read_trips(written(good(), tmp_path / "whole.csv"))
    folder = tmp_path / "months"
    folder.mkdir()
    parts = [
        written(good()[:15], folder / "yellow_tripdata_2018-03.csv"),
        written(good()[15:], folder / "yellow_tripdata_2018-03_b.parquet"),
    ]
    (folder / "taxi_zone_lookup.csv").write_text("LocationID,Borough\n1,EWR\n")
    for paths in (parts, folder, [*map(str, parts), folder]):
        trips = read_trips(paths)
        pd.testing.assert_frame_equal(trips.frame, whole.frame)
        assert trips.files == tuple(p.name for p in parts)
        assert trips.rows == 40


def test_long_files_are_read_in_pieces_without_a_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [written(good(), tmp_path / name) for name in ("a.csv", "a.parquet")]
    whole = read_trips(paths[0]).frame
    monkeypatch.setattr("optkit.instances.new_york.trip_files.CHUNK", 7)
    for path in paths:
        pd.testing.assert_frame_equal(read_trips(path).frame, whole)


def test_only_the_hours_asked_for_are_kept_and_the_others_are_counted(tmp_path: Path) -> None:
    path = written(good(), tmp_path / "a.parquet")
    noon = np.datetime64("2018-03-05T12:00:00")
    some, every = read_trips(path, when=lambda times: times >= noon), read_trips(path)
    pd.testing.assert_frame_equal(some.frame, every.frame.query("pickup_time >= @noon").reset_index(drop=True))
    assert some.report[UNASKED] == len(every.frame) - len(some.frame) > 0
    assert some.period == every.period


def test_the_summary_names_every_count(tmp_path: Path) -> None:
    path = written(good(), tmp_path / "a.csv")
    path.write_text(path.read_text() + ",,1,2,,,\n")
    trips = read_trips(path)
    text = trips.summary()
    assert "41 rows from 1 file(s)" in text
    assert "1  missing value" in text
    assert "40  trips kept" in text
    assert all(f"25.0%  {r} {name}" in text for r, name in enumerate(REGIONS, 1))
    assert ELSEWHERE not in text


def _refused(paths, message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        read_trips(paths)
    assert len(str(caught.value).splitlines()) == 1


def test_missing_columns_are_named_beside_those_present(tmp_path: Path) -> None:
    for name in ("a.csv", "a.parquet"):
        path = written(good().drop(columns=["PULocationID", "tpep_dropoff_datetime"]), tmp_path / name)
        _refused(
            path, "no column tpep_dropoff_datetime, PULocationID; it has tpep_pickup_datetime, DOLocationID, Vendor"
        )


def test_a_path_that_is_no_trip_file_is_refused(tmp_path: Path) -> None:
    _refused(tmp_path / "absent.csv", "there is no file .*absent.csv")
    _refused(
        written(good(), tmp_path / "a.txt"), r"a.txt is no trip file: its name must end in .parquet, .csv, .csv.gz"
    )
    _refused([], "no trip file is named")
    (tmp_path / "empty").mkdir()
    _refused(tmp_path / "empty", "the folder .*empty holds no trip records")


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    for name in ("a.parquet", "a.csv.gz"):
        path = written(good(400), tmp_path / name)
        path.write_bytes(path.read_bytes()[:-30])
        _refused(path, f"cannot read .*{name} .*fetch it again")
    path = written(good(400), tmp_path / "b.parquet")
    content = bytearray(path.read_bytes())
    content[4:2000] = bytes(1996)
    path.write_bytes(content)
    _refused(path, "cannot read .*b.parquet")
    useless = {"noise.parquet": b"no parquet", "empty.parquet": b"", "empty.csv": b"", "a.csv.gz": b"no gzip"}
    for name, content in useless.items():
        (tmp_path / name).write_bytes(content)
        _refused(tmp_path / name, f"cannot read .*{name}")
    (tmp_path / "noise.csv").write_bytes(b"\xff\xfe\x00\x81binary\n" * 9)
    _refused(tmp_path / "noise.csv", "cannot read .*noise.csv")
    path = written(good(), tmp_path / "open.csv")
    path.write_text(path.read_text() + '"2018-03-05 11:00:00')
    _refused(path, "cannot read .*open.csv .row 41: a quotation mark is not closed")


def test_a_row_with_too_few_or_too_many_fields_is_refused_by_its_number(tmp_path: Path) -> None:
    """Nobody can tell which of its fields is missing, so that all may be shifted; a cut-off file ends in such a row."""
    whole = written(good(), tmp_path / "whole.csv").read_text()
    for number, more in enumerate(("1,2,3,4,5,6,7,8,9,10,11\n", "2018-03-05 11:00:00,2\n", "1,2,3,4,5,6,7,8\n")):
        path = tmp_path / f"{number}.csv"
        path.write_text(whole + more)
        _refused(path, rf"{number}.csv: row 41 has \d+ entries for 7 columns")
    path.write_text(whole[:-20])
    _refused(path, "row 40 has . entries for 7 columns: is the file complete")


def test_commas_at_the_ends_of_rows_are_no_fields(tmp_path: Path) -> None:
    """TLC's months of 2016 have two commas more in each row than in the header, and a blank line below it."""
    whole = written(good(), tmp_path / "whole.csv")
    header, *rows = whole.read_text().splitlines()
    path = tmp_path / "commas.csv"
    path.write_text("\n".join([header, "", *(f"{row},," for row in rows), ""]))
    pd.testing.assert_frame_equal(read_trips(path).frame, read_trips(whole).frame)


@pytest.mark.parametrize("name", ["tpep_pickup_datetime", "PULocationID", "VendorID", None])
def test_a_pandas_index_is_a_column_like_any_other(tmp_path: Path, name: str | None) -> None:
    """Whatever pandas took for the index of its rows, the trips of a parquet file are the same."""
    frame = good() if name is None else good().set_index(name)
    path = written(frame if name else frame[::-1], tmp_path / "indexed.parquet")
    expected = read_trips(written(good() if name else good()[::-1], tmp_path / "plain.csv"))
    pd.testing.assert_frame_equal(read_trips(path).frame, expected.frame)


def test_hidden_files_of_a_folder_are_no_records(tmp_path: Path) -> None:
    """macOS leaves ._NAME beside NAME, and others leave what they have not finished."""
    written(good(), tmp_path / "yellow_tripdata_2018-03.parquet")
    (tmp_path / "._yellow_tripdata_2018-03.parquet").write_bytes(b"\0\5\x16\7" + bytes(4092))
    (tmp_path / ".yellow_tripdata_2018-04.csv").write_text("half")
    (tmp_path / ".DS_Store").write_bytes(b"\0")
    assert read_trips(tmp_path).files == ("yellow_tripdata_2018-03.parquet",)


TWINS = {
    "the month as CSV": lambda frame: (frame, "yellow_tripdata_2018-03.csv"),
    "a copy": lambda frame: (frame, "yellow_tripdata_2018-03 (1).parquet"),
    "under another name, in another order": lambda frame: (frame[::-1], "mine.csv.gz"),
    "its first half": lambda frame: (frame[: len(frame) // 2], "half.csv"),
    "a week more": lambda frame: (pd.concat([frame, _later(frame)]), "more.csv"),
    "green columns": lambda frame: (_green(frame), "green.csv"),
    "zones as floats": lambda frame: (_floating(frame), "floats.csv"),
}


def _later(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(**{c: frame[c] + pd.Timedelta("7D") for c in frame.columns[:2]})


@pytest.mark.slow
@pytest.mark.parametrize("case", TWINS, ids=str)
@pytest.mark.parametrize("count", [3, 10_000])  # fewer, and more, than are kept of a file
def test_trips_that_two_files_hold_are_not_counted_twice(tmp_path: Path, case: str, count: int) -> None:
    """Whatever its name, format and order: a file that holds trips of another is refused, and both are named."""
    frame = good(count)
    written(frame, tmp_path / "yellow_tripdata_2018-03.parquet")
    other, name = TWINS[case](frame)
    written(other, tmp_path / name)
    _refused([tmp_path / "yellow_tripdata_2018-03.parquet", tmp_path / name], "hold the same trips.*leave one out")


@pytest.mark.slow
def test_other_trips_are_kept_apart_from_twins(tmp_path: Path) -> None:
    """Files of other weeks, and of the same hours with other zones, are read together; so is a file named twice."""
    frame = good(9_000)
    elsewhere = frame.assign(PULocationID=np.roll(frame["PULocationID"], 1))
    paths = [written(one, tmp_path / f"{n}.parquet") for n, one in enumerate([frame, elsewhere, _later(_later(frame))])]
    link = tmp_path / "link.parquet"
    link.symlink_to(paths[0])
    trips = read_trips([*paths, paths[0], link])
    assert (len(trips.frame), trips.rows) == (27_000, 27_000)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("zone", "read"),
    [*[(text, True) for text in ("12", "12.0", " 12 ", "12.")]]
    + [(text, False) for text in ("012", "1.2e1", "12_", "+12", "0x0c", "12.5", "True", "NA", "nan", "1200")],
)
def test_zones_are_written_in_one_way_only(tmp_path: Path, zone: str, read: bool) -> None:
    """A zone is a whole number as TLC writes it; what merely looks like one is unknown, and counted."""
    start, end = "2018-03-05 11:00:00", "2018-03-05 11:10:00"
    rows = [(start, end, zone, 12), (start, end, 13, 12)]
    trips = read_trips(written(table(*rows), tmp_path / "a.csv"))
    assert (len(trips.frame), trips.report["unknown zone"]) == ((2, 0) if read else (1, 1))


def test_dates_that_are_numbers_are_no_dates(tmp_path: Path) -> None:
    """Seconds since 1970, of a parquet file, are counted as unreadable, beside rows that are right."""
    frame = good(4).astype({"tpep_pickup_datetime": "int64"})
    with pytest.raises(DataError, match="4 unreadable date"):
        read_trips(written(frame, tmp_path / "a.parquet"))


def test_a_file_without_a_usable_trip_is_refused_with_the_counts(tmp_path: Path) -> None:
    rows = [("2018-03-05 11:00:00", "2018-03-05 11:10:00", AIRPORT, 12)] * 2 + [("junk", "junk", 12, 12)]
    _refused(
        written(table(*rows), tmp_path / "a.csv"), "among 3 rows of .*a.csv: 1 unreadable date, 2 outside Manhattan"
    )
    for name in ("b.csv", "b.parquet"):
        _refused(written(good()[:0], tmp_path / name), "among 0 rows of .*: the files are empty")
