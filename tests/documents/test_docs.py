"""Everything that the README, the guide for contributors and the examples say is run."""

import doctest
import json
import re
import runpy
import sys
from pathlib import Path

import pytest

from optkit.cli import main
from optkit.evaluation.main_job import run_main_job
from optkit.instances.catalogue import scenario

ROOT = Path(__file__).parents[2]
# The notebooks of 1-derivation are run in test_notebooks.py.
SMALLER = {"own_gap.py": "8", "own_scenario.py": "3", "figures.py": "--small"}
"""Days or steps of the longest examples, in a fifth of the time."""

EXAMPLES = sorted(path for path in (ROOT / "examples").rglob("*.py") if "1-derivation" not in path.parts)


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_code_blocks_print_what_the_page_shows(page):
    """Every Python block of a page runs and prints what stands beneath it."""
    results = doctest.testfile(str(ROOT / page), module_relative=False, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert results.attempted > 5
    assert results.failed == 0


def parameter(example):
    long = example.name in {*SMALLER, "own_value.py"}
    return pytest.param(example, id=example.name, marks=[pytest.mark.slow] if long else [])


@pytest.mark.slow
@pytest.mark.parametrize("example", [parameter(path) for path in EXAMPLES])
def test_examples_run(example, capsys, monkeypatch):
    """Every example runs to its end and passes its own assertions, on smaller data where it takes a size."""
    size = [SMALLER[example.name]] if example.name in SMALLER else []
    monkeypatch.setattr(sys, "argv", [str(example), *size])
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out


@pytest.mark.slow
def test_readme_shows_the_table_that_the_main_job_gives():
    """The table in the README is the main job's own, to the digits shown."""
    result = run_main_job(scenario("I.1", seed=0).split(), {}, verify=0)
    block = re.search(r"<!-- table -->\n```text\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    width = block.group(1).splitlines()[0].index("ratio %") - 1
    shown = {line[1:width].strip(): line[width:] for line in block.group(1).splitlines()[2:]}
    assert list(shown) == result.comparison.table["policy"].tolist()
    for _, row in result.comparison.table.iterrows():
        for number in (row["ratio"], row["std"], row["low"], row["high"], 100 * row["served"]):
            assert re.search(
                rf"(?<![\d.]){number:.{1 if number == 100 * row['served'] else 2}f}(?!\d)", shown[row["policy"]]
            )


def test_readme_shows_the_prices_of_its_requests(tmp_path, monkeypatch, capsys):
    """The command prices the file that the README shows as the README says."""
    block = r"<!-- {} -->\n```text\n(.*?)```"
    requests, prices = (
        re.search(block.format(name), (ROOT / "README.md").read_text(), re.DOTALL).group(1)
        for name in ("requests", "prices")
    )
    (tmp_path / "requests.csv").write_text(requests)
    monkeypatch.setattr("sys.argv", ["optkit", "price", str(tmp_path / "requests.csv")])
    with pytest.raises(SystemExit):
        main()
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    shown = [line.rstrip() for line in prices.splitlines()]
    assert shown == printed[printed.index(shown[0]) :][: len(shown)]


def test_readme_links_lead_somewhere():
    """Relative links and pictures of the README and the guide exist."""
    for page in ("README.md", "CONTRIBUTING.md"):
        for target in re.findall(r"\]\(([^)#:]+)\)", (ROOT / page).read_text()):
            assert (ROOT / target).exists(), f"{page}: {target}"


def test_the_two_links_at_the_top_lead_into_the_package():
    """models and bounds at the top level are relative links to the package's folders."""
    for name in ("models", "bounds"):
        assert (ROOT / name).is_symlink()
        assert (ROOT / name).readlink() == Path("optkit") / name


def test_benchmark_results_name_their_machine():
    """Every kept benchmark result says on which machine it was measured."""
    for path in (ROOT / "benchmarks" / "results").glob("*.json"):
        assert json.loads(path.read_text())["machine"], path.name
