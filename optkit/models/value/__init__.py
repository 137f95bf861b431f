"""Value functions of sets of waiting requests; the light ones are loaded when they are first asked for."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optkit.models.value.light import KernelValue, LinearValue

__all__ = ["KernelValue", "LinearValue"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from optkit.models.value import light

        return getattr(light, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
