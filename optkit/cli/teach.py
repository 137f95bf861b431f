"""``optkit teach``: the derivation in notebooks that one can touch, served on this machine."""

from __future__ import annotations

import os
import secrets
import signal
import socket
import subprocess
import sys
import time
import webbrowser
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated
from urllib.parse import urlencode

import typer

from optkit.basics.errors import InputError, MissingExtraError, OptkitError
from optkit.cli.console import say

HOST = "127.0.0.1"

START = 60.0
"""Seconds that the server may take to answer."""


def teach(
    name: Annotated[
        str | None, typer.Argument(help="A notebook, by number or name, e.g. 3 or markup; without it, all of them.")
    ] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Port; a free one by default.")] = None,
    browser: Annotated[bool, typer.Option(help="Open a browser too.")] = True,
) -> None:
    """Open the derivation: from a worker's choice to the optimal markup, and on to values of waiting.

    Five notebooks with sliders compute every claim live: *choice*, *concavity*, *markup*, *nonnegative* and
    *post_decision*. They are served on this machine only, to whoever has the address, until Ctrl-C.
    """
    for library in ("marimo", "sympy"):
        if find_spec(library) is None:
            raise MissingExtraError(f"the notebooks need {library}, which is missing: pip install 'optkit[examples]'")
    folder = Path(str(files("optkit"))) / "teach"
    notebooks = sorted(folder.glob("[0-9]_*.py"))
    chosen = None if name is None else _find(name, notebooks)
    port = _free_port(port)
    token = secrets.token_urlsafe()
    asked = {} if chosen is None else {"file": chosen.name}
    address = f"http://{HOST}:{port}/?{urlencode(asked | {'access_token': token})}"
    # As a file: to serve needs nothing of the command line, which takes half a second to load.
    program = [sys.executable, "-P", str(Path(__file__).with_name("notebook_server.py"))]
    served = [*program, str(folder), HOST, str(port)]
    stop = signal.signal(signal.SIGINT, signal.default_int_handler)
    # SIGTERM too must not leave the server behind.
    end = signal.signal(signal.SIGTERM, signal.default_int_handler)
    # The server ends when this end of the pipe is closed, and so with this process, in whatever way it ends.
    there, here = os.pipe()
    os.write(here, f"{token}\n".encode())
    server = subprocess.Popen(served, stdin=there, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    os.close(there)
    try:
        _wait(server, port)
        for notebook in [chosen] if chosen else notebooks:
            say(f"  {notebook.stem}")
        say(address, "Ctrl-C ends it.")
        if browser:
            webbrowser.open(address)
        said = server.communicate()[1]
        raise OptkitError(f"the server of the notebooks ended with status {server.returncode}{_last_line(said)}")
    except KeyboardInterrupt:
        say("", "ended")
    finally:
        _stop(server)
        os.close(here)
        signal.signal(signal.SIGINT, stop)
        signal.signal(signal.SIGTERM, end)


def _find(name: str, notebooks: list[Path]) -> Path:
    """Return the notebook of a number, a name, or both."""
    wanted = name.removesuffix(".py").replace("-", "_")
    for path in notebooks:
        number, _, title = path.stem.partition("_")
        if wanted in (number, title, path.stem):
            return path
    listed = ", ".join(path.stem for path in notebooks)
    raise InputError(f"there is no notebook {name}; there are {listed}")


def _free_port(port: int | None) -> int:
    """Return the port if it is free, or some free port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as servers do: a port just closed is free
        try:
            probe.bind((HOST, port or 0))
        except OSError as error:
            raise InputError(
                f"--port {port} cannot be had ({error.strerror}): take another, or leave it out for a free one"
            ) from None
        return int(probe.getsockname()[1])


def _wait(server: subprocess.Popen[str], port: int) -> None:
    """Return when the server answers."""
    begun = time.monotonic()
    while server.poll() is None and time.monotonic() - begun < START:
        try:
            socket.create_connection((HOST, port), timeout=1.0).close()
        except OSError:
            time.sleep(0.1)
        else:
            return
    ended = server.poll()
    _stop(server)
    said = server.communicate()[1]
    why = f"does not answer after {START:.0f} s" if ended is None else f"ended with status {ended}"
    raise OptkitError(f"the server of the notebooks {why}{_last_line(said)}")


def _last_line(said: str) -> str:
    lines = said.strip().splitlines()
    return f": {lines[-1].strip()}" if lines else ""


def _stop(server: subprocess.Popen[str]) -> None:
    """End the server, politely at first."""
    if server.poll() is None:
        server.terminate()
        try:
            server.wait(5.0)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()
