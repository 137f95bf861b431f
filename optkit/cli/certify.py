"""``optkit certify``: how far policies are from optimal, with proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from optkit.basics.arrays import number
from optkit.basics.errors import InputError
from optkit.basics.printable import printable
from optkit.cli.console import open_source, progress_bar, say, say_json
from optkit.cli.options import Believed, Fraction, Jobs, Json, Mode, Quiet, Seed, Setting, Traceback, Trips
from optkit.cli.output import FIGURE, ROWS, write_rows
from optkit.cli.policy_file import own_policies

if TYPE_CHECKING:
    from optkit.bounds.penalised.linear_charges import LinearCharges
    from optkit.gap.charging import Charging
    from optkit.instances.instance import Instance
    from optkit.instances.scenario import Scenario, Split
    from optkit.models.preferences.preferences import Preferences
    from optkit.simulation.simulator import Policy

NAMED = ("myopic", "linear", "kernel", "charging")


def certify(
    source: Annotated[str, typer.Argument(help="A scenario (I.1, I.2, I.3, II, nyc-weak, nyc-strong) or a folder.")],
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="myopic, linear, kernel, a file of optkit train, own.py:NAME for a policy of your own (the file is "
            "run), or charging: the policy of the value function that the penalised bound charges with; repeatable. "
            "Myopic and linear by default."
        ),
    ] = None,
    seed: Seed = 0,
    trips: Trips = None,
    mode: Mode = None,
    fraction: Fraction = None,
    settings: Setting = None,
    instances: Annotated[
        int | None,
        typer.Option(min=2, help="Test instances to use, all by default; a scenario draws more than its split has."),
    ] = None,
    kinds: Annotated[
        str | None,
        typer.Option(
            help="Bounds, by commas: full, lagrangian, penalised-lagrangian, arrival, penalised. "
            "All that can be but the second penalised one, which is for days on which dozens of requests wait at once."
        ),
    ] = None,
    worker_rate: Annotated[
        str | None,
        typer.Option(
            help="Folders of your own: mean number of workers who join a step (Poisson), if you know it; or learned: "
            "rates by time of day, from the days that are not measured on."
        ),
    ] = None,
    train: Annotated[
        Path | None,
        typer.Option(help="Folder of other days to train and learn on; then all days of SOURCE are measured on."),
    ] = None,
    group_share: Annotated[
        str | None, typer.Option(help="With --worker-rate and several groups: their probabilities, e.g. 0.3,0.7.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=0, help="Waiting requests told apart, 14 by default; work doubles with each.")
    ] = None,
    preferences: Believed = None,
    jobs: Jobs = None,
    checkpoint: Annotated[
        Path | None, typer.Option(help="File that keeps finished instances; a rerun goes on.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Also write a row per instance to this .csv or .parquet file.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Also draw bounds and policies to this .png or .pdf file.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    traceback: Traceback = False,
) -> None:
    """Say, with proof, how far policies are at most from the best that any policy can earn.

    Policies are trained on the training instances and measured on the test instances, where every bound's certificate
    is checked. The penalised bound needs to know the process: a scenario does, and so does a folder that optkit
    generate wrote; of your own, give --worker-rate. What was assumed is said, and tested on the test instances, what
    was not learned on the training instances too: where they contradict it there is no penalised bound, one line says
    why, and the exit status is 1.
    """
    from optkit.basics.parallel import check_jobs
    from optkit.bounds.arrival.exact import check_limit
    from optkit.gap.report import chosen_kinds, gap_report
    from optkit.models.preferences.preferences import Preferences
    from optkit.plotting.files import figure_bytes

    jobs = None if jobs is None else check_jobs(jobs, "--jobs")
    if limit is not None:
        check_limit(limit)
    reads = [one for one in (checkpoint, preferences) if one is not None]
    if out is not None:
        ROWS.check(out, reads=reads)
    if plot is not None:
        FIGURE.check(plot, "--plot", reads)
    wanted = policy or ["myopic", "linear"]
    given = _given_policies(wanted)
    if preferences is not None and not {*wanted} & {"myopic", "linear", "kernel"}:
        raise InputError("--preferences goes with --policy myopic, linear or kernel, and none of them is asked for")
    believed = None if preferences is None else Preferences.load(preferences)
    shares, rate = _shares(group_share), _rate(worker_rate)
    chosen = None if kinds is None else chosen_kinds([kind.strip() for kind in kinds.split(",")])
    opened = open_source(source, seed=seed, trips=trips, mode=mode, fraction=fraction, settings=settings)
    more: dict[str, Any] = {"n_jobs": jobs, "checkpoint": checkpoint, "seed": seed}
    if limit is not None:
        more["limit"] = limit
    if chosen is not None:
        more["kinds"] = chosen
    with progress_bar(quiet or as_json) as tell:
        charge = chosen is None or "penalised" in chosen
        linear = chosen is not None and "penalised-lagrangian" in chosen
        split, tested, charging, noise = _prepare(opened, train, instances, rate, shares, charge or linear, tell)
        if charging is None and chosen is not None and (charge or linear):
            raise InputError(f"--kinds penalised: nothing tells how workers come in {source}: give --worker-rate")
        if charging is not None:
            if linear:
                tell("linear charges", 0, 1)
                more["charges"] = _linear_charges(opened, split, charging)
            more |= {"value": charging.value, "foresight": charging.foresight, "assumptions": charging.assumptions}
            more |= {"learned": charging.learned, "known_process": not isinstance(opened, Path)}
            if isinstance(opened, Path) and charging.learned is None:
                more["others"] = [*split.train, *split.validation, *split.test[len(tested) :]]
        more["assumptions"] = (*more.get("assumptions", ()), *noise)
        named = _policies(wanted, given, split, charging, believed, tell)
        report = gap_report(tested, named, progress=lambda k, n: tell("certifying", k, n), **more)
    if as_json:
        say_json({"source": source, **report.to_dict()})
    else:
        say(f"{source}: {len(report.rows)} test instances", *report.summary().split("\n"))
    if out is not None:
        write_rows(report.rows, out)
    if plot is not None:
        FIGURE.write(plot, figure_bytes(report.plot(), plot.suffix[1:]), "--plot")
    if report.failures or report.refused:
        raise typer.Exit(1)


def _prepare(
    opened: Scenario | Path,
    train: Path | None,
    count: int | None,
    worker_rate: float | Literal["learned"] | None,
    shares: list[float] | None,
    charge: bool,
    tell: Callable[[str, int, int], object],
) -> tuple[Split, list[Instance], Charging | None, list[str]]:
    """Return instances to train on and to measure on, what a penalised bound needs, and what to say of noise."""
    from optkit.gap.charging import scenario_charging, worker_charging
    from optkit.instances.catalogue import scenario_of, worker_settings
    from optkit.instances.splits import held_out, read_apart, read_split
    from optkit.learning.worker_rates import learn_worker_rates

    if shares is not None and worker_rate is None:
        raise InputError("--group-share goes with --worker-rate")
    if train is not None and not isinstance(opened, Path):
        raise InputError("--train goes with a folder: a scenario draws its own training instances")
    noise: list[str] = []
    if isinstance(opened, Path):
        split, origin = read_split(opened) if train is None else read_apart(opened, train)
        if "noise" in origin:
            noise.append(f"noise: drawn here for {origin['noise']} instances of the folder, which have none")
        if not split.test:
            raise InputError(f"{opened} has no test instances to measure on")
        tested, told = split.test, origin["sets"].get("test", origin["sets"].get("set"))["scenario"]
        if count is not None and count > len(tested):
            raise InputError(f"--instances {count}: {opened} has {len(tested)} test instances")
        tested, source, known = tested[:count], scenario_of(told), worker_settings(told)
        if source is None and known is not None and worker_rate is None:  # drawn from trips: its workers are known
            worker_rate, shares = known.worker_rate, [1.0 / known.groups] * known.groups
    else:
        if worker_rate is not None:
            raise InputError("--worker-rate goes with a folder: a scenario knows its own")
        split, tested, source = opened.split(), held_out(opened, count), opened
    if not charge or (worker_rate is None and source is None):
        return split, tested, None, noise
    tell("charging", 0, 1)
    if worker_rate == "learned":
        others = [*split.train, *split.validation]
        charging = worker_charging(split.train, learn_worker_rates(others), shares)
    elif worker_rate is not None:
        charging = worker_charging(split.train, worker_rate, shares)
    else:
        assert source is not None
        charging = scenario_charging(source)
        if isinstance(opened, Path):
            drawn = f"instances: drawn from {source.name}, world {source.seed}, as scenario.json says"
            charging = replace(charging, assumptions=(drawn, *charging.assumptions))
    tell("charging", 1, 1)
    return split, tested, charging, noise


def _linear_charges(opened: Scenario | Path, split: Split, charging: Charging) -> LinearCharges:
    """Fit linear charges to the training instances; who knows the scenario's requests charges for them too."""
    from optkit.bounds.penalised.charge_fit import fit_linear_charges
    from optkit.gap.charging import scenario_linear_charges

    if not isinstance(opened, Path):
        return scenario_linear_charges(opened, split.train)
    return fit_linear_charges(split.train, charging.foresight)


def _rate(text: str | None) -> float | Literal["learned"] | None:
    if text is None or text == "learned":
        return cast("Literal['learned'] | None", text)
    try:
        rate = float(text)
    except ValueError:
        raise InputError(f"--worker-rate {text}: give a mean number of workers a step, or the word learned") from None
    return number("--worker-rate", rate, least=0.0)


def _shares(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        shares = [float(share) for share in text.split(",")]
    except ValueError:
        raise InputError(f"--group-share {text} is not of the form 0.3,0.7: numbers, one for each group") from None
    shares = [number("--group-share", share, least=0.0, most=1.0) for share in shares]
    if abs(sum(shares) - 1.0) > 1e-6:
        raise InputError(f"--group-share {text} adds up to {sum(shares):g}, not to 1")
    return shares


def _given_policies(wanted: list[str]) -> dict[str, Policy]:
    """Read the policies of files; refuse, before any work, one that is no name and no file, or comes twice."""
    from optkit.learning.trained import Trained

    own = [name for name in wanted if not name.endswith(".json") and ".py:" in name]
    given: dict[str, Policy] = {name: Trained.load(name).policy for name in wanted if name.endswith(".json")}
    for name in wanted:
        if name not in (*given, *own, *NAMED):
            raise InputError(
                f"--policy {name}: take {', '.join(NAMED)}, a .json file that optkit train wrote, or own.py:NAME"
            )
    called = [_called(name) for name in wanted]
    for name in called:
        if called.count(name) > 1:
            raise InputError(f"two of the policies are called {name}: rename one")
    return given | own_policies(own)


def _called(name: str) -> str:
    """Name of a policy in the report: of a file without its folder and ending, of one's own without its file."""
    short = name.rpartition(".py:")[2] if ".py:" in name else Path(name).stem if name.endswith(".json") else name
    return printable(short)


def _policies(
    wanted: list[str],
    given: dict[str, Policy],
    split: Split,
    charging: Charging | None,
    believed: Preferences | None,
    tell: Callable[[str, int, int], object],
) -> dict[str, Policy]:
    """Return the policies by name; those of names believe the preferences that are given, or know the truth."""
    from optkit.learning.training import train
    from optkit.policies import PostDecisionPricing

    myopic = PostDecisionPricing() if believed is None else PostDecisionPricing(choice=believed)
    found: dict[str, Policy] = {}
    for done, name in enumerate(wanted):
        tell("policies", done, len(wanted))
        if name == "myopic":
            found[name] = myopic
        elif name == "charging":
            if charging is None:
                raise InputError("--policy charging: there is no penalised bound here to charge for")
            found[name] = charging.policy
        elif name in NAMED:
            found[name] = train(split, name, choice="true" if believed is None else believed).policy
        else:
            found[_called(name)] = given[name]
    tell("policies", len(wanted), len(wanted))
    return found
