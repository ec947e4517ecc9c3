"""Formulas as MathML, written when the site is built: a reader's browser draws them without a script and without a network.

What LaTeX cannot be translated is an error of the build, with the page and the line.
"""

import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)

# where TeX's spacing and letters differ from MathML's defaults
SLASH = "<mo>&#x0002F;</mo>", '<mo lspace="0" rspace="0">&#x0002F;</mo>'
CAPITAL = re.compile(r"<mi>(&#x003(?:9[1-9A-F]|A[0-9]);)</mi>")  # Greek ones are upright
FUNCTION = re.compile(
    r"(</m(?:n|i|sub|sup|frac|sqrt|row)>)?(<mi>(?:ln|exp|cos|sin)</mi>)(?=(<m(?:i|n|sub|sup|frac|sqrt|row)\b)?)"
)
THIN = '<mspace width="0.167em"/>'


def mathml(latex: str, display: str) -> str:
    """A formula as a ``<math>`` element."""
    found = convert(latex, display=display)
    if left_over := re.findall(r"\\[A-Za-z{}]\w*", found):
        raise ValueError(f"{left_over[0]} has no MathML")
    found = CAPITAL.sub(r'<mi mathvariant="normal">\1</mi>', found.replace(*SLASH))
    return FUNCTION.sub(lambda m: (m[1] + THIN if m[1] else "") + m[2] + (THIN if m[3] else ""), found)


def translate(self: nodes.NodeVisitor, node: nodes.math | nodes.math_block, display: str) -> None:
    """Append a formula to the page."""
    latex = node.astext()
    try:
        found = mathml(latex, display)
    except Exception as error:
        logger.warning("formula %s: %s", latex, error, location=node)
        found = self.encode(latex)
    self.body.append(f'<div class="math">{found}</div>' if display == "block" else found)
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer(
        "mathml",
        (lambda self, node: translate(self, node, "inline"), None),
        (lambda self, node: translate(self, node, "block"), None),
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
