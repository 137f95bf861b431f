"""The paper's figures from the results of the studies, each with a few sentences on how to read it.

    python examples/3-paper/figures.py                            small studies, worked out here in half a minute
    python examples/3-paper/figures.py results/studies figures    from what optkit study left, into a folder
    python examples/3-paper/figures.py --small                    with few short days and one draw of each belief

What is drawn is what is there: cells that no study has worked out yet are missing in the figures.
"""

import sys
import tempfile
from pathlib import Path

from optkit.basics.files import write_whole
from optkit.plotting.files import figure_bytes
from optkit.studies.claims.verdicts import claims
from optkit.studies.grids import Study
from optkit.studies.report.figures import study_figures
from optkit.studies.runner import load, run_cells
from optkit.studies.store import CellStore
from optkit.studies.tables import study_tables

READING = {
    "perf_syn": "Each box is a policy on the same test instances: quartiles, whiskers, and the mean beneath. 100 is a "
    "clairvoyant. Look how far those who know or have learned preferences stand above the rules FP and PP.",
    "perf_syn_2": "The same with three groups of workers. A single model believes in an average worker whom nobody is: "
    "compare it with a model for each group, and with the truth.",
    "sens_syn": "Each bubble is one perturbed belief: its size and number are the ratio, its colour the mean error. "
    "Compare dark bubbles, whose beliefs overestimate how much workers like requests, with light ones.",
    "sens_syn_2": "The same with three groups: an error about one of them touches a third of the workers, one "
    "about all touches everybody. Compare the lines of a group with those of all.",
    "utility_scen_2": "What requests are worth to each group before pay, by type: where the histograms of two groups "
    "do not overlap, one price cannot suit both.",
    "mnl_momnl": "True less estimated utility. A single model is wrong by as much as the groups differ; separate "
    "models by what the data leave open. Compare the paper's random offers with re-estimation.",
}
"""How to read a figure; what it shows is said by numbers."""


SHORT = {"horizon": 25, "split": (60, 12, 12)}
SMALL = {"horizon": 5, "split": (16, 4, 4)}


def results(folder: Path | None, name: str, small: bool):
    """Return the tables of a study: from a folder of finished cells, or worked out here on few small instances."""
    if folder is not None:
        study = Study(name)
        return study_tables(load(study.cells(), CellStore(folder / "cells")))
    study = Study(name, seeds=1, settings=SMALL if small else SHORT, gap=False, draws=1 if small else 10)
    cells = [cell for cell in study.cells() if "Attention" not in str(cell) and "Kernel" not in str(cell)]
    with tempfile.TemporaryDirectory() as scratch:
        return study_tables(run_cells(cells, CellStore(scratch)))


def main(source: str | None = None, target: str | None = None, *, small: bool = False) -> None:
    """Draw the figures of three studies and say what they show."""
    folder = None if source is None else Path(source)
    for name in ("homogeneous", "heterogeneous", "sensitivity"):
        tables = results(folder, name, small)
        for label, figure in study_figures(tables).items():
            kind = label if label in READING else label.rpartition("_")[0]
            print(f"{label}: {READING[kind]}\n")
            image = figure_bytes(figure.axes[0], "png")
            assert image.startswith(b"\x89PNG")
            if target is not None:
                Path(target).mkdir(parents=True, exist_ok=True)
                write_whole(Path(target) / f"{label}.png", image)
        found = claims(name, tables)
        assert found
        for one in found:
            print(f"Result {one['result']}, {one['verdict']}: {one['pattern']}")
            print(f"    the paper: {one['paper']}\n    here: {one['here']}\n")


if __name__ == "__main__":
    main(*(text for text in sys.argv[1:] if not text.startswith("-")), small="--small" in sys.argv)
