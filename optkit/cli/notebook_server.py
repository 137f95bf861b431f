"""The notebooks' server, a process of its own: for whoever holds the token, here, as long as its parent lives.

``python -P optkit/cli/notebook_server.py FOLDER HOST PORT``, with the token on the first line of standard input. marimo
serves, and asks for the token; what a browser sends from another site's page is refused before it gets there.
"""

from __future__ import annotations

import os
import runpy
import sys
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any, BinaryIO
from urllib.parse import urlsplit

Scope = MutableMapping[str, Any]
Application = Callable[[Scope, Any, Any], Awaitable[None]]

HERE = {"127.0.0.1", "localhost", "::1"}


def is_ours(host: str | None, origin: str | None) -> bool:
    """Whether a request was sent to this machine by name, and by no page but the server's own.

    A page of another site says where it comes from (``Origin``). One whose name was made to point here after it was
    loaded (DNS rebinding) asks for that name (``Host``).

    Examples
    --------
    >>> is_ours("127.0.0.1:80", None), is_ours("localhost:80", "http://localhost:80")
    (True, True)
    >>> is_ours("evil.example", None), is_ours("127.0.0.1:80", "http://evil.example"), is_ours(None, None)
    (False, False, False)
    """
    try:
        named = urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return False
    return named in HERE and origin in (None, f"http://{host}")


def guarded(served: Application) -> Application:
    """Return the application behind :func:`is_ours`: HTTP status 403 for all else, on WebSockets too."""

    async def application(scope: Scope, receive: Any, send: Any) -> None:
        if scope["type"] in ("http", "websocket"):
            sent: dict[bytes, list[str]] = {}
            for name, value in scope["headers"]:
                sent.setdefault(name.lower(), []).append(value.decode("latin-1"))
            hosts, origins = sent.get(b"host", []), sent.get(b"origin", [""])
            if not (len(hosts) == len(origins) == 1 and is_ours(hosts[0], origins[0] or None)):
                if scope["type"] == "websocket":
                    await send({"type": "websocket.close", "code": 1008})
                else:
                    await send({"type": "http.response.start", "status": 403, "headers": []})
                    await send({"type": "http.response.body", "body": b"not from here\n"})
                return
        await served(scope, receive, send)

    return application


def main(folder: str, host: str, port: str) -> None:
    """Serve the notebooks of a folder until somebody ends this process, or the one that started it is no more."""
    import uvicorn

    sys.path.append(os.path.abspath(os.path.join(__file__, *[os.pardir] * 3)))  # where the notebooks' optkit is
    parent = os.fdopen(os.dup(0), "rb", buffering=0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)  # no notebook reads what the parent writes
    token = parent.readline().decode().strip()
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()

    class Guarded(uvicorn.Config):
        def __init__(self, app: Any, *args: Any, **more: Any) -> None:
            super().__init__(guarded(app), *args, **more)

    uvicorn.Config = Guarded  # type: ignore[misc]  # outside of all that marimo puts around its application
    # Run mode: code can be read but not changed, and no other machine is asked for anything. Not given to a process of
    # its own, the token is in no list of processes.
    sys.argv = ["marimo", "--yes", "--quiet", "run", folder, "--headless", "--no-sandbox", "--include-code"]
    sys.argv += ["--token-password", token, "--host", host, "--port", port]
    runpy.run_module("marimo", run_name="__main__", alter_sys=True)


def _end_with(parent: BinaryIO) -> None:
    """End this process with its parent, even one that was killed: the pipe that it holds is closed then."""
    parent.read()
    os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
