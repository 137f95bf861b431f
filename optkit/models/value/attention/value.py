"""The paper's attention network as a value function that is fitted in rounds (section 3.3, Algorithm 1; section 3.4).

With ``PRINTED`` it is the paper's: Lemma 1's targets for the level of every visited set, and the table of the appendix
on neural network training; with ``LEVELS`` settings are better. With ``TUNED`` the same network is fitted to
differences: prices depend on nothing else, and with the same new arrivals after S and after S without i most of the
noise of the arrivals cancels.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from optkit.basics.arrays import Floats, floats, whole_number
from optkit.basics.errors import InputError, MissingExtraError
from optkit.models.value.attention.settings import LEVELS, PRINTED, TUNED, AttentionSettings
from optkit.models.value.experience import Experience
from optkit.models.value.parameters import Parameters
from optkit.models.value.request_sets import RequestSets

if TYPE_CHECKING:
    from optkit.models.value.attention.network import FrozenAttention
    from optkit.models.value.attention.training import AttentionTraining

__all__ = ["LEVELS", "PRINTED", "TUNED", "AttentionSettings", "AttentionValue"]


class AttentionValue(Parameters):
    """The attention network as a post-decision value function.

    Results are the same for the same seed, experience, version of PyTorch and number of threads.

    Parameters
    ----------
    settings : AttentionSettings
        ``TUNED``, ``LEVELS`` or ``PRINTED``, or others.
    seed : int
        Of the first weights and the order of the gradient steps.

    Attributes
    ----------
    residual_ : float
        Root mean square residual of the last pass, money.

    Raises
    ------
    MissingExtraError
        If PyTorch is not installed.
    InputError
        If the seed is not a whole number of at least 0.

    Examples
    --------
    >>> from dataclasses import replace
    >>> AttentionValue(replace(TUNED, sweeps=4), seed=1).settings.sweeps
    4
    """

    def __init__(self, settings: AttentionSettings = TUNED, seed: int = 0) -> None:
        _require_torch()
        self.settings = settings
        self.seed = whole_number("seed", seed, least=0)
        self._training: AttentionTraining | None = None
        self._fitted: FrozenAttention | None = None

    @property
    def deviations(self) -> tuple[float, ...]:
        """Exploration noise of each round, money."""
        return self.settings.deviations

    @property
    def discount(self) -> float:
        """Discount with which experience is to be made."""
        return self.settings.discount

    def value(self, sets: RequestSets) -> Floats:
        """Value of each set, (b,), money."""
        return self._frozen().value(sets)

    def opportunity_cost(self, sets: RequestSets) -> Floats:
        """V(S) - V(S without i) for every member i, (b, w), money; 0 for padding."""
        return self._frozen().opportunity_cost(sets)

    def fit(self, experience: Experience, y: None = None) -> AttentionValue:
        """Update the network from the experience of one round (Algorithm 1, step 2).

        Adam's state, the learning rate and the target network go on from round to round. After an error everything is
        as before.

        Parameters
        ----------
        experience : Experience
            Of the policy that prices with this value function, explored around; at first of the myopic one.
        y : None
            Targets come with the experience.

        Raises
        ------
        InputError
            If nobody ever waited, or the requests have other numbers of features or groups than in earlier rounds.
        TrainingError
            If the training diverges: weights that are not finite, or values far beyond what any set can be worth.
        """
        from optkit.models.value.attention.training import AttentionTraining, random_network, scaling_of

        visited = [sets for step in range(experience.horizon) if (sets := experience.sets(step)) is not None]
        if not visited:
            raise InputError(
                "nobody ever waited in this experience: there is nothing to fit, prices may as well be myopic"
            )
        if self._training is not None:
            training = copy.deepcopy(self._training)
        elif self._fitted is not None:
            network = copy.deepcopy(self._fitted.network)
            training = AttentionTraining.of(self.settings, self._fitted.scaling, network, int(self.seed))
        else:
            scaling = scaling_of(visited, self.settings.scaled)
            network = random_network(scaling.request_mean.size, int(self.seed))
            training = AttentionTraining.of(self.settings, scaling, network, int(self.seed))
        residual = training.round(experience, visited)
        self._training, self._fitted, self.residual_ = training, training.freeze(), residual
        return self

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Weights and scaling as plain arrays, by name; with ``settings`` they are all that values need.

        Raises
        ------
        InputError
            If nothing has been fitted yet.
        """
        fitted = self._frozen()
        weights = {name: weight.numpy().copy() for name, weight in fitted.network.state_dict().items()}
        return weights | {f.name: np.array(getattr(fitted.scaling, f.name)) for f in fields(fitted.scaling)}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, npt.ArrayLike], settings: AttentionSettings | Mapping[str, Any], seed: int = 0
    ) -> AttentionValue:
        """Return the value function that ``to_arrays`` wrote down; its values are the same to the last digit.

        Fitting it further starts with a fresh optimizer.

        Parameters
        ----------
        arrays : mapping
            As ``to_arrays`` gives them.
        settings : AttentionSettings or mapping
            The settings, or ``dataclasses.asdict`` of them, also after a trip through JSON.
        seed : int
            For further fitting.

        Raises
        ------
        InputError
            If an array is missing, unknown, of the wrong shape or not finite, or a setting is unknown.
        """
        if not isinstance(settings, AttentionSettings):
            unknown = set(settings) - set(asdict(TUNED))
            if unknown:
                raise InputError(f"unknown settings of an attention value: {', '.join(sorted(unknown))}")
            settings = AttentionSettings(**settings)
        made = cls(settings, seed)
        from optkit.models.value.attention.network import SET_INPUTS, FrozenAttention, Scaling, tensor
        from optkit.models.value.attention.training import random_network

        inputs = np.size(arrays.get("request_mean", ()))
        network = random_network(inputs, 0)
        shapes = {name: tuple(weight.shape) for name, weight in network.state_dict().items()}
        shapes |= {"request_mean": (inputs,), "request_std": (inputs,), "unit": ()}
        shapes |= {"set_mean": (SET_INPUTS,), "set_std": (SET_INPUTS,)}
        given = _checked(arrays, shapes)
        scaling: dict[str, Any] = {f.name: given.pop(f.name) for f in fields(Scaling)}
        scaling["unit"] = float(scaling["unit"])
        network.load_state_dict({name: tensor(weight) for name, weight in given.items()})
        made._fitted = FrozenAttention(network, Scaling(**scaling), settings.empty_is_zero)
        return made

    def to_dict(self) -> dict[str, Any]:
        """Settings and arrays as plain data that JSON can hold; :meth:`from_dict` reads it.

        Raises
        ------
        InputError
            If nothing has been fitted yet.
        """
        arrays = {name: array.tolist() for name, array in self.to_arrays().items()}
        return {"kind": "AttentionValue", "settings": asdict(self.settings), "seed": int(self.seed), "arrays": arrays}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> AttentionValue:
        """Make a fitted value function again from its plain data.

        Raises
        ------
        InputError
            If the data are incomplete or do not fit together.
        """
        try:
            return cls.from_arrays(dict(plain["arrays"]), dict(plain["settings"]), plain["seed"])
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"the attention value cannot be read: {error!r}") from None

    def _frozen(self) -> FrozenAttention:
        if self._fitted is None:
            raise InputError("this AttentionValue is not fitted: call fit first")
        return self._fitted


def _checked(arrays: Mapping[str, npt.ArrayLike], shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Floats]:
    """Return the arrays as floats, or raise an InputError that names the first that is wrong."""
    for name in (*shapes, *arrays):
        if name not in arrays or name not in shapes:
            fault = "is missing" if name in shapes else "is unknown"
            raise InputError(f"array {name!r} of an attention value {fault}; give what to_arrays() gave")
    return {name: floats(f"array {name!r} of an attention value", arrays[name], shapes[name]) for name in shapes}


def _require_torch() -> None:
    try:
        import torch  # noqa: F401
    except ImportError:
        raise MissingExtraError(
            "the attention network needs PyTorch, which is not installed: pip install 'optkit[attention]'"
        ) from None
