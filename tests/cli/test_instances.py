"""optkit instances, called as a user calls it on messy tables of his own."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from optkit import simulate
from optkit.instances.storage import load_instances, read_description
from tests.command_line import optkit, strict

MAP = (
    "--map=request_id=order,arrival=time,expiry=deadline,reward=fare,penalty=late fee",
    "--map=utility_bike=likes bike,utility_car=likes car,worker_id=who,joined=time",
)


def tables(folder, days=3):
    """Write orders and couriers of some mornings: names with zeros, a time zone, a column of no use, early couriers."""
    rng, orders, couriers = np.random.default_rng(7), [], []
    for day in range(days):
        opens = pd.Timestamp("2026-03-27T08:00:00", tz="Europe/Rome") + pd.Timedelta(
            days=day
        )  # clocks change on the 29th
        opens = opens.replace(hour=8)
        for k in range(6):
            time = opens + pd.Timedelta(seconds=float(rng.uniform(0, 280)))
            orders.append({
                "order": f"{day}0{k}", "date": time.date(), "time": time.isoformat(), "fare": 20.0 + k,
                "deadline": (time + pd.Timedelta(seconds=90)).isoformat(), "late fee": -2, "likes bike": -5.0,
                "likes car": -7.5, "km": 1.0 + k, "note": "" if k else "ring twice",
            })  # fmt: skip
        for k in range(5):
            time = opens + pd.Timedelta(seconds=60.0 * k - 30)
            couriers.append(
                {"who": f"00{k}", "date": time.date(), "time": time.isoformat(), "group": ["bike", "car"][k % 2]}
            )
    pd.DataFrame(orders).sample(frac=1, random_state=1).to_csv(folder / "orders.csv", index=False)
    pd.DataFrame(couriers).to_csv(folder / "couriers.csv", index=False)
    return folder / "orders.csv", folder / "couriers.csv"


def test_from_messy_tables_to_a_set(tmp_path):
    """Names, places and times are kept, rows that have no part counted, and offers join back to the tables."""
    orders, couriers = tables(tmp_path)
    more = ("--step=15s", "--start=08:00", "--day-column=date", "--features=km", "--mu", "bike=1.5,car=2")
    done = optkit("instances", orders, couriers, *MAP, *more, "--out", tmp_path / "days", "--json", check=0)
    told = strict(done.stdout)
    assert list(told["days"]) == ["2026-03-27", "2026-03-28", "2026-03-29"]
    assert told["left_out"]["workers"] == {"come before the start, 08:00:00": 3}
    assert told["left_out"]["unused"] == {"requests": ["note"], "workers": []}
    days = load_instances(tmp_path / "days")
    assert [(one.n_requests, one.n_workers) for one in days] == [(6, 4)] * 3
    assert read_description(tmp_path / "days")["scenario"]["days"] == list(told["days"])
    assert days[2].clock.start == "2026-03-29T08:00:00+02:00"
    assert (days[0].group_names, days[0].feature_names, days[0].mu.tolist()) == (("bike", "car"), ("km",), [1.5, 2.0])
    sold = simulate([one.with_noise(0) for one in days], lambda state: state.reward).to_frame()
    own = pd.read_csv(orders, dtype={"order": str})
    joined = sold.merge(own, left_on="request_id", right_on="order", validate="1:1")
    assert len(joined) == len(sold) > 3
    assert (joined["compensation"] == joined["fare"]).all()


def test_nothing_is_written_without_out(tmp_path):
    """What was understood is shown, with the first rows, and the folder stays as it is."""
    orders, couriers = tables(tmp_path)
    done = optkit("instances", orders, couriers, *MAP, "--step", "15s", "--day-column", "date", check=0)
    assert "nothing is written without --out" in done.stdout
    assert "columns that play no part: km, note" in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["couriers.csv", "orders.csv"]


@pytest.mark.slow
def test_the_next_verb_takes_it(tmp_path):
    """A set made of tables is certified as it is."""
    orders, couriers = tables(tmp_path, days=12)
    more = ("--step=15s", "--day-column=date", "--out", tmp_path / "days")
    optkit("instances", orders, couriers, *MAP, *more, check=0)
    told = strict(optkit("certify", tmp_path / "days", "--kinds", "full", "--json", check=0).stdout)
    assert told["policies"]
    optkit("train", tmp_path / "days", "--choice", "true", "--out", tmp_path / "policy.json", "--quiet", check=0)
    for part in ("test", "all"):
        optkit("evaluate", tmp_path / "policy.json", tmp_path / "days", "--part", part, "--json", check=0)


REFUSED = {
    "no names": ((), "has no column 'arrival', 'expiry', 'reward'.*--map arrival=COLUMN,expiry=COLUMN"),
    "no pair": (("--map=fare",), "not of the form MEANING=COLUMN"),
    "no meaning": (("--map=fare=reward",), "nothing is called 'fare'; there are request_id, arrival"),
    "no column": (("--map=reward=fares",), "the table of requests has no column 'fares'"),
    "two meanings": (("--map=reward=fare,penalty=fare",), "says two things of fare: reward and penalty"),
    "meant twice": (("--map=reward=fare,reward=km",), "says twice what reward is"),
    "no step": (MAP, "say how long a step is, such as 15s"),
    "days in a row": ((*MAP, "--step=15s"), "span 2.0 days: name the column of days"),
    "no days": ((*MAP, "--step=15s", "--day-column=day"), "--day-column day: .*orders.csv has no column 'day'; it has"),
    "one mu": (
        (*MAP, "--step=15s", "--day-column=date", "--mu=bike=1"),
        "mu is given for bike, .* groups are bike, car",
    ),
    "twice a mu": ((*MAP, "--mu=bike=1,bike=2"), "gives a group twice"),
    "no mu": ((*MAP, "--mu=some"), "--mu some is neither a number"),
    "no time": ((*MAP, "--step=15s", "--day-column=date", "--start=noon"), "start = 'noon' is no time"),
    "no feature": ((*MAP, "--features=miles"), "--features miles: .* has no column 'miles'"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REFUSED)
def test_refusals_say_what_to_type(tmp_path, case):
    """One line, status 2, and nothing is written."""
    arguments, message = REFUSED[case]
    done = optkit("instances", *tables(tmp_path), *arguments, "--out", tmp_path / "days")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert re.search(message, done.stderr), done.stderr
    assert not (tmp_path / "days").exists()


@pytest.mark.slow
def test_what_is_there_stays(tmp_path):
    """A folder that is no instance set is never replaced, and a set only when it is said."""
    orders, couriers = tables(tmp_path)
    more = (*MAP, "--step=15s", "--day-column=date", "--out", tmp_path / "days")
    optkit("instances", orders, couriers, *more, check=0)
    assert "pass --overwrite" in optkit("instances", orders, couriers, *more, check=2).stderr
    optkit("instances", orders, couriers, *more, "--overwrite", check=0)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    assert (
        "so it stays"
        in optkit("instances", orders, couriers, *more, "--out", tmp_path / "other", "--overwrite", check=2).stderr
    )


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["parquet", "json"])
def test_other_formats(tmp_path, suffix):
    """Parquet with timestamps and JSON give the same set as CSV."""
    orders, couriers = tables(tmp_path)
    for path in (orders, couriers):
        frame = pd.read_csv(path, dtype={"order": str, "who": str})
        if suffix == "json":
            path.with_suffix(".json").write_text(
                json.dumps(frame.astype(object).where(frame.notna(), None).to_dict("records"))
            )
        else:
            for name in {"time", "deadline"} & {*frame}:
                frame[name] = pd.to_datetime(frame[name], utc=True).dt.tz_convert("Europe/Rome")
            frame.to_parquet(path.with_suffix(".parquet"))
    for kind in ("csv", suffix):
        pair = (orders.with_suffix(f".{kind}"), couriers.with_suffix(f".{kind}"))
        more = ("--step=15s", "--start=08:00", "--day-column=date", "--out", tmp_path / kind)
        optkit("instances", *pair, *MAP, *more, check=0)
    found, expected = load_instances(tmp_path / suffix), load_instances(tmp_path / "csv")
    assert [one.arrival.tolist() for one in found] == [one.arrival.tolist() for one in expected]
    assert [one.request_id.tolist() for one in found] == [one.request_id.tolist() for one in expected]


def test_rows_of_files_count_from_1(tmp_path):
    """Whether a cell cannot be read, or what it says cannot be."""
    (tmp_path / "workers.csv").write_text("joined\n1\n")
    for cell, message in (
        ("x", "expiry in row 2 is 'x', and 3 in row 1: give steps or times"),
        ("0", "expiry in row 2 = 0 comes before its arrival"),
        ("", "expiry in row 2 is empty"),
        ("2.5", "expiry in row 2 = 2.5 is not a whole number"),
    ):
        (tmp_path / "requests.csv").write_text(f"arrival,expiry,reward,utility\n0,3,9,-1\n1,{cell},9,-1\n")
        done = optkit(
            "instances", tmp_path / "requests.csv", tmp_path / "workers.csv", "--out", tmp_path / "o", check=2
        )
        assert message in done.stderr


def test_parquet_keeps_its_time_zone(tmp_path):
    """By name, not only the offset of the day."""
    times = pd.date_range("2026-03-28 08:00", periods=3, freq="10min", tz="Europe/Berlin")
    asked = {"arrival": times, "expiry": times + pd.Timedelta("30min"), "reward": 9.0, "utility": -1.0}
    pd.DataFrame(asked).to_parquet(tmp_path / "r.parquet")
    pd.DataFrame({"joined": times}).to_parquet(tmp_path / "w.parquet")
    files = (tmp_path / "r.parquet", tmp_path / "w.parquet")
    optkit("instances", *files, "--step", "60s", "--out", tmp_path / "days", check=0)
    assert load_instances(tmp_path / "days")[0].clock.zone == "Europe/Berlin"
