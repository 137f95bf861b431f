"""Gradient steps of the attention network, and what goes on from round to round.

Importing this module needs PyTorch.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import huber_loss, mse_loss

from optkit.basics.arrays import Bools, Floats, Ints
from optkit.basics.errors import TrainingError
from optkit.models.value.attention.network import (
    AttentionNetwork,
    FrozenAttention,
    Scaling,
    request_inputs,
    set_inputs,
    sums,
    tensor,
)
from optkit.models.value.attention.settings import AttentionSettings
from optkit.models.value.experience import Experience
from optkit.models.value.request_sets import RequestSets

LARGEST = 1e3
"""Values beyond this many times the largest surplus are no values of waiting: training has diverged."""


@dataclass(eq=False)
class AttentionTraining:
    """A network in training.

    Attributes
    ----------
    settings : AttentionSettings
    scaling : Scaling
    network : AttentionNetwork
    optimizer : Adam
        Of the network's weights.
    rng : Generator
        For the order of instances and sets.
    target : FrozenAttention or None
        The network from which targets are taken.
    updates, gradient_steps : int
        How many there have been.
    """

    settings: AttentionSettings
    scaling: Scaling
    network: AttentionNetwork
    optimizer: torch.optim.Adam
    rng: np.random.Generator
    target: FrozenAttention | None = None
    updates: int = 0
    gradient_steps: int = 0

    @classmethod
    def of(
        cls, settings: AttentionSettings, scaling: Scaling, network: AttentionNetwork, seed: int
    ) -> AttentionTraining:
        """Begin to train a network."""
        optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
        return cls(settings, scaling, network, optimizer, np.random.default_rng(seed))

    def freeze(self) -> FrozenAttention:
        """Return the network as it is now, as a value function."""
        return FrozenAttention(copy.deepcopy(self.network), self.scaling, self.settings.empty_is_zero)

    def round(self, experience: Experience, visited: list[RequestSets]) -> float:
        """Update the network; return the root mean square residual of the last pass, money.

        Raises
        ------
        TrainingError
            If weights are no longer finite, or targets or residuals are far beyond what any set can be worth.
        """
        settings, unit = self.settings, self.scaling.unit
        data = VisitedSets.of(experience, visited, self.scaling)
        limit = LARGEST * max(1.0, float(np.abs(experience.requests.surplus).max(initial=0.0)))
        begun, length = self._schedule(data)
        target, squares, count = np.zeros(0), 0.0, 0
        for _ in range(settings.sweeps):
            squares, count = 0.0, 0
            for part in data.parts(settings.instances, self.rng):
                if self.target is None or self.updates % settings.refresh == 0:
                    self.target = self.freeze()
                    target = np.zeros(0)
                if target.size == 0:
                    target = _targets(experience, visited, self.target, settings.target)
                found = 0.0
                for _ in range(settings.passes):
                    found = self._pass(data, part, tensor(target / unit), begun, length)
                self.updates += 1
                squares += found
                count += int(data.count[part].sum()) if settings.target == "difference" else part.size
                self._check(float(np.abs(target).max()), unit * float(np.sqrt(squares / count)), limit)
        return unit * float(np.sqrt(squares / count))

    def _schedule(self, data: VisitedSets) -> tuple[int, int]:
        """Gradient step from which the decay of the learning rate counts, and the steps in which it decays once."""
        settings = self.settings
        if settings.decay_steps is not None:
            return 0, settings.decay_steps
        return self.gradient_steps, settings.sweeps * settings.passes * -(-data.count.size // settings.batch)

    def _pass(self, data: VisitedSets, part: Ints, target: Tensor, begun: int, length: int) -> float:
        """One pass over some of the sets in random order; return the sum of squared residuals, in units of output."""
        settings, network = self.settings, self.network
        loss_of = mse_loss if settings.loss == "squared" else huber_loss
        order = self.rng.permutation(part)
        squares = 0.0
        for first in range(0, order.size, settings.batch):
            rows = order[first : first + settings.batch]
            if settings.target == "difference":
                predicted, chosen = data.differences(network, rows)
            else:
                predicted, chosen = data.levels(network, rows), torch.from_numpy(rows)
            wanted = target[chosen]
            rate = settings.learning_rate * settings.decay_rate ** ((self.gradient_steps - begun) / length)
            for group in self.optimizer.param_groups:
                group["lr"] = rate
            self.optimizer.zero_grad()
            loss_of(predicted, wanted).backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), settings.clip)
            self.optimizer.step()
            self.gradient_steps += 1
            squares += float((predicted.detach() - wanted).square().sum())
        return squares

    def _check(self, largest: float, residual: float, limit: float) -> None:
        finite = all(bool(weight.isfinite().all()) for weight in self.network.parameters())
        if not (finite and largest <= limit and residual <= limit):
            raise TrainingError(
                f"training diverged in update {self.updates}: targets up to {largest:.3g}, residual {residual:.3g}; "
                f"lower learning_rate = {self.settings.learning_rate:g}, or give more instances"
            )


@dataclass(frozen=True, eq=False)
class VisitedSets:
    """The sets of a round as the network sees them: m members of r sets, set after set.

    Attributes
    ----------
    request : (m, p) tensor
        Scaled inputs of the members.
    whole, without : (r, 3), (m, 3) tensor
        Scaled inputs of the sets, and of the sets without each member.
    count : (r,) int
        Members of each set.
    owner : (r,) int
        The instance that each set is from.
    """

    request: Tensor
    whole: Tensor
    without: Tensor
    count: Ints
    owner: Ints

    @classmethod
    def of(cls, experience: Experience, visited: list[RequestSets], scaling: Scaling) -> VisitedSets:
        """Scale the inputs of visited sets."""
        inputs = [set_inputs(sets) for sets in visited]
        # The first entry of every row belongs to its instance.
        return cls(
            torch.cat([scaling.of_requests(sets.requests, sets.index[sets.member], sets.step) for sets in visited]),
            torch.cat([scaling.of_sets(whole) for whole, _ in inputs]),
            torch.cat([scaling.of_sets(without) for _, without in inputs]),
            np.concatenate([sets.member.sum(axis=1) for sets in visited]),
            np.concatenate([experience.owner[sets.index[:, 0]] for sets in visited]),
        )

    def parts(self, instances: int | None, rng: np.random.Generator) -> Iterator[Ints]:
        """Split the sets by their instance, so many instances to a part, in random order; None for one part."""
        if instances is None:
            yield np.arange(self.count.size)
            return
        order = rng.permutation(np.unique(self.owner))
        for first in range(0, order.size, instances):
            yield np.flatnonzero(np.isin(self.owner, order[first : first + instances]))

    def levels(self, network: AttentionNetwork, rows: Ints) -> Tensor:
        """Output for some of the sets, (rows,)."""
        _, _, context = self._embedded(network, rows)
        return network.head(context, self.whole[torch.from_numpy(rows)])

    def differences(self, network: AttentionNetwork, rows: Ints) -> tuple[Tensor, Tensor]:
        """Output for some of the sets less that without each member, (members,), and which members these are."""
        entry, terms, context = self._embedded(network, rows)
        owner = torch.from_numpy(np.repeat(np.arange(rows.size), self.count[rows]))
        contexts = torch.cat([context, context[owner] - terms])
        inputs = torch.cat([self.whole[torch.from_numpy(rows)], self.without[entry]])
        v = network.head(contexts, inputs)
        return v[: rows.size][owner] - v[rows.size :], entry

    def _embedded(self, network: AttentionNetwork, rows: Ints) -> tuple[Tensor, Tensor, Tensor]:
        """Members of some of the sets, their terms, and the contexts."""
        count = self.count[rows]
        start = np.cumsum(self.count)[rows] - count
        entry = torch.from_numpy(np.arange(count.sum()) + np.repeat(start - (np.cumsum(count) - count), count))
        terms = network.terms(self.request[entry])
        return entry, terms, sums(terms, torch.arange(entry.numel()), count)


def random_network(inputs: int, seed: int) -> AttentionNetwork:
    """Return a network with random weights; PyTorch's own random state stays as it is."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return AttentionNetwork(inputs)


def scaling_of(visited: list[RequestSets], scaled: bool) -> Scaling:
    """Scaling by the mean and standard deviation over visited sets."""
    x = np.concatenate([request_inputs(sets.requests, sets.index[sets.member], sets.step) for sets in visited])
    s = np.concatenate([set_inputs(sets)[0] for sets in visited])
    surplus = np.concatenate([sets.mean_surplus[sets.member] for sets in visited])
    unit = float(_spread(surplus[:, None])[0]) if scaled else 1.0
    return Scaling(x.mean(axis=0), _spread(x), s.mean(axis=0), _spread(s), unit)


def _spread(x: Floats) -> Floats:
    """Standard deviations of the columns; 1 for columns that are constant but for rounding."""
    std = x.std(axis=0)
    varies: Bools = std > 1e-9 * np.abs(x).max(axis=0)
    return np.where(varies, std, 1.0)


def _targets(experience: Experience, visited: list[RequestSets], value: FrozenAttention, kind: str) -> Floats:
    """Target of every member of every set, or of every set, in the order of :class:`VisitedSets`, money."""
    if kind == "level":
        return np.concatenate([experience.target(value, sets.step) for sets in visited])
    return np.concatenate([experience.target_differences(value, sets.step)[sets.member] for sets in visited])
