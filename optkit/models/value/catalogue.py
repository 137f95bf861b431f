"""Value functions by name, and read from files."""

from __future__ import annotations

from typing import Any

import numpy as np

from optkit.basics.errors import InputError
from optkit.models.value.experience import Estimator
from optkit.models.value.features import features_of
from optkit.models.value.light import KernelValue, LinearValue
from optkit.models.value.mean import MeanValue
from optkit.models.value.ranked_term import RankedTerm
from optkit.models.value.request_sets import SetValue

LIGHT_VALUES: dict[str, type[LinearValue] | type[KernelValue]] = {
    "LinearValue": LinearValue,
    "KernelValue": KernelValue,
}
"""Light value functions by their kind in a file."""


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
        return MeanValue.from_dict(plain, value_of)
    return _light_value(plain)


def _light_value(plain: dict[str, Any]) -> LinearValue | KernelValue:
    try:
        made = LIGHT_VALUES[plain["kind"]](**plain["settings"])
        made.terms_ = [
            RankedTerm(features_of(t["features"]), t["order"], t["rank_knots"], t["busy_knots"]) for t in plain["terms"]
        ]
        made.coef_ = np.asarray(plain["coef"], dtype=float)
    except InputError:
        raise
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f"the value function cannot be read: {error!r}") from None
    size = sum(term.size for term in made.terms_)
    if made.coef_.ndim != 2 or made.coef_.shape[1] != size or not np.isfinite(made.coef_).all():
        raise InputError(f"the value function has coefficients of shape {made.coef_.shape}; finite (steps, {size}) fit")
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
    light: dict[str, type[Estimator]] = {"linear": LinearValue, "kernel": KernelValue, "mean": MeanValue}
    if value in light:
        return light[value]()
    networks = ("attention", "attention-levels", "attention-printed")
    if value not in networks:
        names = ", ".join(f'"{name}"' for name in (*light, *networks))
        raise InputError(f"value = {value!r} is unknown; there are {names}")
    from optkit.models.value.attention.value import LEVELS, PRINTED, TUNED, AttentionValue

    return AttentionValue(dict(zip(networks, (TUNED, LEVELS, PRINTED), strict=True))[value])
