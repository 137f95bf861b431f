"""Tables of one's own: times, names, days; every row is in an instance or counted."""

import datetime
import re
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optkit import Instance
from optkit.basics.errors import InstanceError
from optkit.instances.account import LeftOutWarning
from optkit.instances.clock import Clock
from optkit.instances.days import days_from_frames
from optkit.instances.queue import fifo_queue

START = pd.Timestamp("2026-03-02T08:00:00")


def at(*seconds, zone=None):
    return [(START + pd.Timedelta(s, unit="s")).tz_localize(zone) for s in seconds]


def requests(**changes):
    columns = {"arrival": at(5, 20, 44.9), "expiry": at(60, 90, 45), "reward": [30.0, 40.0, 20.0], "utility": -9.0}
    return pd.DataFrame(columns | changes)


def workers(**changes):
    return pd.DataFrame({"joined": at(16, 17, 31)} | changes)


def made(asked=None, came=None, **options):
    given = {"start": START, "step": "15s"} | options
    return Instance.from_frames(requests() if asked is None else asked, workers() if came is None else came, **given)


def test_times_become_steps():
    """By hand: 60 s is the beginning of step 4, so that 3 is the last step with time in it; 44.9 to 45 s is step 2."""
    day = made()
    assert day.arrival.tolist() == [0, 1, 2]
    assert day.expiry.tolist() == [3, 5, 2]
    assert day.worker_joined.tolist() == [1, 1, 2]
    assert day.worker_step.tolist() == [1, 2, 3]
    assert day.clock == Clock("2026-03-02T08:00:00", 15.0)
    assert day.clock.time_of(3) == START + pd.Timedelta("45s")


ZONE = "America/New_York"
FORMS = {
    "datetime": lambda one: one.dt.to_pydatetime().tolist() if hasattr(one, "dt") else one,
    "microseconds": lambda one: one.astype("datetime64[us]"),
    "text": lambda one: one.map(lambda t: t.isoformat()),
    "text with a blank": lambda one: one.map(lambda t: str(t)),
    "arrow": lambda one: one.astype(pd.ArrowDtype(pa.timestamp("us"))),
    "objects": lambda one: one.astype(object),
}


@pytest.mark.parametrize("form", FORMS)
def test_times_of_all_kinds(form):
    """Whatever holds them, the same times are the same steps."""
    asked, came = requests(), workers()
    for table, names in ((asked, ("arrival", "expiry")), (came, ("joined",))):
        for name in names:
            table[name] = FORMS[form](table[name])
    assert made(asked, came) == made()


def test_tables_of_other_libraries():
    """Tables of pyarrow and of polars, a dict of columns, and columns that are called by numbers."""
    tables = requests(), workers()
    arrow = [pa.Table.from_pandas(one) for one in tables]
    assert made(*arrow) == made() == made(*(one.to_dict("list") for one in tables))
    polars = pytest.importorskip("polars", reason="polars is missing: pip install polars")
    assert made(*map(polars.from_arrow, arrow)) == made()


def test_nullable_and_categorical_columns():
    """Pandas' nullable numbers and text, Arrow's, and categories as names."""
    plain = made(requests(utility_bike=-9.0, request_id=["a", "b", "c"]).drop(columns="utility"), workers(group="bike"))
    for dtype in ("Float64", "double[pyarrow]"):
        asked = requests(utility_bike=pd.array([-9.0] * 3, dtype), reward=pd.array([30, 40, 20], dtype))
        asked["request_id"] = pd.array(["a", "b", "c"], "string")
        came = workers(group=pd.Categorical(["bike"] * 3))
        assert made(asked.drop(columns="utility"), came) == plain
    missing = requests(reward=pd.array([30, None, 20], "Float64"))
    with pytest.raises(InstanceError, match="reward in row 1"):
        made(missing)


@pytest.mark.parametrize("zone", ["UTC", ZONE, "Asia/Kolkata"])
def test_time_zones(zone):
    """With a zone the steps are the same; a start without one is of the tables' zone, one with another is converted."""
    asked = requests(arrival=at(5, 20, 44.9, zone=zone), expiry=at(60, 90, 45, zone=zone))
    came = workers(joined=at(16, 17, 31, zone=zone))
    for start in (START, START.tz_localize(zone), START.tz_localize(zone).tz_convert("Europe/Rome"), "08:00", None):
        day = made(asked, came, start=start)
        assert (day.arrival.tolist(), day.worker_joined.tolist()) == ([0, 1, 2], [1, 1, 2])
    with pytest.raises(InstanceError, match="joined has none: give both one, or neither"):
        made(asked)
    with pytest.raises(InstanceError, match="has a time zone and the tables have none"):
        made(start=START.tz_localize(zone))


def test_where_clocks_change():
    """The night of summer time has an hour less; times with their offset are right, and 02:30 is no time there."""
    asked = pd.DataFrame({
        "arrival": ["2026-03-08T01:30:00-05:00", "2026-03-08T03:30:00-04:00"], "reward": 9.0, "utility": 0.0,
        "expiry": ["2026-03-08T01:59:00-05:00", "2026-03-08T03:59:00-04:00"],
    })  # fmt: skip
    came = pd.DataFrame({"joined": ["2026-03-08T01:31:00-05:00"]})
    day = Instance.from_frames(asked, came, step="30min")
    assert day.arrival.tolist() == [0, 2]
    zoned = pd.DataFrame({"joined": pd.to_datetime(came["joined"], utc=True).dt.tz_convert(ZONE)})
    for name in ("arrival", "expiry"):
        asked[name] = pd.to_datetime(asked[name], utc=True).dt.tz_convert(ZONE)
    assert Instance.from_frames(asked, zoned, step="30min", start="01:30").arrival.tolist() == [0, 2]
    with pytest.raises(InstanceError, match="02:30 on 2026-03-08 is no one time there"):
        Instance.from_frames(asked, zoned, step="30min", start="02:30")


WRONG = {
    "no step": ({"step": None}, {}, {}, "say how long a step is"),
    "no length": ({"step": "soon"}, {}, {}, "'soon' is no length of time"),
    "nothing": ({"step": 0}, {}, {}, "longer than nothing"),
    "no start": ({"start": "noon"}, {}, {}, "start = 'noon' is no time"),
    "no time": ({}, {"arrival": ["2026-03-02T08:00:05", "later", None]}, {}, "arrival in row 1 = 'later'"),
    "missing": ({}, {"arrival": [START, None, START]}, {}, "arrival in row 1 is missing"),
    "steps and times": ({}, {}, {"joined": [1, 2, 3]}, "arrival holds times and joined numbers of steps"),
    "backwards": ({}, {"expiry": at(60, 19, 45)}, {}, "expiry in row 1 comes before its arrival"),
    "offsets": ({}, {"arrival": ["2026-03-02T08:00Z", "2026-03-02T08:00", "2026-03-02"]}, {}, "none in row 1"),
    "long ago": ({}, {"arrival": ["0001-01-01"] * 3, "expiry": ["0001-01-02"] * 3}, {}, "1678"),
    "a year": ({}, {"expiry": at(60, 90, 3e7)}, {}, "span 347.2 days: name the column of days"),
    "twice": ({}, {"request_id": ["a", "b", "a"]}, {}, "request_id in row 2 = 'a' is the same as request_id in row 0"),
    "no name": ({}, {"request_id": ["a", None, "c"]}, {}, "request_id in row 1 is missing"),
    "half a name": ({}, {"request_id": ["a", 2, "c"]}, {}, "write all as text"),
    "half": ({}, {"request_id": [1, 2.5, 3]}, {}, "neither text nor a whole number"),
    "group": ({}, {"utility_bike": -9.0}, {"group": ["bike", "bikes", "bike"]}, "do you mean 'bike'"),
    "a group's mu": ({"mu": {"car": 1.0}}, {"utility_bike": -9.0}, {"group": "bike"}, "given for car, .* are bike"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said(case):
    """One line that names the row and the remedy."""
    options, asked, came, message = WRONG[case]
    table = requests(**asked)
    table = table.drop(columns="utility") if any("utility_" in name for name in asked) else table
    with pytest.raises(InstanceError, match=message) as caught:
        made(table, workers(**came), **options)
    assert "\n" not in str(caught.value)


def test_steps_need_no_clock():
    """A clock for tables that count steps is a mistake."""
    asked = pd.DataFrame({"arrival": [0], "expiry": [1], "reward": [1.0], "utility": [0.0]})
    with pytest.raises(InstanceError, match="step goes with timestamps"):
        Instance.from_frames(asked, pd.DataFrame({"joined": [0]}), step="15s")


def test_groups_by_name():
    """Utilities by name, in the order of the columns; mu and the outside utility by name, too; one column for all."""
    asked = requests(utility_car=[-1.0, -2.0, -3.0], utility_bike=-9.0).drop(columns="utility")
    day = made(
        asked,
        workers(group=["bike", "car", "bike"]),
        mu={"bike": 1.0, "car": 2.0},
        outside_utility={"car": 1, "bike": 0},
    )
    assert day.group_names == ("car", "bike")
    assert day.worker_group.tolist() == [1, 0, 1]
    assert day.utility[0].tolist() == [-1.0, -2.0, -3.0]
    assert (day.mu.tolist(), day.outside_utility.tolist()) == ([2.0, 1.0], [1.0, 0.0])
    alike = made(requests(), workers(group=["b", "a", "b"]))
    assert (alike.group_names, alike.utility.tolist()) == (("a", "b"), [[-9.0] * 3] * 2)


def test_joined_and_seen():
    """Who joined and when he was seen may both be known; then no queue is made up."""
    day = made(came=workers(step=at(31, 46, 61)))
    assert day.worker_joined.tolist() == [1, 1, 2]
    assert day.worker_step.tolist() == [2, 3, 4]
    with pytest.raises(InstanceError, match=r"worker_joined\[0\] = 1 .* after he is seen at step 0"):
        made(came=workers(step=at(1, 46, 61)))


def tables_back(day):
    asked, came = day.to_frames()
    options = {"mu": day.mu, "outside_utility": day.outside_utility, "horizon": day.horizon}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return Instance.from_frames(asked, came, features=day.feature_names or (), **options)


def test_tables_come_back():
    """What to_frames returns makes the same instance, but for its clock."""
    asked = requests(utility_car=[-1.0, -2.0, -3.0], utility_bike=-9.0, km=[1.0, 2.0, 3.0], request_id=["a", "b", "c"])
    day = made(
        asked.drop(columns="utility"), workers(group=["bike", "car", "bike"], worker_id=[7, 8, 9]), features=["km"]
    )
    again = tables_back(day)
    assert again.clock is None
    assert {**vars(again), "clock": day.clock}.keys() == vars(day).keys()
    assert all(
        np.array_equal(vars(again)[name], vars(day)[name])
        for name in vars(day)
        if name != "clock" and vars(day)[name] is not None
    )


@st.composite
def anyhow(draw):
    """Requests and workers at any time about a day of eight steps of 15 seconds."""
    n, J = draw(st.integers(0, 8)), draw(st.integers(0, 8))
    seconds = st.floats(-60, 200, allow_nan=False).map(lambda x: round(x, 3))
    came = draw(st.lists(seconds, min_size=n, max_size=n))
    life = draw(st.lists(st.floats(0, 100).map(lambda x: round(x, 3)), min_size=n, max_size=n))
    joined = draw(st.lists(seconds, min_size=J, max_size=J))
    asked = {"arrival": at(*came), "expiry": at(*(a + b for a, b in zip(came, life, strict=True)))}
    return pd.DataFrame(asked | {"request_id": range(n), "reward": 1.0, "utility": 0.0}), pd.DataFrame(
        {"joined": pd.DatetimeIndex(at(*joined)), "worker_id": [f"w{j}" for j in range(J)]}
    )


@pytest.mark.slow
@settings(max_examples=60)
@given(tables=anyhow(), horizon=st.integers(1, 8))
def test_every_row_is_in_the_instance_or_counted(tables, horizon):
    """Against loops over the rows: who is in, at which step, and how many are left out."""
    asked, came = tables
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        day = made(asked, came, horizon=horizon)
    told = " ".join(str(one.message) for one in caught)
    out = {
        name: int(found[1]) if (found := re.search(rf"(\d+) of \d+ {name} are left out", told)) else 0
        for name in ("requests", "workers")
    }
    assert day.n_requests + out["requests"] == len(asked)
    assert day.n_workers + out["workers"] == len(came)
    elapsed = (asked["arrival"] - START).dt.total_seconds() if len(asked) else pd.Series([], dtype=float)
    inside = [k for k, s in enumerate(elapsed) if 0 <= s < 15 * horizon]
    assert (day.request_id.tolist() if day.n_requests else []) == inside
    assert day.arrival.tolist() == [int(elapsed[k] // 15) for k in inside]
    assert all(day.arrival <= day.expiry)
    spent = sorted(int(s // 15) for s in (came["joined"] - START).dt.total_seconds() if 0 <= s < 15 * horizon)
    assert day.worker_step.tolist() == fifo_queue(spent, horizon)[0].tolist()


def test_days():
    """One instance a day, all with the groups and the horizon of all, each beginning at the same time of day."""
    asked = pd.concat([requests(date=datetime.date(2026, 3, 2)), requests(date=datetime.date(2026, 3, 3))])
    asked.loc[asked["date"] == datetime.date(2026, 3, 3), ["arrival", "expiry"]] += pd.Timedelta("1D")
    came = pd.concat([workers(date="2026-03-02", group="bike"), workers(date="2026-03-03", group="car")])
    came.loc[came["date"] == "2026-03-03", "joined"] += pd.Timedelta("1D1min")
    days = days_from_frames(asked, came, day="date", step="15s", start="08:00", horizon=8)
    assert list(days) == ["2026-03-02", "2026-03-03"]
    assert {one.horizon for one in days.values()} == {8}
    assert {one.group_names for one in days.values()} == {("bike", "car")}
    assert [one.worker_group.tolist() for one in days.values()] == [[0] * 3, [1] * 3]
    assert (
        days["2026-03-02"]
        .to_frames()[0]
        .equals(
            made(
                requests(utility_bike=-9.0, utility_car=-9.0).drop(columns="utility"), workers(group="bike")
            ).to_frames()[0]
        )
    )
    assert days["2026-03-03"].worker_joined.tolist() == [5, 5, 6]
    assert days["2026-03-03"].clock.start == "2026-03-03T08:00:00"
    with pytest.warns(
        LeftOutWarning, match="^3 of 6 workers are left out: 3 join after the day's last step; 2 of 6 requests are open"
    ):
        days_from_frames(asked, came, day="date", step="15s", start="08:00", horizon=5)
    with pytest.raises(InstanceError, match="no day in row 2"):
        days_from_frames(asked.assign(date=["a", "b", None] * 2), came, day="date", step="15s")
    with pytest.raises(InstanceError, match="day 2026-03-03: expiry in row 3 comes before"):
        days_from_frames(
            asked.assign(expiry=asked["expiry"].where(asked["date"] == datetime.date(2026, 3, 2), START)),
            came,
            day="date",
            step="15s",
        )


def test_days_begin_by_one_clock():
    """That of the requests, whoever comes first, and whatever clock the workers' table has."""
    first = [pd.Timestamp("2026-07-06T06:01:00Z"), pd.Timestamp("2026-07-07T06:10:00Z")]
    asked = pd.DataFrame({"day": ["a", "b"], "arrival": first, "reward": 9.0, "utility": -1.0})
    asked["arrival"] = asked["arrival"].dt.tz_convert("Europe/Berlin")
    asked["expiry"] = asked["arrival"] + pd.Timedelta("20min")
    came = pd.DataFrame(
        {"day": ["a", "b"], "joined": [first[0] + pd.Timedelta("2min"), first[1] - pd.Timedelta("8min")]}
    )
    days = days_from_frames(asked, came, day="day", step="1min", start="08:00", horizon=60)
    assert [day.clock.start for day in days.values()] == ["2026-07-06T08:00:00+02:00", "2026-07-07T08:00:00+02:00"]
    assert {day.clock.zone for day in days.values()} == {"Europe/Berlin"}
    assert [(day.arrival.tolist(), day.worker_joined.tolist()) for day in days.values()] == [([1], [3]), ([10], [2])]


def test_days_by_number_and_without_a_clock():
    """Days in the order of their numbers; a day without workers is one too."""
    asked = pd.DataFrame({"week": [10, 9, 9], "arrival": 0, "expiry": [1, 2, 3], "reward": 5.0, "utility": 0.0})
    days = days_from_frames(asked, pd.DataFrame({"week": [9], "joined": [1]}), day="week")
    assert [(name, one.n_requests, one.n_workers, one.horizon) for name, one in days.items()] == [
        ("9", 2, 1, 4),
        ("10", 1, 0, 4),
    ]


@pytest.mark.parametrize("name", ["mu", "outside_utility"])
def test_a_series_of_groups_goes_by_its_labels(name):
    """Numbers or names of groups, in any order, are a mapping; other labels, and labels that stand twice, are none."""
    asked = requests().drop(columns="utility").assign(utility_bike=-9.0, utility_car=-8.0, utility_van=-7.0)
    came = workers(group=["car", "van", "bike"])
    numbered = asked.rename(
        columns={"utility_bike": "utility_0", "utility_car": "utility_1", "utility_van": "utility_2"}
    )
    right = pd.Series({"bike": 1.0, "car": 2.0, "van": 3.0})
    for seed in range(6):
        mixed = right.sample(frac=1.0, random_state=seed)
        assert getattr(made(asked, came, **{name: mixed}), name).tolist() == [1.0, 2.0, 3.0]
        mixed = right.set_axis([0, 1, 2]).sample(frac=1.0, random_state=seed)
        day = made(numbered, workers(group=[1, 2, 0]), **{name: mixed})
        assert getattr(day, name).tolist() == [1.0, 2.0, 3.0]
    for wrong in (right.set_axis([0, 1, 2]), right[["bike", "car"]], right[["bike", "car", "van", "van"]]):
        with pytest.raises(InstanceError, match=f"{name} is given"):
            made(asked, came, **{name: wrong})


def test_a_notebook_shows_one_screen():
    """Names are escaped, and a long day is cut."""
    day = made(requests(request_id=["<b>", "b", "c"]))
    assert "&lt;b&gt;" in day._repr_html_()
    assert "<b>" not in day._repr_html_()


def test_lengths_and_times_that_were_misread():
    """A bare number is seconds, in text too; an hour that does not exist; billions of steps."""
    assert made(step="15") == made(step=15) == made()
    for start in ("25:00", "24:00", "08:61"):
        with pytest.raises(InstanceError, match="no time of day"):
            made(start=start)
    with pytest.raises(InstanceError, match="take longer steps"):
        made(step="1us", start=None)


def test_a_day_with_two_offsets_begins_by_its_first():
    """In the night in which clocks change, text with offsets gives what a time zone gives."""
    times = ["2026-03-29T01:10:00+01:00", "2026-03-29T03:10:00+02:00"]
    ends = ["2026-03-29T03:30:00+02:00", "2026-03-29T04:30:00+02:00"]
    found = []
    for zone in (None, "Europe/Berlin"):
        asked = pd.DataFrame({"date": "2026-03-29", "arrival": times, "expiry": ends, "reward": 9.0, "utility": 0.0})
        came = pd.DataFrame({"date": ["2026-03-29"], "joined": ["2026-03-29T01:40:00+01:00"]})
        if zone is not None:
            for table, name in ((asked, "arrival"), (asked, "expiry"), (came, "joined")):
                table[name] = pd.to_datetime(table[name], utc=True).dt.tz_convert(zone)
        found.append(days_from_frames(asked, came, day="date", start="01:00", step="15min")["2026-03-29"])
    assert found[0].arrival.tolist() == found[1].arrival.tolist() == [0, 4]
    assert found[0].worker_joined.tolist() == found[1].worker_joined.tolist() == [2]


def test_days_are_called_alike_in_both_tables():
    """1, 1.0 and "1.0" are one day; days in one table only are told."""
    asked = pd.DataFrame({"date": [1, 2], "arrival": 0, "expiry": 2, "reward": 9.0, "utility": 0.0})
    for days in ([1.0, 2.0], ["1.0", "2.0"], ["1", "2"]):
        assert [
            one.n_workers
            for one in days_from_frames(asked, pd.DataFrame({"date": days, "joined": 0}), day="date").values()
        ] == [1, 1]
    with pytest.warns(
        LeftOutWarning, match="1 days have requests and no workers: 1; 1 days have workers and no requests: 7"
    ):
        days_from_frames(asked, pd.DataFrame({"date": [2, 7], "joined": 0}), day="date")


def test_columns_may_be_called_by_numbers():
    """Of days and of features too."""
    asked = pd.DataFrame({0: ["a"], 3: [1.5], "arrival": 0, "expiry": 2, "reward": 9.0, "utility": 0.0})
    day = days_from_frames(asked, pd.DataFrame({0: ["a"], "joined": 0}), day=0, features=[3])["a"]
    assert day.features.tolist() == [[1.5]]


def test_a_named_index_is_a_column():
    """Identifiers that stand in it are kept; where a column has its name already, that one counts."""
    named = requests(request_id=["a", "b", "c"]).set_index("request_id")
    assert made(named).request_id.tolist() == ["a", "b", "c"]
    assert made(requests(request_id=["a", "b", "c"]).set_index("request_id", drop=False)).request_id.tolist() == [
        *"abc"
    ]
