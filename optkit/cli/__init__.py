"""The command line: every verb is a module of its own, loaded with the app and light to load."""

from optkit.cli.app import app, main

__all__ = ["app", "main"]


def __dir__() -> list[str]:
    return sorted(__all__)
