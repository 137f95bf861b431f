"""Every block of code on the documentation's pages runs, in order, and prints what stands beneath it.

On a page, ``python`` blocks with prompts run as one session, ``console`` blocks run their ``$`` lines in a shell, and a
block with a caption is written to a file of that name. All of a page's blocks share one empty folder.
"""

import contextlib
import doctest
import io
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import pytest

from tests.command_line import optkit

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
RESULTS = ROOT / "benchmarks" / "results"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
FENCE = re.compile(r"^```(?P<kind>\{[a-z-]+\}|[a-z]+)?[ ]?(?P<argument>[^\n]*)\n(?P<body>.*?)^```$", re.M | re.S)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w])")
LOOSE = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
SHOWN_ONLY = {None, "text", "{math}", "{toctree}", "{note}", "{figure}"}


class Block(NamedTuple):
    """A fenced block: what it is, its caption, its text, and its line."""

    kind: str | None
    caption: str | None
    body: str
    line: int


def blocks(text):
    """Return the fenced blocks of a page."""
    found = []
    for match in FENCE.finditer(text):
        kind, body, caption = match["kind"], match["body"], None
        if kind == "{code-block}":
            options = re.match(r"((?:^:.*\n)*)\n?", body, re.M)
            caption = re.search(r"^:caption: (\S+)$", options[1], re.M)
            kind, caption, body = match["argument"], caption and caption[1], body[options.end() :]
        found.append(Block(kind, caption, body, text[: match.start("body")].count("\n") + 1))
    return found


def agree(wanted, got):
    """Whether two numbers differ by at most one unit of the last digit shown, or are both rounding errors."""
    a, b = float(wanted), float(got)
    mantissa, _, power = wanted.partition("e")
    unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(a - b) <= 1.001 * unit * ("." in wanted) or max(abs(a), abs(b)) < 1e-6


class Checker(doctest.OutputChecker):
    """Compare output as doctest does, or word for word with the last digit of numbers left open."""

    def check_output(self, want, got, optionflags):
        """Return whether the output is the one that is wanted."""
        if super().check_output(want, got, optionflags):
            return True
        same_words = NUMBER.sub("#", want).split() == NUMBER.sub("#", got).split()
        pairs = list(zip(NUMBER.findall(want), NUMBER.findall(got), strict=False))
        return same_words and all(agree(a, b) for a, b in pairs)


def commands(body):
    """Cut a console block into commands: what is typed, what that means in one line, and what it prints."""
    assert body.startswith("$ "), "a console block begins with a command"
    for part in re.split(r"^\$ ", body, flags=re.M)[1:]:
        typed, command = re.match(r"(?:.*\\\n)*.*\n", part)[0], ""
        for line in typed.splitlines():
            command += line.removeprefix("> ").lstrip().removesuffix("\\")
        yield f"$ {typed}", command, part[len(typed) :]


VERB = re.compile(
    r"(optkit (?:[^|;&<>$`*'\"]|'[^']*'|\"[^\"$`]*\")*)"
    r"(?:(?P<told>(?:;|\|\|) echo \"exit status \$\?\")|\|(?P<pipe>[^|].*))?",
    re.S,
)
"""A call of optkit, and what its output is piped to or that its status is told: the shell need change nothing."""

SCRIPT = re.compile(r"python (\w+\.py(?: [\w.]+)*)")
"""A call of a script."""


def shell(command, folder):
    """Run a command in a folder, with this environment's programs first, and return what it prints.

    A plain call of optkit or of a script is made in this process, which has imported already what another would
    import anew.
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {"PATH": path, "COLUMNS": "100", "NO_COLOR": "1", "OPENBLAS_NUM_THREADS": "1"}
    said, given, verb = "", None, VERB.fullmatch(command)
    if verb:
        with patch.dict(os.environ, environment):
            done = optkit(*shlex.split(verb[1])[1:], cwd=folder)
        if verb["told"]:
            tells = done.returncode or verb["told"].startswith(";")
            return f"{done.stderr}{done.stdout}" + f"exit status {done.returncode}\n" * bool(tells)
        if verb["pipe"] is None:
            return done.stderr + done.stdout
        said, given, command = done.stderr, done.stdout, verb["pipe"]
    elif script := SCRIPT.fullmatch(command):
        words, printed = script[1].split(), io.StringIO()
        with patch.object(sys, "argv", words), contextlib.chdir(folder), contextlib.redirect_stdout(printed):
            runpy.run_path(words[0], run_name="__main__")
        return printed.getvalue()
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env={**os.environ, **environment},
        input=given,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    return said + done.stdout


LONG = {
    "explanation/bounds.md", "how-to/bounds.md", "how-to/extend.md", "how-to/preferences.md", "how-to/pricing.md",
    "how-to/studies.md", "how-to/training.md", "tutorial.md",
}  # fmt: skip
"""Pages that take two seconds or more."""


def parameter(page):
    name = str(page.relative_to(DOCS))
    return pytest.param(page, id=name, marks=[pytest.mark.slow] if name in LONG else [])


@pytest.mark.slow
@pytest.mark.parametrize("page", [parameter(path) for path in PAGES])
def test_blocks_print_what_the_page_shows(page, tmp_path, monkeypatch):
    """Every command and every example of a page runs, and gives what the page says."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    session, runner = {"__name__": "__main__"}, doctest.DocTestRunner(Checker(), verbose=False, optionflags=LOOSE)
    said = []
    for block in blocks(page.read_text()):
        where = f"{page.relative_to(ROOT)}:{block.line}"
        if block.caption is not None:
            (tmp_path / block.caption).write_text(block.body)
        elif block.kind == "python":
            test = doctest.DocTestParser().get_doctest(block.body, session, where, str(page), block.line)
            assert test.examples, f"{where}: a Python block needs prompts, or a caption to be a file"
            runner.run(test, out=said.append, clear_globs=False)
            session.update(test.globs)
        elif block.kind == "console":
            for _, command, wanted in commands(block.body):
                got = shell(command, tmp_path)
                if not Checker().check_output(wanted, got, LOOSE):
                    said.append(f"{where}\n$ {command}\nexpected:\n{wanted}\ngot:\n{got}")
        elif block.kind == "sh":
            assert all(line in KNOWN for line in block.body.splitlines()), f"{where}: only commands that CI runs"
        else:
            assert block.kind in SHOWN_ONLY, f"{where}: nothing runs a block of kind {block.kind!r}"
    for block in blocks(page.read_text()):
        if block.caption is not None:
            # Another page may have a file of the same name.
            sys.modules.pop(Path(block.caption).stem, None)
    assert not said, "\n".join(said)


README = (ROOT / "README.md").read_text()
KNOWN = {
    # CI runs the README's two commands; the others prepare them or look at what they made.
    *(line for body in re.findall(r"^```sh\n(.*?)^```$", README, re.M | re.S) for line in body.splitlines()),
    "git clone REPOSITORY optkit && cd optkit",
    "python3 -m venv .venv && .venv/bin/pip install -q .",
    ". .venv/bin/activate",
    "pip install -e '.[dev]'",
    "pip install -e '.[attention]'",
    "sphinx-build -W docs docs/_build",
}


def test_the_checker_tells_numbers_apart():
    """One unit of the last digit shown is rounding; more is not, and words must be the same."""
    check = Checker().check_output
    assert check("profit 26.71\n", "profit 26.72\n", LOOSE)
    assert check("gap 3.7e-13\n", "gap -1.1e-14\n", LOOSE)
    assert not check("profit 26.71\n", "profit 26.74\n", LOOSE)
    assert not check("120 instances\n", "121 instances\n", LOOSE)
    assert not check("profit 26.71\n", "loss 26.71\n", LOOSE)
    assert not check("profit 26.71\n", "profit 26.71 27.71\n", LOOSE)


def test_ratios_of_the_comparison_are_those_of_the_kept_results():
    """What the page on neighbours says of speed is what the benchmarks kept, to two digits."""
    said = " ".join((DOCS / "neighbours.md").read_text().split())
    pricing, estimation, arrival = (
        json.loads((RESULTS / f"{name}.json").read_text()) for name in ("pricing", "estimation", "arrival")
    )
    peer = {(run["peer"], run["situations"]): run["ratio"] for run in estimation["runs"]}
    forms = pricing["all states"]["closed_form"]
    seconds = {row["method"]: row["seconds"] for row in arrival["results"][0]["rows"]}
    for pattern, kept in (
        (r"statsmodels ([\d,]+) times", peer["statsmodels", 100_000]),
        (r"took (\d+) times the time on 100,000", peer["xlogit", 100_000]),
        (r"took ([\d,]+) times as long. It estimates", peer["biogeme", 10_000]),
        (r"took CVXPY ([\d,]+) times", forms["paper's form"]["times faster than plain CVXPY"]),
        (r"and ([\d,]+) times as long as the exact form", forms["exact, c >= 0"]["times faster than plain CVXPY"]),
        (r"took it ([\d,]+) times", seconds["CVXPY + Clarabel"] / seconds["dual"]),
    ):
        (told,) = re.findall(pattern, said)
        assert float(told.replace(",", "")) == pytest.approx(kept, rel=0.05), pattern


@pytest.mark.slow
def test_refresh_writes_what_blocks_print(tmp_path):
    """The script for contributors mends what has changed, and leaves alone what the tests would accept."""
    page, old = tmp_path / "page.md", "```python\n>>> 1 + 1\n3\n>>> 1 / 3\n0.33...\n```\n"
    page.write_text(f"{old}\n```console\n$ echo one \\\n>   two\nthree\n```\n")
    subprocess.run([sys.executable, str(DOCS / "refresh.py"), str(page)], check=True)
    assert page.read_text() == f"{old.replace('3', '2', 1)}\n```console\n$ echo one \\\n>   two\none two\n```\n"
