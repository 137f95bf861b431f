"""Preferences that optkit fit learned from a log, wherever a verb asks what workers like."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from optkit import PostDecisionPricing, gap_report, optimal_prices, scenario, simulate, train
from optkit.evaluation.main_job import GIVEN
from optkit.instances.splits import read_split
from optkit.instances.storage import save_instances
from optkit.learning.trained import Trained
from optkit.models.preferences.preferences import Preferences
from tests.command_line import optkit, strict


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Days, a log of offers on them, and what was fitted to it."""
    place = tmp_path_factory.mktemp("preferences")
    save_instances(place / "days", scenario("I.1", seed=0, horizon=20).sample(30, seed=1))
    optkit("collect", place / "days", "--out", place / "log.parquet", "--low", 0.2, "--high", 0.6, check=0)
    optkit("fit", place / "log.parquet", "--ridge", 1e-3, "--out", place / "fit", check=0)
    optkit(
        "train", place / "days", "--preferences", place / "fit" / "preferences.json", "-q", "--out", place / "p.json"
    )
    return place


def believed(place):
    return Preferences.load(place / "fit" / "preferences.json")


@pytest.mark.slow
def test_a_policy_is_trained_by_them(place):
    """It has them, and is the one that Python trains by them."""
    found, learned = Trained.load(place / "p.json"), believed(place)
    np.testing.assert_array_equal(found.preferences.weights, learned.weights)
    assert found.source["choice"] == "given"
    split, _ = read_split(place / "days")
    same = train(split, "linear", choice=learned)
    np.testing.assert_array_equal(simulate(split.test, found.policy).reward, simulate(split.test, same.policy).reward)


@pytest.mark.slow
def test_policies_are_compared_by_them(place):
    """In evaluate another's policy believes them; in certify those of names do; in run there are two more rows."""
    told = ["--preferences", place / "fit" / "preferences.json", "--json", "--quiet"]
    split, _ = read_split(place / "days")
    myopic = simulate(split.test, PostDecisionPricing(choice=believed(place))).reward.mean()
    optkit("train", place / "days", "--choice", "true", "--out", place / "true.json", "--quiet", check=0)
    rows = strict(optkit("evaluate", place / "true.json", place / "days", *told, check=0).stdout)["policies"]
    assert rows[0]["reward"] == pytest.approx(myopic, rel=1e-12)
    policy = Trained.load(place / "true.json").believing(believed(place)).policy
    assert rows[1]["reward"] == pytest.approx(simulate(split.test, policy).reward.mean(), rel=1e-12)
    found = strict(optkit("certify", place / "days", "--policy", "myopic", "--kinds", "full", *told, check=0).stdout)
    report = gap_report(split.test, {"myopic": PostDecisionPricing(choice=believed(place))}, kinds="full")
    assert found["policies"][0]["money"] == pytest.approx(report.policies["money"][0], rel=1e-12)
    run = strict(optkit("run", place / "days", "--verify", 0, "--out", place / "results", *told, check=0).stdout)
    means = {row["policy"]: row["reward"] for row in run["policies"]}
    assert means[GIVEN] == pytest.approx(myopic, rel=1e-12)
    assert means["Linear, given MNL"] == pytest.approx(
        simulate(split.test, Trained.load(place / "p.json").policy).reward.mean(), rel=1e-12
    )


@pytest.mark.slow
def test_requests_are_priced_by_them(place):
    """By their features and places, with or without a policy; one line says what does not go together."""
    learned = believed(place)
    day = read_split(place / "days")[0].test[0]
    columns = {"request_id": [f"r{i}" for i in range(4)], "reward": day.reward[:4], "penalty": day.penalty[:4]}
    table = pd.DataFrame(columns)
    places = {"pickup": day.pickup[:4], "dropoff": day.dropoff[:4]}
    features = {name: day.features[:4, k] for k, name in enumerate(learned.attributes.names)}
    table = table.assign(**places, **features)
    table.drop(columns="request_id").to_csv(place / "open.csv", index=False)
    words = ["--preferences", place / "fit" / "preferences.json"]
    utility = learned.utility_of(day.features[:4], day.pickup[:4], day.dropoff[:4], np.zeros(4, np.int64))
    told = strict(optkit("price", place / "open.csv", *words, "--json", check=0).stdout)
    best = optimal_prices(day.reward[:4], utility, learned.scale[0])
    np.testing.assert_allclose([row["compensation"] for row in told["requests"]], best.compensation, rtol=1e-12)
    assert (told["mu"], told["mu_is"]) == (learned.scale[0], "of the preferences")
    assert "without --preferences" in optkit("price", place / "open.csv", *words, "--mu", 2, check=2).stderr
    assert "no group is called 'bike'" in optkit("price", place / "open.csv", *words, "--group", "bike", check=2).stderr
    table.drop(columns="dropoff").to_csv(place / "bare.csv", index=False)
    assert "'dropoff'" in optkit("price", place / "bare.csv", *words, check=2).stderr
    table.assign(utility=1.0).to_csv(place / "both.csv", index=False)
    assert "leave one out" in optkit("price", place / "both.csv", *words, check=2).stderr
    table.assign(expiry=9).to_csv(place / "waiting.csv", index=False)
    words = [*words, "--policy", place / "true.json", "--step", 3]
    done = strict(optkit("price", place / "waiting.csv", *words, "--json", check=0).stdout)
    policy = replace(Trained.load(place / "true.json")).believing(learned)
    found = policy.price(table.assign(expiry=9), step=3)
    np.testing.assert_allclose([row["compensation"] for row in done["requests"]], found["compensation"], rtol=1e-12)
    assert (
        "--choice true goes without"
        in optkit("train", place / "days", "--choice", "true", *words[:2], "--out", place / "q.json", check=2).stderr
    )
