"""The layers of the kit: which package may import which, and where the code stands.

``python -m tests.layers`` prints units, layers, arrows and circles of this tree; with a folder as argument, of another
tree's ``optkit/``.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1] / "optkit"

ORDER = (
    ("basics",),
    ("instances", "plotting"),
    ("models", "simulation"),
    ("bounds", "policies"),
    ("learning",),
    ("gap", "evaluation"),
    ("__init__", "studies"),
    ("cli", "teach"),
    ("__main__",),
)
"""Packages from the ground up; each imports from below its own. ``__init__``, the face, names what lies below."""

GROUND = {f"optkit.basics.{one}" for one in ("errors", "arrays", "seeds")} | {"optkit.instances.instance"}
"""What the mathematics, ``models`` and ``bounds``, may know of the rest."""


def unit(path: Path, root: Path = ROOT) -> str:
    """Name of the package, or of the loose file, that a file of the kit belongs to."""
    first = path.relative_to(root).parts[0]
    return first.removesuffix(".py")


@cache
def imported(path: Path, root: Path = ROOT) -> frozenset[str]:
    """Dotted names of the kit that a file imports anywhere, also inside functions and for type checkers only.

    ``from optkit import x`` imports the module or package ``x`` where there is one, and the face's name where not.
    """
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level:
            raise ValueError(f"{path} imports relatively, which this script does not follow")
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                place = root.parent / whole.replace(".", "/")
                is_module = place.is_dir() or place.with_suffix(".py").exists()
                found.add(whole if is_module else str(node.module))
    return frozenset(name for name in found if name.split(".")[0] == "optkit")


def arrows(root: Path = ROOT) -> dict[str, set[str]]:
    """Which units each unit imports from."""
    graph: dict[str, set[str]] = {}
    for path in sorted(root.rglob("*.py")):
        here = graph.setdefault(unit(path, root), set())
        for name in imported(path, root):
            there = name.split(".")[1] if "." in name else "__init__"
            here.add(there)
    return {here: there - {here} for here, there in graph.items()}


def circles(graph: dict[str, set[str]]) -> list[tuple[str, ...]]:
    """Sets of nodes that reach each other, by Tarjan's algorithm through SciPy."""
    from scipy.sparse import lil_array
    from scipy.sparse.csgraph import connected_components

    names = sorted(set(graph) | {name for there in graph.values() for name in there})
    matrix = lil_array((len(names), len(names)))
    for here, there in graph.items():
        for name in there:
            matrix[names.index(here), names.index(name)] = 1
    count, label = connected_components(matrix.tocsr(), connection="strong")
    sets = [tuple(name for name, one in zip(names, label, strict=True) if one == k) for k in range(count)]
    return [one for one in sets if len(one) > 1]


def depth(graph: dict[str, set[str]]) -> int:
    """Number of layers: nodes on the longest chain of imports, those of a circle counted as one."""
    merged = {name: one for one in circles(graph) for name in one}
    whole: dict[object, set[object]] = {}
    for here, there in graph.items():
        key = merged.get(here, here)
        whole.setdefault(key, set()).update({merged.get(name, name) for name in there} - {key})
    height: dict[object, int] = {}

    def rise(node: object) -> int:
        if node not in height:
            height[node] = 1 + max((rise(below) for below in whole.get(node, ())), default=0)
        return height[node]

    return max(map(rise, whole), default=0)


def module_circles(root: Path = ROOT) -> list[tuple[str, ...]]:
    """Circles among single files, as far as imports at the top of the files go."""
    graph: dict[str, set[str]] = {}
    for path in root.rglob("*.py"):
        name = ".".join(("optkit", *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        graph[name] = set(imported(path, root))
    known = {here: {one for one in there if one in graph} - {here} for here, there in graph.items()}
    return circles(known)


def main() -> None:
    """Print the structure."""
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT
    graph = arrows(root)
    loose = [name for name in graph if not (root / name).is_dir()]
    print(f"{len(graph)} units ({len(loose)} loose files), {depth(graph)} layers of imports")
    print(f"{sum(map(len, graph.values()))} arrows between units, circles: {circles(graph) or 'none'}")
    print(f"circles among files: {module_circles(root) or 'none'}")
    for name in sorted(graph):
        print(f"  {name}: {', '.join(sorted(graph[name]))}")


if __name__ == "__main__":
    main()
