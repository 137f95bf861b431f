"""McFadden's conditional logit on ragged choice sets."""

from optkit.models.estimation.columns import NotIdentifiedError
from optkit.models.estimation.conditional_logit import ConditionalLogit
from optkit.models.estimation.identification import EstimationWarning, IdentificationReport, identification
from optkit.models.estimation.results import ConditionalLogitResults

__all__ = [
    "ConditionalLogit",
    "ConditionalLogitResults",
    "EstimationWarning",
    "IdentificationReport",
    "NotIdentifiedError",
    "identification",
]


def __dir__() -> list[str]:
    return sorted(__all__)
