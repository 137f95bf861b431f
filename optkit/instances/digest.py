"""What tells one list of instances from another: a digest of every field, exactly as it is stored."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from scipy import sparse

from optkit.basics.errors import InputError
from optkit.instances.instance import Instance

LABELS = ("request_id", "worker_id", "worker_joined", "group_names", "feature_names", "clock")
"""Fields that no number depends on: what things are called changes nothing, nor does when a worker joined."""


DIFFERENT = 4
"""Different rewards from which two days are not alike by chance, as those of a few types of requests are."""


def exact_digest(instances: Sequence[Instance]) -> bytes:
    """Digest of all that numbers depend on, of all instances, 32 bytes; the same in every process.

    Examples
    --------
    >>> from optkit import scenario
    >>> days = scenario("I.2", seed=0).sample(2, seed=1)
    >>> exact_digest(days) == exact_digest(days[::-1])
    False
    """
    digest = hashlib.sha256()
    for one in instances:
        for field in fields(one):
            if field.name in LABELS:
                continue
            value = getattr(one, field.name)
            if value is None:  # as an array it would be an address, which every process has its own of
                digest.update(f"{field.name} none".encode())
                continue
            compressed = isinstance(value, sparse.csr_array)
            for part in (value.data, value.indices, value.indptr) if compressed else (value,):
                array = np.asarray(part)
                digest.update(f"{field.name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.digest()


def refuse_repeated(instances: Sequence[Instance]) -> None:
    """Refuse instances of which two are the same: an interval over them would take a copy for another day.

    Other draws of the noise make no other day. Days on which hardly anything happens may well be alike: those of fewer
    than :data:`DIFFERENT` rewards are the same only if their noise is, too.

    Raises
    ------
    InputError
        That names both.
    """
    seen: dict[bytes, int] = {}
    for b, one in enumerate(instances):
        if not (one.n_requests and one.n_workers):
            continue
        many = one.noise is not None and np.unique(one.reward).size >= DIFFERENT
        first = seen.setdefault(exact_digest([replace(one, noise=None, outside_noise=None) if many else one]), b)
        if first != b:
            told = f"instances {first} and {b} are the same"
            raise InputError(f"{told}: intervals need independent days; if one is a copy, leave it out")
