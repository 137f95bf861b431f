"""Upper bounds on what any policy can earn, each with a certificate that proves it.

Solvers are loaded when a bound first needs them. The functions themselves are bound here at once, not by a module's
``__getattr__``: a function that is named as its module would be hidden by that module as soon as anybody imports it.
"""

from optkit.bounds.arrival_information import arrival_information
from optkit.bounds.bound import Bound, Certificate, SolverRecord, Verdict
from optkit.bounds.exact_value import exact_value
from optkit.bounds.foresight import Foresight
from optkit.bounds.full_information import full_information
from optkit.bounds.penalized import penalized
from optkit.bounds.small_model import SmallModel

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
