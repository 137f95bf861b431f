"""Figures show the numbers of the tables, and are drawn exactly where the tables suffice."""

import numpy as np
import pandas as pd
import pytest

from optkit.instances.new_york.trips import manhattan_zones
from optkit.plotting.files import new_figure
from optkit.studies.grids import STUDIES
from optkit.studies.report.drawing import ink
from optkit.studies.report.figures import DRAWINGS, study_figures
from optkit.studies.report.histograms import edges_of, histogram_rows
from optkit.studies.report.maps import CENTROIDS, bubble_grid
from optkit.studies.tables import hopeful, study_tables

LABELS = [
    "utility_scen_2", "manhattan_utilities", "perf_syn_I.1", "perf_syn_I.2", "perf_syn_I.3", "sens_syn", "mnl_momnl",
    "perf_syn_2", "sens_syn_2", "nyt_combined_mnl", "perf_nyt_weak", "comp_nyt_weak", "perf_nyt_strong",
    "comp_nyt_strong", "fair_nyt_combined",
]  # fmt: skip
"""Of the figures of results in the paper's sections 4 and 5; fig:perf_syn has one panel for each scenario."""


def texts(figure):
    return [text.get_text() for ax in figure.axes for text in (*ax.texts, *ax.get_xticklabels(), *ax.get_yticklabels())]


def draw(tables, label):
    return DRAWINGS[label].draw(tables)


def most_policies(cell):
    """Whether a cell is of a policy beyond three, which say as much as all."""
    return cell.kind == "policy" and cell.settings["policy"] not in ("PP", "FP", "Myopic, true MNL")


def titles(figure):
    return [ax.get_title() for ax in figure.axes if ax.get_visible()]


@pytest.fixture(scope="module")
def drawn(made_once):
    """All figures of each study, by its name, and the tables that they show."""
    tables = {name: study_tables(made_once(name)[1]) for name in STUDIES}
    return {name: study_figures(table) for name, table in tables.items()}, tables


@pytest.mark.slow
def test_every_label_of_the_paper_is_drawn(drawn):
    """Full tables give all figures, each by one study, each on a canvas of its own; pyplot knows of none of them."""
    drawn, _ = drawn
    assert sorted(label for figures in drawn.values() for label in figures) == sorted(LABELS) == sorted(DRAWINGS)
    for name, figures in drawn.items():
        assert {DRAWINGS[label].study for label in figures} == {name}
        for label, figure in figures.items():
            assert not figure.canvas.manager, label
            figure.draw_without_rendering()


@pytest.mark.slow
def test_missing_tables_leave_figures_out(made_up):
    """A figure needs all that its entry names but means, and nothing else; no table, no figure, and no error."""
    assert study_figures({}) == {}
    tables = study_tables(made_up("nyc", leave=most_policies)[1])
    labels = [label for label in DRAWINGS if DRAWINGS[label].study == "nyc"]
    for left_out, lost in {
        "over": {"comp_nyt_weak", "comp_nyt_strong"},
        "pairs": {"fair_nyt_combined"},
        "errors": {"nyt_combined_mnl"},
        "utilities": {"manhattan_utilities"},
        "operations": set(),
    }.items():
        rest = {name: table for name, table in tables.items() if name != left_out}
        needed = {label for label in labels if left_out in DRAWINGS[label].tables}
        assert {label for label in needed if draw(rest, label) is None} == lost
    weak = {name: table[table["scenario"] == "nyc-weak"] for name, table in tables.items()}
    assert sorted(set(labels) - set(study_figures(weak))) == ["comp_nyt_strong", "perf_nyt_strong"]


@pytest.mark.parametrize("worlds", [(0,), (2, 5)])
def test_boxes_stand_above_the_means_of_the_table(drawn, made_up, worlds):
    """The means beneath are those of the table over worlds; where instances are pooled, the title says it."""
    if worlds == (0,):
        tables, figure = drawn[1]["homogeneous"], drawn[0]["homogeneous"]["perf_syn_I.2"]
    else:
        tables = study_tables(made_up("homogeneous", worlds, leave=most_policies)[1])
        figure = draw(tables, "perf_syn_I.2")
    table = tables["worlds"][tables["worlds"]["scenario"] == "I.2"]
    means = [label.get_text().split("\n")[-1] for label in figure.axes[0].get_xticklabels()]
    assert means == [f"{ratio:.1f}" for ratio in table["ratio"]]
    pooled = "" if len(worlds) == 1 else " of 2 worlds, pooled"
    assert titles(figure) == [f"Scenario I.2: {12 * len(worlds)} test instances{pooled}"]


def test_means_leave_out_what_the_table_leaves_out():
    """An instance in which one policy has no finite ratio counts for none."""
    rows = pd.DataFrame({"scenario": "I.1", "world": 0, "policy": ["FP", "FP", "PP", "PP"], "instance": [0, 1, 0, 1]})
    rows["ratio"] = rows["of_arrival"] = [90.0, 70.0, 80.0, -np.inf]
    assert hopeful(rows)["instance"].tolist() == [0, 0]
    assert {"FP\n90.0", "PP\n80.0"} <= set(texts(study_figures({"rows": rows})["perf_syn_I.1"]))
    assert study_figures({"rows": rows[rows["instance"] == 1]}) == {}


def test_pay_and_use_show_the_means_of_operations(drawn):
    """Above what accepted requests got beyond their burden, below the workers used, with the means of the table."""
    tables = drawn[1]["nyc"]
    upper, lower = drawn[0]["nyc"]["comp_nyt_strong"].axes
    table = tables["operations"][tables["operations"]["scenario"] == "nyc-strong"]
    for ax, column in ((upper, "over"), (lower, "utilised")):
        means = [label.get_text().split("\n")[-1] for label in ax.get_xticklabels()]
        assert means == [f"{mean:.1f}" for mean in table[column]]
    assert "money" in upper.get_ylabel()
    assert "%" in lower.get_ylabel()


@pytest.mark.slow
@pytest.mark.parametrize(("label", "scenario", "lines"), [("sens_syn", "I.1", 4), ("sens_syn_2", "II", 13)])
def test_a_bubble_is_its_row(drawn, label, scenario, lines):
    """Number and area are the ratio, the colour is the MBE, the last column is the mean."""
    table = drawn[1]["sensitivity"]["sensitivity"]
    table = table[table["scenario"] == scenario]
    ax, bar = drawn[0]["sensitivity"][label].axes
    assert [round(tick) for tick in ax.get_yticks()] == list(range(lines))
    assert [tick.get_text() for tick in ax.get_xticklabels()] == [*map(str, range(10)), "average"]
    (bubbles,) = ax.collections
    assert len(bubbles.get_offsets()) == 1 + 11 * (lines - 1)
    numbers = {
        (round(x, 6), round(y - 0.48, 6)): text.get_text() for text in ax.texts for x, y in [text.get_position()]
    }
    last = ax.get_xticks()[-1]
    reach = table["mbe"].abs().max()
    assert np.allclose(bar.get_xlim(), [-reach, reach])
    lightness = {}
    for (x, y), size, colour in zip(
        bubbles.get_offsets().tolist(), bubbles.get_sizes(), bubbles.get_facecolor(), strict=True
    ):
        line = ax.get_yticklabels()[round(y + 0.12)].get_text()
        group = line[line.index("{") + 1] if "{" in line else "all"
        own = table[(table["group"] == group) & (table["epsilon"] == float(line.split("= ")[1]))]
        own = own if x == last else own[own["draw"] == x]
        assert numbers[round(x, 6), round(y, 6)] == f"{own['ratio'].mean():.1f}"
        full_size = 0.7**2 * (72 * 0.62) ** 2
        assert size == pytest.approx(full_size * own["ratio"].mean() / 100)
        lightness[own["mbe"].mean()] = colour[:3] @ [0.2126, 0.7152, 0.0722]
    shades = [lightness[mbe] for mbe in sorted(lightness)]
    assert shades == sorted(shades)  # so that grey tells over- from underestimation
    assert shades[-1] - shades[0] > 0.5


def test_a_lost_draw_has_no_bubble(drawn):
    """A ratio below 0 has a circle still, the smallest; what was not worked out has none."""
    table = drawn[1]["sensitivity"]["sensitivity"]
    table = table[(table["scenario"] == "I.1") & ~((table["epsilon"] == 4) & (table["draw"] == 3))].copy()
    table.loc[(table["epsilon"] == 4) & (table["draw"] == 4), "ratio"] = -30.0
    ax = bubble_grid({"sensitivity": table}, "I.1").axes[0]
    (bubbles,) = ax.collections
    places = {tuple(np.round(at, 2)): size for at, size in zip(bubbles.get_offsets(), bubbles.get_sizes(), strict=True)}
    assert len(places) == 33
    assert (3.0, 1.88) not in places
    assert places[4.0, 1.88] == min(places.values()) > 0
    assert "-30.0" in texts(ax.figure)


def test_histograms_hold_all_requests():
    """Bars have the shares of the requests, to one scale in all rows; the mean is weighted as the requests are."""
    rows = pd.DataFrame({"type": [1, 1, 2, 2], "utility": [-4.0, -1.0, -3.5, -2.5], "count": [3, 1, 1, 1]})
    ax = new_figure(4, 4).subplots()
    histogram_rows(ax, rows, "type", "utility", np.array([-4.0, -3, -2, -1]), ["type 1", "type 2", "type 3"])
    stairs = [one.get_data() for one in ax.patches]
    assert [one.baseline for one in stairs] == [2, 1, 0]
    heights = [one.values - one.baseline for one in stairs]
    assert np.allclose(heights, 0.86 / 0.75 * np.array([[0.75, 0, 0.25], [0.5, 0.5, 0], [0, 0, 0]]))
    assert [text.get_text() for text in ax.texts] == ["-3.25", "-3.00"]  # none where there is no request


def test_edges_hold_all_values_and_zero():
    for values in ([-3.0, 8.0], [1.0, 2.0], [-5.0, -4.0], [0.0, 0.0], [2.5]):
        for zero in (False, True):
            edges = edges_of(pd.Series(values), zero=zero)
            assert edges[0] <= min(values)
            assert max(values) <= edges[-1] + 1e-9
            assert (np.diff(edges) > 0).all()
            assert not zero or np.isclose(edges, 0.0).any()


def test_error_histograms_tell_the_rmse_of_the_table(drawn):
    """Each panel a way to learn, each row a group with its RMSE and its mean error, recomputed from the requests."""
    tables, figure = drawn[1]["heterogeneous"], drawn[0]["heterogeneous"]["mnl_momnl"]
    assert titles(figure) == [
        "One MNL for all groups, paper's data", "One MNL each, paper's data",
        "One MNL for all groups, re-estimated", "One MNL each, re-estimated",
    ]  # fmt: skip
    errors = tables["errors"]
    for ax, choice in zip(figure.axes, ("single-paper", "paper", "single", "learned"), strict=True):
        for group in (1, 2, 3):
            own = errors[(errors["choice"] == choice) & (errors["group"] == group)]
            each = np.repeat(own["error"].to_numpy(), own["count"])
            label = ax.get_yticklabels()[group - 1].get_text()
            assert label == f"group {group}\nRMSE {np.sqrt((each**2).mean()):.2f}"
            assert ax.texts[group - 1].get_text() == f"{each.mean():.2f}"


def test_places_have_their_own_names(drawn):
    """Pick-up regions stand as p, drop-off regions as d; both ways to learn have a line of panels."""
    panels = drawn[0]["nyc"]["nyt_combined_mnl"].axes
    assert len(panels) == 8
    for number, ax in enumerate(panels):
        letter = "pd"[number % 2]
        assert [label.get_text() for label in ax.get_yticklabels()] == [f"{letter} = {i}" for i in (1, 2, 3, 4)]
    wanted = ["Weak preferences, paper's data", "Strong preferences, re-estimated"]
    assert [panels[0].get_title().split("\n")[0], panels[7].get_title().split("\n")[0]] == wanted


@pytest.mark.slow
def test_a_scenario_without_an_estimate_has_no_panels(drawn):
    """Where one scenario's preferences could not be learned, the other's are shown nevertheless."""
    tables = dict(drawn[1]["nyc"])
    errors = tables["errors"]
    tables["errors"] = errors[~((errors["scenario"] == "nyc-strong") & (errors["choice"] == "paper"))]
    assert len(titles(draw(tables, "nyt_combined_mnl"))) == 6


def test_heat_maps_write_each_share(drawn):
    """Shares of requests served and utilities cell by cell, a dash where nobody asked, and the CV beneath."""
    tables, figure = drawn[1]["nyc"], drawn[0]["nyc"]["fair_nyt_combined"]
    for number, scenario in enumerate(("nyc-weak", "nyc-strong")):
        heat, side = figure.axes[2 * number : 2 * number + 2]
        rows = tables["pairs"][tables["pairs"]["scenario"] == scenario]
        policies = list(dict.fromkeys(rows["policy"]))
        cells = {text.get_position(): text.get_text() for text in heat.texts}
        aside = {text.get_position(): text.get_text() for text in side.texts}
        assert cells[-0.7, 15.8] == "CV (%)"
        for row in rows.itertuples():
            line, place = 4 * (row.pickup - 1) + row.dropoff - 1, policies.index(row.policy)
            assert cells[place, line] == ("–" if np.isnan(row.served) else f"{row.served:.0f}")
            assert aside[0, line] == ("–" if np.isnan(row.utility) else f"{row.utility:.1f}")
        assert cells[0, 14] == "–"
        spread = tables["operations"].query("scenario == @scenario").set_index("policy")["acceptance_cv"]
        for place, name in enumerate(policies):
            assert cells[place, 15.8] == f"{spread[name]:.1f}"
        assert heat.images[0].get_clim() == (0.0, 100.0)


@pytest.mark.slow
def test_the_map_is_drawn_where_centres_are_known(made_up, tmp_path):
    """Zones lie at their centres, marked by region; without the file, or with a wrong one, the figure says so."""
    study, run = made_up("nyc")
    tables = study_tables(run)
    file = tmp_path / "trips" / CENTROIDS

    tables = {"utilities": tables["utilities"]}

    def drawn(trips=study.trips):
        return study_figures(tables, trips=trips)["manhattan_utilities"]

    for _ in range(2):
        figure = drawn()
        assert len(figure.axes) == 4
        assert CENTROIDS in figure.get_suptitle()
        file.write_text("LocationID,latitude\n4,40.7\n")
    zones = manhattan_zones()[["LocationID"]].assign(lat=40.7 + 0.001 * zones_of(), lon=-74.0)
    zones.to_csv(file, index=False)
    for trips in (study.trips, [tmp_path / "trips" / "a_tripdata.csv"]):
        figure = drawn(trips)
        assert len(figure.axes) == 5
        assert CENTROIDS not in figure.get_suptitle()
        area = next(ax for ax in figure.axes if ax.get_title() == "Centres of taxi zones")
        counts = [len(one.get_offsets()) for one in area.collections]
        assert counts == manhattan_zones().groupby("region").size().tolist()
        figure.draw_without_rendering()


def zones_of():
    return np.arange(len(manhattan_zones()))


@pytest.mark.slow
def test_what_differs_in_kind_is_of_the_first_world(made_up):
    """Of several worlds, utilities, errors, places and perturbations are those of the first; the title says so."""

    def much(cell):
        return most_policies(cell) or cell.settings.get("draw", 0) > 2

    for name in ("heterogeneous", "sensitivity", "nyc"):
        both, first = (study_tables(made_up(name, worlds, leave=much)[1]) for worlds in ((4, 7), (4,)))
        for label, figure in study_figures(both).items():
            told = figure.get_suptitle() + " ".join(titles(figure))
            if label.startswith(("perf", "comp")):
                assert "2 worlds, pooled" in told
            else:
                assert "(world 4 of 2 worlds)" in told
                assert texts(figure) == texts(draw(first, label))


def test_policies_keep_their_colour(drawn):
    """A family of policies has one colour in all figures, and hatching tells what is known of workers."""
    seen = {}
    for name in ("homogeneous", "nyc", "heterogeneous"):
        for figure in (figure for label, figure in drawn[0][name].items() if label.startswith("perf")):
            ax = figure.axes[0]
            for box, tick in zip(ax.patches, ax.get_xticklabels(), strict=True):
                policy = tick.get_text().rsplit("\n", 1)[0]
                seen.setdefault(policy, set()).add((box.get_facecolor(), box.get_hatch()))
    assert all(len(looks) == 1 for looks in seen.values())
    families = {policy.split(",")[0]: look[0] for policy, (look,) in seen.items()}
    assert len(set(families.values())) == len(families) >= 5
    assert len({look for (look,) in seen.values()}) >= len(seen) - 1  # both single models are hatched alike


def test_ink_is_read_on_every_shade():
    """The contrast of a number with its cell, by WCAG, is at least 4.5 on all shades of both palettes."""
    from matplotlib import colormaps

    for palette in ("Blues", "cividis"):
        for shade in colormaps[palette](np.linspace(0, 1, 64)):
            c = np.where(shade[:3] <= 0.04045, shade[:3] / 12.92, ((shade[:3] + 0.055) / 1.055) ** 2.4)
            luminance = c @ [0.2126, 0.7152, 0.0722]
            other = 0.0 if ink(shade) == "black" else 1.0
            assert (max(luminance, other) + 0.05) / (min(luminance, other) + 0.05) >= 4.5
