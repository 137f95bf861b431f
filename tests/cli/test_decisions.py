"""optkit price with a column decision: thousands at once, each as if it were alone."""

import numpy as np
import pandas as pd
import pytest

from optkit.models.pricing import optimal_prices
from tests.command_line import optkit, strict


@pytest.fixture
def table(tmp_path):
    """Rows of 300 decisions of one to five requests, shuffled; some are not on offer, some cannot be served."""
    rng = np.random.default_rng(0)
    size = rng.integers(1, 6, 300)
    n = int(size.sum())
    frame = pd.DataFrame({
        "decision": np.repeat([f"{d:03d}" for d in range(300)], size), "request": [f"r{i}" for i in range(n)],
        "value": rng.uniform(5, 40, n).round(3), "utility": rng.uniform(-30, 0, n).round(3),
        "offered": (rng.random(n) < 0.8).astype(int),
    })  # fmt: skip
    frame["utility"] = frame["utility"].where(rng.random(n) < 0.9, -np.inf)
    frame.sample(frac=1, random_state=1).to_csv(tmp_path / "many.csv", index=False)
    return tmp_path / "many.csv"


def test_each_decision_is_priced_as_if_it_were_alone(table, tmp_path):
    """Prices, profits and proofs, against one call a decision; the file holds what is printed, row by row."""
    out = tmp_path / "prices.csv"
    told = strict(optkit("price", table, "--mu", 2, "--json", "--out", out, check=0).stdout)
    frame = pd.read_csv(table, dtype={"decision": str})
    assert [one["decision"] for one in told["decisions"]] == frame["decision"].drop_duplicates().tolist()
    for one in told["decisions"]:
        own = frame[frame["decision"] == one["decision"]]
        alone = optimal_prices(own["value"].tolist(), own["utility"].tolist(), 2.0, offered=own["offered"] == 1)
        assert [row["compensation"] for row in one["requests"]] == pytest.approx(alone.compensation, abs=1e-9)
        assert one["profit"] == pytest.approx(float(alone.profit), abs=1e-9)
        assert one["optimal"]
        assert one["bound"] >= one["profit"]
    written = pd.read_csv(out, dtype={"decision": str})
    assert written["request"].tolist() == frame["request"].tolist()
    flat = {row["request"]: row["compensation"] for one in told["decisions"] for row in one["requests"]}
    assert written["compensation"].tolist() == pytest.approx([flat[name] for name in written["request"]])
    text = optkit("price", table, "--mu", 2, "--out", out, check=0).stdout
    assert f"{len(frame):,} requests of 300 decisions, each priced apart" in text
    assert "300 of 300 decisions proven optimal" in text
    assert "mu 2 as given" in text


def test_what_goes_with_one_decision_only(table, tmp_path):
    """A solver and a proposal; and a foreign file is not replaced."""
    assert "--solver goes with one decision" in optkit("price", table, "--solver", "CLARABEL", check=2).stderr
    (tmp_path / "mine.csv").write_text("thesis\n1\n")
    done = optkit("price", table, "--out", tmp_path / "mine.csv", check=2)
    assert "holds no rows of optkit" in done.stderr
    assert "is what is read" in optkit("price", table, "--out", table, check=2).stderr


def test_a_mu_in_another_unit_is_suspected(tmp_path):
    """Where nobody ever rejects; and one decision may be written too."""
    (tmp_path / "one.csv").write_text("request,value,utility\na,30000,-10000\nb,53000,-22000\n")
    done = optkit("price", tmp_path / "one.csv", "--out", tmp_path / "p.parquet", check=0)
    assert "is mu = 1 in the unit of the money?" in done.stderr
    assert pd.read_parquet(tmp_path / "p.parquet")["request"].tolist() == ["a", "b"]
    assert "unit" not in optkit("price", tmp_path / "one.csv", "--mu", 1000, check=0).stderr
