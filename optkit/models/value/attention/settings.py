"""How the attention network is trained: the paper's table, and our settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from optkit.basics.arrays import flag, is_finite, number, whole_number
from optkit.basics.errors import InputError


@dataclass(frozen=True)
class AttentionSettings:
    """Settings of :class:`~optkit.models.value.attention.value.AttentionValue`; the defaults are ``TUNED``.

    Attributes
    ----------
    target : "difference" or "level"
        What is regressed: opportunity costs, or values of sets.
    empty_is_zero : bool
        Whether the empty set is worth 0, or what the network says.
    scaled : bool
        Whether one unit of output is the standard deviation of the surplus, or of money.
    loss : "squared" or "huber"
        Of the residual in units of output; Huber's turns linear at 1.
    deviations : tuple of float
        Standard deviation of the exploration noise of each round, money; as many rounds.
    discount : float
        Of the future, in [0, 1].
    instances : int or None
        Instances whose sets make one update of the network; None for all of a round.
    sweeps : int
        How often a round goes through its instances.
    passes : int
        Passes over the sets of an update.
    refresh : int
        Updates between copies of the network to the one that targets are taken from.
    batch : int
        Sets per gradient step.
    learning_rate, decay_rate, decay_steps : float, float, int or None
        After k gradient steps Adam's learning rate is ``learning_rate * decay_rate ** (k / decay_steps)``; None counts
        every round anew, and its whole length as ``decay_steps``.
    clip : float
        Largest norm of a gradient.

    Raises
    ------
    InputError
        If a setting is out of range.

    Examples
    --------
    >>> AttentionSettings(discount=0.99).target
    'difference'
    """

    target: Literal["difference", "level"] = "difference"
    empty_is_zero: bool = True
    scaled: bool = True
    loss: Literal["squared", "huber"] = "squared"
    deviations: tuple[float, ...] = (8.0, 4.0)
    discount: float = 1.0
    instances: int | None = None
    sweeps: int = 8
    passes: int = 3
    refresh: int = 1
    batch: int = 512
    learning_rate: float = 2e-2
    decay_rate: float = 0.1
    decay_steps: int | None = None
    clip: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "deviations", tuple(self.deviations))
        for name in ("sweeps", "passes", "refresh", "batch", "instances", "decay_steps"):
            given = getattr(self, name)
            if given is None and name in ("instances", "decay_steps"):
                continue
            object.__setattr__(self, name, whole_number(name, given, least=1))
        for name in ("empty_is_zero", "scaled"):
            flag(name, getattr(self, name))
        for name in ("learning_rate", "decay_rate", "clip"):
            number(name, getattr(self, name), above=0.0)
        number("discount", self.discount, least=0.0, most=1.0)
        if not self.deviations or not all(is_finite(deviation) and deviation >= 0 for deviation in self.deviations):
            raise InputError(f"deviations = {self.deviations} must be numbers of at least 0, in money, one per round")
        for name, known in (("target", ("difference", "level")), ("loss", ("squared", "huber"))):
            if getattr(self, name) not in known:
                raise InputError(f"{name} = {getattr(self, name)!r}: take {' or '.join(map(repr, known))}")


TUNED = AttentionSettings()
"""Our best settings for this network."""

LEVELS = AttentionSettings(
    target="level", loss="huber", deviations=(8.0, 6.0, 5.0, 4.0, 3.0, 2.0), batch=128, learning_rate=5e-3
)
"""The best settings we found for Algorithm 1 as it stands, which regresses the level of every set: of 30 tried, on
worlds that no result of ours is about."""

PRINTED = AttentionSettings(
    target="level",
    empty_is_zero=False,
    scaled=False,
    loss="huber",
    deviations=tuple(max(0.0, 10.0 - 1e-4 * 480 * 50 * epoch) for epoch in range(30)),
    discount=0.95,
    instances=80,
    sweeps=1,
    passes=1,
    refresh=5,
    batch=512,
    learning_rate=1e-5,
    decay_rate=1e-2,
    decay_steps=10_000,
    clip=0.5,
)
"""The paper's table of training details. What it leaves open we read as follows.

C = 80 x 50 are the steps of 80 instances with horizon 50: theta changes after every 80 instances, by one pass in
batches over their sets, and the target network after five such updates (K). An epoch is a round through the 480
training instances; prices follow theta from round to round. The learning rate decays as TensorFlow's
``ExponentialDecay``. delta is a standard deviation, and 1e-4 is taken off it per step of an instance. The clip value
bounds the gradient's norm. Huber's loss turns linear at 1 unit of money. Inputs are centred and scaled, outputs are
not.
"""
