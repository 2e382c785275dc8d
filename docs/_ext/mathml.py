# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mathematics as MathML, made when the site is built: every browser draws it, without a script."""

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util.math import get_node_equation_number


def inline(writer, node):
    """Mathematics in a line."""
    writer.body.append(f'<span class="math">{convert(node.astext())}</span>')
    raise nodes.SkipNode


def block(writer, node):
    """Mathematics between lines, with its number if it has a label."""
    number = ""
    if node["number"]:
        number = f'<span class="eqno">({get_node_equation_number(writer, node)})</span>'
    ids = f' id="{node["ids"][0]}"' if node["ids"] else ""
    mathml = convert(node.astext(), display="block")
    writer.body.append(f'<div class="math"{ids}>{mathml}{number}</div>')
    raise nodes.SkipNode


def setup(app):
    """Make it the renderer of HTML."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True}
