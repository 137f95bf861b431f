"""Instance sets on disk; :mod:`optkit.storage.schema` describes the folder."""

from optkit.storage.load import load_instances, read_description
from optkit.storage.save import save_instances

__all__ = ["load_instances", "read_description", "save_instances"]
