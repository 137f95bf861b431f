"""The process: workers come one at a time, a policy pays, the worker takes the best offer or none."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.simulation.batch import Batch as Batch
    from optkit.simulation.metrics import performance_ratio as performance_ratio
    from optkit.simulation.simulator import Simulation as Simulation
    from optkit.simulation.simulator import simulate as simulate
    from optkit.simulation.state import State as State

__all__ = ["Batch", "Simulation", "State", "performance_ratio", "simulate"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.simulation.batch": ["Batch"],
        "optkit.simulation.metrics": ["performance_ratio"],
        "optkit.simulation.simulator": ["Simulation", "simulate"],
        "optkit.simulation.state": ["State"],
    },
)
