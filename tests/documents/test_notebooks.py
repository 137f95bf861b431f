"""The derivation's notebooks three ways: as scripts, as apps in a browser with a slider moved, and as exported HTML."""

import os
import re
import runpy
import shutil
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch
from urllib.request import urlopen

import matplotlib.font_manager  # lists the fonts; the first notebook's process would say that it does
import numpy as np
import pytest
from matplotlib.figure import Figure

from optkit.bounds import SmallModel, exact_value
from optkit.models.choice import acceptance_probabilities
from optkit.models.pricing import optimal_prices

marimo = pytest.importorskip("marimo", reason="marimo is missing: pip install 'optkit[examples]'")
pytest.importorskip("sympy", reason="SymPy is missing: pip install 'optkit[examples]'")

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "optkit" / "teach").glob("[0-9]_*.py"))
every_notebook = pytest.mark.parametrize("notebook", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])

WATCH = """
import os, sys
def watch(event, arguments):
    host = None
    if event == "socket.connect" and isinstance(arguments[1], tuple):
        host = arguments[1][0]
    elif event == "socket.getaddrinfo":
        host = arguments[0]
    if host is not None and str(host) not in ("127.0.0.1", "::1", "localhost", "0.0.0.0", ""):
        with open(os.environ["OPTKIT_TEST_REACHED"], "a") as log:
            print(event, host, file=log)
sys.addaudithook(watch)
"""
"""Python loads it at its start: writes down which hosts beyond this machine a process asks for."""


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    """Environment of processes: a home of their own, no settings of the user's, and a log of what they reach for."""
    home = tmp_path_factory.mktemp("home")
    (home / "sitecustomize.py").write_text(WATCH)
    reached = home / "reached.txt"
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("MARIMO_", "XDG_"))}
    path = os.pathsep.join([str(home), str(ROOT)])
    env = {**kept, "HOME": str(home), "PYTHONPATH": path, "OPTKIT_TEST_REACHED": str(reached), "NO_COLOR": "1"}
    env["MPLCONFIGDIR"] = matplotlib.get_cachedir()  # where the fonts are known: a home of its own would list them anew
    run("-c", "import socket; socket.getaddrinfo('name.invalid', 80)", cwd=home, env=env)
    assert reached.read_text() == "socket.getaddrinfo name.invalid\n"  # the watch is awake
    reached.write_text("")
    yield env
    assert reached.read_text() == ""


def run(*arguments, cwd, env):
    return subprocess.run(
        [sys.executable, *map(str, arguments)], cwd=cwd, env=env, capture_output=True, text=True, check=False
    )


def test_there_are_five_and_the_examples_lead_to_them():
    """The five notebooks are package data; examples/1-derivation is a relative link to them."""
    assert [path.stem for path in NOTEBOOKS] == [
        "1_choice",
        "2_concavity",
        "3_markup",
        "4_nonnegative",
        "5_post_decision",
    ]
    assert (ROOT / "examples" / "1-derivation").readlink() == Path("../optkit/teach")


# --- As scripts -------------------------------------------------------------------------------------------------


@pytest.fixture
def here_only(monkeypatch):
    """Connections of this process go nowhere."""

    def refuse(*arguments):
        raise AssertionError(f"reaches for {arguments}")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


def app_of(notebook):
    return runpy.run_path(str(notebook))["app"]


def turned_round(notebook, folder):
    """Write a copy of which one assertion is turned round."""
    text = notebook.read_text()
    claims = re.findall(r"^    assert np\.isclose\(.*\)$|^    assert abs\(.*$", text, re.MULTILINE)
    false = claims[0].replace("assert ", "assert not (", 1) + ")"
    (folder / notebook.name).write_text(text.replace(claims[0], false))
    return folder / notebook.name


@pytest.mark.slow
def test_a_script_ends_as_its_claims_say(here_only, capfd, look, tmp_path):
    """Run as a script, a notebook is silent; with an assertion turned round it leaves with an error."""
    notebook = NOTEBOOKS[2]  # the quickest; all end in the same lines
    false = turned_round(notebook, tmp_path)
    runpy.run_path(str(notebook), run_name="__main__")
    assert look.seen > 0
    assert capfd.readouterr() == ("", "")
    with pytest.raises(AssertionError):
        runpy.run_path(str(false), run_name="__main__")
    for path in NOTEBOOKS:
        assert path.read_text().endswith('\n\nif __name__ == "__main__":\n    app.run()\n')


@pytest.fixture
def look(monkeypatch):
    """What is done with each figure in place of a file of it, which takes longer than all else: nothing at first.

    Notebooks import it when they are loaded, so that it is in place before and asks anew.
    """
    looks = SimpleNamespace(at=lambda figure: None, seen=0)

    def figure_bytes(axes, kind):
        looks.seen += 1
        looks.at(axes.get_figure(root=True))
        return b""

    monkeypatch.setattr("optkit.plotting.files.figure_bytes", figure_bytes)
    return looks


@pytest.mark.slow
@every_notebook
def test_a_claim_that_does_not_hold_ends_the_run(notebook, tmp_path, look):
    """A notebook of which one assertion is turned round fails."""
    with pytest.raises(AssertionError):
        app_of(turned_round(notebook, tmp_path)).run()


@pytest.mark.slow
@every_notebook
def test_claims_hold_wherever_the_sliders_stand(notebook, here_only, capfd, look):
    """Its assertions hold, in silence, as it stands, with all sliders at an end, and at places drawn at random."""
    app = app_of(notebook)
    _, names = app.run()
    sliders = {name: thing for name, thing in names.items() if isinstance(thing, marimo.ui.slider)}
    assert len(sliders) >= 3
    rng = np.random.default_rng(0)
    places = [{name: getattr(s, end) for name, s in sliders.items()} for end in ("start", "stop")]
    for _ in range(2):
        steps = {name: rng.integers(0, round((s.stop - s.start) / s.step) + 1) for name, s in sliders.items()}
        places.append({name: round(s.start + steps[name] * s.step, 9) for name, s in sliders.items()})
    for number, place in enumerate(places):
        # Figures can be laid out and drawn at the ends. Where the apps begin, and after a move, they become files.
        look.at = Figure.draw_without_rendering if number < 2 else lambda figure: None
        app.run(defs={name: SimpleNamespace(value=value) for name, value in place.items()})
    assert look.seen == 5 * len(re.findall(r"picture\(\s*_ax", notebook.read_text()))
    assert capfd.readouterr() == ("", "")


# --- As apps ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def address(surroundings, tmp_path_factory):
    """Address of the notebooks as optkit teach serves them; on Ctrl-C it ends cleanly, and leaves nothing behind."""
    command = [sys.executable, "-c", "from optkit.cli import main; main()", "teach", "--no-browser"]
    before = sorted((ROOT / "optkit" / "teach").iterdir())
    folder = tmp_path_factory.mktemp("served")
    server = subprocess.Popen(
        command, cwd=folder, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        lines = [server.stdout.readline().strip() for _ in range(6)]
        assert lines[:5] == [path.stem for path in NOTEBOOKS]
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?access_token=[\w-]{43}", lines[5])
        yield lines[5]
        server.send_signal(signal.SIGINT)
        assert "ended" in server.communicate(timeout=20)[0]
        assert server.returncode == 0
    finally:
        server.kill()
    with pytest.raises(OSError, match="refused"):
        urlopen(lines[5])
    assert sorted((ROOT / "optkit" / "teach").iterdir()) == before


def choice(steps):
    """Notebook 1: the probability of rejection, against the compensation of request 1."""
    pay = 7 + 0.5 * steps
    return {"rejection": acceptance_probabilities([pay, 8.0, 4.0], [-6.0, -7.5, -5.0], 1.5)[1]}


def concavity(steps):
    """Notebook 2: the profit of prices at a part of the way from 0 to the optimum, against that part."""
    value, utility, part = np.array([16.0, 14.0]), [-8.0, -7.0], 0.5 + 0.05 * steps
    prices = part * optimal_prices(value, utility, 1.2, nonnegative=False).compensation
    return {"by-price": acceptance_probabilities(prices, utility, 1.2)[0] @ (value - prices)}


def markup(steps):
    """Notebook 3: markup and profit, against the noise scale."""
    best = optimal_prices([18.0, 20.0, 15.0], [-8.0, -11.0, -6.0], 2 + 0.1 * steps, nonnegative=False)
    return {"markup": best.markup, "profit": best.profit, "profit-cvxpy": best.profit}


def nonnegative(steps):
    """Notebook 4: profits of exact and clipped prices, against the value of the request that workers like."""
    profit = {
        how: optimal_prices([8.0, 8.0, -4 + 0.5 * steps], [1.0, -4.0, 6.0], nonnegative=how).profit
        for how in (True, "clip")
    }
    return {"exact": profit[True], "clipped": profit["clip"], "lost": profit[True] - profit["clip"]}


def post_decision(steps):
    """Notebook 5: the value of the small model, against the number of steps."""
    model = SmallModel(
        horizon=5 + steps, reward=[30.0, 50.0], penalty=[-15.0, -15.0], lifetime=[1, 2], utility=[[-10.0, -28.0]],
        mu=[4.0], arrivals=[0.6, 0.4], workers=[0.2, 0.8],
    )  # fmt: skip
    value = exact_value(model).value
    return {"by-hand": value, "exact": value}


MOVES = [
    ("1_choice", "Compensation of request 1", 1, choice),
    ("2_concavity", "How far along the way", -1, concavity),
    ("3_markup", "Noise scale", 1, markup),
    ("4_nonnegative", "Value of request 3", 1, nonnegative),
    ("5_post_decision", "Steps", -1, post_decision),
]
"""A slider of each notebook, how far to move it, and what is shown where it stands."""


@pytest.mark.slow
def test_apps_show_what_optkit_computes_and_fit_a_phone_and_the_dark(address, page):
    """The gallery leads to each of the five, which is opened once.

    The numbers shown are optkit's, before and after a slider is moved with the keyboard; nothing is fetched. Then the
    desk becomes a phone in the dark: at 390 px nothing is wider than the page, every slider is on it, and figures are
    labelled.
    """
    from playwright.sync_api import expect

    expect.set_options(timeout=30_000)
    page.goto(address)
    expect(page.locator("a[href*='file=']")).to_have_count(5)
    for notebook, slider, step, expected in MOVES:
        with page.context.expect_page() as opened:
            page.locator(f"a[href*='{notebook}']").click()
        app = opened.value
        start, end = expected(0), expected(step)
        digits = 6 if notebook == "5_post_decision" else 4
        for name, value in start.items():
            expect(app.locator(f"output[data-number='{name}']"), notebook).to_have_text(f"{value:.{digits}f}")
        app.get_by_role("slider", name=slider).focus()
        app.keyboard.press("ArrowRight" if step > 0 else "ArrowLeft")
        for name, value in end.items():
            assert abs(value - start[name]) > 1e-3, notebook
            expect(app.locator(f"output[data-number='{name}']"), notebook).to_have_text(f"{value:.{digits}f}")
        fits_a_phone_and_the_dark(app, (ROOT / "optkit" / "teach" / f"{notebook}.py").read_text())
        app.close()


def fits_a_phone_and_the_dark(page, text):
    """Turn a page that is open on a desk into a small and dark one, and look at it."""
    from playwright.sync_api import expect

    def background():
        return page.evaluate(
            "(() => {const c = document.createElement('canvas').getContext('2d');"
            "c.fillStyle = getComputedStyle(document.body).backgroundColor; c.fillRect(0, 0, 1, 1);"
            "return [...c.getImageData(0, 0, 1, 1).data].slice(0, 3)})()"
        )

    assert min(background()) > 191
    page.set_viewport_size({"width": 390, "height": 844})
    page.emulate_media(color_scheme="dark")
    expect(page.locator("img[alt]:not([alt=''])")).to_have_count(len(re.findall(r"picture\(\s*_ax", text)))
    expect(page.locator(".output-area").last.locator(".markdown, img").first).to_be_visible()
    page.locator(".katex").first.wait_for()
    sliders = page.get_by_role("slider")
    expect(sliders).to_have_count(len(re.findall(r"mo\.ui\.slider\(", text)))
    page.evaluate("document.fonts.ready")
    wide = page.evaluate(
        "[...document.querySelectorAll('html, body, #App, #App *')]"
        ".filter(e => e.scrollWidth > e.clientWidth + 1 && ['auto', 'scroll'].includes(getComputedStyle(e).overflowX))"
        ".map(e => `${e.tagName} ${e.textContent.slice(0, 60)}`)"
    )
    assert wide == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    for slider in sliders.all():
        slider.scroll_into_view_if_needed()
        box = slider.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
    assert max(background()) < 64


# --- As HTML ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_export_runs_and_needs_the_net_to_be_looked_at(surroundings, tmp_path):
    """The export runs every cell and holds its output, but a browser would fetch its looks: so optkit teach serves."""
    from marimo._cli.cli import main

    # One of them: that every cell of the others runs too is seen as script and as app.
    notebook = NOTEBOOKS[0]
    copy = Path(shutil.copy(notebook, tmp_path))  # the export leaves a cache beside it
    page = copy.with_suffix(".html")
    # Its cells run in a process that marimo starts. In a thread: this one's event loop may be a browser's.
    with patch.dict(os.environ, surroundings, clear=True), ThreadPoolExecutor(1) as pool:
        export = ["--yes", "export", "html", str(copy), "-o", str(page)]
        assert not pool.submit(main, export, standalone_mode=False).result()
    text = page.read_text()
    assert text.count("data-number") >= len(re.findall(r"<output", notebook.read_text()))
    assert "AssertionError" not in text.replace(notebook.read_text(), "")
    assert "marimo-error" not in text
    assert re.search(r"<script[^>]* src=.https://cdn\.jsdelivr\.net/", text)
