# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Sphinx's configuration of the site: ``make docs``."""

import os
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent / "_ext"), str(Path(__file__).parents[1])]

import hypergap_dolfinx

project = "hypergap_dolfinx"
author = "The hypergap_dolfinx developers"
copyright = "2026, the hypergap_dolfinx developers"
version = release = hypergap_dolfinx.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinxcontrib.bibtex",
    "sphinx_copybutton",
    # Our own, in _ext
    "mathml",
    "gallery",
    "messages_page",
    "snippets",
]
exclude_patterns = ["_build", "paper"]
bibtex_bibfiles = ["paper/paper.bib"]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
# Files of the repository that pages link to are copied beside them: the site needs no other one
suppress_warnings = ["myst.strikethrough"]

autodoc_member_order = "bysource"
# A default for "members" would replace the lists of members on the pages
autodoc_default_options = {"inherited-members": True}
autodoc_typehints = "none"  # the docstrings say it in words
napoleon_google_docstring = True
napoleon_numpy_docstring = False

# The inventories are read from the net: only where it is there (the workflow of the site sets it)
intersphinx_mapping = (
    {
        "python": ("https://docs.python.org/3", None),
        "numpy": ("https://numpy.org/doc/stable", None),
        "dolfinx": ("https://docs.fenicsproject.org/dolfinx/v0.10.0/python", None),
        "ufl": ("https://docs.fenicsproject.org/ufl/main", None),
    }
    if os.environ.get("HYPERGAP_DOCS_ONLINE")
    else {}
)

html_theme = "furo"
pygments_dark_style = "monokai"
html_title = "hypergap_dolfinx"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False
html_copy_source = html_show_sourcelink = False
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


def plain_bars(app, what, name, obj, options, lines):
    """Bars of |x| in docstrings are no substitutions."""
    lines[:] = [line if "``" in line else line.replace("|", r"\|") for line in lines]


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", plain_bars)
