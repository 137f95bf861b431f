"""The app: its verbs, and how it ends."""

from __future__ import annotations

import signal
import sys
from typing import NoReturn

import typer

from optkit.basics.errors import OptkitError
from optkit.cli.bound import bound
from optkit.cli.certify import certify
from optkit.cli.collect import collect
from optkit.cli.evaluate import evaluate
from optkit.cli.fit import fit
from optkit.cli.generate import generate
from optkit.cli.price import price
from optkit.cli.run import run
from optkit.cli.study import study
from optkit.cli.teach import teach
from optkit.cli.train import train

app = typer.Typer(
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

        typer.echo(__version__)
        raise typer.Exit


for verb in (run, generate, bound, certify, price, collect, fit, train, evaluate, study, teach):
    app.command()(verb)


def main() -> None:
    """Run the command line; errors of optkit become one line and exit status 2."""
    signal.signal(signal.SIGINT, _interrupted)
    # A scheduler's polite end is an interruption too: worker processes must not outlive this one.
    signal.signal(signal.SIGTERM, _interrupted)
    try:
        app()
    except OptkitError as error:
        print(f"optkit: {error}", file=sys.stderr)
        sys.exit(2)
    except MemoryError:
        print("optkit: out of memory: take fewer or smaller instances", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        print(f"optkit: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is left is closing down


def _interrupted(*_: object) -> NoReturn:
    print("\noptkit: interrupted; what was there before stays", file=sys.stderr)
    raise KeyboardInterrupt  # Typer leaves with exit status 130
