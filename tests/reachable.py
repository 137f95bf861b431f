"""Every array that can be reached from an object, for tests that nobody writes where nobody should."""

from contextlib import suppress

import numpy as np


def arrays_within(thing, path="", seen=None):
    """Yield a path and an array each: through attributes, properties and containers, and what arrays are views of."""
    seen = {} if seen is None else seen
    if id(thing) in seen or isinstance(thing, type | str | int | float | np.generic) or thing is None:
        return
    seen[id(thing)] = thing  # kept, so that no other object is given its number
    if isinstance(thing, np.ndarray):
        yield path, thing
        yield from arrays_within(thing.base, f"{path}.base", seen)
    elif isinstance(thing, tuple | list):
        for k, one in enumerate(thing):
            yield from arrays_within(one, f"{path}[{k}]", seen)
    elif isinstance(thing, dict):
        for key, one in thing.items():
            yield from arrays_within(one, f"{path}[{key!r}]", seen)
    elif hasattr(thing, "indptr"):
        for name in ("data", "indices", "indptr"):
            yield from arrays_within(getattr(thing, name), f"{path}.{name}", seen)
    elif type(thing).__module__.startswith(("optkit", "tests")):
        for name in dir(thing):
            if not name.startswith("__"):
                with suppress(AttributeError, ValueError):
                    yield from arrays_within(getattr(thing, name), f"{path}.{name}", seen)


def scribble(thing):
    """Write into every array that can be reached, where that is possible; return the paths that were tried."""
    tried = []
    for path, array in list(arrays_within(thing)):
        tried.append(path)
        with suppress(ValueError):
            array.flags.writeable = True  # as somebody does whom a refusal annoys
        with suppress(ValueError):
            array[...] = ~array if array.dtype == bool else array + 7
    return tried
