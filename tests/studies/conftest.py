"""Studies whose cells nobody worked out: numbers drawn from the cell's key, in the form of a cell's results."""

import numpy as np
import pytest

from optkit.studies.grids import Study
from optkit.studies.runner import StudyRun
from optkit.studies.store import Stored

DAYS, KINDS = 12, 30


def made_up_result(cell):
    rng = np.random.default_rng(int(cell.key, 16))
    same = np.random.default_rng([cell.place["world"], len(cell.place["scenario"])])  # what cells of a place share
    groups = 3 if cell.place["scenario"] == "II" else 1
    full, penalty = same.uniform(200, 300, DAYS), -same.uniform(20, 60, DAYS)
    requests, workers = same.integers(15, 30, DAYS), same.integers(15, 30, DAYS)
    reward = (full - rng.uniform(5, 60, DAYS)).tolist()
    served = same.integers(5, 15, DAYS)
    errors = {"rmse": rng.uniform(0, 3, groups).tolist(), "mbe": rng.normal(0, 2, groups).tolist()}
    if cell.kind == "bounds":
        sizes = {"penalty": penalty.tolist(), "requests": requests.tolist(), "workers": workers.tolist()}
        bounds = {"full": full.tolist(), "lagrangian": (full - 4).tolist(), "arrival": (full - 6).tolist()}
        return {**bounds, **sizes, "certificate_gap": {"full": 1e-12, "lagrangian": 4e-7, "arrival": 2e-10}}
    if cell.kind == "utilities":
        return {
            "type": (np.arange(KINDS) % 5).tolist(),
            "pickup": (np.arange(KINDS) % 4).tolist(),
            "dropoff": (np.arange(KINDS) // 4 % 4).tolist(),
            "count": same.integers(1, 5, KINDS).tolist(),
            "utility": rng.uniform(-60, -10, (groups, KINDS)).tolist(),
        }
    if cell.kind == "policy":
        result = {"score": float(rng.uniform(100, 200)), "reward": reward, "served": served.tolist()}
        result |= {"margin": reward, "paid": (served * 20.0).tolist()}
        if cell.settings.get("detail"):
            asked = same.integers(5, 20, (4, 4))
            asked[3, 2] = 0  # nobody asked
            taken = (asked * rng.uniform(0.2, 1, (4, 4))).astype(int)
            over = rng.normal(3, 2, int(served.sum()))
            result |= {"asked": asked.tolist(), "taken": taken.tolist(), "over": over.tolist()}
        return result
    if cell.kind == "estimate":
        return {"error": rng.normal(0, 2, (groups, KINDS)).tolist(), **errors}
    if cell.kind == "perturbed":
        return {"reward": reward, "served": served.tolist(), **errors}
    names = ("Myopic, true MNL", "Charging, true MNL")
    gaps = {"bound": "penalised", "points": 0.5, "points_low": 0.2, "points_high": 0.8, "claim": 0.7}
    return {
        "bounds": [{"kind": "penalised", "points": 93.0}],
        "policies": [{"policy": name, "points": 92.5} for name in names],
        "gaps": [{"policy": name, **gaps} for name in names],
        "best": {"bound": "penalised"},
        "instances": DAYS,
        "failures": {},
    }


def maker(folder):
    """Return what makes a study and its run with made-up results, as ``made_up(name, worlds)``."""
    trips = folder / "trips"
    trips.mkdir()
    (trips / "a_tripdata.csv").write_text("only its digest matters")

    def make(name, worlds=(0,), seconds=1.0, leave=lambda cell: False):
        study = Study(name, worlds=worlds, seeds=2, trips=(str(trips),) if name == "nyc" else ())
        cells = study.cells()
        found = {cell.key: Stored(made_up_result(cell), seconds) for cell in cells if not leave(cell)}
        return study, StudyRun(cells, found)

    return make


@pytest.fixture
def made_up(tmp_path):
    """Return a study and its run with made-up results, as ``made_up(name, worlds)``; trip files lie in ``trips``."""
    return maker(tmp_path)


@pytest.fixture(scope="module")
def made_once(tmp_path_factory):
    """The same for what several tests share."""
    return maker(tmp_path_factory.mktemp("shared"))
