"""Forged certificates: whatever is done to the arrays of a proof, it never proves less than the optimum.

``python -m tests.bounds.forged 300`` forges for 300 seconds in all, and says for each kind of bounds how many forgeries
were refused and how many proved a bound, none below what 60 digits say; a second number is the first seed.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import fields, replace
from fractions import Fraction
from typing import Any

import mpmath as mp
import numpy as np

from optkit.basics.errors import OptkitError, SolverError
from optkit.bounds.bound import prove
from tests.bounds.kinds import KINDS

EACH = 100
"""Forgeries of one certificate."""


def factor(rng: np.random.Generator) -> float:
    """A factor from 1 + 1e-12 to 1e300, or one over it."""
    grows = 1.0 + 10.0 ** rng.uniform(-12, 0) if rng.random() < 0.5 else 10.0 ** rng.uniform(0, 300)
    return float(grows if rng.random() < 0.5 else 1.0 / grows)


def _swap(a: Any, rng: np.random.Generator) -> Any:
    return rng.permutation(a.ravel()).reshape(a.shape)


def _somewhere(change: Callable[[Any, np.random.Generator], Any]) -> Callable[[Any, np.random.Generator], Any]:
    def changed(a: Any, rng: np.random.Generator) -> Any:
        return np.where(rng.random(a.shape) < 0.5, change(a, rng), a)

    return changed


TYPES = (
    "int8", "int16", "int32", "int64", "uint8", "uint64", "float16", "float32", "longdouble", "complex128", "object",
    "U8",
)  # fmt: skip


def _other_type(a: Any, rng: np.random.Generator) -> Any:
    """The numbers in another type, or the least number of that type everywhere, whose absolute value is negative."""
    kind = np.dtype(rng.choice(TYPES))
    if kind.kind == "i" and rng.random() < 0.5:
        return np.full(a.shape, np.iinfo(kind).min, kind)
    return a.astype(kind)


TAMPER: dict[str, Callable[[Any, np.random.Generator], Any]] = {
    "factor": lambda a, rng: a * factor(rng),
    "sign": lambda a, rng: -a,
    "swap": _swap,
    "shift": lambda a, rng: a + rng.choice([-1, 1]) * rng.choice([1e17, 1e18, 1e16]) * float(rng.uniform(0.5, 2)),
    "shift a little": lambda a, rng: a + rng.choice([-1, 1]) * np.abs(a).max(initial=0.0) * 10.0 ** rng.uniform(-16, 0),
    "nan": lambda a, rng: np.full_like(a, rng.choice([np.nan, np.inf, -np.inf])),
    "zero": lambda a, rng: 0.0 * a,
    "other type": _other_type,
    "last digits": lambda a, rng: np.nextafter(a, rng.choice([-np.inf, np.inf], a.shape)),
}
"""What is done to an array of numbers."""


def forge(certificate: Any, rng: np.random.Generator) -> Any:
    """The certificate with some of its arrays tampered with, each wholly or in places, one or several of a field."""
    arrays = [f.name for f in fields(certificate) if isinstance(getattr(certificate, f.name), np.ndarray | tuple)]
    for name in rng.choice(arrays, int(rng.integers(1, 3))):
        given = getattr(certificate, name)
        tables = [np.array(table) for table in given] if isinstance(given, tuple) else [np.array(given)]
        kind, everywhere, one = rng.choice(list(TAMPER)), rng.random() < 0.5, rng.integers(0, 2**32)
        change = TAMPER[kind] if everywhere else _somewhere(TAMPER[kind])
        only = None if not tables or rng.random() < 0.5 else int(rng.integers(len(tables)))
        for j, table in enumerate(tables):
            if only in (None, j):  # the same change to all tables leaves their differences as they are
                tables[j] = _changed(table, change, np.random.default_rng(one))
        certificate = replace(certificate, **{name: tuple(tables) if isinstance(given, tuple) else tables[0]})
    return certificate


def _changed(table: Any, change: Any, rng: np.random.Generator) -> Any:
    if table.dtype == bool:
        return table ^ (rng.random(table.shape) < 0.5)
    if table.dtype.kind in "iu":
        return rng.permutation(table) if rng.random() < 0.5 else rng.integers(-1, 6, table.shape)
    if table.dtype != float:  # of another type since an earlier change
        return table
    with np.errstate(over="ignore", invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's, of what a type cannot hold
        return change(table, rng)


def exactly(number: float) -> Any:
    """A float in 60 digits, or as it is."""
    return mp.mpf(float(number))


def attempt(name: str, seed: int, each: int = EACH) -> Counter[str]:
    """Draw a subject, bound it and forge its proof so often; AssertionError if a forgery proves too little."""
    kind, rng = KINDS[name], np.random.default_rng(seed)
    subject, became = kind.subject(rng), Counter[str]()
    try:
        honest = kind.bound(subject)
    except SolverError:  # a solver that stands for nothing where floats are strained
        return Counter({"unbounded": 1})
    optimum = kind.optimum(subject)
    least = optimum(honest.certificate)
    assert not below(prove(honest, subject).bound, least), (name, seed, "honest", honest.value, least)
    penalties = float(np.abs(subject.penalty * getattr(subject, "count", 1.0)).sum())
    rounding = 1e-12 * abs(honest.value) + 1e-14 * penalties
    for _ in range(each):
        forged = forge(honest.certificate, rng)
        try:
            # The value that the forged certificate proves, or one that is lower, as a liar would say.
            less = float(abs(honest.value)) * 10.0 ** rng.uniform(-8, 0) if rng.random() < 0.3 else 0.0
            claimed = replace(honest, certificate=forged, value=forged.check(subject).bound - less)
            verdict = prove(claimed, subject)
        except OptkitError:
            became["refused"] += 1
            continue
        assert not below(verdict.bound, optimum(forged)), (name, seed, verdict, optimum(forged), forged)
        if kind.one_program:
            assert verdict.attained <= honest.value + rounding, (name, seed, verdict, honest.value)
        said = claimed.value + 2e-9 * abs(claimed.value) + 1e3 * rounding
        assert said == np.inf or not below(said, optimum(forged)), (name, seed, claimed.value, optimum(forged))
        became["proven"] += 1
    return became


def below(bound: float, optimum: Any) -> bool:
    """Whether a bound is less than the optimum, without rounding."""
    return Fraction(bound) < optimum if isinstance(optimum, Fraction) else bool(mp.mpf(bound) < optimum)


def main(seconds: float, first: int = 0) -> None:
    """Forge proofs of every kind for about so many seconds in all."""
    for name in KINDS:
        became, seed, end = Counter[str](), first, time.perf_counter() + seconds / len(KINDS)
        while time.perf_counter() < end:
            became += attempt(name, seed)
            seed += 1
        print(
            f"{name:20s} {became.total():7d} forged, {became['refused']} refused, {became['proven']} proven, "
            f"{became['unbounded']} subjects without a bound",
            flush=True,
        )


if __name__ == "__main__":
    main(float(sys.argv[1]), *(int(x) for x in sys.argv[2:3]))
