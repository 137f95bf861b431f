"""What the paper claims, held against the results of a study."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.studies.claims.verdicts import claims as claims

__all__ = ["claims"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.studies.claims.verdicts": ["claims"],
    },
)
