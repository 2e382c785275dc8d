# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The directive that lists messages on their page."""

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from messages import messages


class Messages(Directive):
    """``{messages} GROUP``: the messages of a group, with their ways out."""

    required_arguments = 1

    def run(self):
        """Definitions: the message, then the way out and its module."""
        items = nodes.definition_list(classes=["messages"])
        mine = [m for m in messages() if m.group == self.arguments[0]]
        for message in sorted(mine, key=lambda m: not m.whole):
            term = nodes.term("", "", nodes.Text(message.text))
            place = nodes.literal("", message.module.replace("/", "."))
            definition = nodes.definition()
            if message.advice:
                lines = StringList([message.advice], "advice.toml")
                self.state.nested_parse(lines, self.content_offset, definition)
            said = "part of a message in " if not message.whole else "said in "
            definition += nodes.paragraph("", "", nodes.Text(said), place, classes=["place"])
            items += nodes.definition_list_item("", term, definition)
        return [items]


def setup(app):
    """Called by Sphinx."""
    app.add_directive("messages", Messages)
    return {"parallel_read_safe": True}
