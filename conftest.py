"""Doctests of modules that need an extra are collected only where it is installed, and those of notebooks never."""

from importlib.util import find_spec

NEEDS_TORCH = [f"optkit/models/value/attention/{part}.py" for part in ("network", "training", "value")]

collect_ignore = ["optkit/teach", *([] if find_spec("torch") else NEEDS_TORCH)]
