"""Reports: complete, the same bytes for the same results, safe, and readable in a real browser."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser

import pandas as pd
import pytest

import optkit
from optkit.basics.errors import InputError, OptkitError
from optkit.plotting.files import figure_bytes, new_figure
from optkit.studies.report import report as module
from optkit.studies.report.figures import study_figures
from optkit.studies.report.report import check_report, report_files, write_report
from optkit.studies.report.texts import CAPTIONS, LATEX, latex, shown
from optkit.studies.runner import StudyRun
from optkit.studies.store import Stored
from optkit.studies.tables import study_tables

CLAIMS = [
    {
        "result": 1,
        "pattern": "A beats B.",
        "paper": "1 < 2",
        "here": "<b>3</b> & 4",
        "verdict": "contradicted",
        "why": "",
    }
]


class Page(HTMLParser):
    """What a page holds: its elements with their attributes, and its text."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.text = [], ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        """Keep an element."""
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data):
        """Keep text."""
        self.text += data

    def all(self, tag):
        """Return the attributes of all elements of a kind."""
        return [attrs for name, attrs in self.elements if name == tag]


@pytest.fixture
def small(monkeypatch):
    """Draw no figures, where figures are not what is tested."""
    monkeypatch.setattr(module, "study_figures", lambda tables, trips: {})


@pytest.fixture(scope="module")
def written(made_once, tmp_path_factory):
    """The largest report, of two worlds of New York: its run and its page.

    All but one figure are emptied once they are made: test_figures draws them.
    """
    study, run = made_once("nyc", (0, 1))

    def few(tables, trips):
        figures = study_figures(tables, trips=trips)
        for name, figure in figures.items():
            if name != "perf_nyt_weak":
                figure.clf()
                figure.set_layout_engine(None)  # nothing is left to lay out
        return figures

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "study_figures", few)
        return run, write_report(tmp_path_factory.mktemp("written") / "report", study, run, CLAIMS)


@pytest.mark.slow
def test_the_same_results_give_the_same_bytes(made_up, monkeypatch):
    """Whenever, and however long it took: all files but timings.csv are equal; another result changes them."""
    study, run = made_up("heterogeneous")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")  # Matplotlib's clock
    some = {"rows", "errors"}  # two kinds of figures, and not the third
    monkeypatch.setattr(
        module, "study_figures", lambda tables, trips: study_figures({name: tables[name] for name in some})
    )
    first = report_files(study, run, CLAIMS)
    today = pd.Timestamp.now()
    for form in ("%Y-%m-%d", "%d.%m.%Y", "%d %B %Y", "%B %d, %Y"):
        assert not [name for name in first if today.strftime(form).encode() in first[name]]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1500000000")
    slow = {key: Stored(kept.result, 77.0) for key, kept in reversed(run.found.items())}
    again = report_files(study, StudyRun(run.cells, slow), CLAIMS)
    assert {name for name in first if first[name] != again[name]} == {"timings.csv"}
    cell = next(cell for cell in run.cells if cell.kind == "policy")
    result = run.found[cell.key].result
    other = run.found | {cell.key: Stored(result | {"reward": [x - 1 for x in result["reward"]]}, 1.0)}
    monkeypatch.setattr(module, "study_figures", lambda tables, trips: study_figures({"rows": tables["rows"]}))
    changed = report_files(study, StudyRun(run.cells, other), CLAIMS)
    lost = {name for name in changed if first[name] != changed[name]}
    assert {"ratios.csv", "ratios.parquet", "ratios.tex", "report.json"} <= lost  # the page has the tables' numbers
    assert {"perf_syn_2.png", "perf_syn_2.pdf"} <= lost
    assert "bounds.csv" not in lost


@pytest.mark.slow
def test_every_table_and_figure_is_there(written):
    """Each in all its forms, named and linked in the page; tables as files have all rows and all digits."""
    run, path = written
    assert (path.parent.name, path.name) == ("report", "report.html")
    page, tables = Page(path.read_text()), study_tables(run)
    ids = {attrs.get("id") for _, attrs in page.elements}
    links = {attrs["href"] for attrs in page.all("a")}
    assert {"ratios", "worlds", "rows", "over", "pairs", "operations", "gap", "bounds", "trainings"} <= set(tables)
    for name, table in tables.items():
        assert f"table-{name}" in ids
        assert CAPTIONS[name].split(":")[0] in page.text
        csv = pd.read_csv(path.with_name(f"{name}.csv"))
        pd.testing.assert_frame_equal(csv, table, check_dtype=False, rtol=1e-15)
        pd.testing.assert_frame_equal(pd.read_parquet(path.with_name(f"{name}.parquet")), table, check_dtype=False)
        assert {f"{name}.csv", f"{name}.parquet"} <= links
    for name in ("ratios", "worlds", "gap", "estimation", "operations"):
        assert f"{name}.tex" in links
    images = {name.removeprefix("figure-") for name in ids if name and name.startswith("figure-")}
    assert images == {label for label, drawing in module.DRAWINGS.items() if drawing.study == "nyc"}
    for name in images:
        assert path.with_name(f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert path.with_name(f"{name}.pdf").read_bytes().startswith(b"%PDF")
    # Every link leads to a file of the folder or to a place of the page, and every file is linked but this one's own.
    written = {file.name for file in path.parent.iterdir()}
    assert {link for link in links if not link.startswith("#")} == written - {"report.html", "report.json"}
    assert {link[1:] for link in links if link.startswith("#")} <= ids
    assert len(pd.read_csv(path.with_name("timings.csv"))) == len(run.cells)


@pytest.mark.slow
def test_the_page_needs_nothing_else_and_is_accessible(written):
    """No script, no reference beyond the page, a language, a title, headers with a scope, pictures with a text."""
    html = written[1].read_text()
    page = Page(html)
    assert page.all("html") == [{"lang": "en"}]
    assert "Study nyc" in html.split("<title>")[1].split("</title>")[0]
    assert not page.all("script")
    assert all(attrs["src"].startswith("data:image/svg+xml;base64,") for attrs in page.all("img"))
    assert all(len(attrs["alt"]) > 80 for attrs in page.all("img"))
    assert all(attrs["scope"] in ("col", "row") for attrs in page.all("th"))
    assert [attrs["href"] for attrs in page.all("link")] == ["data:,"]
    assert not re.search(r"url\(|@import|https?:", html)
    named = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(named) == len(set(named))


@pytest.mark.slow
def test_numbers_of_the_page_are_those_of_the_tables(made_up, small):
    """Ratios have two decimals, intervals stand in one column, long tables are begun and say how long they are."""
    study, run = made_up("homogeneous")
    html = report_files(study, run)["report.html"].decode()
    tables = study_tables(run)
    for row in tables["ratios"].to_dict(orient="records"):
        assert f'<td class="n">{row["ratio"]:.2f}</td>' in html
        assert f"[{row['low']:.2f}, {row['high']:.2f}]" in html
    length = len(tables["rows"])
    assert length > 200
    assert f"The first 20 of {length} rows" in html
    assert html.count("<tr>") == sum(
        1 + (20 if name == "rows" else len(table)) for name, table in tables.items()
    )  # the heading of each, and its rows
    assert "4.0e-07" in html


@pytest.mark.slow
def test_text_of_others_is_escaped(made_up, small):
    """Neither a failed cell's error nor a claim can put elements into the page, or columns into a LaTeX table."""
    study, run = made_up("heterogeneous", leave=lambda cell: cell.kind == "gap")
    lost = run.missing[0]
    run.failed[lost.key] = "<script>alert('&')</script>"
    html = report_files(study, run, CLAIMS)["report.html"].decode()
    page = Page(html)
    assert not page.all("script")
    assert f"{lost}: <script>alert('&')</script>" in page.text
    assert "<b>3</b> & 4" in page.text
    frame = pd.DataFrame({"scenario": [r"100 % of A_1 & \B{}^~#$"], "group": [1], "rmse": [-0.001]})
    assert r"100 \% of A\_1 \& \textbackslash{}B\{\}\textasciicircum{}\textasciitilde{}\#\$ & 1 & 0.00 \\" in latex(
        "estimation", frame
    )


@pytest.mark.slow
def test_what_is_missing_is_said(made_up, monkeypatch):
    """Failed cells with their reason, cells that were not worked out, figures that could not be drawn, extras."""
    study, run = made_up("heterogeneous", leave=lambda cell: cell.kind in ("utilities", "gap"))
    cell = next(cell for cell in run.missing if cell.kind == "gap")
    run.failed[cell.key] = "no luck today"
    files = report_files(study, run)
    page = Page(files["report.html"].decode())
    assert f"{len(run.cells) - 2} of {len(run.cells)} cells are finished" in page.text
    assert "II, world 0: gap: no luck today" in page.text
    assert "Cells that were not worked out: 1." in page.text
    assert "for want of their tables: utility_scen_2, mnl_momnl." in page.text
    told = json.loads(files["report.json"])
    assert told["failed"] == {str(cell): "no luck today"}
    assert told["missing"] == ["II, world 0: utilities"]
    assert "gap.csv" not in files
    monkeypatch.setattr("optkit.studies.grids.find_spec", lambda _: None)
    study, run = without_results(study)
    html = report_files(study, run)["report.html"].decode()
    assert "optkit[attention]" in html
    assert "0 of " in html


def without_results(study):
    return study, StudyRun(study.cells(), {})


@pytest.mark.slow
def test_a_whole_study_says_nothing_of_missing(made_up, small, monkeypatch):
    monkeypatch.setattr("optkit.studies.grids.find_spec", lambda _: object())
    monkeypatch.setattr(module, "DRAWINGS", {})
    html = report_files(*made_up("homogeneous"))["report.html"].decode()
    assert "What is left out" not in html
    assert "The paper&#39;s results" not in html


@pytest.mark.slow
def test_settings_versions_and_checksums_are_told(made_up, small):
    """Settings and versions in the page and in report.json, with a checksum of each file; no path of this machine."""
    study, run = made_up("nyc", (3,))
    study = replace(study, settings={"split": (8, 4, 4)})
    files = report_files(study, run)
    told = json.loads(files["report.json"])
    assert told["settings"]["worlds"] == [3]
    assert told["settings"]["digest of the trips"] == run.cells[0].place["trips"]
    assert told["versions"]["optkit"] == optkit.__version__
    assert told["sha256"] == {
        name: sha256(data).hexdigest() for name, data in files.items() if name not in ("report.json", "timings.csv")
    }
    page = Page(files["report.html"].decode())
    assert "split = 8, 4, 4" in page.text
    assert told["versions"]["numpy"] in page.text
    assert study.trips[0] not in page.text + json.dumps(told)


@pytest.mark.slow
def test_only_a_report_of_the_same_study_is_replaced(made_up, small, tmp_path):
    """What is not ours stays as it is."""
    study, run = made_up("homogeneous")
    folder = tmp_path / "report"
    assert not check_report(folder, study.name)
    write_report(folder, study, run, CLAIMS)
    write_report(folder, study, StudyRun(run.cells, {}))
    assert check_report(folder)
    assert not (folder / "claims.csv").exists()
    with pytest.raises(InputError, match="holds the report of the study homogeneous"):
        write_report(folder, *without_results(made_up("sensitivity")[0]))
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"thesis\.tex"):
        write_report(folder, study, run)
    assert (folder / "thesis.tex").read_text() == "years of work"
    with pytest.raises(InputError, match="is a file"):
        check_report(folder / "thesis.tex")
    (folder / "report.json").write_text("[1]")
    with pytest.raises(InputError, match="no part of a study's report"):
        check_report(folder)


@pytest.mark.slow
def test_a_full_disk_leaves_the_old_report(made_up, small, tmp_path, monkeypatch):
    """A clear error, and what was there is there still."""
    study, run = made_up("homogeneous")
    path = write_report(tmp_path / "report", study, run)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(OptkitError, match=r"cannot be written \(No space left on device\)"):
        write_report(tmp_path / "report", study, StudyRun(run.cells, {}))
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before
    assert [file.name for file in tmp_path.iterdir() if "report" in file.name] == ["report"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LATEX))
def test_latex_tables_have_a_cell_for_every_column(made_up, name):
    """As many cells as columns in each line, booktabs' rules, caption, label; a world only where there are several."""
    for worlds in ((0,), (0, 1)):
        table = study_tables(made_up("nyc", worlds)[1])[name]
        text = latex(name, table)
        columns = re.search(r"\\begin\{tabular\}\{([lr]+)\}", text).group(1)
        lines = [line for line in text.splitlines() if line.endswith(r"\\")]
        assert len(lines) == 1 + len(table)
        assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in lines} == {len(columns)}
        assert [text.count(rule) for rule in (r"\toprule", r"\midrule", r"\bottomrule", r"\caption", r"\label")] == [
            1
        ] * 5
        assert ("World &" in lines[0]) == (len(worlds) > 1 and name != "worlds")
        assert "–" not in text


@pytest.mark.slow
def test_latex_compiles(made_up, tmp_path):
    """All tables of a study, in a document that knows nothing but booktabs."""
    program = shutil.which("pdflatex")
    if program is None:
        pytest.skip("pdflatex is missing: install a TeX distribution, for example apt-get install texlive-latex-base")
    tables = study_tables(made_up("nyc", (0, 1))[1])
    body = "\n".join(latex(name, tables[name]) for name in LATEX)
    (tmp_path / "all.tex").write_text(
        "\\documentclass{article}\\usepackage{booktabs}\\begin{document}" + body + "\\end{document}"
    )
    done = subprocess.run([program, "-interaction=nonstopmode", "-halt-on-error", "all.tex"], cwd=tmp_path, check=False)
    assert done.returncode == 0


def test_numbers_are_written_for_people():
    """No minus zero, no digits that nobody measured, a dash for nothing, words as they are."""
    frame = pd.DataFrame(
        {"policy": ["FP", None], "world": [0, 12], "chosen": [True, False], "mbe": [-0.001, float("nan")],
         "worst_gap": [3.4e-8, 0.0], "gain_low": [1.0, float("nan")], "gain_high": [2.0, 3.0], "own": [0.5, -1.25]}
    )  # fmt: skip
    told = shown("any", frame)
    assert told.headings[-2:] == ["95 % interval", "Own"]
    assert told.rows == [
        ["FP", "0", "yes", "0.00", "3.4e-08", "[1.00, 2.00]", "0.50"],
        ["–", "12", "no", "–", "0.0e+00", "–", "-1.25"],
    ]


@pytest.mark.slow
def test_every_column_has_a_heading(made_up):
    """No table of any study shows a name of the code where people read a heading with its unit."""
    for name in ("homogeneous", "heterogeneous", "sensitivity", "nyc"):
        for table, frame in study_tables(made_up(name)[1]).items():
            assert table in CAPTIONS
            told = shown(table, frame)
            assert len({len(row) for row in told.rows}) == 1
            assert not [heading for heading in told.headings if "_" in heading]


@pytest.mark.slow
def test_a_figure_is_the_same_bytes_at_any_time(monkeypatch):
    """As PNG, PDF and SVG, also in another decade by Matplotlib's clock, and when another was drawn in between."""

    def drawn(value, moment=0):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", str(moment))
        figure = new_figure(3, 2)
        figure.subplots().plot([0, value], clip_on=True)
        return {kind: figure_bytes(figure, kind, name="one") for kind in ("png", "pdf", "svg")}

    first, other, again = drawn(1.0), drawn(2.0), drawn(1.0, moment=1_500_000_000)
    assert first == again
    assert all(first[name] != other[name] for name in first)


@pytest.mark.slow
def test_the_page_opens_in_a_browser(page, written):
    """Wide and narrow, light and dark: no complaint, no scrolling to the side but inside boxes, pictures drawn."""
    page.goto(written[1].as_uri())
    assert page.title() == "Study nyc – optkit"
    for width, scheme in ((1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") == width
        drawn = "[...document.images].map(i => i.complete && i.naturalWidth > 0 && i.getBoundingClientRect().width)"
        sizes = page.evaluate(drawn)
        assert len(sizes) == 7
        assert min(sizes) >= 600  # a picture scrolls in its card before it gets too small to be read
        colours = page.evaluate("(s => [s.color, s.backgroundColor])(getComputedStyle(document.body))")
        text, ground = (sum(map(int, re.findall(r"\d+", colour)[:3])) for colour in colours)
        assert (text - ground if scheme == "dark" else ground - text) > 500
        assert page.locator(".card").first.evaluate("e => getComputedStyle(e).backgroundColor") == "rgb(255, 255, 255)"
        wide = page.locator("#table-ratios .box")
        assert wide.evaluate("e => e.scrollWidth > e.clientWidth") == (width == 390)
        assert wide.evaluate("e => e.getBoundingClientRect().right <= innerWidth")
    first = page.locator("#table-rows tbody tr").first
    assert not first.is_visible()
    page.locator("#table-rows summary").click()
    assert first.is_visible()
