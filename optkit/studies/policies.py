"""The policies of the studies, by the names that tables and figures show."""

from __future__ import annotations

from typing import NamedTuple

CHOICES = ("true", "paper", "learned", "single-paper", "single")
"""What is known of workers: the truth (the paper's Pert(0)); learned from the paper's random offers; learned with
re-estimation; and both with one model for all groups."""


class Spec(NamedTuple):
    """How a policy is made.

    Attributes
    ----------
    rule : {"PP", "FP"} or None
        A tuned rule, which needs no beliefs.
    value : str or None
        Its value function, by name; None prices myopically.
    choice : str
        One of :data:`CHOICES`.
    """

    rule: str | None = None
    value: str | None = None
    choice: str = "true"

    @property
    def random(self) -> bool:
        """Whether another training seed gives another policy."""
        return self.rule is None and (self.value is not None or self.choice != "true")


_VALUES = {
    "Myopic": None,
    "Linear": "linear",
    "Kernel": "kernel",
    "Attention": "attention",
    "Attention as printed": "attention-printed",
}
_BELIEFS = {
    "true MNL": "true",
    "paper's data": "paper",
    "re-estimated": "learned",
    "single MNL, paper's data": "single-paper",
    "single MNL": "single",
}

POLICIES: dict[str, Spec] = {
    **{f"{v}, {c}": Spec(value=value, choice=choice) for v, value in _VALUES.items() for c, choice in _BELIEFS.items()},
    "PP": Spec(rule="PP"),
    "FP": Spec(rule="FP"),
}
"""By name."""
