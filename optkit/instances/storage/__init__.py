"""Instance sets on disk; :mod:`optkit.instances.storage.schema` describes the folder."""

from optkit.instances.storage.load import load_instances, read_description
from optkit.instances.storage.save import save_instances

__all__ = ["load_instances", "read_description", "save_instances"]


def __dir__() -> list[str]:
    return sorted(__all__)
