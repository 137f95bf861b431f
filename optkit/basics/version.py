"""The version, and those of the packages that numbers depend on."""

from __future__ import annotations

import platform
from importlib import metadata

__version__ = "0.1.0"


def versions() -> dict[str, str]:
    """Versions of optkit, Python and the packages that the numbers depend on."""
    packages = ("numpy", "scipy", "scikit-learn", "statsmodels", "cvxpy", "clarabel", "highspy")
    return {"optkit": __version__, "python": platform.python_version()} | {p: metadata.version(p) for p in packages}
