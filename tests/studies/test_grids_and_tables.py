"""Which cells a study has, and what its tables make of them, recomputed by hand."""

from functools import partial

import numpy as np
import pandas as pd
import pytest

from optkit import performance_ratio
from optkit.basics.errors import DataError, InputError
from optkit.simulation.metrics import mean_interval
from optkit.studies import grids
from optkit.studies.cells import Cell
from optkit.studies.claims.new_york import _fair, _Operations, _paid
from optkit.studies.claims.verdicts import claims
from optkit.studies.grids import Study, digest_of
from optkit.studies.runner import StudyRun, expected_seconds
from optkit.studies.store import Stored
from optkit.studies.tables import study_tables

PLACES = [{"scenario": "I.1", "world": world, "set": {}} for world in (0, 1)]
LEAST = np.array([-10.0, -20.0, -5.0])
FULL = np.array([100.0, 50.0, -5.0])
"""The third instance cannot be improved on: a ratio there is 100 or minus infinity."""


def study_run(pairs):
    cells = [cell for cell, _ in pairs]
    return StudyRun(cells, {cell.key: Stored(result, 1.0) for cell, result in pairs if result is not None})


def bounds(place, add=0.0):
    sizes = {"requests": [4, 5, 1], "workers": [3, 0, 2]}
    values = {"full": (FULL + add).tolist(), "arrival": (FULL + add).tolist(), "lagrangian": (FULL + add).tolist()}
    worst = {"full": 1e-12, "arrival": 2e-9, "lagrangian": 3e-7}
    return Cell("bounds", place, {}), {**values, **sizes, "penalty": LEAST.tolist(), "certificate_gap": worst}


def policy(place, name, seed, reward, score, **more):
    result = {"reward": list(reward), "score": score, "served": [2, 0, 1], "paid": [5.0, 0.0, 1.0], **more}
    return Cell("policy", place, {"policy": name, "seed": seed}), result


@pytest.mark.parametrize("settings", [{"horizon": -3}, {"split": (20, 4)}, {"mu": float("nan")}, {"guess": 1}])
def test_settings_are_checked_before_there_are_cells(settings):
    """One line instead of a failure in every cell."""
    with pytest.raises(InputError, match="setting"):
        Study("sensitivity", settings=settings)


def test_a_setting_has_one_key_however_it_is_written():
    """The command line reads 12 as 12.0."""
    keys = [[cell.key for cell in Study("sensitivity", settings={"horizon": h}).cells()] for h in (12, 12.0)]
    assert keys[0] == keys[1]


@pytest.mark.parametrize(
    ("name", "places", "policies"),
    [("homogeneous", 3, 9), ("heterogeneous", 1, 12), ("nyc", 2, 9), ("sensitivity", 2, 0)],
)
def test_grids_have_all_their_cells(name, places, policies, tmp_path, monkeypatch):
    """Five seeds for what is random, one for what is not, in each of two worlds."""
    monkeypatch.setattr(grids, "find_spec", lambda _: object())
    (tmp_path / "a_tripdata.csv").write_text("x")
    cells = Study(name, worlds=(0, 3), trips=(str(tmp_path),) if name == "nyc" else ()).cells()
    assert len({cell.key for cell in cells}) == len(cells)
    kinds = [cell.kind for cell in cells]
    assert kinds.count("bounds") == 2 * places
    assert {cell.place["world"] for cell in cells} == {0, 3}
    names = [cell.settings["policy"] for cell in cells if cell.kind == "policy"]
    assert len(set(names)) == policies
    for one in set(names):
        assert names.count(one) == 2 * places * (1 if one in ("PP", "FP", "Myopic, true MNL") else 5)
    # 10 draws of 3 epsilons and none: I.1 once, II for everybody and for each of three groups.
    assert kinds.count("perturbed") == (2 * (31 + 121) if name == "sensitivity" else 0)
    assert kinds.count("gap") == (0 if name == "sensitivity" else 2 * places)
    assert all(expected_seconds(cell) > 0 for cell in cells)


def test_the_network_is_left_out_where_it_cannot_be_made(monkeypatch):
    monkeypatch.setattr(grids, "find_spec", lambda _: None)
    assert not any("Attention" in str(cell) for cell in Study("homogeneous").cells())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "guess"}, "no study 'guess'"),
        ({"worlds": ()}, "worlds"),
        ({"worlds": (-1,)}, "worlds"),
        ({"seeds": 0}, "seeds = 0"),
        ({"seeds": True}, "seeds = True"),
        ({"draws": 0}, "draws = 0"),
        ({"draws": 1.5}, "draws = 1.5"),
        ({"name": "nyc"}, "needs trip records"),
        ({"mode": "mondays"}, "the study homogeneous has none"),
        ({"fraction": 0.3}, "the study homogeneous has none"),
        ({"name": "nyc", "trips": ("x.csv",), "mode": "sundays"}, "no mode 'sundays'"),
        ({"name": "nyc", "trips": ("x.csv",), "mode": ["mondays"]}, "no mode"),
        ({"name": "nyc", "trips": ("x.csv",), "fraction": 2.0}, "fraction = 2"),
        ({"name": "nyc", "trips": ("x.csv",), "fraction": "0.3"}, "fraction = '0.3'"),
        ({"name": "nyc", "trips": ("x.csv",), "fraction": True}, "fraction = True"),
    ],
)
def test_what_makes_no_study_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        Study(**{"name": "homogeneous", **change})


def test_the_selection_of_trips_makes_other_cells(tmp_path):
    """The usual one is not told, so that cells of studies that did not ask for it are found again."""
    (tmp_path / "a.csv").write_text("x")
    make = partial(Study, "nyc", trips=(str(tmp_path / "a.csv"),), gap=False)
    usual, said, other, fewer = (
        {cell.key for cell in make(**more).cells()}
        for more in ({}, {"mode": "folded"}, {"mode": "mondays"}, {"mode": "mondays", "fraction": 0.01})
    )
    assert usual == said
    assert not usual & other
    assert not other & fewer
    assert "mode" not in make().cells()[0].place
    assert make(fraction=1).cells()[0].key == make(fraction=1.0).cells()[0].key


def test_trips_are_known_by_what_is_in_them(tmp_path):
    """Names and places do not matter, contents do."""
    for name, text in (("a.csv", "one"), ("b.csv", "two"), ("c.csv", "one")):
        (tmp_path / name).write_text(text)
    a, b, c = (digest_of([str(tmp_path / name)]) for name in ("a.csv", "b.csv", "c.csv"))
    assert a == c != b
    assert digest_of([str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]) not in (a, b)
    with pytest.raises(DataError, match="no file"):
        digest_of([str(tmp_path / "none.csv")])


def test_validation_chooses_the_seed_and_instances_without_hope_are_left_out():
    """Means, intervals and gains by hand; seed 1 scores best on validation, though seed 0 earned more."""
    ours = [(0, [90.0, 45.0, -5.0], 1.0), (1, [80.0, 40.0, -5.0], 2.0), (2, [70.0, 45.0, -6.0], 2.0)]
    rules = {"PP": [60.0, 40.0, -7.0], "FP": [50.0, 30.0, -5.0]}
    pairs = [bounds(PLACES[0]), *(policy(PLACES[0], "Linear, true MNL", *one) for one in ours)]
    pairs += [policy(PLACES[0], name, 0, reward, None) for name, reward in rules.items()]
    tables = study_tables(study_run(pairs))
    row = tables["ratios"].set_index("policy").loc["Linear, true MNL"]
    ratio = performance_ratio([80.0, 40.0], FULL[:2], LEAST[:2])
    assert (row["seed"], row["instances"]) == (1, 2)
    assert row["ratio"] == pytest.approx(ratio.mean())
    gain = mean_interval(ratio, performance_ratio([60.0, 40.0], FULL[:2], LEAST[:2]))
    assert (row["rule"], row["gain"], row["gain_low"]) == ("PP", pytest.approx(gain.mean), pytest.approx(gain.low))
    assert row["served"] == pytest.approx(100 * 2 / 9)
    assert tables["trainings"]["chosen"].tolist() == [False, True, False, True, True]
    assert len(tables["rows"]) == 9
    points = tables["bounds"].set_index("bound")
    assert points.loc["arrival", "points"] == pytest.approx(100.0)
    assert points.loc["lagrangian", "worst_gap"] == 3e-7


def test_over_worlds():
    """The mean of the worlds' means, with Student's interval over worlds."""
    pairs = []
    for place, add in zip(PLACES, (0.0, 10.0), strict=True):
        pairs += [bounds(place, add), policy(place, "PP", 0, [60.0, 30.0, -5.0], None)]
    tables = study_tables(study_run(pairs))
    means, row = tables["ratios"]["ratio"].to_numpy(), tables["worlds"].iloc[0]
    over = mean_interval(means)
    assert (row["worlds"], row["ratio"], row["low"]) == (2, pytest.approx(over.mean), pytest.approx(over.low))
    assert (row["least"], row["most"]) == (means.min(), means.max())


def test_what_is_missing_is_missing_only_where_it_belongs():
    """A study without bounds has no ratios; one without anything no tables."""
    pairs = [(bounds(PLACES[0])[0], None), policy(PLACES[0], "PP", 0, [60.0, 30.0, -5.0], None)]
    assert study_tables(study_run(pairs)) == {}
    assert study_tables(study_run([])) == {}
    for name in grids.STUDIES:
        assert claims(name, {}) == []


def test_how_places_are_served():
    """Two pairs of places with rates 1 and 1/2, one that nobody asked for; used workers and payments in the mean."""
    detail = {"over": [1.0, 2.0, 6.0], "asked": [[2, 2], [0, 0]], "taken": [[2, 1], [0, 0]]}
    kinds = {"type": [0, 0], "pickup": [0, 0], "dropoff": [0, 1], "count": [3, 1], "utility": [[-1.0, -4.0]]}
    pairs = [bounds(PLACES[0]), policy(PLACES[0], "PP", 0, [60.0, 30.0, -5.0], None, **detail)]
    pairs.append((Cell("utilities", PLACES[0], {}), kinds))
    tables = study_tables(study_run(pairs))
    row = tables["operations"].iloc[0]
    assert row["over"] == pytest.approx(3.0)
    assert row["utilised"] == pytest.approx(100 * (2 / 3 + 0 + 1 / 2) / 3)
    assert row["acceptance_cv"] == pytest.approx(100 * 0.25 / 0.75)
    shown = tables["pairs"].set_index(["pickup", "dropoff"])
    assert shown.loc[(1, 2), "served"] == pytest.approx(50.0)
    assert shown.loc[(1, 2), "utility"] == pytest.approx(-4.0)
    assert np.isnan(shown.loc[(2, 1), "served"])


def sensitivity(ratios):
    """Tables of a sensitivity study with given ratios and errors by epsilon, group and draw."""
    place = {"scenario": "II", "world": 0, "set": {}}
    pairs = [bounds(place, add=15.0)]
    best = FULL + 15.0
    for (epsilon, group, draw), (ratio, mbe) in ratios.items():
        settings = {"epsilon": epsilon, "draw": draw, "value": "linear", "seed": 0}
        settings |= {} if group is None else {"groups": [group]}
        result = {"reward": (LEAST + (best - LEAST) * ratio / 100).tolist(), "mbe": mbe}
        pairs.append((Cell("perturbed", place, settings), result))
    return study_tables(study_run(pairs))


@pytest.mark.parametrize(
    ("sign", "extra", "verdict"), [(1.0, 6.0, "reproduced"), (-1.0, 6.0, "contradicted"), (1.0, 0.1, "not settled")]
)
def test_claims_of_sensitivity_follow_the_numbers(sign, extra, verdict):
    """One group's errors cost a little, all groups' more; one sign of the error more than the other."""
    ratios = {(0.0, None, 0): (90.0, [0.0] * 3)}
    for epsilon, loss in ((2.0, 2.0), (4.0, 3.0)):
        for draw in range(4):
            mbe = sign * (3.0 if draw % 2 else -3.0)
            more = 0.0 if draw % 2 else extra
            for group in range(3):
                one = [mbe if g == group else 0.0 for g in range(3)]
                ratios[(epsilon, group, draw)] = (90.0 - loss - more - 0.1 * draw, one)
            ratios[(epsilon, None, draw)] = (88.0 - 3 * epsilon - draw - more, [mbe] * 3)
    tables = sensitivity(ratios)
    assert tables["sensitivity"].set_index(["group", "epsilon", "draw"]).loc[("1", 2.0, 1), "ratio"] == pytest.approx(
        87.9
    )
    found = claims("sensitivity", tables)
    assert [one["result"] for one in found] == [4, 4, 4, 4]
    assert [one["verdict"] for one in found] == ["reproduced", "reproduced", "not settled", verdict]


def homogeneous(step, leave=()):
    """Tables of a study in which ratios fall by a step from I.2 to I.1 to I.3; some policies are left out of I.3."""
    pairs = []
    top = min(0.0, 2 * step)  # nobody earns more than full information
    for number, name in zip((-top, step - top, 2 * step - top), ("I.2", "I.1", "I.3"), strict=True):
        place = {"scenario": name, "world": 0, "set": {}}
        pairs.append(bounds(place))
        told = {
            "Linear, true MNL": 94.0,
            "Linear, re-estimated": 94.0,
            "PP": 80.0,
            "FP": 81.0,
            "Kernel, true MNL": 90.0,
        }
        for who in leave if name == "I.3" else ():
            del told[who]
        for who, ratio in told.items():
            shift = np.array([0.0, 1.0, 0.0])
            reward = LEAST + (FULL - LEAST) * (ratio - number + shift) / 100 - [0.0, 0.0, 1.0]
            pairs.append(policy(place, who, 0, reward, 1.0))
        reward = LEAST + (FULL - LEAST) * (93.9 - number + np.array([0.0, 1.1, 0.0])) / 100
        pairs.append(policy(place, "Linear, paper's data", 0, reward, 1.0))
    return study_tables(study_run(pairs))


@pytest.mark.slow
@pytest.mark.parametrize(("step", "verdict"), [(20.0, "reproduced"), (0.5, "not settled"), (-20.0, "contradicted")])
def test_an_order_of_scenarios_is_reproduced_only_where_the_draws_settle_it(step, verdict):
    last = claims("homogeneous", homogeneous(step))[-1]
    assert last["pattern"].startswith("With the true preferences")
    assert last["verdict"] == verdict
    assert last["here"].count("[") == 2


@pytest.mark.slow
def test_a_cell_that_failed_elsewhere_takes_no_scenario_from_the_claims():
    """Without the kernel on I.3, which no claim asks for, I.3 is still compared; without its rules it is not."""
    assert claims("homogeneous", homogeneous(1.0, ["Kernel, true MNL"])) == claims("homogeneous", homogeneous(1.0))
    told = [one["here"] for one in claims("homogeneous", homogeneous(1.0, ["PP"]))]
    assert "I.3" not in told[0]
    assert "I.3" in told[1]


def test_a_lead_whose_sign_the_instances_leave_open_is_not_settled():
    pairs = [bounds(PLACES[0])]
    for who, ratios in (("PP", [80.0, 80.0, 80.0]), ("FP", [70.0] * 3), ("Linear, paper's data", [99.0, 70.0, 80.0])):
        pairs.append(policy(PLACES[0], who, 0, LEAST + (FULL - LEAST) * np.array(ratios) / 100, 1.0))
    assert claims("homogeneous", study_tables(study_run(pairs)))[0]["verdict"] == "not settled"


def test_claims_of_the_homogeneous_study_follow_the_numbers():
    """The learned policy beats the rules everywhere, and loses nothing to the true preferences."""
    found = claims("homogeneous", homogeneous(1.0))
    assert [one["verdict"] for one in found] == ["reproduced", "contradicted", "not settled"]
    assert "I.1: 93.4 % against 80.5 % (FP)" in found[0]["here"]
    assert found[0]["why"]
    assert found[1]["why"]


@pytest.mark.parametrize(
    ("fp", "verdicts"),
    [([9.0, 9.2, 9.1], ["reproduced"]), ([1.0, 9.0, 2.1], ["not settled"]), ([1.0, 1.1, 0.9], ["contradicted"])],
)
def test_what_is_paid_is_compared_world_by_world(fp, verdicts):
    """PP pays 7 more in each of three worlds; FP more, now more and now less, or less."""
    rows = []
    for scenario in ("nyc-weak", "nyc-strong"):
        for world in range(3):
            paid = {"Linear, true MNL": 2.0, "Linear, paper's data": 2.0 + 0.1 * world, "PP": 9.0, "FP": fp[world]}
            for policy_name, over in paid.items():
                uneven = 5.0 if scenario == "nyc-weak" else 20.0 + world
                row = {"scenario": scenario, "world": world, "policy": policy_name, "over": over, "utilised": 50.0}
                rows.append({**row, "acceptance_cv": uneven + (policy_name != "Linear, true MNL")})
    seen = _Operations(pd.DataFrame(rows))
    paid_claim = _paid(seen, ("nyc-weak", "nyc-strong"))
    assert [paid_claim["verdict"]] == verdicts
    assert "learned pays less by +6.90 [+6.65, +7.15] than PP" in paid_claim["here"]
    strong_less_even, alike = _fair(seen, ("nyc-weak", "nyc-strong"))
    assert (strong_less_even["verdict"], alike["verdict"]) == ("reproduced", "not settled")
