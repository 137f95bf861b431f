"""The app: its verbs, and how it ends."""

from __future__ import annotations

import logging
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import cache
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup
from typer.main import get_command

from optkit.basics.errors import OptkitError
from optkit.basics.printable import printable
from optkit.basics.users_code import printing_aside
from optkit.cli.bound import bound
from optkit.cli.certify import certify
from optkit.cli.collect import collect
from optkit.cli.console import say
from optkit.cli.evaluate import evaluate
from optkit.cli.fit import fit
from optkit.cli.generate import generate
from optkit.cli.instances import instances
from optkit.cli.interruption import interruptible
from optkit.cli.price import price
from optkit.cli.run import run
from optkit.cli.study import study
from optkit.cli.teach import teach
from optkit.cli.train import train


class Verbs(TyperGroup):
    """Verbs whose complaints about the command line quote it so that a terminal shows it as it is."""

    def make_context(self, *args: Any, **more: Any) -> Any:
        """Read the options before the verb."""
        with _printable_complaints():
            return super().make_context(*args, **more)

    def invoke(self, *args: Any, **more: Any) -> Any:
        """Read the verb's own options, and run it."""
        with _printable_complaints():
            return super().invoke(*args, **more)


@contextmanager
def _printable_complaints() -> Iterator[None]:
    try:
        yield
    except Exception as error:
        said = getattr(error, "message", None)
        if hasattr(error, "exit_code") and isinstance(said, str):  # Typer's own, wherever it keeps Click
            vars(error)["message"] = "\n".join(map(printable, said.split("\n")))
        raise


app = typer.Typer(
    cls=Verbs,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def root(version: bool = typer.Option(False, "--version", help="Print the version and leave.", is_eager=True)) -> None:
    """Compensations for gig workers under multinomial logit, with certificates and upper bounds."""
    if version:
        from optkit.basics.version import __version__

        say(__version__)
        raise typer.Exit


for verb in (run, generate, instances, bound, certify, price, collect, fit, train, evaluate, study, teach):
    app.command()(verb)

VERBS = {verb.callback.__name__: verb for verb in app.registered_commands if verb.callback is not None}


def _command(verb: str) -> Any:
    """Return the command with this verb alone, or with all where there is none of that name.

    Typer reads the options of every verb that a command has, which takes longer than many a verb.
    """
    return _built(verb if verb in VERBS else "")


@cache
def _built(verb: str) -> Any:
    part = copy(app)
    part.registered_commands = [VERBS[verb]] if verb else app.registered_commands
    return get_command(part)


def main() -> None:
    """Run the command line; errors of optkit become one line and exit status 2."""
    with interruptible(), _any_encoding(), _library_logs(), printing_aside(), warnings.catch_warnings():
        warnings.showwarning = _warned
        try:
            _command(sys.argv[1] if sys.argv[1:] else "")()
        except OptkitError as error:
            if "--traceback" in sys.argv:
                say(*"".join(traceback.format_exception(error)).splitlines(), err=True)
            _end(error)
        except MemoryError:
            _end("out of memory: take fewer or smaller instances")
        except OSError as error:
            _end(": ".join(map(str, filter(None, (error.filename, error.strerror)))) or error)


@contextmanager
def _any_encoding() -> Iterator[None]:
    """Have standard output and error take characters that their encoding lacks, as escapes."""
    streams = [one for one in (sys.stdout, sys.stderr) if hasattr(one, "reconfigure")]
    before = [one.errors for one in streams]
    for one in streams:
        one.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        for one, errors in zip(streams, before, strict=True):
            one.reconfigure(errors=errors)


@contextmanager
def _library_logs() -> Iterator[None]:
    """With --quiet no library's log is written; what one writes goes to standard error."""
    before = logging.root.manager.disable
    if {"--quiet", "-q"} & set(sys.argv[1:]):
        logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _end(why: object) -> NoReturn:
    say(f"optkit: {why}", err=True)
    sys.exit(2)


def _warned(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    say(f"optkit: {category.__name__}: {message}", err=True)
