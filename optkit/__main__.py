"""``python -m optkit`` is the command line."""

from optkit.cli import main

main()
