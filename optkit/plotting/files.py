"""Figures as files, the same bytes each time: nothing inside tells when they were drawn, but that optkit drew them."""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING, Any

from optkit.basics.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARK = "optkit"
"""Stands in every picture, by which it is known again."""

_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": MARK},
    "pdf": {"Creator": MARK, "CreationDate": None},
    "svg": {"Creator": MARK, "Date": None},
}


def figure_bytes(drawn: Axes | Figure, kind: str, *, name: str = MARK, facecolor: str = "auto") -> bytes:
    """Return a figure as a file.

    Parameters
    ----------
    drawn : matplotlib Figure, or axes of one
        What to save.
    kind : {"png", "pdf", "svg"}
        Of the file.
    name : str
        Names inside an SVG come from it: two in one page must not share theirs.
    facecolor : str
        As for matplotlib.

    Returns
    -------
    bytes
        The same each time for the same figure.

    Raises
    ------
    InputError
        If the axes belong to no figure.

    Examples
    --------
    >>> picture = figure_bytes(new_figure(1.0, 1.0), "png")
    >>> picture[1:4], drawn_here(picture)
    (b'PNG', True)
    """
    from matplotlib import rc_context

    sink = io.BytesIO()
    figure: Any = drawn if hasattr(drawn, "savefig") else drawn.get_figure(root=True)
    if figure is None:
        raise InputError("these axes have no figure")
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(sink, format=kind, dpi=160, metadata=_METADATA[kind], facecolor=facecolor)
    return sink.getvalue()


def shown_in_notebooks(ax: Axes) -> Axes:
    """Return axes that a notebook shows as their picture, though their figure is nobody's pyplot state.

    Examples
    --------
    >>> shown_in_notebooks(new_figure(1.0, 1.0).subplots())._repr_png_()[1:4]
    b'PNG'
    """
    ax._repr_png_ = partial(figure_bytes, ax, "png")  # type: ignore[attr-defined]
    return ax


def settled(figure: Figure) -> Figure:
    """Lay a finished figure out for good, and return it: every file of it is then drawn once, not measured first.

    Examples
    --------
    >>> settled(new_figure(1.0, 1.0)).get_layout_engine() is None
    True
    """
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)
    return figure


def drawn_here(picture: bytes) -> bool:
    """Whether a PNG or PDF file is as :func:`figure_bytes` made it.

    Examples
    --------
    >>> drawn_here(b"dear diary")
    False
    """
    if picture.startswith(b"\x89PNG"):
        return b"tEXtSoftware\0" + MARK.encode() in picture.partition(b"IDAT")[0]
    whole = picture.startswith(b"%PDF") and picture.rstrip().endswith(b"%%EOF")
    # What is added to a PDF file later, a comment for example, has an end of its own.
    return whole and picture.count(b"%%EOF") == 1 and f"/Creator ({MARK})".encode() in picture


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
