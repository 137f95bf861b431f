"""What people hold in their hands fits on one screen: as text, and in a notebook."""

import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from optkit import gap_report, optimal_prices
from optkit.plotting.boxes import box_plot
from optkit.policies import RewardPercentage
from tests.public import DAYS, PUBLIC

SHOWN = (
    "instance", "scenario", "prices", "price certificate", "full information", "arrival information", "simulation",
    "gap report", "trained", "learned",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
def test_it_fits_on_a_screen(name):
    """Its text is short and begins with its class; its HTML is a table or a line, and well formed."""
    thing = PUBLIC[name][0]()
    told, page = repr(thing), thing._repr_html_()
    assert told.startswith(f"{type(thing).__name__}(")
    assert len(told) < 800
    assert told.count("\n") < 12
    assert page.count("<tr") < 60
    for tag in ("p", "table", "pre", "tr"):
        assert len(re.findall(rf"<{tag}[ >]", page)) == page.count(f"</{tag}>")


def test_many_decisions_fit_too():
    assert repr(optimal_prices(np.full((300, 3), 5.0), [-1.0] * 3)).startswith("Pricing(300 decisions, ")
    assert len(repr(optimal_prices(np.full(5000, 5.0), np.full(5000, -1.0)))) < 800


@pytest.mark.slow
def test_names_from_files_are_escaped():
    """Whatever a policy or a request is called, a notebook does not run it."""
    report = gap_report(DAYS[:2], {"<script>": RewardPercentage(0.5)}, kinds="full")
    assert "<script>" not in report._repr_html_()


@pytest.mark.slow
def test_figures_show_by_themselves():
    """Axes of a figure of their own are a picture to a notebook; those that somebody brought are left as they are."""
    report = gap_report(DAYS[:2], {"half": RewardPercentage(0.5)}, kinds="full")
    assert report.plot()._repr_png_().startswith(b"\x89PNG")
    assert box_plot({"a": [1.0, 2.0]})._repr_png_().startswith(b"\x89PNG")
    assert not hasattr(box_plot({"a": [1.0, 2.0]}, ax=Figure().subplots()), "_repr_png_")
