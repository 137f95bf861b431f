"""optkit collect and optkit fit, called as a user calls them."""

import json

import numpy as np
import pandas as pd
import pytest

from optkit import scenario
from optkit.instances.splits import read_split
from optkit.instances.storage import save_instances
from optkit.learning.offer_log import collect
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences
from optkit.policies.explore import RandomOffers


@pytest.fixture(scope="module")
def log():
    """Random offers of 30 to 70 % on scenario I.2: plenty of rejections."""
    return collect(scenario("I.2", seed=0).sample(150, seed=0), RandomOffers(0.3, 0.7))


@pytest.fixture(scope="module")
def file(log, tmp_path_factory):
    """The same as a file."""
    return log.save(tmp_path_factory.mktemp("log") / "offers.parquet")


@pytest.mark.slow
def test_collect_and_fit_show_what_the_library_finds(optkit, tmp_path):
    """optkit collect I.2 writes a parquet file, and optkit fit on it prints summary, parameters and identification."""
    path = tmp_path / "offers.parquet"
    done = optkit("collect", "I.2", "--out", path, "--low", "0.3", "--high", "0.7", check=0)
    offers = Offers.load(path)
    assert f"{len(offers):,} offers, {offers.n_situations:,} situations, {offers.n_choices:,} choices" in done.stdout
    done = optkit("fit", path, check=0)
    for words in ("coefficients of utility / mu", "Log-Likelihood", "preferences, in money", "dropoff_4"):
        assert words in done.stdout
    assert "identification of group 0: identified" in done.stdout or "of group 0: weak" in done.stdout
    assert f"{fit_preferences(offers).scale[0]:.4f}" in done.stdout


@pytest.mark.slow
def test_collect_is_the_librarys_log_of_the_training_instances(optkit, tmp_path):
    """The file holds what collect() logs on the training set, and --json tells its counts."""
    path = tmp_path / "o.parquet"
    code, out, _ = optkit("collect", "I.1", "--out", path, "--seed", 2, "--offer-seed", 5, "--json")
    want = collect(scenario("I.1", seed=2).split().train, RandomOffers(seed=5))
    assert code == 0
    assert json.loads(out) == {
        "file": str(path),
        "offers": len(want),
        "situations": want.n_situations,
        "choices": want.n_choices,
    }
    pd.testing.assert_frame_equal(Offers.load(path).to_frame(), want.to_frame())


def test_collect_takes_a_folder_of_instances(optkit, tmp_path):
    """Of an instance set of one's own, the part that optkit run trains on is logged."""
    instances = scenario("I.1", seed=0).sample(4, seed=0)
    save_instances(tmp_path / "set", instances)
    code, out, _ = optkit("collect", tmp_path / "set", "--out", tmp_path / "o.parquet")
    want = collect(read_split(tmp_path / "set")[0].train, RandomOffers())
    assert code == 0
    assert f"{len(want)} offers" in out
    np.testing.assert_array_equal(Offers.load(tmp_path / "o.parquet").compensation, want.compensation)


@pytest.mark.slow
def test_json_is_the_librarys_fit(optkit, log, file):
    """--json prints parameters, models and identification, and nothing else; numbers are those of fit_preferences."""
    code, out, err = optkit("fit", file, "--json")
    plain = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    found = fit_preferences(log)
    assert (code, err) == (0, "")
    assert (plain["offers"], plain["situations"]) == (len(log), log.n_situations)
    assert [row["parameter"] for row in plain["parameters"]] == [*found.attributes.columns, "mu"]
    np.testing.assert_allclose([row["estimate"] for row in plain["parameters"]][:-1], found.weights[0], rtol=1e-9)
    assert plain["models"][0]["llf"] == pytest.approx(found.results[0].llf)
    report = plain["identification"][0]
    assert report["choices"] == log.n_choices
    assert report["rejections"] == log.n_situations - log.n_choices
    assert len(report["eigenvalues"]) == len(found.attributes.columns) + 1


def test_out_writes_text_and_json(optkit, file, tmp_path):
    """--out saves the summary as text and, beside it, the very JSON that --json prints."""
    code, out, _ = optkit("fit", file, "--out", tmp_path / "fit.txt", "--json")
    assert code == 0
    assert json.loads((tmp_path / "fit.json").read_text()) == json.loads(out)
    text = (tmp_path / "fit.txt").read_text()
    for words in ("Log-Likelihood", "verdict", "pickup_4", "mu"):
        assert words in text


@pytest.mark.slow
def test_options_reach_the_fit(optkit, log, file):
    """--pooled, --method, --ridge, --scale-penalty, --robust and --features are the arguments of the same names."""
    for options, arguments in (
        (["--pooled", "--robust"], {"pooled": True, "robust": True}),
        (["--method", "accept-reject", "--ridge", 0.1], {"method": "accept-reject", "ridge": 0.1}),
        (["--scale-penalty", 50], {"scale_penalty": 50.0}),
    ):
        code, out, _ = optkit("fit", file, "--json", *options)
        found = fit_preferences(log, **arguments)
        assert code == 0
        last = json.loads(out)["parameters"][-1]
        assert last["estimate"] == pytest.approx(found.scale[0], rel=1e-9)
        assert last["standard_error"] == pytest.approx(np.sqrt(found.covariance[0][-1, -1]), rel=1e-9)
    code, out, _ = optkit("fit", file, "--json", "--features", "feature_0, feature_2")
    names = [row["parameter"] for row in json.loads(out)["parameters"]]
    assert names[:3] == ["feature_0", "feature_2", "pickup_0"]


def users_table(n=400, *, generous=0.0):
    """Named situations, two features and no groups or places; true mu = 2."""
    rng = np.random.default_rng(0)
    size, pay = rng.uniform(0, 1, (n, 2)), rng.uniform(2, 10, (n, 2)) + generous
    u = pay - 4 * size - 3 + rng.gumbel(0, 2, (n, 2))
    out = rng.gumbel(0, 2, n)
    chosen = (u == u.max(1, keepdims=True)) & (u.max(1) > out)[:, None]
    who = np.repeat([f"ride {i}" for i in range(n)], 2)
    return pd.DataFrame(
        {"situation": who, "size": size.ravel(), "compensation": pay.ravel(), "chosen": chosen.ravel().astype(int)}
    )


def test_a_users_csv(optkit, tmp_path):
    """A CSV of one's own gives its own names back, and mu = 2 within 4 standard errors."""
    users_table().to_csv(tmp_path / "own.csv", index=False)
    code, out, _ = optkit("fit", tmp_path / "own.csv", "--json")
    rows = json.loads(out)["parameters"]
    assert code == 0
    assert [row["parameter"] for row in rows] == ["size", "constant", "mu"]
    assert abs(rows[-1]["estimate"] - 2) < 4 * rows[-1]["standard_error"]


@pytest.mark.slow
def test_no_rejection_is_an_error_and_with_a_ridge_a_warning(optkit, tmp_path):
    """Without rejections: one line and status 2; with --ridge numbers, a verdict and a warning, in text and JSON."""
    users_table(generous=60.0).to_csv(tmp_path / "own.csv", index=False)
    code, out, err = optkit("fit", tmp_path / "own.csv")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("optkit: group 0: no situation chose the outside option")
    code, out, _ = optkit("fit", tmp_path / "own.csv", "--ridge", 0.001)
    assert code == 0
    assert "identification of group 0: not identified" in out
    assert "warning: group 0: " in out
    code, out, err = optkit("fit", tmp_path / "own.csv", "--ridge", 0.001, "--json")
    plain = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert plain["warnings"]
    assert plain["identification"][0]["verdict"] == "not identified"


BAD = {
    "no file": (["fit", "nowhere.csv"], "there is no file nowhere.csv"),
    "missing column": (["fit", "bad.csv"], "no column 'chosen'"),
    "text": (["fit", "text.csv"], "chosen in row 1 is 'maybe', neither 0 nor 1"),
    "damaged": (["fit", "broken.parquet"], "cannot read broken.parquet"),
    "method": (["fit", "good.csv", "--method", "probit"], "'probit' is unknown"),
    "ridge": (["fit", "good.csv", "--ridge", -1], "ridge = -1.0"),
    "feature": (["fit", "good.csv", "--features", "colour"], "no column 'colour'"),
    "json as out": (["fit", "good.csv", "--out", "fit.json"], "or the text file's name"),
    "no folder": (["fit", "good.csv", "--out", "no/fit.txt"], "cannot be written"),
    "scenario": (["collect", "IV", "--out", "o.parquet"], "'IV' is neither a scenario"),
    "range": (["collect", "I.1", "--out", "o.parquet", "--low", 0.9], "high = 0.85"),
    "no target": (["collect", "I.1", "--out", "no/o.parquet", "--set", "horizon=20"], "cannot be written"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_input_is_one_line_and_status_2(optkit, tmp_path, monkeypatch, case):
    """Every wrong argument or file: status 2, nothing on standard output, one line that says what is wrong."""
    monkeypatch.chdir(tmp_path)
    users_table(100).to_csv("good.csv", index=False)
    (tmp_path / "bad.csv").write_text("situation,compensation,x\n1,2,3\n")
    (tmp_path / "text.csv").write_text("situation,compensation,chosen,x\n1,2,maybe,3\n")
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 and nothing else")
    arguments, words = BAD[case]
    code, out, err = optkit(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("optkit: ")
    assert err.count("\n") == 1
    assert words in err


@pytest.mark.slow
def test_a_negative_offer_seed_is_one_line(optkit, tmp_path):
    """A seed below 0 is bad input like any other."""
    code, _, _ = optkit("collect", "I.1", "--out", tmp_path / "o.parquet", "--offer-seed", -1, "--set", "horizon=20")
    assert code == 2


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["fit", "collect"])
def test_help(optkit, verb):
    """Both verbs explain themselves."""
    code, out, _ = optkit(verb, "--help")
    assert code == 0
    assert "--json" in out


@pytest.mark.slow
def test_fit_clusters_by_a_column(optkit, log, tmp_path):
    """optkit fit --cluster COLUMN tells clustered standard errors, and refuses a column that is not there."""
    file = tmp_path / "log.csv"
    log.to_frame().assign(worker=[f"w{s % 40}" for s in log.situation]).to_csv(file, index=False)
    plain = json.loads(optkit("fit", file, "--features", ",".join(log.names), "--json", check=0).stdout)
    done = json.loads(optkit("fit", file, "--cluster", "worker", "--json", check=0).stdout)
    said = "Sandwich of 40 clusters, with the small-sample correction."
    assert [model["standard_errors"] for model in done["models"]] == [said]
    want = fit_preferences(Offers.load(file, cluster="worker")).table().to_dict(orient="records")
    assert [row["standard_error"] for row in done["parameters"]] == pytest.approx([r["standard_error"] for r in want])
    assert [r["estimate"] for r in done["parameters"]] == pytest.approx([r["estimate"] for r in plain["parameters"]])
    assert f"Standard errors: {said}" in optkit("fit", file, "--cluster", "worker", check=0).stdout
    code, _, err = optkit("fit", file, "--cluster", "boss")
    assert code == 2
    assert "has no column 'boss'" in err


@pytest.mark.slow
def test_out_writes_a_folder_with_preferences(optkit, file, tmp_path):
    """--out FOLDER: the summary, and preferences that Python reads as they were estimated; nothing else is replaced."""
    folder = tmp_path / "learned"
    code, out, _ = optkit("fit", file, "--out", folder)
    assert code == 0
    assert f"preferences: {folder / 'preferences.json'}" in out
    assert sorted(path.name for path in folder.iterdir()) == ["preferences.json", "summary.json", "summary.txt"]
    expected = fit_preferences(Offers.load(file))
    assert Preferences.load(folder / "preferences.json").to_dict() == expected.to_dict()
    assert optkit("fit", file, "--out", folder)[0] == 0
    (folder / "preferences.json").write_text("{}")
    code, _, err = optkit("fit", file, "--out", folder)
    assert code == 2
    assert "preferences.json in it," in err
    assert "exists and holds no preferences of optkit" in err
    code, _, err = optkit("fit", file, "--out", tmp_path / "no" / "where")
    assert (code, "its folder does not exist" in err) == (2, True)
