"""Sphinx: ``sphinx-build -W docs site``."""

from gaitopt import __version__

project = "gaitopt"
author = "The gaitopt developers"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["examples"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
html_theme = "alabaster"
html_theme_options = {"description": "Periodic gaits of legged walkers that slip", "page_width": "1100px"}
html_sidebars = {"**": ["about.html", "navigation.html", "searchfield.html"]}
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"exclude-members": "__init__, __new__"}
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
