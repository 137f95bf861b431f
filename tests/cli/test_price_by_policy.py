"""optkit price with a trained policy: tables of one's own, a fit, a policy, and this morning's requests."""

import io

import pandas as pd
import pytest

from optkit.learning.trained import Trained
from tests.cli.test_instances import MAP, tables
from tests.command_line import optkit, strict


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A policy that was trained on days made of two tables."""
    folder = tmp_path_factory.mktemp("road")
    more = ("--step=15s", "--start=08:00", "--day-column=date", "--features=km", "--out", folder / "days")
    optkit("instances", *tables(folder, days=12), *MAP, *more, check=0)
    optkit("train", folder / "days", "--choice", "true", "--out", folder / "policy.json", "--quiet", check=0)
    return folder / "policy.json"


OPEN = (
    "request,expiry,reward,penalty,km,utility_bike,utility_car,colour\n"
    "007,2026-05-04T08:03:00+02:00,25,-2,1.5,-5,-7.5,red\n7,2026-05-04T08:02:00+02:00,22,-2,3,-5,-7.5,red\n"
)


@pytest.mark.slow
def test_open_requests_are_priced(policy, tmp_path):
    """By time and group, with a certificate; the prices are those of Python, and what is ignored is said."""
    (tmp_path / "open.csv").write_text(OPEN)
    words = ("price", tmp_path / "open.csv", "--policy", policy, "--time", "08:01:40", "--group", "car", "--mu", 2)
    done = optkit(*words, "--json", check=0)
    told = strict(done.stdout)
    assert "ignored columns" in done.stderr
    assert [row["request"] for row in told["requests"]] == ["007", "7"]
    assert told["certificates"]["prices"]["optimal"]
    assert (told["mu"], told["mu_is"]) == (2.0, "as given")
    found = Trained.load(policy).price(
        pd.read_csv(tmp_path / "open.csv", dtype={"request": str}), time="08:01:40", group="car", mu=2
    )
    assert [row["compensation"] for row in told["requests"]] == pytest.approx(found["compensation"].tolist(), rel=1e-12)
    assert "priced as one decision of 2 requests; mu 2.0000 as given" in optkit(*words, check=0).stdout


@pytest.mark.slow
def test_what_is_missing_is_said(policy, tmp_path):
    """One line each, that says what to type."""
    (tmp_path / "open.csv").write_text(OPEN)
    (tmp_path / "bare.csv").write_text("request,reward,expiry\na,25,9\n")
    for file, options, message in (
        ("open.csv", ("--time", "08:01"), "of which group the worker is: bike, car"),
        ("open.csv", ("--group", "car"), "at which step"),
        ("open.csv", ("--group", "car", "--time", "10:00"), "not on the day of 10:00"),
        ("open.csv", ("--group", "van", "--time", "08:01"), "no group is called 'van'"),
        ("bare.csv", ("--group", "car", "--step", 3), "no column 'km'"),
    ):
        done = optkit("price", tmp_path / file, "--policy", policy, *options, check=2)
        assert message in done.stderr
        assert done.stderr.splitlines()[-1].startswith("optkit: ")
    assert "--step 3 goes with --policy" in optkit("price", tmp_path / "open.csv", "--step", 3, check=2).stderr


@pytest.mark.slow
def test_columns_that_would_count_are_not_ignored(policy, tmp_path):
    """Requests that are not on offer, and several decisions, are not priced as one."""
    table = pd.read_csv(io.StringIO(OPEN), dtype={"request": str}).drop(columns="colour")
    for name in ("offered", "decision"):
        table.assign(**{name: [0, 1]}).to_csv(tmp_path / "open.csv", index=False)
        words = ("--policy", policy, "--time", "08:01:40", "--group", "car")
        assert f"has a column '{name}'" in optkit("price", tmp_path / "open.csv", *words, check=2).stderr
