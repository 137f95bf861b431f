"""What reaches a terminal: whatever files and arguments are called, nothing that moves its cursor, in any encoding."""

import ast
import io
import json
import logging
import random
import re
import signal
import sys
import time
import unicodedata
import warnings
from pathlib import Path

import numpy as np
import pytest

import optkit.cli
from optkit.basics.errors import DataError, MissingExtraError, OptkitError, SolverError
from optkit.basics.plain_json import to_json
from optkit.basics.printable import encodable, listed, printable
from optkit.cli import console

NASTY = [
    *map(chr, [*range(1, 32), 127, *range(0x80, 0xA0)]),  # C0, DEL, C1
    *map(chr, [0x61C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)]),  # direction of writing
    *("\u2028", "\u2029", "\u200b", "\ufeff", "\xad", "\ud800", "\U000e0041"),
    *(
        "\x1b]0;title\x07",
        "\x1b[2J",
        "\x1b[31m",
        "\x9b31m",
        "\x1bP",
        "[bold]",
        ":smile:",
        "é",
        "中",
        "אב",
        "🚚",
        "n",
        " ",
    ),
]


def seen(text):
    """Whether every character of a text is one to be seen, lines apart."""
    return all(c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" for c in text)


@pytest.fixture
def call(monkeypatch):
    """Run the command line in this process on streams of an encoding; return exit status, output and errors."""
    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)]

    def run(*arguments, encoding="utf-8"):
        streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict") for _ in range(2)]
        monkeypatch.setattr(sys, "stdout", streams[0])
        monkeypatch.setattr(sys, "stderr", streams[1])
        monkeypatch.setattr(sys, "argv", ["optkit", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            optkit.cli.main()
        for one in streams:
            assert one.errors == "strict"  # left as they were
            one.flush()
        return left.value.code or 0, *(one.buffer.getvalue().decode(encoding) for one in streams)

    yield run
    signal.signal(signal.SIGINT, before[0])
    signal.signal(signal.SIGTERM, before[1])


def nasty(rng, length=12):
    """A name of things that no terminal should be sent."""
    return "".join(rng.choices(NASTY, k=rng.randint(1, length)))


def test_printable_leaves_nothing_hidden_and_nothing_else_changed():
    """2,000 names: what comes out is one line of visible characters, the same when it goes through again."""
    rng = random.Random(0)
    for _ in range(2_000):
        name = nasty(rng)
        shown = printable(name)
        assert seen(shown)
        assert "\n" not in shown
        assert printable(shown) == shown
        for encoding in ("ascii", "latin-1", "cp1252", "utf-8"):
            assert encodable(name, encoding).encode(encoding)
    for plain in ("café", "中文", "עברית", "🚚 [bold]x", "10\u202fkm", "007", ""):
        assert printable(plain) == plain
    assert printable("no UTF-8: \udce9") == r"no UTF-8: \udce9"  # as Python reads such a file name


def test_an_error_is_one_printable_line():
    """Whatever a message quotes, the error's text is one line that a terminal shows; so are errors of errors."""
    rng = random.Random(1)
    for kind in (OptkitError, DataError, SolverError, MissingExtraError):
        inner = kind(f"{nasty(rng)}\nsecond line")
        for error in (inner, DataError(f"{nasty(rng)}: {inner}")):
            assert seen(str(error))
            assert "\n" not in str(error)


def test_lists_of_names_are_cut_off():
    """A message lists what fits, says how many more there are, and shortens a name that is a page long."""
    assert listed(["a", 7]) == "a, 7"
    assert listed(f"c{i}" for i in range(1_000)).endswith("more")
    assert len(listed(["x" * 10_000])) < 500


@pytest.mark.slow
def test_names_of_all_kinds_are_printed_so_that_they_can_be_seen(call, tmp_path):
    """Requests, columns and files of nasty names: all the output is visible characters, and nobody's lines move."""
    rng = random.Random(2)
    for number in range(6):
        names = [nasty(rng) + str(i) for i in range(6)]
        odd = "".join(c for c in nasty(rng) if c not in "/\ud800")
        rows = [{"request": name, "value": 30 + i, "utility": -10, odd: 1} for i, name in enumerate(names)]
        file = tmp_path / f"{odd}{number}.json"
        file.write_text(json.dumps(rows))
        for more in ((), ("--json",)):
            code, out, err = call("price", file, *more)
            assert code == 0, err
            assert seen(out + err)
            assert err.count("\n") == 1  # of the column that has no meaning
        assert [row["request"] for row in json.loads(out)["requests"]] == names
        code, out, err = call("price", file, "--mu", -1)
        assert (code, out, err.count("\n")) == (2, "", 2)
        assert seen(err)


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ["price", "no\x1b[31m\n.csv"],
        ["price", "x", "--form", "\x1b[31m"],
        ["price", "x", "--\x9b31m"],
        ["price", "x", "--mu", "\u202e"],
        ["pr\x1b]0;x\x07"],
        ["bound", "\x1b[2J"],
        ["run", "\u202eI.1"],
        ["run", "I.1", "--set", "\x1b[31m=3"],
        ["fit", "x\x1b.csv", "--features", "a\x9b"],
        ["certify", "I.1", "--policy", "\x1b[31m"],
        ["evaluate", "p\x1b.json", "I.1"],
        ["study", "\x1b[31m"],
        ["generate", "I.1", "--count", "\x1b"],
        ["train", "I.1", "--value", "\x1b[31m", "--set", "horizon=5", "--set", "split=2,1,1"],
        ["teach", "\x1b[31m"],
    ],
    ids=lambda arguments: arguments[0].encode("unicode_escape").decode(),
)
def test_arguments_are_quoted_so_that_they_can_be_seen(call, arguments, tmp_path, monkeypatch):
    """An argument of any verb, and one that is no verb: status 2, and nothing but visible characters."""
    monkeypatch.chdir(tmp_path)
    code, out, err = call(*arguments)
    assert code == 2
    assert out == ""
    assert err
    assert seen(err)


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "cp437", "utf-8"])
def test_any_encoding_will_do(call, encoding, tmp_path, monkeypatch):
    """Names that the output's encoding lacks are printed as escapes, on both streams: numbers and status as ever."""
    monkeypatch.chdir(tmp_path)
    file = Path("größe 中.csv")
    file.write_text("request,value,utility,中\ncáfe 中 🚚,30,-10,1\n", encoding="utf-8")
    code, out, err = call("price", file, encoding=encoding)
    assert code == 0
    profit = next(line for line in call("price", file)[1].split("\n") if line.startswith("expected profit"))
    assert profit in out
    for name in ("cáfe 中 🚚", "größe 中.csv"):
        assert encodable(name, encoding) in out
    assert encodable("中", encoding) in err
    code, out, err = call("price", "nö 中.csv", encoding=encoding)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert encodable("nö 中.csv", encoding) in err
    for arguments in (["--help"], ["price", "--help"], ["price", "--nö中"]):
        code, out, err = call(*arguments, encoding=encoding)
        assert code == (0 if "--help" in arguments else 2)
        assert "Usage" in out + err


@pytest.mark.slow
def test_a_fit_is_written_in_any_encoding(call, tmp_path):
    """Names that the output's encoding lacks cost no file: the summary and the JSON are those of any terminal."""
    rng, log = np.random.default_rng(0), tmp_path / "log.csv"
    pay, km = rng.uniform(2, 12, (200, 2)), rng.uniform(1, 8, (200, 2))
    worth = np.column_stack([np.zeros(200), pay - 1.2 * km - 1]) + rng.gumbel(size=(200, 3))
    chosen = (worth.argmax(axis=1)[:, None] == [1, 2]).astype(int)
    columns = zip(np.repeat(np.arange(200), 2), km.ravel(), pay.ravel(), chosen.ravel(), strict=True)
    rows = [",".join(map(str, row)) for row in columns]
    log.write_text("\n".join(["situation,größe_中,compensation,chosen", *rows]), encoding="utf-8")
    found = {}
    for encoding in ("utf-8", "ascii", "cp1252"):
        out = tmp_path / encoding / "fit.txt"
        out.parent.mkdir()
        code, told, _ = call("fit", log, "--out", out, encoding=encoding)
        assert code == 0
        assert encodable("größe_中", encoding) in told
        whole = out.read_text(encoding="utf-8").partition("\n\n")[2]  # below the digest of what follows
        text = re.sub(r"\w{3}, \d\d \w{3} \d{4}|\b\d\d:\d\d:\d\d\b", "", whole)  # when it was written
        found[encoding] = (text, out.with_suffix(".json").read_text(encoding="utf-8"))
    assert "größe_中" in found["utf-8"][0]
    assert found["ascii"] == found["cp1252"] == found["utf-8"]


def test_warnings_are_printed_so_that_they_can_be_seen(call, monkeypatch, tmp_path):
    """A warning that quotes a name is one line on standard error."""
    (tmp_path / "r.csv").write_text("value,utility\n30,-10\n")

    def warned(*_, **__):
        warnings.warn("column \x1b[31m\n\u202e", UserWarning, stacklevel=1)
        raise DataError("enough")

    monkeypatch.setattr("optkit.models.pricing.optimal_prices", warned)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        code, _, err = call("price", tmp_path / "r.csv")
    assert code == 2
    assert err.split("\n")[:-1] == [r"optkit: UserWarning: column \x1b[31m\n\u202e", "optkit: enough"]


def test_json_is_ascii_without_control_characters():
    """Whatever is in the data, JSON for the terminal is visible ASCII, and reads back as it was."""
    rng = random.Random(3)
    data = {nasty(rng): [nasty(rng), 1.5, None] for _ in range(200)}
    assert seen(to_json(data))
    assert to_json(data).isascii()
    assert json.loads(to_json(data)) == data


def test_the_command_line_prints_in_one_place():
    """No verb prints by itself: all go through say, say_json and print_table, which escape."""
    for file in Path(optkit.cli.__file__).parent.glob("*.py"):
        if file.name == "console.py":
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("print", "typer.echo", "typer.secho"), (file.name, node.lineno)
                assert not called.startswith(("sys.stdout.write", "sys.stderr.write")), (file.name, node.lineno)


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [[], ["--quiet"], ["-q"]])
def test_logs_of_libraries_are_silent_with_quiet_and_never_on_standard_output(
    quiet, optkit, tmp_path, monkeypatch, caplog
):
    """As Dask's nanny warns of a worker that takes its time to end, and Matplotlib of its fonts."""
    told = "Worker process still alive after 4.0 seconds, killing"

    def run_cells(*_, **__):
        for name in ("distributed.nanny", "matplotlib.font_manager"):
            logging.getLogger(name).warning(told)
            logging.getLogger(name).critical(told)
        raise OptkitError("that was all")

    monkeypatch.setattr("optkit.studies.runner.run_cells", run_cells)
    done = optkit("study", "sensitivity", "--out", tmp_path / "s", "--jobs", 1, *quiet, check=2)
    assert done.stdout == ""
    assert (told in caplog.text) == (not quiet)  # who listens to logs is told, unless they are silent
    assert "that was all" in done.stderr
    assert logging.root.manager.disable == 0


def test_a_log_is_told_how_long_it_will_take(monkeypatch, capsys):
    """Where there is no terminal, a line now and then says how much is done and left; --quiet says nothing."""
    monkeypatch.setattr(console, "BETWEEN", 0.0)
    for quiet in (False, True):
        with console.progress_bar(quiet) as tell:
            for done in range(4):
                tell("bounding", done, 3)
                time.sleep(0.01)
        said = capsys.readouterr().err.splitlines()
        wanted = [] if quiet else [f"bounding: {done} of 3" for done in (1, 2, 3)]
        assert [line.partition(",")[0] for line in said] == wanted
        assert all(re.fullmatch(r"bounding: \d of 3, about \d+ s left", line) for line in said)
