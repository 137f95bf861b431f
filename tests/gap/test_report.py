"""The gap report: policies against bounds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from optkit import Instance, scenario
from optkit.basics.errors import InputError, PolicyError, SolverError
from optkit.bounds import full_information
from optkit.bounds.penalised.charge_fit import fit_linear_charges
from optkit.bounds.penalised.foresight import Foresight, fifo_presence
from optkit.gap import charging
from optkit.gap.charging import scenario_charging, worker_charging
from optkit.gap.process_tests import process_tests
from optkit.gap.report import GapReport, gap_report
from optkit.learning.worker_rates import learn_worker_rates
from optkit.models.value import LinearValue
from optkit.policies import PostDecisionPricing, RewardPercentage
from optkit.simulation.metrics import mean_interval
from tests.gap import processes

STEPS = 20
NAMED = {"myopic": PostDecisionPricing(), "half": RewardPercentage(0.5)}


@pytest.fixture(scope="module")
def charges():
    """Value and foresight of a small world, trained in a moment."""
    made = scenario_charging(scenario("I.2", seed=3, horizon=STEPS), training=80, pool=40, estimator=LinearValue())
    return {"value": made.value, "foresight": made.foresight, "assumptions": made.assumptions}


@pytest.fixture(scope="module")
def days():
    """Instances that no charge was made from."""
    return scenario("I.2", seed=3, horizon=STEPS).sample(12, seed=9)


@pytest.fixture(scope="module")
def report(days, charges):
    """The report that most tests look at."""
    return gap_report(days, NAMED, **charges)


@pytest.fixture(scope="module")
def plain(days):
    """The same without charges, by arrival information alone."""
    return gap_report(days, NAMED, kinds=["arrival"])


def test_draws_that_would_not_fit_are_refused_before_the_first(days):
    """One line, at once; what every day needs is counted, and that of the largest matters."""
    with pytest.raises(InputError, match=r"1,000,000,000,000 draws of the noise .* more than there is: take fewer"):
        gap_report(days, NAMED, kinds=["full"], redraws=10**12)


@pytest.mark.slow
def test_bounds_and_policies_are_in_order(report):
    """Looser bounds lie above tighter ones, and all above all policies."""
    points = report.bounds.set_index("kind")["points"]
    assert points.index.tolist() == ["full", "lagrangian", "arrival", "penalised"]
    assert points.is_monotonic_decreasing
    assert points["penalised"] > report.policies["points"].max()
    assert (report.best_bound, report.best_policy) == ("penalised", "myopic")
    assert (report.gaps["points"] > 0).all()


@pytest.mark.slow
def test_no_path_is_below_zero(report):
    """With all requests told apart, no policy earns more than a bound of arrivals, on any path, up to rounding."""
    assert (report.policies["exact"] == len(report.rows)).all()
    smallest = report.gaps[report.gaps["bound"] != "full"]["smallest"]
    assert (smallest >= -1e-9).all()
    for name in NAMED:
        paid = report.rows[f"policy: {name}"] - report.rows[f"charge: {name}"]
        assert (report.rows["bound: penalised"] - paid >= -1e-9).all()


def test_certificates_are_checked(report):
    """Every bound reports the worst of its certificates, and it is rounding but for the multipliers' own tolerance."""
    worst = report.bounds.set_index("kind")["certificate_gap"]
    assert (worst[["full", "arrival", "penalised"]] < 1e-6).all()
    assert 0 <= worst["lagrangian"] < 1e-4
    assert (report.bounds["residual"] == 0).all()


def test_points_are_ratios_of_means(report, days):
    """By hand from the rows: full information is 100 points, and the gap a ratio of sums."""
    rows = report.rows
    full = np.array([full_information(day).value for day in days])
    assert rows["bound: full"].to_numpy() == pytest.approx(full, rel=1e-12)
    worth = full - rows["penalty"]
    short = rows["bound: penalised"] - rows["policy: half"] + rows["charge: half"]
    row = report.gap("half", "penalised")
    assert row["points"] == pytest.approx(100 * short.sum() / worth.sum(), rel=1e-12)
    assert row["money"] == pytest.approx(short.mean(), rel=1e-12)
    assert report.bounds["points"].iloc[0] == pytest.approx(100, rel=1e-12)
    assert report.bounds["half_width"].iloc[0] == pytest.approx(0, abs=1e-9)


def test_charges_take_the_luck_out(report):
    """Charges have mean zero within their error, and money is known far better without them."""
    for _, row in report.policies.iterrows():
        assert abs(row["charge"]) < 2 * row["charge_half_width"]  # about four standard errors
        raw = report.rows[f"policy: {row['policy']}"]
        assert row["money_half_width"] < 0.5 * 2.2 * raw.std() / np.sqrt(len(raw))


@pytest.mark.slow
def test_processes_change_nothing(days, charges, report):
    """Two processes give what one gives, to the last digit."""
    again = gap_report(days, NAMED, n_jobs=2, **charges)
    pd.testing.assert_frame_equal(again.rows, report.rows, check_exact=True)


@pytest.mark.slow
def test_an_interrupted_report_goes_on(days, plain, tmp_path):
    """Interrupted after five instances it goes on from there, and ends with the same rows."""

    class StopError(Exception):
        pass

    def stop(done, total):
        if done == 5:
            raise StopError

    told = {"kinds": ["arrival"], "checkpoint": tmp_path / "rows.jsonl"}
    with pytest.raises(StopError):
        gap_report(days, NAMED, progress=stop, **told)
    seen = []
    resumed = gap_report(days, NAMED, progress=lambda done, total: seen.append((done, total)), **told)
    assert seen == [(done, 12) for done in range(5, 13)]
    pd.testing.assert_frame_equal(resumed.rows, plain.rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policies", "change"),
    [
        ({**NAMED, "half": RewardPercentage(0.6)}, {}),
        (NAMED, {"limit": 3}),
        (NAMED, {"seed": 1}),
        (NAMED, {"kinds": ["lagrangian"]}),
        ({**NAMED, "half": lambda state: 0.5 * state.reward}, {}),
    ],
)
def test_a_checkpoint_belongs_to_one_report(days, tmp_path, policies, change):
    """Another policy of the same name, or another setting, takes no rows but its own, which it keeps beside."""
    told = {"kinds": ["arrival"], "checkpoint": tmp_path / "rows.jsonl"}
    gap_report(days[:2], NAMED, **told)
    before = (tmp_path / "rows.jsonl").read_bytes()
    other = gap_report(days[:2], policies, **{**told, **change})
    right = gap_report(days[:2], policies, **{**told, **change, "checkpoint": None})
    pd.testing.assert_frame_equal(other.rows, right.rows, check_exact=True)
    assert not any(line.startswith("rows:") for line in other.assumptions)
    again = gap_report(days[:2], policies, **{**told, **change})
    assert any(line.startswith("rows: 2 of 2 are of") for line in again.assumptions)
    assert (tmp_path / "rows.jsonl").read_bytes() == before
    assert len(list(tmp_path.glob("*.jsonl"))) == 2


def test_an_edited_policy_that_earns_the_same_is_not_taken_for_the_old_one(tmp_path):
    """On the noise as drawn both shares are refused by the workers; in the mean over the noise they differ."""
    shape = {"features": [[]], "pickup": [0], "dropoff": [0], "worker_step": [0], "worker_group": [0]}
    money = {"reward": [30.0], "penalty": [-5.0], "utility": [[-15.0]], "mu": [4.0], "noise": [[0.0]]}
    some = [
        Instance(horizon=1, arrival=[0], expiry=[0], outside_noise=[3.0 + i / 10], **shape, **money) for i in range(4)
    ]

    def money_of(share, checkpoint=None):
        report = gap_report(some, {"mine": lambda state: share * state.reward}, kinds="arrival", checkpoint=checkpoint)
        return float(report.policies["money"].iloc[0])

    file = tmp_path / "rows.jsonl"
    assert money_of(0.45, file) == money_of(0.45)
    assert money_of(0.50, file) == money_of(0.50) != money_of(0.45)


def test_ones_own_policy(days):
    """Any callable goes through, in other processes too, and must be feasible."""
    own = gap_report(days[:3], {"own": lambda state: 0.6 * state.reward}, kinds="arrival", n_jobs=2)
    known = gap_report(days[:3], {"own": RewardPercentage(0.6)}, kinds="arrival")
    pd.testing.assert_frame_equal(own.rows, known.rows)
    with pytest.raises(PolicyError):
        gap_report(days[:3], {"bad": lambda state: -state.reward}, kinds="arrival")


@pytest.mark.slow
def test_simulated_and_enumerated_agree(days, charges, report):
    """Where too much may wait a policy is simulated and others are charged for: the same means within 4 errors."""
    exact, drawn = report, gap_report(days, NAMED, kinds=["penalised"], limit=2, redraws=20, **charges)
    assert drawn.policies["exact"].max() < exact.policies["exact"].min()
    for name in NAMED:
        for part in ("policy", "charge"):
            # Charges of fewer requests differ on each path, but their mean is zero too.
            difference = drawn.rows[f"{part}: {name}"] - exact.rows[f"{part}: {name}"]
            assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(len(days))
    # What is not told apart makes the bound looser, never better than the whole lattice in the mean.
    looser = drawn.rows["bound: penalised"] - exact.rows["bound: penalised"]
    assert looser.mean() > -4 * looser.std() / np.sqrt(len(days))


def test_noise_is_not_needed(days):
    """Without noise it is drawn for full information only: all that rests on the arrivals is as it was."""
    bare = [replace(day, noise=None, outside_noise=None) for day in days[:3]]
    with_noise, without = (gap_report(some, NAMED, kinds="arrival") for some in (days[:3], bare))
    for column in ("bound: arrival", "policy: half"):
        assert with_noise.rows[column].tolist() == without.rows[column].tolist()
    assert any("noise: drawn here for 3 instances" in told for told in without.assumptions)


@pytest.mark.slow
def test_a_scenario_brings_what_it_needs(monkeypatch):
    """A scenario stands for its test instances, and charges for its own process, from as many others as are set."""
    monkeypatch.setattr(charging, "MOST", 200)
    monkeypatch.setattr(charging, "POOL", 240)
    small = scenario("I.2", seed=3, split=(20, 4, 0), horizon=12)
    found = gap_report(small, {"half": RewardPercentage(0.5)})
    assert len(found.rows) == 4
    assert found.rows["bound: full"].tolist() == [full_information(day).value for day in small.split().test]
    assert any("Poisson" in told and "240 other instances" in told for told in found.assumptions)
    assert any("trained on 200 other instances" in told for told in found.assumptions)
    assert found.best_bound == "penalised"


@pytest.mark.slow
def test_workers_who_come_otherwise_make_no_penalised_bound(days, charges, plain):
    """A worker rate that the instances contradict: one line, no bound by it, and the others stand."""
    wrong = {"value": charges["value"], "foresight": Foresight(fifo_presence(0.9), np.ones(1))}
    found = gap_report(days, NAMED, kinds=["arrival", "penalised"], **wrong)
    assert found.bounds["kind"].tolist() == ["full", "arrival"]
    assert len(found.refused) == 1
    assert "workers do not come as was assumed" in found.refused[0]
    assert f"penalised bound refused: {found.refused[0]}" in found.summary()
    assert found.to_dict()["refused"] == list(found.refused)
    pd.testing.assert_frame_equal(found.rows, plain.rows)


@pytest.mark.slow
def test_charges_that_are_paid_without_foresight_refuse_the_bound(days, charges):
    """Told that the process is known where it is not, the report finds out from what its policies are charged."""
    wrong = {"value": charges["value"], "foresight": Foresight(fifo_presence(0.05), np.ones(1))}
    found = gap_report(days, NAMED, kinds=["arrival", "penalised"], known_process=True, **wrong)
    assert "penalised" not in found.bounds["kind"].tolist()
    assert len(found.refused) == 1
    assert "money an instance" in found.refused[0]
    assert (found.policies["charge"] == 0).all()
    assert found.policies["money"].tolist() == found.policies["raw_money"].tolist()
    assert found.best_bound == "arrival"


@pytest.mark.slow
def test_requests_that_arrive_otherwise_make_no_penalised_bound(days, charges):
    """Days that only say that they are of a scenario: rewards doubled since, the pool's requests are not theirs."""
    changed = [replace(day, reward=2.0 * day.reward) for day in days]
    found = gap_report(changed, {"half": NAMED["half"]}, kinds=["arrival", "penalised"], **charges)
    assert found.best_bound == "arrival"
    assert len(found.refused) == 1
    assert "requests do not arrive as was assumed" in found.refused[0]


@pytest.mark.slow
def test_a_rush_that_was_learned_makes_a_claim(monkeypatch):
    """Rates by time of day from other days are not contradicted; a steady rate of the same mean is."""
    monkeypatch.setattr(processes, "STEPS", 24)
    others, measured = (processes.days(processes.rush, count, seed) for count, seed in ((40, 1), (10, 2)))
    made = worker_charging(others, learn_worker_rates(others), estimator=LinearValue())
    told = {"assumptions": made.assumptions, "learned": made.learned, "kinds": ["penalised"]}
    found = gap_report(measured, NAMED, value=made.value, foresight=made.foresight, **told)
    assert found.refused == ()
    assert found.bounds["kind"].iloc[-1] == "penalised"
    assert any("rates learned from 40 other days" in told for told in found.assumptions)
    steady = Foresight(fifo_presence(0.5), np.ones(1))
    assert gap_report(measured, NAMED, kinds=["penalised"], value=made.value, foresight=steady).refused


def test_raw_money_is_the_plain_mean_of_the_rows(report):
    """Beside money without luck, which no reader of the rows could make out, stands what he can."""
    for _, row in report.bounds.iterrows():
        assert row["raw_money"] == pytest.approx(report.rows[f"bound: {row['kind']}"].mean(), rel=1e-12)
    for _, row in report.policies.iterrows():
        raw = report.rows[f"policy: {row['policy']}"]
        assert row["raw_money"] == pytest.approx(raw.mean(), rel=1e-12)
        assert row["raw_half_width"] == pytest.approx(mean_interval(raw).high - raw.mean(), rel=1e-9)
    for _, row in report.gaps.iterrows():
        short = report.rows[f"bound: {row['bound']}"] - report.rows[f"policy: {row['policy']}"]
        assert row["raw_money"] == pytest.approx(short.mean(), rel=1e-9)
    assert "raw mean of the rows" in report.summary()
    assert "control variate" in report.to_dict()["notes"]["money"]


@pytest.mark.parametrize("offer", [1e308, 1e200])
@pytest.mark.parametrize("limit", [14, 0])
def test_offers_beyond_numbers_make_no_claim(days, offer, limit):
    """What a policy pays overflows, by enumeration or by simulation: one line, and no claim of nan."""
    with pytest.raises((PolicyError, InputError), match=r"offers 1e[+](308|200) for request|too large to be added up"):
        gap_report(days[:3], {"huge": lambda state: offer * np.ones(state.reward.shape)}, kinds="arrival", limit=limit)


def test_a_bound_that_fails_is_left_out(days, monkeypatch):
    """An instance whose bound cannot be proven is named; if all fail there is no report."""
    from optkit.gap import rows as gap_rows

    def fails(instance):
        if instance is days[1] or len(broken) == 1:
            raise SolverError("no luck")
        return full_information(instance)

    broken = []
    monkeypatch.setattr(gap_rows, "full_information", fails)
    found = gap_report(days[:3], NAMED, kinds="full")
    assert found.failures == {1: "no luck"}
    assert found.rows["instance"].tolist() == [0, 2]
    assert "instance 1 is left out: no luck" in found.summary()
    broken.append(True)
    with pytest.raises(SolverError, match="none of 3 instances"):
        gap_report(days[:3], NAMED, kinds="full")


@pytest.mark.slow
def test_empty_days_have_no_points_but_money(days):
    """Where nothing can be gained there is nothing to measure by; gaps in money are zero."""
    some = days[0]
    nobody = replace(
        some, worker_step=np.zeros(0, int), worker_group=np.zeros(0, int), noise=None, outside_noise=None
    ).with_noise(0)
    found = gap_report([nobody, nobody], NAMED)
    assert found.gaps["money"].to_numpy() == pytest.approx(0, abs=1e-9)
    assert found.gaps["points"].isna().all()
    assert found.plot().get_xlabel() == "Money an instance"
    assert "nan" not in found.claim() + found.summary()


def test_one_instance_allows_no_claim(days):
    """There is no interval: the report says so."""
    found = gap_report(days[:1], NAMED)
    assert "allows no claim" in found.claim()
    assert np.isnan(found.gap()["claim"])
    assert "nan" not in found.summary()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kinds": ["nonsense"]}, "no bound 'nonsense'"),
        ({"kinds": ["penalised"]}, "needs value and foresight"),
        ({"value": LinearValue()}, "both value and foresight"),
        ({"redraws": 0}, "redraws"),
        ({"confidence": 1.0}, "confidence"),
        ({"limit": -1}, "limit"),
        ({"seed": -1}, "seed"),
        ({"n_jobs": -1}, "n_jobs"),
    ],
)
def test_bad_arguments_are_refused(days, change, message):
    """Each in one line that names it."""
    with pytest.raises(InputError, match=message):
        gap_report(days[:2], NAMED, **change)


def test_something_is_needed(days):
    """No instances, no policies, or what is neither, make no report."""
    for given in (([], NAMED), (days[:1], {}), (["day"], NAMED), (days[:1], {"half": 0.5})):
        with pytest.raises(InputError):
            gap_report(*given)


def test_summary_and_plain_data(report):
    """The text states the claims and the assumptions; the plain data hold every table; unknown names are refused."""
    text = report.summary()
    assert report.claim() in text
    assert all(told in text for told in report.assumptions)
    plain = report.to_dict()
    assert plain["instances"] == 12
    assert [row["kind"] for row in plain["bounds"]] == report.bounds["kind"].tolist()
    assert plain["best"]["claim"] == report.claim()
    assert isinstance(report, GapReport)
    with pytest.raises(InputError, match="nobody"):
        report.gap("nobody")


def test_the_ladder_has_a_rung_for_each(report):
    """Policies below, bounds above, each at its mean, and the claim as the title."""
    ax = report.plot()
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        "half", "myopic", "penalised", "arrival", "lagrangian", "full",
    ]  # fmt: skip
    drawn = [float(line.get_xdata()[0]) for line in ax.lines if line.get_marker() in ("s", "o")]
    points = [*report.policies["points"].sort_values(), *report.bounds["points"].sort_values()]
    assert drawn == pytest.approx(points)
    assert ax.get_title().replace("\n", " ") == report.claim()


@pytest.mark.slow
def test_linear_charges_are_paid_by_nobody_and_lower_the_multipliers_bound():
    """As with charges by a value function: a policy's own take the luck out, and no path is below zero."""
    source = scenario("I.1", seed=0, split=(40, 20, 0), horizon=20)
    found = gap_report(source, NAMED, kinds=["lagrangian", "penalised-lagrangian"])
    rows, gaps = found.rows, found.gaps.set_index(["policy", "bound"])
    for name in NAMED:
        paid = rows[f"policy: {name}"] - rows[f"charge: {name}"]
        assert (paid <= rows["bound: penalised-lagrangian"] + 1e-9).all()
        assert abs(rows[f"charge: {name}"].mean()) < 4 * rows[f"charge: {name}"].std() / np.sqrt(len(rows))
        assert gaps.loc[(name, "penalised-lagrangian"), "money"] < gaps.loc[(name, "lagrangian"), "money"]
    assert found.best_bound == "penalised-lagrangian"
    assert any("linear charges" in told for told in found.assumptions)


@pytest.mark.slow
def test_linear_charges_are_simulated_where_too_many_wait():
    """Told apart or not, a policy is charged the same in the mean: by 4 standard errors of the draws."""
    source = scenario("I.1", seed=0, split=(10, 2, 0), horizon=15)
    asked = {"kinds": ["penalised-lagrangian"], "redraws": 2000}
    exact, drawn = (gap_report(source, {"half": RewardPercentage(0.5)}, limit=limit, **asked) for limit in (14, 0))
    assert exact.policies["exact"].item() == 2
    assert drawn.policies["exact"].item() == 0
    assert drawn.rows["charge: half"].to_numpy() == pytest.approx(exact.rows["charge: half"].to_numpy(), abs=1.0)


@pytest.mark.slow
def test_a_process_that_is_contradicted_has_no_linear_charges_either():
    others, days = processes.days(processes.rush, 12, 1), processes.days(processes.rush, 12, 2)
    charges = fit_linear_charges(others, Foresight(fifo_presence(0.5), np.ones(1)))
    found = gap_report(days, NAMED, charges=charges, kinds=["lagrangian", "penalised-lagrangian"])
    assert "workers do not come as was assumed" in found.refused[0]
    assert found.bounds["kind"].tolist() == ["full", "lagrangian"]
    with pytest.raises(InputError, match="needs charges"):
        gap_report(days, NAMED, kinds=["penalised-lagrangian"])


@pytest.mark.slow
def test_other_days_tell_what_few_bounded_ones_hide():
    """A rate that three days do not refute is refused by sixty others of which nothing was made."""
    bounded, others = processes.days(processes.slow, 3, 1), processes.days(processes.slow, 60, 2)
    foresight = Foresight(fifo_presence(0.5), np.ones(1))
    assert not process_tests(bounded, foresight)[0]
    assert "workers do not come" in process_tests(bounded, foresight, others=others)[0][0]
    made = worker_charging(others, 0.5, estimator=LinearValue())
    asked = {"value": made.value, "foresight": made.foresight, "kinds": ["penalised"]}
    assert gap_report(bounded, NAMED, others=others, **asked).refused
