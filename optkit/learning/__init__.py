"""From experience to a policy: preferences and the value of waiting, learned from data."""

from typing import TYPE_CHECKING

from optkit.basics.faces import lazy_face

if TYPE_CHECKING:
    from optkit.learning.offer_log import OfferLog as OfferLog
    from optkit.learning.offer_log import collect as collect
    from optkit.learning.rounds import Learned as Learned
    from optkit.learning.rounds import learn_once as learn_once
    from optkit.learning.rounds import learn_preferences as learn_preferences
    from optkit.learning.trained import Trained as Trained
    from optkit.learning.training import train as train

__all__ = ["Learned", "OfferLog", "Trained", "collect", "learn_once", "learn_preferences", "train"]
__getattr__, __dir__ = lazy_face(
    __name__,
    {
        "optkit.learning.offer_log": ["OfferLog", "collect"],
        "optkit.learning.rounds": ["Learned", "learn_once", "learn_preferences"],
        "optkit.learning.trained": ["Trained"],
        "optkit.learning.training": ["train"],
    },
)
