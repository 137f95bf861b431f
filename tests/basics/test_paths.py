"""Where paths lead, and in which encoding files are read: the same on every machine."""

import ast
import os
from functools import cache
from pathlib import Path

import pytest

import optkit
from optkit.basics.errors import InputError
from optkit.basics.paths import resolved

ROOT = Path(optkit.__file__).parent


@cache
def every_call():
    """Every call of a function or method in the kit: its name, file and node."""
    return [
        (getattr(node.func, "attr", None) or getattr(node.func, "id", None), file.relative_to(ROOT).as_posix(), node)
        for file in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
    ]


def calls(name):
    """Calls of a function or method of that name in the kit: file and node."""
    return [(file, node) for called, file, node in every_call() if called == name]


def test_links_are_followed_and_loops_are_said(tmp_path, monkeypatch):
    """A path without links, of what need not exist; a link to itself, or to what leads back to it, is one line."""
    monkeypatch.chdir(tmp_path)
    os.symlink("real", "link")
    assert resolved("link/day") == tmp_path.resolve() / "real" / "day"
    os.symlink("loop", "loop")
    os.symlink("there", "here")
    os.symlink("here", "there")
    for path in ("loop", "loop/day", "here", "there/day/x.csv"):
        with pytest.raises(InputError, match="leads back to itself: name another place"):
            resolved(path)


@pytest.mark.slow
def test_paths_are_resolved_in_one_place():
    """Path.resolve raises what nobody expects where links make a loop, and on some versions of Python nothing."""
    assert not [(file, node.lineno) for file, node in calls("resolve") if "teach" not in file]
    assert len(list(calls("resolved"))) >= 5


@pytest.mark.slow
def test_text_is_read_and_written_in_a_named_encoding():
    """What an encoding is by default depends on the machine: nothing of the kit does."""
    for name in ("open", "read_text", "write_text", "fdopen", "TextIOWrapper"):
        for file, node in calls(name):
            owner = ast.unparse(node.func)
            mode = [
                ast.literal_eval(one)
                for one in (*node.args, *(k.value for k in node.keywords))
                if isinstance(one, ast.Constant)
            ]
            binary = any(isinstance(one, str) and set(one) <= set("rwxab+") and "b" in one for one in mode)
            if owner in ("os.open", "gzip.open", "webbrowser.open") or binary or file.startswith("teach/"):
                continue
            assert any(keyword.arg == "encoding" for keyword in node.keywords), (file, node.lineno)
