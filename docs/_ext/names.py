"""Cross references by any name that Python knows: optkit.simulate is optkit.simulation.simulator.simulate.

Every name must exist, or the strict build fails. One that is not part of the reference is set without a link.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

OTHERS = ("collections", "numpy", "pandas", "scipy", "sklearn", "statsmodels")
"""Packages whose own documentation is elsewhere: no link, because no page may need the network."""


def find(name: str) -> Any:
    """Return the object of a dotted name, or raise LookupError."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = import_module(".".join(parts[:cut]))
        except ImportError:
            continue
        for at, part in enumerate(parts[cut:], cut):
            if not hasattr(found, part):
                # A dataclass's field without a default is only annotated.
                if part in getattr(found, "__annotations__", {}) and at == len(parts) - 1:
                    return None
                raise LookupError(name)
            found = getattr(found, part)
        return found
    raise LookupError(name)


def resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement) -> nodes.Node | None:
    """Find what Sphinx did not: another name of something in the reference, or something that is not in it."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    if target.split(".")[0] in OTHERS:
        return content
    inside = [node.get("py:module"), ".".join(filter(None, (node.get("py:module"), node.get("py:class"))))]
    for name in [target, *(f"{where}.{target}" for where in inside if where)]:
        try:
            found = find(name)
        except LookupError:
            continue
        home = f"{getattr(found, '__module__', '')}.{getattr(found, '__qualname__', '')}"
        if not home.startswith("optkit."):
            return content
        python = env.get_domain("py")
        link = python.resolve_xref(env, node["refdoc"], app.builder, "obj", home, node, content)
        return content if link is None else link
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to the events of the build."""
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
