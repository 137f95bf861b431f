"""Splits read from folders."""

from dataclasses import replace

import pytest

from optkit.basics.errors import DataError
from optkit.instances.catalogue import scenario
from optkit.instances.splits import read_split
from optkit.instances.storage import save_instances


@pytest.fixture(scope="module")
def days():
    """Instances of Scenario I.2."""
    return scenario("I.2", seed=0).sample(21, seed=1)


def test_parts_come_back_as_they_were_written(days, tmp_path):
    """Each part is its folder's set, and the origin holds the checksums of all."""
    for part, own in (("train", days[:4]), ("test", days[4:6])):
        save_instances(tmp_path / part, own, scenario={"part": part})
    split, origin = read_split(tmp_path)
    assert (split.train, split.test, split.validation) == (days[:4], days[4:6], [])
    assert {part: one["scenario"] for part, one in origin["sets"].items()} == {
        p: {"part": p} for p in ("train", "test")
    }
    assert len(origin["sets"]["train"]["files"]["requests.parquet"]["sha256"]) == 64


def test_one_set_is_cut_in_the_papers_proportions(days, tmp_path):
    """21 instances are cut 16 : 4 : 1, which is 480 : 120 : 30, in order."""
    save_instances(tmp_path / "set", days)
    split, _ = read_split(tmp_path / "set")
    assert [len(part) for part in split] == [16, 4, 1]
    assert [*split.train, *split.test, *split.validation] == days


def test_noise_that_nobody_recorded_is_drawn_alike_each_time(days, tmp_path):
    """Each instance gets its own, the same in a second reading; the rest stays as it was, and the origin says so."""
    bare = [replace(day, noise=None, outside_noise=None) for day in days]
    save_instances(tmp_path / "set", bare)
    (split, origin), (again, _) = read_split(tmp_path / "set"), read_split(tmp_path / "set")
    made = [*split.train, *split.test, *split.validation]
    assert made == [*again.train, *again.test, *again.validation]
    assert [replace(day, noise=None, outside_noise=None) for day in made] == bare
    assert len({float(day.outside_noise[0]) for day in made if day.n_workers}) == sum(d.n_workers > 0 for d in made)
    assert origin["noise"] == 21
    for part, own in (("train", days[:4]), ("test", bare[4:6])):
        save_instances(tmp_path / "both" / part, own)
    split, origin = read_split(tmp_path / "both")
    assert split.train == days[:4]
    assert all(day.noise is not None for day in split.test)
    assert origin["noise"] == 2


def test_a_set_that_repeats_its_trips_is_refused(days, tmp_path):
    """A flat set with more instances than episodes would test on what it trained on."""
    save_instances(tmp_path / "set", days, scenario={"episodes": 20})
    with pytest.raises(DataError, match="without --count"):
        read_split(tmp_path / "set")


def test_one_instance_is_too_few_and_both_kinds_too_many(days, tmp_path):
    """A set of one cannot be cut; a folder that is a set and holds parts is ambiguous."""
    save_instances(tmp_path / "one", days[:1])
    with pytest.raises(DataError, match="1 instance"):
        read_split(tmp_path / "one")
    save_instances(tmp_path / "one" / "test", days[:1])
    with pytest.raises(DataError, match="also holds test"):
        read_split(tmp_path / "one")
