"""Numbers far beyond anything are one line, before anything is built; so is what would not fit in memory."""

import resource
import sys
import time
from contextlib import contextmanager
from typing import get_type_hints

import pytest

from optkit.basics.memory import memory_limit
from optkit.cli.app import app
from optkit.instances.catalogue import scenario
from optkit.instances.world import COPIES, check_sample
from tests.cli.test_instances import MAP, tables
from tests.command_line import optkit

SEEDS = {"seed", "sample_seed", "training_seed", "offer_seed"}
"""Any number of 64 bits and beyond is a seed."""

ASKED = {
    ("run", "verify"): ["run", "days", "--verify"],
    ("generate", "count"): ["generate", "I.1", "--out", "new", "--count"],
    ("generate", "worlds"): ["generate", "benchmark", "--out", "new", "--world"],
    ("instances", "horizon"): ["instances", "orders.csv", "couriers.csv", *MAP, "--step=15s", "--horizon"],
    ("price", "step"): ["price", "orders.csv", "--step"],
    ("bound", "jobs"): ["bound", "days/test", "--jobs"],
    ("certify", "instances"): ["certify", "I.1", "--set", "split=9,4,4", "--instances"],
    ("certify", "limit"): ["certify", "days", "--limit"],
    ("certify", "jobs"): ["certify", "days", "--jobs"],
    ("train", "instances"): ["train", "I.1", "--instances"],
    ("train", "seeds"): ["train", "days", "--seeds"],
    ("study", "seeds"): ["study", "homogeneous", "--dry-run", "--out", "new", "--seeds"],
    ("study", "draws"): ["study", "sensitivity", "--dry-run", "--out", "new", "--draws"],
    ("study", "jobs"): ["study", "homogeneous", "--dry-run", "--out", "new", "--jobs"],
    ("teach", "port"): ["teach", "--port"],
}
"""A command line for every option of every verb that takes a whole number, but for seeds."""

SETTINGS = (
    *("groups", "horizon", "types", "pickups", "dropoffs", "characteristics", "request_rate", "worker_rate"),
    *("split", "mean_lifetime"),
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with small instance sets."""
    folder = tmp_path_factory.mktemp("counts")
    few = ["--set", "split=9,4,4", "--set", "horizon=8"]
    optkit("generate", "I.1", *few, "--out", folder / "days", check=0)
    tables(folder)
    return folder


@contextmanager
def little_memory():
    """Half a gigabyte more than there is in use by now: a test that fails must not take the machine with it."""
    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**29, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def refused(*words, cwd):
    """Run a verb that must refuse within seconds and without memory; return what it says."""
    started = time.process_time()
    with little_memory():
        done = optkit(*words, cwd=cwd, check=2)
    assert time.process_time() - started < 10.0  # what a verb imports takes the most of it
    assert done.stdout == ""
    assert "out of memory" not in done.stderr
    assert not (cwd / "new").exists()
    return done.stderr


def test_every_whole_number_is_among_them():
    """A verb that learns to count is held to the same."""
    found = {
        (str(verb.callback.__name__), name)
        for verb in app.registered_commands
        for name, kind in get_type_hints(verb.callback).items()
        if kind in (int, int | None, list[int] | None) and name not in SEEDS
    }
    assert found == set(ASKED)


@pytest.mark.slow
@pytest.mark.parametrize("number", [10**9, 10**18, 10**30])
@pytest.mark.parametrize("which", ASKED, ids=" ".join)
def test_an_absurd_number_is_refused(which, number, place):
    """In one line that says it; but for what the command line itself refuses, in its own way."""
    said = refused(*ASKED[which], number, cwd=place)
    if which == ("teach", "port"):
        assert "65535" in said
    else:
        assert said.count("\n") == 1
        assert f"{number}" in said.replace(",", "")


@pytest.mark.slow
@pytest.mark.parametrize("text", ["1000000000", "1000000000000000000", "9" * 5000, "5000"])
@pytest.mark.parametrize("study", ["homogeneous", "sensitivity"])
def test_an_absurd_number_of_worlds_is_refused(study, text, place):
    """Worlds by their number are text on the command line; many worlds and seeds are too many cells."""
    more = ["--seeds", 9000] if text == "5000" and study == "homogeneous" else []
    if more or text != "5000":
        said = refused("study", study, "--worlds", text, *more, "--dry-run", "--out", "new", cwd=place)
        assert said.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("number", ["1e6", "1e7", "1e8", "1e9", "1e18"])
@pytest.mark.parametrize("name", SETTINGS)
def test_an_absurd_setting_is_refused(name, number, place, tmp_path):
    """By its range, or by what the instances would take; what fits is drawn."""
    value = f"{int(float(number))},4,4" if name == "split" else number
    words = ["generate", "I.1", *([] if name == "split" else ["--count", 3]), "--set", f"{name}={value}"]
    with little_memory():
        done = optkit(*words, "--out", "new", cwd=tmp_path)
    if done.returncode:
        assert (done.stdout, done.stderr.count("\n")) == ("", 1)
        assert name in done.stderr or "GiB of memory, more than there is: take fewer" in done.stderr
    else:
        assert float(number) <= 1e8
        assert name in ("types", "pickups", "dropoffs", "mean_lifetime", "characteristics")


@pytest.mark.slow
@pytest.mark.parametrize("change", [{}, {"groups": 40}, {"horizon": 3000}, {"characteristics": 200}, {"pickups": 900}])
def test_the_estimate_is_no_less_than_half_of_what_is_taken(change, monkeypatch):
    """And no more than four times as much: what fits is not refused."""
    told = {}
    monkeypatch.setattr("optkit.instances.world.check_memory", lambda what, needed, remedy: told.update(needed=needed))
    source = scenario("I.1", seed=0, **change)
    days = source.sample(3, seed=1)
    check_sample(source.settings, 3)
    taken = sum(sys.getsizeof(one) + sum(getattr(part, "nbytes", 100) for part in vars(one).values()) for one in days)
    assert taken / 2 < told["needed"] / COPIES < 4 * taken + 3 * 4_000


def test_the_limit_is_the_smaller_of_the_machines_and_the_processes():
    """What this process may have is less than what the machine has."""
    whole = memory_limit()
    assert 2**28 < whole < 2**60
    with little_memory():
        assert memory_limit() < whole or whole < 2**31
