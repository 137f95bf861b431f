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
    now, last = moment(pd.Series(list(deadlines)), step, time, clock, horizon)
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


def test_what_is_stale_is_seen():
    """A row of yesterday does not move the others: without a date it is refused, with one it has expired."""
    rows = ("2026-05-04T08:10:30", "2026-05-03T08:10:30")
    for more in ({"time": "08:08"}, {"step": 8}):
        with pytest.raises(InputError, match="expire on several dates"):
            asked(*rows, **more)
    now, last = asked(*rows, time="2026-05-04T08:08")
    assert (now, last[0]) == (8, 10)
    assert last[1] < 0


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
