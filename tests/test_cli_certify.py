"""``optkit certify``."""

import json

import pytest
from typer.testing import CliRunner

from optkit.cli import app

SMALL = ["I.2", "--set", "split=40,4,10", "--set", "horizon=20", "--quiet"]


def run(*arguments):
    """Run the command in this process."""
    return CliRunner().invoke(app, ["certify", *map(str, arguments)])


def test_certify_a_scenario(tmp_path):
    """Bounds, policies, gaps and assumptions as JSON; rows and a figure beside."""
    rows, figure = tmp_path / "rows.csv", tmp_path / "ladder.png"
    done = run(*SMALL, "--json", "--out", rows, "--plot", figure)
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert [row["kind"] for row in told["bounds"]] == ["full", "lagrangian", "arrival", "penalised"]
    assert {row["policy"] for row in told["policies"]} == {"myopic", "linear"}
    assert all(row["money"] > 0 for row in told["gaps"] if row["bound"] == "penalised")
    assert len(rows.read_text().splitlines()) == 5
    assert figure.stat().st_size > 5000


def test_certify_without_charges():
    """Fewer bounds, one policy, as text."""
    done = run(*SMALL, "--kinds", "arrival", "--policy", "myopic", "--instances", 3)
    assert done.exit_code == 0, done.output
    assert "myopic is at most" in done.stdout
    assert "penalised" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--policy", "nonsense"], "--policy nonsense"),
        (["--policy", "missing.json"], "missing.json cannot be read"),
        (["--worker-rate", "0.5"], "--worker-rate goes with a folder"),
        (["--out", "rows.txt"], "must be a file that ends in"),
        (["--kinds", "nonsense"], "no bound 'nonsense'"),
    ],
)
def test_bad_input_is_one_line(arguments, message):
    """What is wrong, before any work."""
    done = run(*SMALL, *arguments)
    assert done.exit_code != 0
    assert message in (str(done.exception) + done.output)
