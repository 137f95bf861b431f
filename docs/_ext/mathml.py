"""Formulas as MathML, written when the site is built: a page needs no script, no fetched font and no network."""

import re

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

OPENING, CLOSING = r"(\\big|\\Big|\\bigg)(?=[(\[]|\\\{)", r"(\\big|\\Big|\\bigg)(?=[)\]]|\\\})"


def mathml(node: nodes.Element, as_block: bool) -> str:
    r"""Return a formula's MathML; TeX's sizes without a side, \big( and \Big), are given one, as docutils demands."""
    text = re.sub(CLOSING, r"\1r", re.sub(OPENING, r"\1l", node.astext()))
    try:
        return str(tex2mathml(text, as_block=as_block))
    except MathError as error:
        logging.getLogger(__name__).warning("%s in the formula %s", error, node.astext(), location=node)
        return ""


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    self.body.append(mathml(node, as_block=False))
    raise nodes.SkipNode


def visit_block(self: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on a line of its own, in a box that scrolls where the page is narrow."""
    # What scrolls must be reachable by keyboard.
    self.body.append(self.starttag(node, "div", CLASS="math", tabindex="0"))
    self.body.append(mathml(node, as_block=True))
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer under the name that conf.py asks for."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
