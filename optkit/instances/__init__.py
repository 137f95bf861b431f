"""What an instance is, where instances come from, and how they are kept."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.instances.instance import Instance as Instance
    from optkit.instances.scenario import Scenario as Scenario
    from optkit.instances.storage import load_instances as load_instances
    from optkit.instances.storage import read_description as read_description
    from optkit.instances.storage import save_instances as save_instances

__all__ = ["Instance", "Scenario", "load_instances", "read_description", "save_instances"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.instances.instance": ["Instance"],
        "optkit.instances.scenario": ["Scenario"],
        "optkit.instances.storage": ["load_instances", "read_description", "save_instances"],
    },
)
