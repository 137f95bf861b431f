"""Figures."""

import numpy as np

from optkit.plotting.boxes import box_plot


def test_box_plot_shows_what_the_paper_shows():
    """One box a policy with quartiles at the data's, the mean beneath its name, and units on the axis."""
    rng = np.random.default_rng(0)
    data = {"myopic": rng.normal(90, 3, 120), "PP": rng.normal(75, 5, 120)}
    ax = box_plot(data, title="I.1")
    assert [t.get_text() for t in ax.get_xticklabels()] == [f"{n}\n{x.mean():.1f}" for n, x in data.items()]
    for box, values in zip(ax.patches, data.values(), strict=True):
        edges = box.get_path().vertices[:, 1]
        assert np.allclose([edges.min(), edges.max()], np.quantile(values, [0.25, 0.75]))
    assert "%" in ax.get_ylabel()
