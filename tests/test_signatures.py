"""Every flag and every lone number of the public surface is what it should be, or refused in a line that names it."""

import importlib
import inspect
import pkgutil

import numpy as np
import pandas as pd
import pytest

import optkit
from optkit import Instance, gap_report, performance_ratio, simulate
from optkit.basics.errors import OptkitError
from optkit.instances.benchmark.sets import write_benchmark_sets
from optkit.instances.days import days_from_frames
from optkit.instances.storage import save_instances
from optkit.learning import learn_once, learn_preferences
from optkit.models.estimation import ConditionalLogit
from optkit.models.preferences.attributes import Attributes
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers
from optkit.models.preferences.preferences import Preferences
from optkit.models.pricing import certify, optimal_prices
from optkit.models.pricing_program import PricingProgram
from optkit.models.value import KernelValue, LinearValue
from optkit.models.value.attention.settings import AttentionSettings
from optkit.policies import Formula, RewardPercentage
from optkit.studies.grids import Study

TABLES = (
    pd.DataFrame({"day": "Mon", "arrival": [0], "expiry": 1, "reward": 9.0, "utility": 1.0}),
    pd.DataFrame({"day": "Mon", "step": [0]}),
)
LOG = Offers([0, 0, 1], [0, 0, 0], [[1.0], [2.0], [3.0]], [0] * 3, [0] * 3, [9.0, 8.0, 1.0], [1, 0, 0])
PRICES = ([1.0, 2.0], [3.0, 4.0], [0.0, 0.0])
ROWS = {"endog": [1, 0, 0, 1], "exog": [[1.0], [2.0], [1.5], [3.0]], "groups": [0, 0, 1, 1]}
FRAME = pd.DataFrame({"y": ROWS["endog"], "x": [1.0, 2.0, 1.5, 3.0], "s": ROWS["groups"]})


def fitted():
    return ConditionalLogit(**ROWS, penalty=1.0).fit()


def report(**given):
    """A report that is told all that it can be told, and has no instances."""
    return gap_report([], {"half": lambda state: 0.5 * state.reward}, **given)


FLAGS = {
    "performance_ratio in_the_mean": lambda x: performance_ratio([1.0], [2.0], [0.0], in_the_mean=x),
    "simulate keep_offers": lambda x: simulate([], RewardPercentage(0.5), keep_offers=x),
    "Simulation.to_frame rejected": lambda x: simulate([], RewardPercentage(0.5)).to_frame(rejected=x),
    "Instance.from_frames queue": lambda x: Instance.from_frames(*(t.drop(columns="day") for t in TABLES), queue=x),
    "days_from_frames queue": lambda x: days_from_frames(*TABLES, day="day", queue=x),
    "save_instances overwrite": lambda x: save_instances(".", [], overwrite=x),
    "write_benchmark_sets overwrite": lambda x: write_benchmark_sets(".", ["none"], overwrite=x),
    "gap_report known_process": lambda x: report(known_process=x),
    "learn_once pooled": lambda x: learn_once([], pooled=x),
    "learn_preferences pooled": lambda x: learn_preferences([], pooled=x),
    "fit_preferences pooled": lambda x: fit_preferences(LOG, ridge=1.0, pooled=x),
    "fit_preferences robust": lambda x: fit_preferences(LOG, ridge=1.0, robust=x),
    "Preferences pooled": lambda x: Preferences(Attributes(("km",)), np.ones((1, 2)), np.ones(1), pooled=x),
    "Attributes reference": lambda x: Attributes(("km",), reference=x),
    "ConditionalLogit outside_option": lambda x: ConditionalLogit(**ROWS, outside_option=x),
    "ConditionalLogit.from_formula outside_option": lambda x: ConditionalLogit.from_formula(
        "y ~ x", FRAME, groups="s", outside_option=x
    ),
    "ConditionalLogit.fit disp": lambda x: ConditionalLogit(**ROWS, penalty=1.0).fit(disp=x),
    "ConditionalLogit.fit use_correction": lambda x: ConditionalLogit(**ROWS, penalty=1.0).fit(
        cov_type="cluster", cov_kwds={"groups": [0, 1], "use_correction": x}
    ),
    "ConditionalLogitResults.predict transform": lambda x: fitted().predict(transform=x),
    "ConditionalLogitResults.t_test use_t": lambda x: fitted().t_test([1.0], use_t=x),
    "ConditionalLogitResults.wald_test use_f": lambda x: fitted().wald_test([1.0], use_f=x),
    "certify nonnegative": lambda x: certify(*PRICES, nonnegative=x),
    "optimal_prices nonnegative": lambda x: optimal_prices(*PRICES[1:], nonnegative=x),
    "PricingProgram nonnegative": lambda x: PricingProgram(2, x),
    "LinearValue by_group": lambda x: LinearValue(by_group=x).fit(None),
    "AttentionSettings empty_is_zero": lambda x: AttentionSettings(empty_is_zero=x),
    "AttentionSettings scaled": lambda x: AttentionSettings(scaled=x),
    "Study gap": lambda x: Study("homogeneous", gap=x),
}
NUMBERS = {
    "certify tolerance": lambda x: certify(*PRICES, tolerance=x),
    "gap_report confidence": lambda x: report(confidence=x),
    "learn_preferences tolerance": lambda x: learn_preferences([], tolerance=x),
    "learn_preferences deviation": lambda x: learn_preferences([], deviation=x),
    "fit_preferences ridge": lambda x: fit_preferences(LOG, ridge=x),
    "fit_preferences scale_penalty": lambda x: fit_preferences(LOG, scale_penalty=x),
    "ConditionalLogit.fit tol": lambda x: ConditionalLogit(**ROWS, penalty=1.0).fit(tol=x),
    "ConditionalLogitResults.conf_int alpha": lambda x: fitted().conf_int(x),
    "ConditionalLogitResults.summary alpha": lambda x: fitted().summary(alpha=x),
    "KernelValue gamma": lambda x: KernelValue(gamma=x).fit(None),
    "KernelValue ridge": lambda x: KernelValue(ridge=x).fit(None),
    "KernelValue memory": lambda x: KernelValue(memory=x).fit(None),
    "LinearValue ridge": lambda x: LinearValue(ridge=x).fit(None),
    "LinearValue memory": lambda x: LinearValue(memory=x).fit(None),
    "Formula reward": lambda x: Formula(x),
    "Formula distance": lambda x: Formula(0.5, distance=x),
    "Formula penalty": lambda x: Formula(0.5, penalty=x),
    "Formula expiry_boost": lambda x: Formula(0.5, expiry_boost=x),
    "RewardPercentage share": lambda x: RewardPercentage(x),
}
MADE = (
    "Bound",
    "GapReport",
    "IdentificationReport",
    "Learned",
    "PriceCertificate",
    "SolverRecord",
    "Trained",
    "Verdict",
)
"""What the kit returns and nobody makes."""


def signatures():
    """Every public function and method, by its name."""
    for module in pkgutil.walk_packages(optkit.__path__, "optkit."):
        if module.ispkg and not module.name.startswith(("optkit.cli", "optkit.basics", "optkit.teach")):
            home = importlib.import_module(module.name)
            for name in getattr(home, "__all__", ()):
                one = getattr(home, name)
                if name in MADE or (inspect.isclass(one) and issubclass(one, Exception)):
                    continue
                if callable(one):
                    yield name, one
                    methods = vars(one).items() if inspect.isclass(one) else ()
                    for method, function in methods:
                        function = getattr(function, "__func__", function)
                        if inspect.isfunction(function) and not method.startswith("_"):
                            yield f"{name}.{method}", function


def test_none_is_forgotten():
    """Each parameter that is a flag or one float, of all that packages offer, is tried below."""
    flags, numbers = set(), set()
    for name, one in signatures():
        for parameter in inspect.signature(one).parameters.values():
            kind = str(parameter.annotation)
            if kind.startswith("bool"):
                flags.add(f"{name} {parameter.name}")
            if kind == "float":
                numbers.add(f"{name} {parameter.name}")
    assert flags - set(FLAGS) == set()
    assert numbers - set(NUMBERS) == set()


def told(call, value):
    """The line in which something is refused; nothing where it is taken, or fails of what else was given."""
    try:
        call(value)
    except OptkitError as error:
        return str(error)
    except AttributeError:  # a fit to no experience at all
        return ""
    return ""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("which", FLAGS)
def test_flags_are_true_or_false(which):
    name = which.split()[-1]
    for value in ("False", "True", "", 0, 1, 1.0, np.nan, [True], np.array(True), np.ma.masked, object()):
        line = told(FLAGS[which], value)
        assert line.startswith(f"{name} = "), (value, line)
        assert "\n" not in line
    for value in (True, False, np.True_, np.False_):
        assert not told(FLAGS[which], value).startswith(f"{name} = ")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("which", NUMBERS)
def test_numbers_are_finite_numbers(which):
    name = which.split()[-1]
    strange = ("a", "0.5", None, True, [1e-9], np.array([0.5]), 1j, np.nan, np.inf, -np.inf, 10**400, np.ma.masked)
    for value in (*strange, np.timedelta64(1), np.datetime64("2020")):
        line = told(NUMBERS[which], value)
        assert f"{name} = " in line, (value, line)
        assert "\n" not in line
    for value in (0.5, np.float32(0.5), np.array(0.5)):
        assert f"{name} = " not in told(NUMBERS[which], value)
