"""Value functions by name, and read from files."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from optkit.basics.arrays import floats
from optkit.basics.errors import InputError

if TYPE_CHECKING:
    from optkit.models.value.experience import Estimator
    from optkit.models.value.light import KernelValue, LinearValue
    from optkit.models.value.request_sets import SetValue

VALUES = {
    "linear": ("light", "LinearValue", None),
    "kernel": ("light", "KernelValue", None),
    "mean": ("mean", "MeanValue", None),
    "attention": ("attention.value", "AttentionValue", "TUNED"),
    "attention-levels": ("attention.value", "AttentionValue", "LEVELS"),
    "attention-printed": ("attention.value", "AttentionValue", "PRINTED"),
}
"""Value functions by name: their module here, which is loaded when it is asked for, the class, and its settings."""


def value_of(plain: dict[str, Any]) -> SetValue:
    """Make a fitted value function again from its plain data.

    Parameters
    ----------
    plain : dict
        What ``to_dict`` returned; its ``kind`` says what it is.

    Returns
    -------
    LinearValue, KernelValue, MeanValue or AttentionValue
        It prices as the one that was written.

    Raises
    ------
    InputError
        If the data are incomplete or do not fit together.

    Examples
    --------
    >>> from optkit import scenario
    >>> from optkit.learning.training import train
    >>> fitted = train(scenario("I.2", seed=0, horizon=10).sample(20, seed=1), "linear", choice="true").value
    >>> bool((value_of(fitted.to_dict()).coef_ == fitted.coef_).all())
    True
    """
    if plain.get("kind") == "AttentionValue":
        from optkit.models.value.attention.value import AttentionValue

        network: SetValue = AttentionValue.from_dict(plain)
        return network
    if plain.get("kind") == "MeanValue":
        from optkit.models.value.mean import MeanValue

        return MeanValue.from_dict(plain, value_of)
    return _light_value(plain)


def _light_value(plain: dict[str, Any]) -> LinearValue | KernelValue:
    from optkit.models.value.features import features_of
    from optkit.models.value.light import KernelValue, LinearValue
    from optkit.models.value.ranked_term import RankedTerm

    try:
        kinds: dict[str, Any] = {kind.__name__: kind for kind in (LinearValue, KernelValue)}
        made: LinearValue | KernelValue = kinds[plain["kind"]](**plain["settings"])
        made.terms_ = [
            RankedTerm(features_of(t["features"]), t["order"], t["rank_knots"], t["busy_knots"]) for t in plain["terms"]
        ]
        made.coef_ = floats("coef", plain["coef"], (None, None))
    except InputError:
        raise
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f"the value function cannot be read: {error!r}") from None
    size = sum(term.size for term in made.terms_)
    if made.coef_.shape[1] != size:
        raise InputError(f"the value function has coefficients of shape {made.coef_.shape}; (steps, {size}) fit")
    return made


def estimator_of(value: str | Estimator) -> Estimator:
    """Return the value function that a name stands for, not fitted yet.

    Parameters
    ----------
    value : str or Estimator
        A name, or a value function of one's own.

    Returns
    -------
    Estimator
        What is given comes back as it is.

    Raises
    ------
    InputError
        If there is none of this name, or what is given cannot be fitted.

    Examples
    --------
    >>> estimator_of("linear")
    LinearValue()
    """
    if not isinstance(value, str):
        if isinstance(value, type):
            raise InputError(f"{value.__name__} is a class: pass one of its instances, {value.__name__}()")
        if not (callable(getattr(value, "fit", None)) and callable(getattr(value, "opportunity_cost", None))):
            raise InputError(f"a {type(value).__name__} is no value function: it needs fit, value and opportunity_cost")
        return value
    if value not in VALUES:
        names = ", ".join(f'"{name}"' for name in VALUES)
        raise InputError(f"value = {value!r} is unknown; there are {names}")
    place, kind, settings = VALUES[value]
    module = import_module(f"optkit.models.value.{place}")
    made: Estimator = getattr(module, kind)(*([] if settings is None else [getattr(module, settings)]))
    return made
