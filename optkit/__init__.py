"""optkit: compensations for gig workers under multinomial logit, with certificates and upper bounds.

Names are loaded when they are first used, so that ``import optkit`` stays quick and quiet.

Examples
--------
>>> from optkit import PostDecisionPricing, scenario, simulate
>>> instances = scenario("I.1", seed=0).sample(3, seed=1)
>>> simulate(instances, PostDecisionPricing()).reward.shape
(3,)
"""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face
from optkit.basics.version import __version__

if TYPE_CHECKING:
    from optkit.basics.errors import OptkitError as OptkitError
    from optkit.bounds import arrival_information as arrival_information
    from optkit.bounds import full_information as full_information
    from optkit.gap.report import gap_report as gap_report
    from optkit.instances.catalogue import scenario as scenario
    from optkit.instances.instance import Instance as Instance
    from optkit.learning.training import train as train
    from optkit.models.choice import acceptance_probabilities as acceptance_probabilities
    from optkit.models.estimation import ConditionalLogit as ConditionalLogit
    from optkit.models.pricing import certify as certify
    from optkit.models.pricing import optimal_prices as optimal_prices
    from optkit.policies import Formula as Formula
    from optkit.policies import PostDecisionPricing as PostDecisionPricing
    from optkit.policies import RewardPercentage as RewardPercentage
    from optkit.simulation.metrics import performance_ratio as performance_ratio
    from optkit.simulation.simulator import simulate as simulate

__all__ = [
    "ConditionalLogit",
    "Formula",
    "Instance",
    "OptkitError",
    "PostDecisionPricing",
    "RewardPercentage",
    "__version__",
    "acceptance_probabilities",
    "arrival_information",
    "certify",
    "full_information",
    "gap_report",
    "optimal_prices",
    "performance_ratio",
    "scenario",
    "simulate",
    "train",
]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.basics.errors": ["OptkitError"],
        "optkit.bounds": ["arrival_information", "full_information"],
        "optkit.gap.report": ["gap_report"],
        "optkit.instances.catalogue": ["scenario"],
        "optkit.instances.instance": ["Instance"],
        "optkit.learning.training": ["train"],
        "optkit.models.choice": ["acceptance_probabilities"],
        "optkit.models.estimation": ["ConditionalLogit"],
        "optkit.models.pricing": ["certify", "optimal_prices"],
        "optkit.policies": ["Formula", "PostDecisionPricing", "RewardPercentage"],
        "optkit.simulation.metrics": ["performance_ratio"],
        "optkit.simulation.simulator": ["simulate"],
    },
    ["__version__"],
)
