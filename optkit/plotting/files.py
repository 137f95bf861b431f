"""Figures as files, the same bytes each time: nothing inside tells when they were drawn."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from optkit.basics.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def figure_bytes(ax: Axes, kind: str) -> bytes:
    """Return the figure of an axes as a file of the given kind, ``"png"`` or ``"pdf"``, without a date inside."""
    sink = io.BytesIO()
    figure = ax.get_figure(root=True)
    if figure is None:
        raise InputError("these axes have no figure")
    dated = {"CreationDate": None} if kind == "pdf" else None
    figure.savefig(sink, format=kind, dpi=160, metadata=dated)
    return sink.getvalue()


def new_figure(width: float, height: float, *, apart: float = 0.02) -> Figure:
    """Return a figure, in inches, that belongs to nobody's pyplot state and keeps its labels apart.

    Parameters
    ----------
    width, height : float
        In inches.
    apart : float
        Space between columns of panels, as a share of a panel's width.

    Examples
    --------
    >>> new_figure(4.0, 3.0).get_size_inches().tolist()
    [4.0, 3.0]
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    return Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(wspace=apart))


def figure_files(name: str, figure: Figure) -> dict[str, bytes]:
    """Return a figure as PNG, PDF and SVG, the same bytes each time for the same figure.

    Parameters
    ----------
    name : str
        Of the files, without their endings.
    figure : matplotlib Figure
        Of no pyplot state.

    Returns
    -------
    dict of str to bytes
        By file name.

    Examples
    --------
    >>> from optkit.plotting.files import new_figure
    >>> sorted(figure_files("empty", new_figure(1.0, 1.0)))
    ['empty.pdf', 'empty.png', 'empty.svg']
    """
    from matplotlib import rc_context

    made = {}
    undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": None}
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        for kind, meta in undated.items():
            sink = io.BytesIO()
            figure.savefig(sink, format=kind, dpi=160, metadata=meta, facecolor="white")
            made[f"{name}.{kind}"] = sink.getvalue()
    return made
