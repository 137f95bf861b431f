"""optkit teach, called as a user calls it; what it serves is tested in test_notebooks.py."""

import importlib.util
import re
import socket
import sys
from functools import partial
from urllib.request import urlopen

import pytest

module = sys.modules["optkit.cli.teach"]  # as an attribute of optkit.cli the name is the function
needs_extra = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("marimo", "sympy")),
    reason="marimo or SymPy is missing: pip install 'optkit[examples]'",
)


@pytest.fixture
def teach(optkit):
    """Run the verb in this process; return exit status, output and errors."""
    return partial(optkit, "teach")


@pytest.fixture
def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@needs_extra
@pytest.mark.parametrize(
    ("name", "file"), [(None, None), ("3", "3_markup.py"), ("markup", "3_markup.py"), ("5_post-decision.py", "5_post")]
)
def test_opens_a_browser_at_what_is_served(teach, monkeypatch, free_port, name, file):
    """The address is said, answers, and leads to the notebook that was asked for; Ctrl-C ends the server."""
    seen = []

    def browse(address):
        with urlopen(address, timeout=10) as answer:
            seen.append((address, answer.status))
        raise KeyboardInterrupt

    monkeypatch.setattr(module.webbrowser, "open", browse)
    status, out, err = teach(*([] if name is None else [name]), "--port", free_port)
    [(address, answered)] = seen
    assert (status, answered, err) == (0, 200, "")
    assert address.startswith(f"http://127.0.0.1:{free_port}/" + ("" if file is None else f"?file={file}"))
    assert address in out.splitlines()
    assert out.endswith("ended\n")
    with pytest.raises(OSError, match="refused"):
        urlopen(address)


@pytest.mark.parametrize("missing", ["marimo", "sympy"])
def test_names_the_extra_that_is_missing(teach, monkeypatch, missing):
    """Without marimo or SymPy, one line says how to get them."""
    monkeypatch.setattr(module, "find_spec", lambda name: None if name == missing else "there")
    status, out, err = teach()
    assert (status, out) == (2, "")
    assert err == f"optkit: the notebooks need {missing}, which is missing: pip install 'optkit[examples]'\n"


@needs_extra
def test_a_port_in_use_is_refused(teach):
    """A port that somebody listens on is named, with the remedy."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        status, _, err = teach("--no-browser", "--port", port)
    assert status == 2
    assert err.startswith(f"optkit: --port {port} cannot be had (")
    assert err.count("\n") == 1


@needs_extra
def test_an_unknown_notebook_is_refused(teach):
    """The message lists those that there are."""
    status, _, err = teach("lambert")
    assert status == 2
    assert err == (
        "optkit: there is no notebook lambert; there are 1_choice, 2_concavity, 3_markup, 4_nonnegative, "
        "5_post_decision\n"
    )


@needs_extra
def test_a_server_that_fails_is_reported(teach, monkeypatch):
    """If the server ends by itself, its last words are passed on."""
    monkeypatch.setattr(module, "HOST", "192.0.2.1")  # an address for documentation, which no machine has
    monkeypatch.setattr(module, "_free_port", lambda port: 9)
    status, _, err = teach("--no-browser")
    assert status == 2
    assert re.match(r"optkit: the server of the notebooks ended with status \d+: .*bind on (any )?address", err)
    assert err.count("\n") == 1


@needs_extra
def test_a_server_that_does_not_answer_is_ended(teach, monkeypatch, free_port):
    """If nothing answers in time, the server is stopped and that is said."""
    monkeypatch.setattr(module, "START", 0.0)
    status, _, err = teach("--no-browser", "--port", free_port)
    assert status == 2
    assert "does not answer after 0 s" in err
