"""How well a policy did: the paper's performance ratio, and means with paired confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.special import stdtr, stdtrit

from optkit.basics.arrays import Floats, flag, number, real
from optkit.basics.errors import InputError

if TYPE_CHECKING:
    pass

ROUNDING = 1e-12
"""Part of the money in play that counts as nothing."""


def performance_ratio(
    reward: npt.ArrayLike,
    full_information: npt.ArrayLike,
    total_penalty: npt.ArrayLike,
    *,
    in_the_mean: bool = False,
) -> Floats:
    r"""Performance ratio of each instance, in per cent (paper section 4.3).

    .. math:: 100 \Big(1 - \frac{\rho^{opt} - \rho^{alg}}{\rho^{opt} - \sum_i \beta_i}\Big)

    It is 100 for the full-information solution and 0 for a platform that lets every request expire.

    Parameters
    ----------
    reward : (B,) float
        What the policy earned, in money.
    full_information : (B,) float
        The full-information bound, in money.
    total_penalty : (B,) float
        Sum of the penalties of all requests, in money, at most 0.
    in_the_mean : bool
        Whether the bound is one on the mean, as with arrival information: single rewards may then exceed it.

    Returns
    -------
    (B,) float
        Where nothing can be gained (the bound equals the penalties) the ratio is 100 if the policy gets that much, and
        ``-inf`` if it gets less.

    Raises
    ------
    InputError
        If lengths differ, numbers are not finite, or a bound lies below the penalties or, beyond rounding, below the
        reward.

    Examples
    --------
    >>> performance_ratio([80.0, -20.0], [100.0, 100.0], [-20.0, -20.0])
    array([83.33333333,   0.        ])
    """
    flag("in_the_mean", in_the_mean)
    given = {"reward": reward, "full_information": full_information, "total_penalty": total_penalty}
    labels: list[Any] = [getattr(x, "index", None) for x in given.values() if hasattr(x, "loc")]
    if any(not one.equals(labels[0]) for one in labels):
        raise InputError("reward, full_information and total_penalty have different labels: bring them into one order")
    earned, best, least = (np.atleast_1d(real(name, x)) for name, x in given.items())
    if not earned.shape == best.shape == least.shape:
        raise InputError(
            f"lengths differ: reward {earned.shape}, full_information {best.shape}, total_penalty {least.shape}"
        )
    if (least > 0).any():
        b = int((least > 0).argmax())
        raise InputError(f"total_penalty[{b}] = {least[b]:g} is positive; write costs of expiry as numbers <= 0")
    # By a power of two, which rounds nothing: differences of the largest floats are beyond any float.
    unit = np.frexp(np.maximum(np.abs(earned), np.maximum(np.abs(best), np.abs(least))))[1] + 2
    given_best, given_least, given_earned = best, least, earned
    earned, best, least = (np.ldexp(x, -unit) for x in (earned, best, least))
    room, short = best - least, best - earned
    rounding = ROUNDING * (np.abs(best) + np.abs(least))
    if (room < -rounding).any():
        b = int((room < -rounding).argmax())
        raise InputError(
            f"full_information[{b}] = {given_best[b]:g} lies below the penalties {given_least[b]:g}: no bound does; "
            f"are the arguments in order (reward, full_information, total_penalty)?"
        )
    if not in_the_mean and (short < -rounding).any():
        b = int((short < -rounding).argmax())
        raise InputError(
            f"reward[{b}] = {given_earned[b]:g} lies above full_information[{b}] = {given_best[b]:g}, which no policy "
            "earns: are they of the same instances, in the same order? A bound on the mean alone is in_the_mean=True"
        )
    gained = room > rounding
    ratio = np.where(short <= rounding, 100.0, -np.inf)
    with np.errstate(over="ignore"):
        ratio[gained] = 100.0 * (1.0 - short[gained] / room[gained])
    if not np.isfinite(ratio[gained]).all():
        b = int((gained & ~np.isfinite(ratio)).argmax())
        raise InputError(f"the ratio of reward[{b}] = {given_earned[b]:g} to what can be gained is beyond any float")
    return ratio if in_the_mean else np.minimum(ratio, 100.0)


@dataclass(frozen=True)
class MeanInterval:
    """A mean with its spread and a Student confidence interval.

    Attributes
    ----------
    mean, std : float
        Mean and standard deviation over instances; the deviation of one is NaN.
    low, high : float
        Confidence interval of the mean; NaN for one instance.
    count : int
        Number of instances.
    """

    mean: float
    std: float
    low: float
    high: float
    count: int

    @property
    def p_value(self) -> float:
        """Two-sided p-value of Student's t-test that the mean is 0; NaN for one instance, 1 if all are 0.

        Examples
        --------
        >>> round(mean_interval([1.0, 2.0, 3.0]).p_value, 4), mean_interval([0.0, 0.0]).p_value
        (0.0742, 1.0)
        """
        if self.count == 1 or self.std == 0:
            return float("nan") if self.count == 1 else float(self.mean == 0)
        return float(2.0 * stdtr(self.count - 1, -abs(self.mean) / self.std * self.count**0.5))


def mean_interval(
    values: npt.ArrayLike, baseline: npt.ArrayLike | None = None, *, confidence: float = 0.95
) -> MeanInterval:
    """Mean of values over instances, or of their paired differences to a baseline on the same instances.

    Pairing removes what instances have in common, so that small differences between policies show.

    Parameters
    ----------
    values : (B,) float
        One number for each instance.
    baseline : (B,) float, optional
        Same instances, same order.
    confidence : float
        Coverage of the interval, in (0, 1).

    Returns
    -------
    MeanInterval
        With one instance the mean alone; the rest is NaN.

    Raises
    ------
    InputError
        If there are no values, one is not finite, lengths differ, or the confidence is out of range.

    Examples
    --------
    >>> mean_interval([3.0, 5.0, 7.0], [2.0, 4.0, 6.0]).mean
    1.0
    """
    x = real("values", values)
    if baseline is not None:
        base = real("baseline", baseline)
        if base.shape != x.shape:
            raise InputError(f"pairing needs the same instances: {x.shape} values against {base.shape} of the baseline")
        x = x - base
    if x.ndim != 1 or x.size == 0:
        raise InputError(f"a mean needs one value per instance, at least one; got shape {x.shape}")
    real("values less baseline", x)
    if not 0 < number("confidence", confidence) < 1:
        raise InputError(f"confidence = {confidence} is not between 0 and 1")
    if x.size == 1:
        return MeanInterval(float(x[0]), float("nan"), float("nan"), float("nan"), 1)
    # By a power of two, which rounds nothing: squares of small numbers would be 0, and of large ones infinite.
    unit = int(np.frexp(np.abs(x).max())[1])
    scaled = np.ldexp(x, -unit)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused
        mean, std = float(np.ldexp(scaled.mean(), unit)), float(np.ldexp(scaled.std(ddof=1), unit))
        half = float(stdtrit(x.size - 1, 0.5 + confidence / 2) * std / np.sqrt(x.size))
    found = MeanInterval(mean, std, mean - half, mean + half, x.size)
    if not np.isfinite([mean, std, half, found.low, found.high]).all():
        raise InputError(
            f"the interval comes to {found.low} to {found.high}: the values or the confidence are too large"
        )
    return found
