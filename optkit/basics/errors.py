"""The exceptions that optkit raises; all of them are :class:`OptkitError`.

Every message is one line: what is wrong, where, and how to mend it. The command line prints it as it
stands and leaves with exit status 2. What it quotes of a file or of a name cannot move a terminal's cursor.
"""

from optkit.basics.printable import printable


class OptkitError(Exception):
    """Root of every error that optkit raises on purpose."""

    def __str__(self) -> str:
        """Return the message on one line, see :func:`optkit.basics.printable.printable`."""
        return printable(super().__str__())


class InputError(OptkitError, ValueError):
    """An argument is wrong: a shape, a sign, a NaN, an unknown name."""


class InstanceError(InputError):
    """An instance breaks one of the rules of the problem (for example, expiry before arrival)."""


class DataError(OptkitError):
    """A file or a table cannot be read as what it should be."""


class PolicyError(OptkitError):
    """A policy, or what it believes in, failed or returned something that is not a feasible compensation decision."""


class SolverError(OptkitError, RuntimeError):
    """A solver gave up, hit its time limit, or returned something that does not hold when checked."""


class MissingExtraError(OptkitError, ImportError):
    """An optional dependency is needed; the message names the extra that installs it."""


class TrainingError(OptkitError, RuntimeError):
    """Training diverged or did not get anywhere; what it led to is not returned."""
