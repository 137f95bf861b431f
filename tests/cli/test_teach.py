"""optkit teach, called as a user calls it; what it serves is tested in test_notebooks.py."""

import asyncio
import importlib.util
import itertools
import re
import socket
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from urllib.request import HTTPCookieProcessor, build_opener, urlopen

import pytest

from optkit.cli.notebook_server import guarded

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


@pytest.mark.slow
@needs_extra
def test_opens_a_browser_at_what_is_served(teach, monkeypatch, free_port):
    """The address is said and answers; Ctrl-C ends the server."""
    seen = []

    def browse(address):
        with build_opener(HTTPCookieProcessor()).open(address, timeout=10) as answer:
            assert "/auth/login" not in answer.url
            seen.append((address, answer.status))
        raise KeyboardInterrupt

    monkeypatch.setattr(module.webbrowser, "open", browse)
    status, out, err = teach("--port", free_port)
    [(address, answered)] = seen
    assert (status, answered, err) == (0, 200, "")
    assert address.startswith(f"http://127.0.0.1:{free_port}/?access_token=")
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


@pytest.mark.parametrize("name", ["3", "markup", "3_markup", "3_markup.py"])
def test_a_notebook_is_found_by_number_and_name(name):
    """All name the same."""
    assert module._find(name, [Path("2_concavity.py"), Path("3_markup.py")]) == Path("3_markup.py")


@needs_extra
def test_an_unknown_notebook_is_refused(teach):
    """The message lists those that there are."""
    status, _, err = teach("lambert")
    assert status == 2
    assert err == (
        "optkit: there is no notebook lambert; there are 1_choice, 2_concavity, 3_markup, 4_nonnegative, "
        "5_post_decision\n"
    )


@pytest.mark.slow
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


def answered(kind, *headers):
    """What a guarded application answers: its own word, or a status."""
    said = []

    async def served(scope, receive, send):
        said.append("served")

    async def send(message):
        said.append(message.get("status") or message.get("code"))

    scope = {"type": kind, "headers": [(name, value.encode()) for name, value in headers]}
    asyncio.run(guarded(served)(scope, None, send))
    return said[0]


OURS = ["127.0.0.1:2718", "localhost:2718", "[::1]:2718"]
FOREIGN = [
    "evil.example",
    "evil.example:2718",
    "127.0.0.1.evil.example:2718",
    "localhost.evil.example",
    "192.0.2.1",
    "",
]
FOREIGN += ["evil@", "[::1", "127.0.0.1:2718@evil.example", "evil.example#127.0.0.1", "0.0.0.0:2718"]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "refusal"), [("http", 403), ("websocket", 1008)])
def test_only_its_own_pages_are_answered(kind, refusal):
    """A request names this machine, and comes from no page or from one of the same address: all else is refused."""
    for host in OURS:
        assert answered(kind, (b"host", host)) == "served"
        for origin in (f"http://{one}" for one in [*OURS, *FOREIGN, "127.0.0.1:3000", "127.0.0.1"]):
            same = origin == f"http://{host}"
            assert answered(kind, (b"host", host), (b"Origin", origin)) == ("served" if same else refusal), origin
        assert answered(kind, (b"host", host), (b"origin", "null")) == refusal
    for host, origin in itertools.product(FOREIGN, [*OURS, *FOREIGN]):
        assert answered(kind, (b"host", host)) == refusal
        assert answered(kind, (b"host", host), (b"origin", f"http://{origin}")) == refusal
    assert answered(kind) == refusal
    assert answered(kind, (b"host", OURS[0]), (b"host", FOREIGN[0])) == refusal


def status_of(port, host, path="/", *headers):
    """Status that the server gives to a request; a WebSocket's opening is one."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as line:
        line.sendall("\r\n".join([f"GET {path} HTTP/1.1", f"Host: {host}", *headers, "", ""]).encode())
        return int(line.recv(200).split()[1])


def leads_to(address):
    """Where a browser ends up that knows nothing but the address."""
    with build_opener(HTTPCookieProcessor()).open(address, timeout=30) as page:
        return page.url


@pytest.mark.slow
@needs_extra
def test_who_may_look_and_until_when(free_port):
    """Nobody without the token, and no other site's page; the parent killed, the server ends too.

    The address leads to the notebook that was asked for.
    """
    command = [sys.executable, "-c", "from optkit.cli import main; main()", "teach", "1", "--no-browser"]
    parent = subprocess.Popen([*command, "--port", str(free_port)], stdout=subprocess.PIPE, text=True)
    try:
        address = [parent.stdout.readline().strip() for _ in range(2)][1]
        assert address.startswith(f"http://127.0.0.1:{free_port}/?file=1_choice")
        here, (_, query) = f"127.0.0.1:{free_port}", address.split("/?")
        socket_of = "/ws?session_id=s_1&" + query
        opening = (
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Key: {'A' * 22}==",
        )
        assert "/auth/login" not in leads_to(address)
        assert "/auth/login" in leads_to(address.partition("&")[0])
        assert status_of(free_port, here, "/ws?session_id=s_1&file=1_choice.py", *opening) in (401, 403)
        assert status_of(free_port, f"evil.example:{free_port}", "/?" + query) == 403
        assert status_of(free_port, here, socket_of, "Origin: http://evil.example", *opening) == 403
        assert status_of(free_port, here, socket_of, f"Origin: http://{here}", *opening) == 101
    finally:
        parent.kill()
        parent.wait()
    for _ in range(100):
        try:
            socket.create_connection(("127.0.0.1", free_port), timeout=1).close()
        except OSError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("the server is still there")
