"""Utilities and noise scales of workers, from logged offers; each name is loaded when it is first asked for."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optkit.models.preferences.attributes import Attributes
    from optkit.models.preferences.fit import fit_preferences
    from optkit.models.preferences.offers import Offers
    from optkit.models.preferences.preferences import Preferences

__all__ = ["Attributes", "Offers", "Preferences", "fit_preferences"]

_HOME = {"Attributes": "attributes", "Offers": "offers", "Preferences": "preferences", "fit_preferences": "fit"}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
