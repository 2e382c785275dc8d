# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Mathematics as MathML, made when the site is built: every browser draws it, without a script."""

import html
import re

from docutils import nodes
from latex2mathml import converter
from sphinx.util.math import get_node_equation_number


def bold(match: re.Match) -> str:
    """A bold letter: browsers know the character, and no longer the attribute."""
    letter = html.unescape(match["letter"])
    for first, last, there in (("A", "Z", 0x1D400), ("a", "z", 0x1D41A), ("α", "ω", 0x1D736)):
        if first <= letter <= last:
            return f"<mi>{chr(there + ord(letter) - ord(first))}</mi>"
    return match[0]


def convert(tex: str, display: str) -> str:
    """MathML of TeX's mathematics."""
    made = converter.convert(tex, display=display)
    return re.sub(r'<mi mathvariant="bold(-italic)?">(?P<letter>[^<]+)</mi>', bold, made)


def inline(writer, node):
    """Mathematics in a line."""
    writer.body.append(f'<span class="math">{convert(node.astext(), "inline")}</span>')
    raise nodes.SkipNode


def block(writer, node):
    """Mathematics between lines, with its number if it has a label."""
    number = ""
    if node["number"]:
        number = f'<span class="eqno">({get_node_equation_number(writer, node)})</span>'
    ids = f' id="{node["ids"][0]}"' if node["ids"] else ""
    mathml = convert(node.astext(), "block")
    writer.body.append(f'<div class="math"{ids}>{mathml}{number}</div>')
    raise nodes.SkipNode


def setup(app):
    """Make it the renderer of HTML."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True}
