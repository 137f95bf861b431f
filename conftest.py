"""What pytest needs to know before it imports the kit, and how it spreads the tests over processes."""

import gc
import os
from importlib.util import find_spec
from pathlib import Path

import pytest

# The tests' numbers are small: where several processes test beside each other, more than one thread each for the loops
# of NumPy and PyTorch costs up to twenty times the processor time. Processes that tests start inherit it.
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

NEEDS_TORCH = [f"optkit/models/value/attention/{part}.py" for part in ("network", "training", "value")]

# Doctests of modules that need an extra are collected only where it is installed, and those of notebooks never.
collect_ignore = ["optkit/teach", *([] if find_spec("torch") else NEEDS_TORCH)]

MOST_PROCESSES = 4
"""Each needs a gigabyte of memory, and loads all libraries anew."""


def pytest_xdist_auto_num_workers(config):
    """Run the whole suite in as many processes as there are processors, but parts, files and single tests in this."""
    whole = Path(__file__).with_name("tests")
    if all(Path(argument).resolve() != whole for argument in config.args):
        return 0
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(processors, MOST_PROCESSES)


def pytest_collection_modifyitems(items):
    """Begin with the files that hold tests marked slow, so that no process is left alone with one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect without looking for garbage: there is next to none, and looking would take a third of the time.

    What is there at the end stays until the last test: no later search need look at it again, and tests draw so many
    figures and tables that a search every 700 new objects, as Python has it, costs a seventh of their time.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
        gc.set_threshold(20_000, 20, 50)
