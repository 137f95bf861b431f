"""How policies fare: compared, bounded, their prices verified; the main job and its results folder."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.evaluation.comparison import compare as compare
    from optkit.evaluation.main_job import run_main_job as run_main_job
    from optkit.evaluation.verification import verify_pricing as verify_pricing

__all__ = ["compare", "run_main_job", "verify_pricing"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.evaluation.comparison": ["compare"],
        "optkit.evaluation.main_job": ["run_main_job"],
        "optkit.evaluation.verification": ["verify_pricing"],
    },
)
