"""How far from optimal policies are, with proof: bounds and policies measured on the same instances."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.gap.report import GapReport as GapReport
    from optkit.gap.report import gap_report as gap_report

__all__ = ["GapReport", "gap_report"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.gap.report": ["GapReport", "gap_report"],
    },
)
