"""Upper bounds on what any policy can earn, each with a certificate that proves it.

Solvers are loaded when a bound first needs them. The functions themselves are bound here at once, not by a module's
``__getattr__``: a function that is named as its module would be hidden by that module as soon as anybody imports it.
"""

from optkit.bounds.arrival.arrival_information import arrival_information
from optkit.bounds.bound import Bound, Certificate, SolverRecord, Verdict
from optkit.bounds.exact.exact_value import exact_value
from optkit.bounds.exact.small_model import SmallModel
from optkit.bounds.full.full_information import full_information
from optkit.bounds.penalised.foresight import Foresight
from optkit.bounds.penalised.penalized import penalized

__all__ = [
    "Bound",
    "Certificate",
    "Foresight",
    "SmallModel",
    "SolverRecord",
    "Verdict",
    "arrival_information",
    "exact_value",
    "full_information",
    "penalized",
]


def __dir__() -> list[str]:
    return sorted(__all__)
