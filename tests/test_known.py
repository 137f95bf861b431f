"""No result holds NaN: what people hold in their hands refuses it when it is made, or says what it means there."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from optkit.basics.errors import OptkitError
from optkit.simulation.metrics import MeanInterval
from tests.public import PUBLIC


def spoiled(value):
    """Versions of a value with one NaN in place of a number; none where there is no number."""
    if isinstance(value, float | np.floating):
        yield float("nan")
    elif isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size:
        for place in {0, value.size // 2, value.size - 1}:
            one = value.copy()
            one.flat[place] = np.nan
            yield one
    elif isinstance(value, pd.DataFrame) and len(value):
        for name in value.select_dtypes("float"):
            yield value.assign(**{name: value[name].where(np.arange(len(value)) > 0)})
    elif isinstance(value, tuple):
        for i, part in enumerate(value):
            yield from ((*value[:i], one, *value[i + 1 :]) for one in spoiled(part))


def parts(thing):
    """A thing and the dataclasses that it is made of; but certificates, which are tried where they are forged."""
    if dataclasses.is_dataclass(thing) and not hasattr(thing, "check"):
        yield thing
        for field in dataclasses.fields(thing):
            yield from parts(getattr(thing, field.name))


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLIC)
def test_nan_in_any_number_is_refused(name):
    """Everywhere but where the class's docstring speaks of NaN."""
    for part in parts(PUBLIC[name][0]()):
        for field in dataclasses.fields(part):
            if not field.init:
                continue
            for worse in spoiled(getattr(part, field.name)):
                try:
                    dataclasses.replace(part, **{field.name: worse})
                except OptkitError:
                    continue
                assert "NaN" in type(part).__doc__, f"{type(part).__name__}.{field.name} takes NaN"


def test_the_tests_spoil_something():
    """Numbers, arrays, tables and tuples of them are reached."""
    tried = [*spoiled((1.0, np.ones(3))), *spoiled(pd.DataFrame({"a": [1.0, 2.0], "b": ["x", "y"]}))]
    assert len(tried) == 5
    assert list(spoiled("word")) == list(spoiled(3)) == []
    assert "NaN" in MeanInterval.__doc__
