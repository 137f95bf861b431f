"""Figures as files: no date inside, and known again."""

import pytest

from optkit.basics.errors import InputError
from optkit.plotting.files import drawn_here, figure_bytes, new_figure


def drawn(value):
    figure = new_figure(2, 1)
    return figure.subplots().plot([0, value])[0].axes


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "date"), [("png", b"tIME"), ("pdf", b"Date"), ("svg", b"dc:date")])
def test_nothing_tells_when(kind, date):
    """Bytes follow from what is drawn: no entry of the format's that holds a date."""
    first, other, again = (figure_bytes(drawn(value), kind) for value in (1.0, 2.0, 1.0))
    assert first == again != other
    assert date not in first


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["png", "pdf"])
def test_pictures_are_known_again(kind, tmp_path):
    """Those of optkit are, those that matplotlib drew for somebody else, cut ones and annotated ones are not."""
    ours = figure_bytes(drawn(1.0), kind)
    assert drawn_here(ours)
    drawn(1.0).figure.savefig(tmp_path / f"own.{kind}")
    assert not drawn_here((tmp_path / f"own.{kind}").read_bytes())
    assert not drawn_here(b"")
    if kind == "pdf":
        assert not drawn_here(ours + b"1 0 obj (a comment) endobj\n%%EOF\n")
        assert not drawn_here(ours[:-9])


def test_axes_without_a_figure():
    """Are refused."""
    ax = drawn(1.0)
    ax.remove()
    with pytest.raises(InputError, match="no figure"):
        figure_bytes(ax, "png")
