"""The digest of an instance set: of what it holds, however it is stored and on whatever machine it was drawn."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from optkit.basics.errors import InputError
from optkit.instances.instance import Instance
from optkit.instances.storage.save import _checked, _rows
from optkit.instances.storage.schema import COLUMNS, table_schema

DECIMALS = 6
"""Floats count to so many decimals. No float of the benchmark sets lies within 1e-13 of a number where its rounding
changes, so that the last bit, in which machines differ, does not matter; with 9 decimals the nearest lies at 2e-16."""

EMPTY = np.iinfo(np.int64).min


def benchmark_digest(instances: Iterable[Instance]) -> str:
    """Return the SHA-256 of what instances hold.

    It is taken over integers, each as 8 bytes, little-endian and signed. A float x counts as the integer nearest to
    10^6 x (of two, the even one), an empty cell as -2^63. In this order:

    1. the number of instances, of features k and of worker groups D;
    2. per instance: horizon, number of requests and of workers, then D times mu, then D times the outside utility;
    3. the columns of ``requests``, then of ``workers``, then of ``noise``, in the order of
       :mod:`optkit.instances.storage.schema`, each from top to bottom.

    Parameters
    ----------
    instances : iterable of Instance
        They share the number of features and of groups.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    InputError
        If the instances do not fit in one set, or a number is too large to count in millionths.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from optkit import scenario
    >>> days = scenario("I.2", seed=0).sample(3, seed=1)
    >>> nearly, other = ([replace(one, reward=one.reward + change) for one in days] for change in (1e-14, 0.01))
    >>> [benchmark_digest(them) == benchmark_digest(days) for them in (nearly, other)]
    [True, False]
    """
    items = _checked(instances)
    k, D = (items[0].features.shape[1], items[0].n_groups) if items else (0, 0)
    digest = hashlib.sha256()

    def add(values: npt.ArrayLike) -> None:
        digest.update(_integers(np.asarray(values)).tobytes())

    add([len(items), k, D])
    for item in items:
        add([item.horizon, item.n_requests, item.n_workers])
        add(item.mu)
        add(item.outside_by_group)
    rows = [_rows(item) for item in items]
    for table in COLUMNS:
        names = table_schema(table, k, D).names
        add(np.repeat(np.arange(len(items)), [row[table][names[1]].size for row in rows]))
        for name in names[1:]:
            add(np.concatenate([row[table][name] for row in rows] or [np.zeros(0)]))
    return digest.hexdigest()


def _integers(values: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    if values.dtype.kind != "f":
        return values.astype("<i8")
    scaled = np.rint(values * 10.0**DECIMALS)
    if (np.abs(scaled) >= 2.0**63).any():
        raise InputError(f"{np.nanmax(np.abs(values)):g} is too large to be counted in units of 1e-{DECIMALS}")
    empty = np.isnan(scaled)
    return np.where(empty, EMPTY, np.where(empty, 0.0, scaled).astype(np.int64)).astype("<i8")
