"""Sphinx: ``sphinx-build -W docs site``. Equations become MathML, so that the pages need no network."""

import re
from typing import Any

from docutils.nodes import SkipNode
from latex2mathml.converter import convert

from gaitopt import __version__

project = "gaitopt"
author = "The gaitopt developers"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["examples", "notebooks/*"]
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_show_copyright = False
html_title = "gaitopt"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False  # what is returned has a name and words; its type stands in the signature
napoleon_attr_annotations = False  # they stand in the signature, in short

FIELD = re.compile(r"^(\*{0,2}\w+(?:, \w+)*) : (.*)$")


def split_fields(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Lead ``a, b : words`` apart into two fields with words, which napoleon would take for a type."""
    if what == "property":
        lines[0] = lines[0].replace(": ", " - ")
    parted = []
    for line in lines:
        field = FIELD.match(line)
        parted += [text for key in field[1].split(", ") for text in (key, f"    {field[2]}")] if field else [line]
    lines[:] = parted


def visit_inline(writer: Any, node: Any) -> None:
    """Write an equation within a sentence."""
    writer.body.append(convert(node.astext()))
    raise SkipNode


def visit_block(writer: Any, node: Any) -> None:
    """Write an equation on its own."""
    writer.body.append(f"<div>{convert(node.astext(), display='block')}</div>")
    raise SkipNode


def setup(app: Any) -> None:
    """Register both."""
    app.connect("autodoc-process-docstring", split_fields, priority=1)
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
