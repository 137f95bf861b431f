"""The NYC scenarios: half-hours of trips become instances."""

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import DataError, InputError
from optkit.instances.catalogue import scenario
from optkit.instances.new_york.trip_scenario import PAPER_FRACTION, TripScenario, trip_scenario
from optkit.instances.new_york.trips import Trips, manhattan_zones, read_trips
from optkit.instances.scenario import Scenario


def records(*trips: tuple[str, float]) -> Trips:
    """Trips of (pick-up, minutes) from region 0 to region 1."""
    times = np.array([when for when, _ in trips], "datetime64[s]")
    minutes = [length for _, length in trips]
    frame = pd.DataFrame({"pickup_time": times, "pickup": 0, "dropoff": 1, "travel_time": minutes})
    return Trips(frame, {}, len(trips), (), (times.min(), times.max()))


@pytest.fixture(scope="module")
def year_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a year like 2018: busier by day, 53 Mondays, all zones; a trip's length tells its week and half-hour."""
    rng = np.random.default_rng(2018)
    hour = rng.choice(24, 200_000, p=np.array([1] * 7 + [4] * 12 + [3] * 5) / 70)
    start = pd.Timestamp("2018-01-01") + pd.to_timedelta(rng.integers(0, 365, hour.size), unit="D")
    start += pd.to_timedelta(3600 * hour + rng.integers(0, 3600, hour.size), unit="s")
    episode = 2 * ((start - pd.Timestamp("2018-01-01")).days // 7) + start.minute // 30
    zones = rng.choice(manhattan_zones()["LocationID"], (2, hour.size))
    names = ["tpep_pickup_datetime", "tpep_dropoff_datetime", "PULocationID", "DOLocationID"]
    columns = [start, start + pd.to_timedelta(60 * (1 + episode), unit="s"), *zones]
    path = tmp_path_factory.mktemp("trips") / "yellow_tripdata_2018.parquet"
    pd.DataFrame(dict(zip(names, columns, strict=True))).to_parquet(path)
    return path


@pytest.fixture(scope="module")
def year(year_file: Path) -> Trips:
    return read_trips(year_file)


def which(instance) -> int:
    """Tell the episode of the synthetic year that an instance comes from by its travel times."""
    (time,) = np.unique(instance.features[:, -1].round(9))
    return round(float(time) * 30) - 1


def test_a_trip_arrives_at_the_step_of_its_pickup() -> None:
    when = ["07:00:00", "07:00:14", "07:00:15", "13:29:59", "18:12:31"]
    trips = records(*((f"2018-03-05 {time}", 15.0) for time in when))
    day = trip_scenario("nyc-weak", 0, trips, fraction=1.0)
    (instance,) = day.sample(1, seed=0)
    assert instance.arrival.tolist() == [0, 0, 1, 50, 119]
    assert set(instance.features[:, -1]) == {0.5}
    assert trip_scenario("nyc-weak", 0, trips, fraction=1.0, horizon=30).sample(1, 0)[0].arrival.tolist() == [
        0,
        0,
        0,
        12,
        29,
    ]


def test_folding_keeps_working_hours_and_pools_iso_weeks() -> None:
    out = ["2018-12-30 12:00:00", "2018-12-31 06:59:59", "2018-12-31 19:00:00", "2019-01-05 09:00:00"]
    within = ["2018-12-31 07:00:00", "2019-01-04 18:29:59", "2019-01-04 18:59:59"]
    folded = trip_scenario("nyc-weak", 0, records(*((time, 9.0) for time in out + within)))
    assert [e.label for e in folded.episodes] == ["2019-W01 first half", "2019-W01 second half"]
    assert [e.arrival.tolist() for e in folded.episodes] == [[0, 119], [119]]


def test_mondays_keep_one_hour_and_the_papers_fraction() -> None:
    in_time = [("2018-03-05 11:00:00", 9.0), ("2018-03-05 11:59:59", 9.0), ("2018-03-12 11:30:00", 9.0)]
    late = [("2018-03-05 10:59:59", 9.0), ("2018-03-05 12:00:00", 9.0), ("2018-03-06 11:10:00", 9.0)]
    mondays = trip_scenario("nyc-weak", 0, records(*in_time, *late), mode="mondays")
    assert mondays.fraction == PAPER_FRACTION
    halves = [("2018-03-05 first half", [0]), ("2018-03-05 second half", [119]), ("2018-03-12 second half", [0])]
    assert [(e.label, e.arrival.tolist()) for e in mondays.episodes] == halves


@pytest.mark.slow
def test_a_year_gives_the_papers_number_of_instances_of_about_fifty_requests(year: Trips) -> None:
    for mode in ("folded", "mondays"):
        assert len(trip_scenario("nyc-weak", 0, year, mode=mode).episodes) == 106
    folded = trip_scenario("nyc-weak", 0, year)
    sizes = np.array([episode.arrival.size for episode in folded.episodes])
    assert folded.fraction * sizes.mean() == pytest.approx(50)
    drawn = np.array([instance.n_requests for instance in folded.sample(106, seed=0)])
    expected = folded.fraction * sizes[folded.order(106, seed=0)]
    # A sum of independent coin tosses each: the standardised differences have mean 0 and standard deviation 1.
    score = (drawn - expected) / np.sqrt(expected * (1 - folded.fraction))
    assert abs(score.mean()) < 4 / np.sqrt(106)
    assert 0.7 < score.std() < 1.3


@pytest.mark.slow
def test_the_request_rate_aims_the_thinning_and_never_invents_trips(year: Trips) -> None:
    usual, twice = (trip_scenario("nyc-weak", 0, year, request_rate=rate / 120) for rate in (50, 100))
    assert twice.fraction == pytest.approx(2 * usual.fraction)
    assert trip_scenario("nyc-weak", 0, year, request_rate=1e6).fraction == 1.0
    assert trip_scenario("nyc-weak", 0, year, fraction=0.05).fraction == 0.05


def test_every_episode_comes_once_before_any_comes_again(year: Trips) -> None:
    folded = trip_scenario("nyc-weak", 0, year)
    instances = folded.sample(150, seed=3)
    assert [which(instance) for instance in instances] == folded.order(150, seed=3)
    assert sorted(map(which, instances[:106])) == list(range(106))
    assert list(map(which, instances[106:])) == list(map(which, instances[:44]))
    assert all(first != again for first, again in zip(instances, instances[106:], strict=False))


def test_the_first_instances_of_a_larger_sample_are_those_of_a_smaller_one(year: Trips) -> None:
    folded = trip_scenario("nyc-weak", 0, year)
    small, large = folded.sample(3, seed=5), folded.sample(120, seed=5)
    assert small == large[:3]
    assert small != folded.sample(3, seed=6)
    sequence = np.random.SeedSequence(5)
    assert folded.sample(3, sequence) == folded.sample(3, sequence) == small


def test_the_order_of_files_and_rows_does_not_matter(year: Trips) -> None:
    shuffled = replace(year, frame=year.frame.sample(frac=1, random_state=0))
    one, other = (trip_scenario("nyc-weak", 0, trips).sample(5, seed=0) for trips in (year, shuffled))
    assert one == other


def test_one_instance_realises_the_episode_asked_for_or_a_random_one(year: Trips) -> None:
    folded = trip_scenario("nyc-weak", 0, year)
    assert which(folded.instance(0, episode=17)) == 17
    assert folded.instance(4) == folded.instance(4)
    assert len({which(folded.instance(seed)) for seed in range(20)}) > 10
    with pytest.raises(InputError, match=r"episode = 106 is not in 0..105"):
        folded.instance(0, episode=106)


@pytest.mark.slow
def test_the_split_keeps_episodes_apart(year: Trips) -> None:
    parts = trip_scenario("nyc-weak", 0, year).split()
    assert [len(part) for part in parts] == [76, 20, 10]
    episodes = [which(instance) for part in parts for instance in part]
    assert len(set(episodes)) == 106
    assert parts == trip_scenario("nyc-weak", 0, year).split()
    assert episodes != [which(i) for part in trip_scenario("nyc-weak", 1, year).split() for i in part]


@pytest.mark.slow
def test_further_instances_realise_the_episodes_of_their_part_anew(year: Trips) -> None:
    """One after the other and again from the start; each realisation has requests of its own."""
    source = trip_scenario("nyc-weak", 0, year)
    split, seen = source.split(), set()
    for part in ("train", "test", "validation"):
        own, more = [which(day) for day in getattr(split, part)], source.further(part, 160)
        assert [which(day) for day in more] == (own * 16)[:160]
        seen |= {day.utility.tobytes() for day in more}
    assert len(seen | {day.utility.tobytes() for part in split for day in part}) == 3 * 160 + 106
    with pytest.raises(InputError, match="has no train half-hours: give each part"):
        trip_scenario("nyc-weak", 0, year, split=(0, 5, 2)).further("train", 4)
    with pytest.raises(InputError, match="part = 'tests'"):
        source.further("tests", 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weeks", "asked", "sizes"),
    [
        (26, (76, 20, 10), [37, 10, 5]),
        (5, (76, 20, 10), [7, 2, 1]),
        (2, (76, 20, 10), [2, 1, 1]),
        (2, (480, 2, 1), [2, 1, 1]),
        (2, (480, 120, 0), [3, 1, 0]),
        (53, (480, 120, 30), [81, 20, 5]),
    ],
)
def test_the_split_shrinks_in_proportion_to_the_episodes(
    year: Trips, weeks: int, asked: tuple[int, int, int], sizes: list[int]
) -> None:
    # Weeks of 2018 begin with the year.
    early = year.frame[year.frame["pickup_time"] < np.datetime64("2018-01-01") + np.timedelta64(weeks, "W")]
    parts = trip_scenario("nyc-weak", 0, replace(year, frame=early), split=asked).split()
    assert [len(part) for part in parts] == sizes
    assert len({which(instance) for part in parts for instance in part}) == 2 * weeks


def test_too_few_episodes_for_a_split_are_refused() -> None:
    trips = records(("2018-03-05 11:00:00", 9.0), ("2018-03-05 11:40:00", 9.0))
    with pytest.raises(DataError, match=r"2 episode\(s\) do not make 3 parts"):
        trip_scenario("nyc-weak", 0, trips).split()


def test_strong_preference_loves_pickups_and_shuns_dropoffs_in_region_one(year: Trips) -> None:
    weak, strong = (trip_scenario(name, 0, year).sample(20, seed=0) for name in ("nyc-weak", "nyc-strong"))
    for one, other in zip(weak, strong, strict=True):
        shift = 30.0 * (one.pickup == 0) - 30.0 * (one.dropoff == 0)
        np.testing.assert_allclose(other.utility, one.utility + shift)
        assert replace(other, utility=one.utility) == one
    assert {0, 1, 2, 3} == set(np.concatenate([one.pickup for one in weak]))


@pytest.mark.slow
def test_the_scenario_is_found_by_name_and_describes_itself(year_file: Path) -> None:
    made = scenario("NYC_strong", seed=2, trips=year_file, mode="mondays", fraction=0.5, worker_rate=1.0)
    assert isinstance(made, TripScenario)
    assert isinstance(made, Scenario)
    told = made.describe()
    assert (told["name"], told["mode"], told["fraction"], told["episodes"]) == ("nyc-strong", "mondays", 0.5, 106)
    assert told["settings"]["worker_rate"] == 1.0
    assert told["trips"]["files"] == ["yellow_tripdata_2018.parquet"]
    kept = sum(episode.arrival.size for episode in made.episodes)
    assert told["trips"]["rows"] == 200_000 == kept + sum(told["trips"]["dropped"].values())
    # Reading only the hours of the mode changes nothing.
    again = trip_scenario("nyc-strong", 2, read_trips(year_file), mode="mondays", fraction=0.5, worker_rate=1.0)
    assert made.sample(4, seed=0) == again.sample(4, seed=0)


def test_trips_without_the_hours_of_the_mode_are_refused(tmp_path: Path, year_file: Path) -> None:
    frame = pd.read_parquet(year_file)
    start = frame["tpep_pickup_datetime"].dt
    quiet = frame[start.day_of_week.isin([1, 6]) & (start.month == 3)]
    quiet.to_parquet(tmp_path / "march.parquet")
    first, last = date(2018, 3, 4), date(2018, 3, 27)
    expected = f"^no Monday between 11 and 12 among trips from {first} to {last}; use mode folded$"
    for trips in (tmp_path / "march.parquet", read_trips(tmp_path / "march.parquet")):
        with pytest.raises(DataError, match=expected):
            trip_scenario("nyc-weak", 0, trips, mode="mondays")
    with pytest.raises(DataError, match="no weekday between 7 and 19 among trips from 2018-03-04 to 2018-03-04"):
        trip_scenario("nyc-weak", 0, records(("2018-03-04 11:00:00", 9.0)))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"name": "I.1"}, "no scenario 'I.1' with trips"),
        ({"seed": -1}, "the world's seed = -1"),
        ({"mode": "tuesdays"}, "no mode 'tuesdays'; there are folded, mondays"),
        ({"fraction": 0.0}, r"fraction = 0.0 is not a finite number above 0"),
        ({"fraction": 1.5}, r"fraction = 1.5 is not a finite number above 0 and at most 1"),
        ({"fraction": float("nan")}, r"fraction = nan is not"),
        ({"pickups": 5}, "settings pickups and dropoffs must stay 4"),
        ({"colour": 1}, "no setting 'colour'"),
    ],
)
def test_wrong_arguments_are_refused(wrong: dict, message: str) -> None:
    call = {"name": "nyc-weak", "seed": 0, "trips": records(("2018-03-05 11:00:00", 9.0))} | wrong
    with pytest.raises(InputError, match=message):
        trip_scenario(**call)


def test_a_negative_count_or_seed_is_refused(year: Trips) -> None:
    folded = trip_scenario("nyc-weak", 0, year)
    assert folded.sample(0, seed=0) == []
    with pytest.raises(InputError, match="count = -1 is not"):
        folded.sample(-1, seed=0)
    with pytest.raises(InputError, match="seed = -1"):
        folded.sample(1, seed=-1)
