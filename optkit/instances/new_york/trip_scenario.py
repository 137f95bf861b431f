"""The NYC scenarios: requests appear when and where real trips began, in a synthetic world of money and workers.

Paper section 4.2 (New York Taxi data) and Table 1; ``docs/explanation/scenarios.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optkit.basics.arrays import number, whole_number
from optkit.basics.errors import DataError, InputError
from optkit.basics.seeds import Stream, check_count, seed_sequence, stream
from optkit.instances.instance import Instance
from optkit.instances.new_york.episodes import MODES, Episode, Mode, cut_episodes
from optkit.instances.new_york.trip_files import Paths
from optkit.instances.new_york.trips import REGIONS, Trips, read_trips
from optkit.instances.scenario import Part, Scenario, Split, cut, world_generator
from optkit.instances.settings import TABLE_1, adjust
from optkit.instances.world import DrawnRequests, World, check_sample, furnish

PAPER_FRACTION = 0.3
"""The share of trips that the paper keeps (section 4.2)."""


@dataclass(frozen=True, eq=False)
class TripScenario(Scenario):
    """A source of random instances whose requests are real trips. :func:`trip_scenario` makes one.

    An instance is a *realisation* of an episode: its trips thinned at random; types, lifetimes, workers and noise
    drawn anew. Samples of different seeds realise the same episodes; only :meth:`split` keeps episodes apart.

    Attributes
    ----------
    name, seed, settings, world
        As in :class:`optkit.instances.scenario.Scenario`.
    mode : {"folded", "mondays"}
        How trips become episodes.
    fraction : float
        Probability that a trip becomes a request.
    episodes : tuple of Episode
        In order of time; those without any trip are absent.
    source : dict
        Names of the files, rows read, and rows left out by reason.
    """

    mode: Mode
    fraction: float
    episodes: tuple[Episode, ...] = field(repr=False)
    source: dict[str, Any] = field(repr=False)

    def instance(self, seed: int | np.random.SeedSequence, episode: int | None = None) -> Instance:
        """Realise an episode, one at random unless its number is given.

        Raises
        ------
        InputError
            If there is no such episode.
        """
        rng = np.random.default_rng(seed)
        if episode is None:
            episode = int(rng.integers(len(self.episodes)))
        if not 0 <= episode < len(self.episodes):
            raise InputError(f"episode = {episode} is not in 0..{len(self.episodes) - 1}, the episodes of these trips")
        trips = self.episodes[episode]
        kept = np.flatnonzero(rng.random(trips.arrival.size) < self.fraction)
        requests = DrawnRequests(
            arrival=trips.arrival[kept].astype(np.int64),
            pickup=trips.pickup[kept].astype(np.int64),
            dropoff=trips.dropoff[kept].astype(np.int64),
            travel_time=trips.travel_time[kept],
        )
        return furnish(self.settings, self.world, requests, rng).with_noise(rng)

    def order(self, count: int, seed: int | np.random.SeedSequence) -> list[int]:
        """Return the number of the episode that each instance of ``sample(count, seed)`` realises.

        Each episode once, in an order that the seed shuffles; then the same order again.

        Raises
        ------
        InputError
            If ``count`` or ``seed`` is negative.
        """
        check_count(count)
        shuffled = np.random.default_rng(seed_sequence(seed)).permutation(len(self.episodes))
        return [int(shuffled[i % shuffled.size]) for i in range(count)]

    def sample(self, count: int, seed: int | np.random.SeedSequence) -> list[Instance]:
        """Realise ``count`` episodes, each once before any comes again (see :meth:`order`), each time anew.

        Seeds are spawned as in :meth:`optkit.instances.scenario.Scenario.sample`: the first instances of a larger
        sample are those of a smaller one.

        Raises
        ------
        InputError
            If ``count`` or ``seed`` is negative.
        """
        check_sample(self.settings, count)
        order = self.order(count, seed)
        return [self.instance(child, e) for child, e in zip(seed_sequence(seed).spawn(count), order, strict=True)]

    def split(self) -> Split:
        """Training, test and validation instances of distinct episodes, fixed by the world's seed.

        76/20/10 in the paper. With fewer episodes than ``settings.split`` asks for, its parts shrink in proportion, to
        at least one each.

        Raises
        ------
        DataError
            If there are fewer episodes than parts.
        """
        sizes = _shrunk(self.settings.split, len(self.episodes))
        return cut(self.sample(sum(sizes), self._split_seed), sizes)

    def further(self, part: Part, count: int) -> list[Instance]:
        """Realise the half-hours of a part of the split anew, one after the other; see the base class.

        Raises
        ------
        InputError
            If there is no such part or it is empty, or ``count`` is negative.
        """
        check_sample(self.settings, count)
        seeds = self._further_seed(part).spawn(count)
        own = self.episodes_of(part)
        if count and not own:
            raise InputError(f"split = {self.settings.split} has no {part} half-hours: give each part at least 1")
        return [self.instance(seed, own[i % len(own)]) for i, seed in enumerate(seeds)]

    def episodes_of(self, part: Part) -> list[int]:
        """Return the number of the episode behind each instance of a part of the split."""
        sizes = _shrunk(self.settings.split, len(self.episodes))
        order = self.order(sum(sizes), self._split_seed)
        at = Split._fields.index(part)
        return order[sum(sizes[:at]) : sum(sizes[: at + 1])]

    @property
    def _split_seed(self) -> np.random.SeedSequence:
        return stream(self.seed, Stream.SPLIT)

    def describe(self) -> dict[str, Any]:
        """Name, seed, settings, mode, fraction and source of the trips as plain data."""
        more = {"mode": self.mode, "fraction": self.fraction, "episodes": len(self.episodes), "trips": self.source}
        return super().describe() | more


def check_selection(mode: Any, fraction: Any) -> None:
    """Refuse what says not how trips become instances.

    Parameters
    ----------
    mode, fraction : str, float or None
        See :func:`trip_scenario`.

    Raises
    ------
    InputError
        If the mode is unknown, or the fraction is no number above 0 and at most 1.
    """
    if not isinstance(mode, str) or mode not in MODES:
        raise InputError(f"no mode {mode!r}; there are {', '.join(MODES)}")
    if fraction is not None:
        number("fraction", fraction, above=0.0, most=1.0)


def trip_scenario(
    name: str, seed: int, trips: Trips | Paths, *, mode: Mode = "folded", fraction: float | None = None, **settings: Any
) -> TripScenario:
    """Make a scenario of the paper's Table 1 from trip records.

    Half an hour is cut into ``settings.horizon`` steps (120 of 15 seconds). A request arrives at its trip's pick-up and
    goes between the trip's regions; its travel time is the trip's, in half-hours: of the magnitude that distances in
    the unit square have. Everything else is drawn as in the synthetic scenarios.

    Parameters
    ----------
    name : {"nyc-weak", "nyc-strong"}
        In nyc-strong, workers love to be picked up in region 1 and shun to end there, by 30 money units each. Both
        share their world, and all but utilities, at the same seed.
    seed : int
        The world's seed.
    trips : Trips or paths
        Trip records, see :func:`optkit.instances.new_york.trips.read_trips`.
    mode : {"folded", "mondays"}
        ``folded``: an episode pools one week's trips of Monday to Friday, 7:00 to 19:00, by their place in the first
        or the second half of the hour: 106 episodes a year even from a small sample of trips. ``mondays``, the paper's
        own: Mondays from 11:00 to 12:00, two episodes each.
    fraction : float, optional
        Probability that a trip becomes a request, the same in all episodes, so that their differences remain. Unless
        given, ``folded`` aims at a mean of ``request_rate * horizon`` requests (50; all trips if there are fewer) and
        ``mondays`` keeps the paper's 0.3. Complete TLC months have thousands of trips in a half-hour: there, pass
        about 0.01.
    **settings
        Fields of :class:`optkit.instances.settings.ScenarioSettings` to change. The request rate matters only as said
        above.

    Returns
    -------
    TripScenario
        Its episodes are the half-hours that instances are drawn from.

    Raises
    ------
    InputError
        If the name, mode, fraction or a setting is unknown or out of range.
    DataError
        If the trips cannot be read, or none lies in the hours of the mode.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from optkit.instances.new_york.trips import Trips
    >>> times = np.datetime64("2018-01-01T07", "s") + 60 * np.arange(40_000)  # a trip a minute, for four weeks
    >>> frame = pd.DataFrame({"pickup_time": times, "pickup": 0, "dropoff": 1, "travel_time": 12.0})
    >>> trips = Trips(frame, report={}, rows=40_000, files=(), period=(times[0], times[-1]))
    >>> weeks = trip_scenario("nyc-weak", 0, trips)
    >>> [episode.label for episode in weeks.episodes[:2]], weeks.episodes[0].arrival.size
    (['2018-W01 first half', '2018-W01 second half'], 1800)
    >>> weeks.sample(3, seed=0)[2]
    Instance(horizon=120, requests=..., workers=..., groups=1, noise=dense)
    """
    key = str(name).lower().replace("_", "-")
    if key not in TABLE_1 or not key.startswith("nyc"):
        raise InputError(f"no scenario {name!r} with trips; there are nyc-weak and nyc-strong")
    seed = whole_number("the world's seed", seed, least=0)
    check_selection(mode, fraction)
    chosen = adjust(TABLE_1[key], settings)
    if (chosen.pickups, chosen.dropoffs) != (len(REGIONS), len(REGIONS)):
        raise InputError(f"settings pickups and dropoffs must stay {len(REGIONS)}: trips know {len(REGIONS)} regions")
    records = trips if isinstance(trips, Trips) else read_trips(trips, when=MODES[mode].hours)
    episodes = cut_episodes(records, mode, chosen.horizon)
    if fraction is None:
        mean = sum(episode.arrival.size for episode in episodes) / len(episodes)
        fraction = min(1.0, chosen.request_rate * chosen.horizon / mean) if mode == "folded" else PAPER_FRACTION
    return TripScenario(
        name=key,
        seed=seed,
        settings=chosen,
        world=World.draw(chosen, world_generator(seed)),
        mode=mode,
        fraction=float(fraction),
        episodes=tuple(episodes),
        source={"files": list(records.files), "rows": records.rows, "dropped": dict(records.report)},
    )


def _shrunk(sizes: tuple[int, int, int], episodes: int) -> tuple[int, int, int]:
    if sum(sizes) <= episodes:
        return sizes
    asked = np.array(sizes)
    if episodes < (asked > 0).sum():
        raise DataError(f"{episodes} episode(s) do not make {(asked > 0).sum()} parts; bring trips of more weeks")
    exact = asked * episodes / asked.sum()
    whole = np.maximum(np.floor(exact).astype(int), asked > 0)
    while whole.sum() != episodes:
        # The part that is furthest from its share gives, or takes, one; no part falls to nothing.
        short = exact - whole
        if whole.sum() < episodes:
            whole[short.argmax()] += 1
        else:
            whole[np.where(whole > 1, short, np.inf).argmin()] -= 1
    return int(whole[0]), int(whole[1]), int(whole[2])
