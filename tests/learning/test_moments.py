"""Which step it is, and when requests expire, by the clock of the days that were learned from."""

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import InputError
from optkit.instances.clock import Clock
from optkit.learning.moments import moment

DAY, NIGHT = Clock("2026-03-02T08:00:00", 60.0), Clock("2026-03-02T22:00:00", 60.0)
BERLIN = Clock("2026-03-02T08:00:00+01:00", 60.0)


def asked(*deadlines, step=None, time=None, clock=DAY, horizon=240):
    now, last, _ = moment(pd.Series(list(deadlines)), step, time, clock, horizon)
    return now, last.tolist()


def test_by_hand():
    """With a step, a time of day and a date, on whatever date; a deadline at the beginning of a step is before it."""
    for more in ({"step": 8}, {"time": "08:08"}, {"time": "2026-05-04T08:08:30"}):
        assert asked("2026-05-04T08:10:00", "2026-05-04T08:10:30", **more) == (8, [9, 10])
    assert asked(9, 10, step=8) == (8, [9, 10])
    assert asked(9, 10, time="8:08") == (8, [9, 10])


def test_a_night_goes_past_midnight():
    """Before and after midnight it is the same night."""
    late = ("2026-05-05T00:05:00", "2026-05-05T00:40:30")
    assert asked(*late, time="23:55", clock=NIGHT) == (115, [124, 160])
    assert asked(*late, time="00:01", clock=NIGHT) == (121, [124, 160])
    assert asked(*late, time="2026-05-04T23:55", clock=NIGHT) == (115, [124, 160])
    assert asked(*late, step=115, clock=NIGHT) == (115, [124, 160])


def test_a_night_in_steps():
    """A time of day before the start is the next morning's, where deadlines are steps, too."""
    assert asked(190, 200, time="01:00", clock=NIGHT) == (180, [190, 200])
    assert asked(190, 200, time="23:00", clock=NIGHT) == (60, [190, 200])


def test_steps_of_a_day_on_which_clocks_change():
    """Eight o'clock is nine hours after midnight where an hour came twice."""
    day = Clock("2026-10-25T00:00:00+02:00", 3600.0, "Europe/Berlin")
    assert day.step_at("08:00") == 9
    assert day.time_of(9).isoformat() == "2026-10-25T08:00:00+01:00"
    with pytest.raises(InputError, match="no one time there"):
        day.step_at("02:30")
    with pytest.raises(InputError, match="zone"):
        Clock("2026-10-25T00:00:00+02:00", 15.0, "")


def test_what_is_stale_is_seen():
    """A row of yesterday does not move the others: without a date it is refused, with one it has expired."""
    rows = ("2026-05-04T08:10:30", "2026-05-03T08:10:30")
    for more in ({"time": "08:08"}, {"step": 8}):
        with pytest.raises(InputError, match="expire on several dates"):
            asked(*rows, **more)
    now, last = asked(*rows, time="2026-05-04T08:08")
    assert (now, last[0]) == (8, 10)
    assert last[1] < 0


def test_a_stale_row_never_moves_the_day():
    """If the first deadline has passed at a time of day, the evening before is no way out."""
    for rows in (("2026-05-04T22:09:00", "2026-05-04T22:20:30"), ("2026-05-04T22:09:00",)):
        with pytest.raises(InputError, match="leave out what has expired"):
            asked(*rows, time="22:10", clock=NIGHT, horizon=60)
    assert asked("2026-05-04T22:09:00", "2026-05-04T22:20:30", time="2026-05-04T22:10", clock=NIGHT)[1] == [8, 20]
    with pytest.raises(InputError, match="not on the day of step 10"):
        asked("2026-05-04T21:50:00", step=10, clock=NIGHT, horizon=60)


LONDON = Clock("2026-07-06T08:00:00+01:00", 60.0, "Europe/London")


def test_named_time_zones():
    """Instants are instants, whatever clock they are written by; a bare time is refused where two clocks differ."""
    winter = pd.Timestamp("2026-12-04T08:10:30", tz="Europe/London")
    assert asked(winter, time="08:08", clock=LONDON) == (8, [10])
    for zone in ("Europe/Berlin", "Asia/Tokyo", "UTC"):
        assert asked(winter.tz_convert(zone), time=winter.floor("min") - pd.Timedelta("2min"), clock=LONDON) == (
            8,
            [10],
        )
    with pytest.raises(InputError, match="by which clock"):
        asked(winter.tz_convert("Europe/Berlin"), time="09:08", clock=LONDON)
    summer = pd.Timestamp("2026-07-07T08:10:30", tz="Europe/Lisbon")  # as in London
    assert asked(summer, time="08:08", clock=LONDON) == (8, [10])
    utc = Clock("2026-03-02T22:00:00+00:00", 60.0, "UTC")
    deadline = pd.Timestamp("2026-01-10T22:20:00", tz="Europe/Berlin")
    now = pd.Timestamp("2026-01-10T22:10:00", tz="Europe/Berlin")
    assert asked(deadline, time=now, clock=utc, horizon=60)[0] == 24 * 60 - 50  # of the evening before: out of range


def test_offsets_an_hour_apart_are_told():
    """Where only offsets are known, summer and winter are taken for granted in words; a named zone is looked up."""
    assert "summer and winter" in moment(pd.Series(["2026-05-04T08:10:30+02:00"]), 8, None, BERLIN, 240).notes[0]
    assert moment(pd.Series(["2026-12-04T08:10:30+01:00"]), 8, None, BERLIN, 240).notes == []
    assert asked(pd.Timestamp("2026-05-04T08:10:30", tz="Europe/Berlin"), time="08:08", clock=BERLIN) == (8, [10])
    with pytest.raises(InputError, match="another time zone"):
        asked(pd.Timestamp("2026-12-04T08:10:30", tz="Europe/Athens"), time="08:08", clock=BERLIN)


def test_other_time_zones():
    """Summer and winter of one zone are the same clock; UTC, and a zone hours away, are not."""
    assert asked("2026-05-04T08:10:30+02:00", time="08:08", clock=BERLIN) == (8, [10])
    assert asked("2026-12-04T08:10:30+01:00", time="08:08", clock=BERLIN) == (8, [10])
    assert asked("2026-05-04T08:10:30+02:00", time="2026-05-04T06:08:00Z", clock=BERLIN) == (8, [10])
    for other in ("2026-05-04T06:10:30Z", "2026-05-04T15:10:30+09:00"):
        with pytest.raises(InputError, match="another time zone"):
            asked(other, time="08:08", clock=BERLIN)
    with pytest.raises(InputError, match="both have a time zone, or neither"):
        asked("2026-05-04T08:10:30", time="08:08", clock=BERLIN)


@pytest.mark.parametrize("seed", range(20))
def test_any_moment_of_any_night(seed):
    """At random: now and deadlines are the whole minutes since the night began."""
    rng = np.random.default_rng(seed)
    opens = pd.Timestamp("2026-01-01") + pd.Timedelta(days=int(rng.integers(300)), hours=int(rng.integers(24)))
    clock = Clock(f"2025-06-01T{opens.time().isoformat()}", 60.0)
    now = opens + pd.Timedelta(seconds=int(rng.integers(0, 6 * 3600)))
    deadlines = [now + pd.Timedelta(seconds=int(x)) for x in rng.integers(1, 3600, 3)]
    step, last = asked(*deadlines, time=now, clock=clock, horizon=480)
    assert step == (now - opens) // pd.Timedelta("60s")
    assert last == [(one - opens - pd.Timedelta("1ns")) // pd.Timedelta("60s") for one in deadlines]
    said = now.floor("min")
    if min(deadlines) - said < pd.Timedelta("24h"):
        assert asked(*deadlines, time=said.time().isoformat("minutes"), clock=clock, horizon=480)[0] == step


@pytest.mark.parametrize("time", ["25:08", "24:00", "noon", "08:61"])
def test_what_is_no_time(time):
    with pytest.raises(Exception, match="no time"):
        asked("2026-05-04T08:10:30", time=time)
