"""The command line, called as a user calls it; see tests/command_line.py."""

import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from optkit.basics.plain_json import sealed
from optkit.bounds import arrival_information, full_information
from optkit.evaluation import main_job
from optkit.evaluation.main_job import run_main_job
from optkit.gap import charging
from optkit.gap.fluid_scenario import bid_prices
from optkit.instances.catalogue import scenario
from optkit.instances.storage import load_instances, read_description, save_instances
from tests.command_line import optkit


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A folder with train, test and validation sets, small enough to run in seconds."""
    folder = tmp_path_factory.mktemp("sets") / "small"
    for part, instances in scenario("I.1", seed=0, split=(12, 6, 3), horizon=12).split()._asdict().items():
        save_instances(folder / part, instances)
    return folder


@pytest.fixture(scope="module")
def finished(small, tmp_path_factory):
    """The results folder of a run on these, and what it printed."""
    out = tmp_path_factory.mktemp("finished") / "results"
    return out, optkit("run", small, "--out", out, "--verify", 5, check=0)


@pytest.fixture
def requests_csv(tmp_path):
    """Three requests, one of which expires now, with somebody's proposed prices."""
    path = tmp_path / "requests.csv"
    path.write_text(
        "request,reward,penalty,expires,utility,compensation\n"
        "lunch,30,-5,0,-10,15\nparcel,45,-8,1,-22,30\nfar,20,-2,0,-40,18\n"
    )
    return path


@pytest.mark.slow
def test_run_writes_results_that_agree_with_what_it_prints(finished):
    """optkit run on a folder prints the table, and writes the same numbers, rows, record and picture."""
    out, done = finished
    summary = json.loads((out / "summary.json").read_text())
    table = pd.read_csv(out / "table.csv")
    rows = pd.read_parquet(out / "per_instance.parquet")
    assert summary["verification"]["holds"]
    assert summary["verification"]["solved"] == 5
    assert summary["record"]["versions"]["optkit"]
    assert summary["record"]["tuned"]["PP"]["share"] >= 0.4
    assert len(rows) == len(summary["policies"]) * 6
    for row in summary["policies"]:
        assert row["policy"] in done.stdout
        assert f"{row['ratio']:.2f}" in done.stdout
        own = rows.loc[rows["policy"] == row["policy"], "ratio"]
        assert own.mean() == pytest.approx(row["ratio"], rel=1e-12)
        assert (own <= 100 + 1e-9).all()
    for name in ("Linear, true MNL", "Kernel, true MNL", "Linear, learned MNL"):
        scores = [f"{one['score']:.2f}" for one in summary["record"]["trained"][name]["rounds"]]
        assert f"trained: {name}: best of 2 round(s) by mean validation reward: {', '.join(scores)}" in done.stdout
    assert table["ratio"].tolist() == pytest.approx([row["ratio"] for row in summary["policies"]], rel=1e-12)
    assert (out / "performance_ratio.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "performance_ratio.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_run_is_reproducible_and_replaces_only_its_own_results(small, finished, tmp_path):
    """The same run gives the same numbers, and a folder that is not a run's stays untouched."""
    out = shutil.copytree(finished[0], tmp_path / "results")
    first = json.loads((out / "summary.json").read_text())
    again = json.loads(optkit("run", small, "--out", out, "--verify", 5, "--json", check=0).stdout)
    assert first["policies"] == again["policies"]
    (tmp_path / "diary").mkdir()
    (tmp_path / "diary" / "day.txt").write_text("dear diary")
    done = optkit("run", small, "--out", tmp_path / "diary", check=2)
    assert "holds 'day.txt', which is no part of the results of optkit run" in done.stderr
    assert (tmp_path / "diary" / "day.txt").read_text() == "dear diary"


@pytest.mark.slow
def test_generate_and_bound_agree_with_the_library(tmp_path):
    """Sets written by optkit generate hold the scenario's instances; optkit bound gives their bounds."""
    folder = tmp_path / "set"
    optkit("generate", "II", "--seed", 3, "--count", 4, "--sample-seed", 5, "--out", folder, check=0)
    expected = scenario("II", seed=3).sample(4, 5)
    assert load_instances(folder) == expected
    assert read_description(folder)["scenario"]["sample_seed"] == 5
    values = [full_information(one).value for one in expected]
    for extra in (["--jobs", 2], ["--method", "lp"], ["--method", "milp"]):
        rows = json.loads(optkit("bound", folder, "--json", *extra, check=0).stdout)["bounds"]
        # Methods agree to 1e-7 relative: HiGHS stops at a feasibility tolerance of that size.
        assert [row["bound"] for row in rows] == pytest.approx(values, rel=1e-7)
    optkit("bound", folder, "--out", tmp_path / "bounds.csv", check=0)
    assert pd.read_csv(tmp_path / "bounds.csv")["bound"].tolist() == pytest.approx(values, rel=1e-7)


@pytest.mark.slow
def test_generate_takes_settings(tmp_path):
    """--set changes the scenario, and the written description says so."""
    optkit("generate", "I.1", "--set", "horizon=80", "--count", 2, "--out", tmp_path / "set", check=0)
    assert load_instances(tmp_path / "set") == scenario("I.1", seed=0, horizon=80).sample(2, 0)
    assert read_description(tmp_path / "set")["scenario"]["settings"]["horizon"] == 80


@pytest.mark.slow
def test_generate_writes_the_three_parts(tmp_path):
    """Without a count, train, test and validation sets are written, and a second time only with --overwrite."""
    folder = tmp_path / "sets"
    short = ["generate", "I.2", "--set", "horizon=6", "--out", folder]
    done = optkit(*short, "--json", check=0)
    assert json.loads(done.stdout)["instances"] == {"train": 480, "test": 120, "validation": 30}
    assert load_instances(folder / "test") == scenario("I.2", seed=0, horizon=6).split().test
    assert "exists" in optkit(*short, check=2).stderr
    optkit(*short, "--overwrite", check=0)


def test_bound_reports_a_solver_that_gave_up(small):
    """A time limit that is hit is reported as such, without a bound, and the exit status is 1."""
    done = optkit("bound", small / "test", "--method", "milp", "--time-limit", 1e-9, "--json", check=1)
    rows = json.loads(done.stdout)["bounds"]
    assert all(row["bound"] is None and "time limit" in row["error"] for row in rows)


@pytest.mark.slow
def test_bound_kinds_agree_with_the_library(tmp_path, monkeypatch):
    """Bounds of arrivals and the fluid are the library's; the penalised are proven, and only their mean counts."""
    monkeypatch.setattr(charging, "MOST", 40)  # fewer instances to train on and to draw from prove less, but as surely
    monkeypatch.setattr(charging, "POOL", 120)
    source = scenario("I.2", seed=3, horizon=10)
    few = ["--set", "horizon=10", "--count", 4, "--sample-seed", 5]
    optkit("generate", "I.2", "--seed", 3, *few, "--out", tmp_path / "set", check=0)
    days = source.sample(4, 5)
    for method in ("exact", "lagrangian"):
        done = optkit("bound", tmp_path / "set", "--kind", "arrival", "--method", method, "--json", check=0)
        found = [row["bound"] for row in json.loads(done.stdout)["bounds"]]
        assert found == pytest.approx([arrival_information(day, method).value for day in days], rel=1e-12)
    rows = tmp_path / "rows.csv"
    done = optkit("bound", tmp_path / "set", "--kind", "penalised", "--out", rows, check=0)
    assert "only the mean is a bound" in done.stdout
    assert (pd.read_csv(rows)["gap"].abs() < 1e-6).all()
    told = json.loads(optkit("bound", tmp_path / "set", "--kind", "fluid", "--json", check=0).stdout)["bounds"]
    assert [row["bound"] for row in told] == pytest.approx([bid_prices(source)[0].value], rel=1e-12)
    assert "no policy earns more in the mean" in optkit("bound", tmp_path / "set", "--kind", "fluid", check=0).stdout
    refused = optkit("bound", tmp_path / "set", "--kind", "fluid", "--checkpoint", tmp_path / "kept", check=2)
    assert "--checkpoint" in refused.stderr


@pytest.mark.slow
def test_bound_goes_on_from_its_checkpoint(small, tmp_path):
    """Bounds that were kept are not worked out again; what failed is; other options have a file of their own."""
    asked = ["bound", small / "test", "--checkpoint", tmp_path / "kept", "--json"]
    first = json.loads(optkit(*asked, check=0).stdout)
    file = next((tmp_path / "kept").iterdir())
    head, *lines = file.read_text().splitlines()
    kept = json.loads(lines[0])
    kept["row"]["bound"] = 12.5  # a mark
    file.write_text("\n".join([head, json.dumps(sealed(kept))]) + "\n")
    again = json.loads(optkit(*asked, check=0).stdout)
    marked = kept["number"]
    assert [row["checked"] for row in again["bounds"]] == [i != marked for i in range(len(again["bounds"]))]
    every = len(again["bounds"])
    assert f"; 0 certificates checked, {every} bounds kept from before" in optkit(*asked[:-1], check=0).stdout
    assert again["bounds"][marked]["bound"] == 12.5
    others = [i for i in range(len(first["bounds"])) if i != marked]
    assert [again["bounds"][i]["bound"] for i in others] == [first["bounds"][i]["bound"] for i in others]
    failing = [*asked, "--method", "milp", "--time-limit", 1e-9]
    optkit(*failing, check=1)
    optkit(*failing, check=1)
    optkit(*asked, "--method", "lp", check=0)
    assert len(list((tmp_path / "kept").iterdir())) == 3


@pytest.mark.slow
def test_bound_takes_no_other_folders_bounds(small, tmp_path):
    """What no table holds counts as well: one digit in the last place of it makes another checkpoint."""
    days = load_instances(small / "validation")
    changes = [
        {},
        {"mu": np.nextafter(days[0].mu, 9.0)},
        {"outside_utility": np.nextafter(0.0, 1.0)},
        {"outside_utility": 40.0},
        {"horizon": days[0].horizon + 1},
    ]
    for number, change in enumerate(changes):
        save_instances(tmp_path / "set", [dataclasses.replace(day, **change) for day in days], overwrite=True)
        asked = ["bound", tmp_path / "set", "--kind", "arrival", "--json"]
        told = json.loads(optkit(*asked, "--checkpoint", tmp_path / "kept", check=0).stdout)["bounds"]
        assert [row["bound"] for row in told] == [row["bound"] for row in json.loads(optkit(*asked).stdout)["bounds"]]
        assert all(row["checked"] for row in told)
        assert len(list((tmp_path / "kept").iterdir())) == number + 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"precious": "one line, no line break"}', "is not a file of optkit bound --checkpoint, so it stays"),
        ("{head}\n" + '{"number": 1e400, "row": {}}\n', "is damaged in line 2: remove this line"),
        ("{head}\n" + "[" * 100_000 + "\n", "is damaged in line 2: remove this line"),
    ],
    ids=["foreign", "wrong", "deep"],
)
def test_a_checkpoint_in_the_way_is_one_line(small, tmp_path, content, said):
    """Foreign and damaged files end in one line, and stay."""
    asked = ["bound", small / "validation", "--checkpoint", tmp_path]
    optkit(*asked, check=0)
    (file,) = tmp_path.iterdir()
    file.write_text(content.replace("{head}", file.read_text().split("\n")[0]))
    before = file.read_bytes()
    done = optkit(*asked, check=2)
    assert done.stderr.startswith(f"optkit: {file} {said}")
    assert (done.stdout, done.stderr.count("\n")) == ("", 1)
    assert file.read_bytes() == before


def test_price_prints_prices_and_certificates(requests_csv):
    """optkit price gives optimal prices with their certificate, and exposes a proposal that is not optimal."""
    done = optkit("price", requests_csv, "--solver", "CLARABEL", check=0)
    for text in ("markup", "expected profit", "verdict        optimal", "NOT optimal", "CLARABEL: optimal"):
        assert text in done.stdout
    result = json.loads(optkit("price", requests_csv, "--json", check=0).stdout)
    prices = [row["compensation"] for row in result["requests"]]
    assert result["markup"] == pytest.approx(53 - prices[1], rel=1e-12)  # the parcel expires: worth 45 + 8
    assert result["certificates"]["prices"]["optimal"]
    assert not result["certificates"]["your prices"]["optimal"]
    assert result["certificates"]["your prices"]["bound"] == pytest.approx(result["profit"], rel=1e-9)


def test_price_by_a_solver_refuses_more_requests_than_fit(tmp_path):
    """Twenty thousand are priced by the form, and in one line not by a program of twelve gigabytes."""
    path = tmp_path / "many.csv"
    path.write_text("value,utility\n" + "".join(f"{30 + i % 7},{-10 - i % 5}\n" for i in range(20_000)))
    done = optkit("price", path, "--solver", "CLARABEL", check=2)
    assert done.stderr.startswith("optkit: a program over 20,000 requests takes about 12.8 GB; at most 5,000")
    assert (done.stdout, done.stderr.count("\n")) == ("", 1)


def test_price_reads_json_like_csv(requests_csv, tmp_path):
    """A JSON list, and a JSON object with a list under requests, mean the same as the CSV."""
    rows = pd.read_csv(requests_csv).to_dict(orient="records")
    expected = json.loads(optkit("price", requests_csv, "--json", check=0).stdout)
    for content in (rows, {"requests": rows}):
        (tmp_path / "requests.json").write_text(json.dumps(content))
        assert json.loads(optkit("price", tmp_path / "requests.json", "--json", check=0).stdout) == expected


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_price_says_the_same_in_any_unit_of_money(tmp_path, unit):
    """Verdicts do not depend on the currency, and amounts are shown in it, however small."""
    table = pd.DataFrame({"request": ["a", "b"], "value": [30 * unit, 53 * unit], "utility": [-10 * unit, -22 * unit]})
    table["compensation"] = [18 * unit, 27 * unit]
    table.to_csv(tmp_path / "r.csv", index=False)
    facts = ("price", tmp_path / "r.csv", "--mu", str(unit), "--solver", "CLARABEL")
    told = json.loads(optkit(*facts, "--json", check=0).stdout)
    assert told["profit"] / unit == pytest.approx(26.714799, rel=1e-6)
    assert [told["certificates"][who]["optimal"] for who in ("prices", "your prices")] == [True, False]
    assert not any(told["certificates"][who]["undecided"] for who in ("prices", "your prices"))
    assert told["solver"]["status"] == "optimal"
    shown = optkit(*facts, check=0).stdout
    assert float(re.search(r"expected profit (\S+)", shown)[1]) / unit == pytest.approx(26.714799, rel=1e-6)
    assert shown.count("NOT optimal") == 1


def test_price_leaves_out_what_is_not_offered_or_cannot_be_served(tmp_path):
    """A request that cannot be served, or is not on offer, changes nothing for the others."""
    path = tmp_path / "r.csv"
    path.write_text("value,utility,offered\n30,-10,1\n50,-inf,1\n60,5,0\n53,-22,1\n")
    told = json.loads(optkit("price", path, "--solver", "CLARABEL", "--json", check=0).stdout)
    assert told["profit"] == pytest.approx(26.714799, rel=1e-6)
    assert [row["acceptance"] for row in told["requests"][1:3]] == [0, 0]
    assert told["certificates"]["prices"]["optimal"]
    path.write_text("value,utility\n30,-10\n50,inf\n")
    assert "utility in row 2 is 'inf', not a finite number" in optkit("price", path, check=2).stderr


def test_forms_of_price_order_as_they_must(requests_csv):
    """Free prices earn at least as much as non-negative ones, and these as clipped ones."""
    profit = {
        form: json.loads(optkit("price", requests_csv, "--form", form, "--json", check=0).stdout)["profit"]
        for form in ("free", "exact", "clip")
    }
    assert profit["free"] >= profit["exact"] >= profit["clip"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run", "I.9"], "neither a scenario"),
        (["run", "nyc-weak"], "trip records"),
        (["run", "I.1", "--trips", "x.parquet"], "takes no trips"),
        (["run", "I.1", "--mode", "folded"], "--mode"),
        (["run", "I.1", "--seed", "-1"], "seed"),
        (["run", "I.1", "--set", "horizn=3"], "no setting 'horizn'"),
        (["run", "I.1", "--set", "horizon"], "NAME=NUMBER"),
        (["run", ".", "--set", "horizon=3"], "--set"),
        (["run", "I.1", "--set", "seed=3"], "no setting 'seed'"),
        (["run", "I.1", "--set", "horizon=1e300"], "horizon"),
        (["run", "I.1", "--set", "request_rate=1e300"], "request_rate"),
        (["run", "I.1", "--set", "split=3"], "split"),
        (["bound", "absent", "--out", "no/such/folder/x.csv"], "cannot be written"),
        (["run", "nyc-weak", "--trips", "absent.parquet"], "absent.parquet"),
        (["generate", "I.1", "--count", "-2", "--out", "x"], "--count -2"),
        (["bound", "absent"], "absent"),
        (["bound", "absent", "--jobs", "-2"], "--jobs"),
        (["bound", "absent", "--out", "x.txt"], ".csv or .parquet"),
        (["bound", "absent", "--kind", "best"], "--kind best"),
        (["bound", "absent", "--kind", "arrival", "--method", "lp"], "--method lp"),
        (["bound", "absent", "--kind", "penalised", "--method", "lp"], "there is but one"),
        (["bound", "absent", "--kind", "arrival", "--time-limit", "3"], "--time-limit"),
        (["generate", "I.1", "--count", "0", "--out", "z"], "--count 0: a set has at least one instance"),
        (["run", "nyc-weak"], "nyc-weak needs trip records: give --trips"),
        (["price", "absent.csv"], "absent.csv"),
        (["price", "absent.csv", "--form", "best"], "--form"),
    ],
)
def test_bad_input_gets_one_line_and_exit_status_2(arguments, says, tmp_path):
    """What is wrong is said in one line on standard error, with exit status 2 and no traceback."""
    done = optkit(*arguments, cwd=tmp_path, check=2)
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


@pytest.mark.slow
def test_runs_do_not_replace_what_is_not_theirs(small, finished, tmp_path):
    """A second run refuses a results folder of other instances, and one that holds somebody's notes."""
    out = shutil.copytree(finished[0], tmp_path / "results")
    save_instances(tmp_path / "other", scenario("I.2", seed=3).sample(8, 1))
    assert "other instances" in optkit("run", tmp_path / "other", "--out", out, check=2).stderr
    (out / "notes.txt").write_text("mine")
    assert "notes.txt" in optkit("run", small, "--out", out, check=2).stderr
    assert (out / "notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_run_needs_no_interval_for_one_instance(tmp_path, monkeypatch):
    """With a single test instance there is no interval: the table shows a dash, and the JSON is JSON."""
    found = []

    def found_once(*asked, **settings):
        found.append(found[0] if found else run_main_job(*asked, **settings))
        return found[-1]

    monkeypatch.setattr(main_job, "run_main_job", found_once)
    save_instances(tmp_path / "two", scenario("I.2", seed=3, horizon=8).sample(2, 1))
    done = optkit("run", tmp_path / "two", "--out", tmp_path / "r", "--verify", 0, "--json", check=0)

    def refuse(word):
        raise AssertionError(word)

    rows = json.loads(done.stdout, parse_constant=refuse)["policies"]
    assert rows[0]["low"] is None
    assert "nan" not in optkit("run", tmp_path / "two", "--out", tmp_path / "r", "--verify", 0, check=0).stdout


@pytest.mark.slow
def test_generate_writes_all_parts_or_none(tmp_path):
    """If one part's place is taken by something else, no part is written; a flat set and a split do not mix."""
    (tmp_path / "sets" / "test").mkdir(parents=True)
    few = ["--set", "split=4,3,2"]
    assert "--overwrite" in optkit("generate", "I.1", "--out", tmp_path / "sets", *few, check=2).stderr
    assert not (tmp_path / "sets" / "train").exists()
    optkit("generate", "I.1", "--out", tmp_path / "flat", "--count", 2, check=0)
    assert "one set" in optkit("generate", "I.1", "--out", tmp_path / "flat", *few, check=2).stderr


def test_bound_goes_on_past_an_instance_without_noise(tmp_path):
    """An instance that cannot be bounded is named; the others are bounded, and the status is 1."""
    day, other = scenario("I.2", seed=3).sample(2, 1)
    save_instances(tmp_path / "set", [dataclasses.replace(day, noise=None, outside_noise=None), other])
    rows = json.loads(optkit("bound", tmp_path / "set", "--json", check=1).stdout)["bounds"]
    assert "not realised" in rows[0]["error"]
    assert rows[1]["bound"] == full_information(other).value


def test_names_are_printed_as_they_are(tmp_path):
    """Markup, numbers and words for nothing are names like any other."""
    names = ["[bold]x[/bold]", "[/oops]", "007", "NA", ":smile:"]
    rows = "".join(f'"{name}",10,-5\n' for name in names)
    (tmp_path / "r.csv").write_text("request,value,utility\n" + rows)
    done = optkit("price", tmp_path / "r.csv", check=0)
    assert all(name in done.stdout for name in names)


def test_columns_without_a_meaning_are_named(tmp_path):
    """A misspelt column does not vanish in silence."""
    (tmp_path / "r.csv").write_text("reward,penalty,expire,utility\n30,-5,1,-10\n")
    assert "expire" in optkit("price", tmp_path / "r.csv", check=0).stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("utility,value\n1,2,3\n", "row 1 has 3 entries for 2 columns"),
        ("utility,value,Value\n1,2,3\n", "'value' twice"),
        ("utility,value,reward\n-1,2,3\n", "both value and reward"),
        ("utility,reward,penalty\n-1,2,3\n", "penalty in row 1 = 3 is positive"),
        ("utility,reward,penalty,expires\n-1,2,-3,7\n", "neither 0 nor 1"),
        ("reward,penalty\n1,2\n", "no column 'utility'"),
        ("utility\n-1\n", "'value' or 'reward'"),
        ("value,utility\n1,\n", "not a finite number"),
        ("value,utility\nten,-3\n", "'ten'"),
        ("value,utility\n", "no requests"),
        ("", "cannot read"),
    ],
)
def test_bad_tables_are_refused_with_the_place(text, says, tmp_path):
    """A table that cannot be priced is refused with the column and the row."""
    (tmp_path / "requests.csv").write_text(text)
    done = optkit("price", tmp_path / "requests.csv", check=2)
    assert says in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_folder_that_cannot_be_written_is_said(small, tmp_path):
    """Where the disk refuses, the error names the folder."""
    (tmp_path / "file").write_text("in the way")
    done = optkit("run", small, "--out", tmp_path / "file" / "x", "--verify", 0, check=2)
    assert "cannot be written" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb", ["run", "generate", "bound", "price", "certify", "fit", "train", "evaluate", "study", "teach"]
)
def test_every_verb_has_help(verb):
    """--help explains every verb."""
    assert "Usage" in optkit(verb, "--help", check=0).stdout


def test_version_is_the_package_s():
    """--version prints the version that the package has."""
    from optkit import __version__

    assert optkit("--version", check=0).stdout.strip() == __version__
    project = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert f'version = "{__version__}"' in project


@pytest.mark.slow
def test_run_on_trips(tmp_path):
    """optkit run on a scenario of New York reads trip records and reports both preferences."""
    rng = np.random.default_rng(0)
    count = 10_000
    start = np.datetime64("2018-01-01T07") + rng.integers(0, 100 * 86400, count).astype("timedelta64[s]")
    zones = np.array([261, 87, 161, 163, 238, 239, 236, 237])
    trips = pd.DataFrame(
        {
            "tpep_pickup_datetime": start,
            "tpep_dropoff_datetime": start + rng.integers(120, 2400, count).astype("timedelta64[s]"),
            "PULocationID": rng.choice(zones, count),
            "DOLocationID": rng.choice(zones, count),
        }
    )
    trips.to_parquet(tmp_path / "yellow_tripdata_2018.parquet")
    few = ["--set", "horizon=8", "--set", "split=8,6,2", "--verify", 3]
    done = optkit("run", "nyc-strong", "--trips", tmp_path, "--out", tmp_path / "run", *few, "--json", check=0)
    result = json.loads(done.stdout)
    assert result["verification"]["holds"]
    assert result["record"]["origin"]["trips"]["rows"] == count
    ratios = {row["policy"]: row["ratio"] for row in result["policies"]}
    assert ratios["Myopic, true MNL"] > max(ratios["PP"], ratios["FP"])
    assert {"Linear, true MNL", "Kernel, true MNL", "Linear, learned MNL"} <= set(ratios)


@pytest.mark.slow
def test_instances_without_features_are_run(optkit, tmp_path):
    """FP, which weighs a feature, is left out by name; train then takes the utilities of the folder, and says so."""
    drawn = scenario("I.2", seed=0, horizon=12).sample(12, 1)
    bare = [dataclasses.replace(day, features=np.zeros((day.n_requests, 0))) for day in drawn]
    save_instances(tmp_path / "days", bare)
    code, out, _ = optkit("run", tmp_path / "days", "--verify", 0, "--out", tmp_path / "results", "--quiet")
    assert code == 0
    assert "FP is left out: it weighs the travel distance" in out
    assert "without features, learned preferences are little more than one level" in out
    assert "FP" not in pd.read_csv(tmp_path / "results" / "table.csv")["policy"].tolist()
    told = (tmp_path / "results" / "README.md").read_text()
    rows = pd.read_parquet(tmp_path / "results" / "per_instance.parquet")
    for name in (*pd.read_csv(tmp_path / "results" / "table.csv"), *rows):
        assert re.search(rf"\b{name}\b", told), name
    _, out, err = optkit("train", tmp_path / "days", "--out", tmp_path / "p.json", "--quiet")
    assert "linear, true MNL" in out
    assert "utilities are the instances' own" in err
    _, _, err = optkit("train", tmp_path / "days", "--out", tmp_path / "p.json", "--choice", "learned", "--quiet")
    assert "little more than one level" in err
