"""Prices of this morning's open requests, by a policy that was trained on other days."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from optkit import scenario, simulate
from optkit.basics.errors import InputError
from optkit.instances.account import LeftOutWarning
from optkit.instances.clock import Clock
from optkit.learning.trained import Trained
from optkit.learning.training import train


def days_of(name, count):
    return [
        replace(
            day, clock=Clock("2026-03-02T11:00:00", 15.0), feature_names=[f"x{f}" for f in range(day.features.shape[1])]
        )
        for day in scenario(name, seed=0, horizon=12).sample(count, seed=1)
    ]


@pytest.fixture(scope="module", params=["true", "learned"])
def trained(request):
    """Of three groups, with the true preferences or learned ones."""
    return train([replace(day, group_names=["a", "b", "c"]) for day in days_of("II", 60)], choice=request.param, seed=0)


def moments(trained, count=2):
    """What a simulation of the policy asks it, with the table of what is open at each moment."""
    seen = []
    days = [replace(day, group_names=["a", "b", "c"]) for day in days_of("II", count)]
    simulate(days, trained.policy, observe=lambda state, offer, taken: seen.append((state, offer)))
    for state, offer in seen:
        for b in range(len(state.row)):
            shown = state.offered[b]
            table = pd.DataFrame(state.features[b][shown], columns=[f"x{f}" for f in range(state.features.shape[2])])
            table = table.assign(
                reward=state.reward[b][shown], penalty=state.penalty[b][shown], pickup=state.pickup[b][shown],
                dropoff=state.dropoff[b][shown], expiry=state.steps_left[b][shown] + state.step,
                **{f"utility_{name}": state.batch.utility[d][state.request[b][shown]] for d, name in enumerate("abc")},
                request_id=[f"r{i}" for i in range(shown.sum())],
            )  # fmt: skip
            if trained.preferences is not None:
                table = table.drop(columns=[f"utility_{name}" for name in "abc"])
            yield state.step, int(state.group[b]), table, offer[b][shown], float(state.mu[b]), int(state.busy[b])


@pytest.mark.slow
def test_prices_are_those_of_the_simulation(trained, tmp_path):
    """From a table, with and without its file, by step and by time, by the group's name and number."""
    loaded, asked = Trained.load(trained.save(tmp_path / "policy.json")), 0
    for step, group, table, offer, mu, busy in moments(trained):
        more = {"busy": busy} | ({"mu": mu} if trained.preferences is None else {})
        found = trained.price(table, step=step, group=group, **more)
        assert found["compensation"].to_numpy() == pytest.approx(offer, rel=1e-12, abs=1e-12)
        assert found["request"].tolist() == table["request_id"].tolist()
        named = loaded.price(table, time=f"11:{step * 15 // 60:02d}:{step * 15 % 60:02d}", group="abc"[group], **more)
        pd.testing.assert_frame_equal(named, found)
        asked += 1
    assert asked > 10


@pytest.mark.slow
def test_what_cannot_be_priced_is_said(trained):
    """Each in one line."""
    step, _, table, *_ = next(iter(moments(trained, 1)))
    more = {"step": step, "group": "a"}
    for change, options, message in (
        (table.drop(columns="x1"), more, "no column 'x1'"),
        (table.drop(columns="reward"), more, "no column 'reward'"),
        (table.assign(expiry=step - 1), more, "leave out what has expired"),
        (table.iloc[:0], more, "no requests to price"),
        (pd.concat([table, table]), more, f"in row {len(table)} = .* is the same as request_id in row 0"),
        (table, {"step": step}, "of which group the worker is: a, b, c"),
        (table, {"step": step, "group": "d"}, "no group is called 'd'"),
        (table, {"group": "a"}, "at which step .* or at which time"),
        (table, {"step": 99, "group": "a"}, r"none of the 12 steps .* 0\.\.11"),
        (table, {"time": "noon", "group": "a"}, "'noon' is no time"),
        (table.assign(expiry="2026-03-02T11:02:00+01:00"), more, "both have a time zone, or neither"),
    ):
        with pytest.raises(InputError, match=message):
            trained.price(change, **options)
    if trained.preferences is None:
        with pytest.raises(InputError, match="need a column 'utility'"):
            trained.price(table.drop(columns="utility_b"), **more)
    else:
        with pytest.raises(InputError, match="mu is the policy's own"):
            trained.price(table, **more, mu=1.0)
    times = pd.Timestamp("2026-05-11T11:00:00") + pd.to_timedelta((table["expiry"] + 0.5) * 15, unit="s")
    again = trained.price(table.assign(expiry=times), **more)
    pd.testing.assert_frame_equal(again, trained.price(table, **more))
    assert np.isfinite(again["compensation"]).all()


@pytest.mark.slow
def test_a_file_without_its_horizon(trained, tmp_path):
    """The value function knows how many steps there are; what disagrees with it, or is no number, is refused."""
    step, _, table, *_ = next(iter(moments(trained, 1)))
    plain = trained.to_dict()
    bare = Trained.from_dict(plain | {"source": {k: v for k, v in plain["source"].items() if k != "horizon"}})
    pd.testing.assert_frame_equal(bare.price(table, step=step, group="a"), trained.price(table, step=step, group="a"))
    for horizon in (11, 13, "q", None, [1], 12.5, True):
        with pytest.raises(InputError, match="horizon"):
            Trained.from_dict(plain | {"source": plain["source"] | {"horizon": horizon}})
    for change in (
        {"clock": "x"},
        {"clock": {"start": "noon", "step": 1.0}},
        {"clock": {"start": "2026-05-01T08:00:00", "step": 1.0, "zone": "Europe/Berlin"}},
        {"clock": {"start": "2026-05-01T08:00:00"}},
        {"group_names": ["a", "a", "b"]},
        {"groups": "x"},
        {"groups": 10**9},
    ):
        with pytest.raises(InputError):
            Trained.from_dict(plain | {"source": plain["source"] | change})
    with pytest.raises(InputError, match="how many steps"):
        replace(trained, source={"group_names": ["a", "b", "c"]}).price(table, step=step, group="a")


@pytest.mark.slow
def test_what_plays_no_part_is_told(trained):
    """Columns, deadlines beyond the day, and groups whose names are numbers."""
    step, group, table, *_ = next(iter(moments(trained, 1)))
    more = {"step": step, "group": "abc"[group]}
    with pytest.warns(LeftOutWarning, match="columns that play no part: foo"):
        trained.price(table.assign(foo=1), **more)
    with pytest.warns(LeftOutWarning, match="1 of .* requests are open when the day ends"):
        late = trained.price(table.assign(expiry=[12, *table["expiry"][1:]]), **more)
    same = trained.price(table.assign(expiry=[11, *table["expiry"][1:]]), **more)
    pd.testing.assert_frame_equal(late, same)
    if trained.preferences is None:
        with pytest.raises(InputError, match="'utility' and 'utility_a': leave one out"):
            trained.price(table.assign(utility=-1.0), **more)
    numbered = replace(trained, source=trained.source | {"group_names": ["1", "2", "3"]})
    with pytest.raises(InputError, match="no group is called 0; there are 1, 2, 3"):
        numbered.price(table, step=step, group=0)
