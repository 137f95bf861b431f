"""Forged certificates of every kind of bounds, judged in 60 digits: see :mod:`tests.bounds.forged`."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from optkit.basics.errors import SolverError
from optkit.bounds import Bound, SolverRecord, exact_value
from optkit.bounds.arrival.market import OpenPairs
from optkit.bounds.bound import Verdict, prove
from optkit.bounds.penalised.charges import KeptCharges
from tests.bounds import forged
from tests.bounds.kinds import KINDS


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_no_forgery_proves_less_than_the_optimum(name):
    """Factors, signs, swaps, shifts by 1e17, NaN and last digits: refused, or proven and not below; some are each."""
    became = forged.attempt(name, 0, each=30)
    assert min(became["refused"], became["proven"]) > 0


def test_penalties_in_expected_numbers_are_rounded_up():
    """A fluid model whom no worker meets, in which a sum of products was below the exact one by its last digit."""
    assert forged.attempt("fluid", 1002, each=1).total() == 1


def test_a_bound_without_its_rounding_is_found(monkeypatch):
    """The judge sees the last digits: a dual that is rounded down, by as little as floats tell apart, does not pass."""
    right = OpenPairs.bound

    def lower(market, multipliers):
        value = right(market, multipliers)
        return value - 1e-13 * abs(value)

    monkeypatch.setattr(OpenPairs, "bound", lower)
    with pytest.raises(AssertionError, match="lagrangian"):
        forged.attempt("arrival, lagrangian", 0, each=1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_bound_holds_what_bounds_nothing(value):
    """NaN and infinity are refused where a bound is made, and where one is proven."""
    with pytest.raises(SolverError, match="bounds nothing"):
        Bound(value, "any", _Says(Verdict(0.0, 0.0, 0.0)), SolverRecord("none", "none", 0.0))
    day = KINDS["arrival, exact"].subject(np.random.default_rng(0))
    said = SimpleNamespace(bound=value, attained=0.0, residual=0.0)
    honest = Bound(1e9, "any", _Says(said), SolverRecord("none", "none", 0.0))
    with pytest.raises(SolverError, match="bounds nothing"):
        prove(honest, day)


def test_a_solution_that_attains_more_than_is_proven_is_refused():
    """One of the two is wrong, and it may be the proof."""
    day = KINDS["arrival, exact"].subject(np.random.default_rng(0))
    honest = Bound(5.0, "any", _Says(Verdict(5.0, 6.0, 0.0)), SolverRecord("none", "none", 0.0))
    with pytest.raises(SolverError, match="attains 6, more than the 5"):
        prove(honest, day)


class _Says:
    """A certificate that says what it was told to."""

    def __init__(self, verdict):
        self.verdict = verdict

    def check(self, subject):
        return self.verdict


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-12, 1e12])
@pytest.mark.parametrize("name", [name for name in KINDS if name != "arrival, program"])
def test_verdicts_do_not_depend_on_the_unit_of_money(name, unit):
    """Claims a little too low, and much, stand or fall alike, whatever a unit of money is worth."""
    kind = KINDS[name]
    plain = kind.subject(np.random.default_rng(5))
    plain = in_units(plain, 1.0 / np.median(plain.reward))
    for lower in (0.0, 1e-12, 1e-7, 0.1):
        told = []
        for one in (plain, in_units(plain, unit)):
            bound = kind.bound(one)
            try:
                prove(replace(bound, value=bound.value - lower * abs(bound.value)), one)
                told.append("proven")
            except SolverError:
                told.append("refused")
        assert told == ["proven" if lower < 1e-9 else "refused"] * 2


MONEY = ("reward", "penalty", "utility", "mu", "outside_utility", "noise", "outside_noise")


def in_units(subject, unit):
    """The same, with all money in another unit."""
    return replace(subject, **{name: unit * getattr(subject, name) for name in MONEY if hasattr(subject, name)})


@pytest.mark.parametrize("name", KINDS)
def test_a_proof_is_one_of_its_kind(name):
    """Under the name of another kind it proves nothing."""
    subject = KINDS[name].subject(np.random.default_rng(3))
    bound = KINDS[name].bound(subject)
    other = "full information" if bound.kind != "full information" else "arrival information"
    with pytest.raises(SolverError, match=f"proves a bound of {bound.kind}, and the bound claims"):
        prove(replace(bound, kind=other), subject)


def test_tables_of_whole_numbers_prove_no_more():
    """The least number of a type has no absolute value in it: rounding was taken off in place of added."""
    model = KINDS["exact"].subject(np.random.default_rng(152))
    bound = exact_value(model)
    least = tuple(np.full(x.shape, -(2**15), "int16") for x in bound.certificate.value)
    whole = replace(bound.certificate, value=least)
    floats = replace(bound.certificate, value=tuple(x.astype(float) for x in least))
    assert whole.check(model) == floats.check(model)


def test_charges_that_somebody_kept_are_worked_out_again():
    """A cache that was filled by hand changes nothing."""
    rng = np.random.default_rng(3)
    day = KINDS["penalised"].subject(rng)
    while day.n_workers < 2:
        day = KINDS["penalised"].subject(rng)
    bound = KINDS["penalised"].bound(day)
    kept = KeptCharges.of(bound.certificate.charges)
    for step in range(-1, day.horizon):
        kept._kept_nobody[step] = 1e6
    forged = replace(bound.certificate, charges=kept)
    assert forged.check(day) == bound.certificate.check(day)


@pytest.mark.parametrize("value", [np.timedelta64(5), np.complex128(5), 10**400, "5", True, None, [5.0]])
def test_what_is_no_bound(value):
    with pytest.raises(SolverError, match="no number"):
        Bound(value, "any", _Says(Verdict(0.0, 0.0, 0.0)), SolverRecord("none", "none", 0.0))


def test_a_number_that_lies_counts_as_what_it_is():
    class Liar(float):
        def __add__(self, other):
            return np.inf

        __abs__ = __radd__ = __mul__ = __rmul__ = __add__

    day = KINDS["arrival, exact"].subject(np.random.default_rng(0))
    honest = KINDS["arrival, exact"].bound(day)
    with pytest.raises(SolverError, match="that is claimed"):
        prove(replace(honest, value=Liar(honest.value - 0.5 * abs(honest.value) - 1.0)), day)
