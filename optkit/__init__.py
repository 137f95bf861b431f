"""optkit: compensations for gig workers under multinomial logit, with certificates and upper bounds.

Names are loaded when they are first used, so that ``import optkit`` stays quick and quiet.

Examples
--------
>>> from optkit import scenario, simulate
>>> from optkit.policies import PostDecisionPricing
>>> instances = scenario("I.1", seed=0).sample(3, seed=1)
>>> simulate(instances, PostDecisionPricing()).reward.shape
(3,)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optkit.errors import OptkitError
    from optkit.instance import Instance
    from optkit.metrics import performance_ratio
    from optkit.scenarios import scenario
    from optkit.simulator import simulate

__version__ = "0.1.0"
__all__ = ["Instance", "OptkitError", "__version__", "performance_ratio", "scenario", "simulate"]

_HOME = {
    "Instance": "optkit.instance",
    "OptkitError": "optkit.errors",
    "performance_ratio": "optkit.metrics",
    "scenario": "optkit.scenarios",
    "simulate": "optkit.simulator",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'optkit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
