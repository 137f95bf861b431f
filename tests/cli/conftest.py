"""The command line for the tests of its verbs."""

import pytest

from tests import command_line


@pytest.fixture
def optkit():
    """Run the command line in this process; return exit status, output and errors."""
    return command_line.optkit
