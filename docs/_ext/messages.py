# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The page of messages: every sentence that the package can say, read from its source.

A message that doesn't say itself what to do has its way out in ``advice.toml``.
"""

import ast
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parents[1]
PACKAGE = DOCS.parent / "hypergap_dolfinx"
GROUPS = {
    "surfaces": ("surface/", "gap_mesh/", "trimming/", "touching"),
    "ties": ("tie", "joining", "interface_laws/", "mortar/", "multipliers/"),
    "problems": ("problem", "nonlinear", "solvers/", "algebra/"),
    "contact": ("contact", "coefficient", "algebra/floating", "algebra/load_path"),
    "programs": ("",),  # whatever is left
}
"""Beginnings of the modules' names; the longest that fits decides."""
WORDS = 4
"""Least number of words of a sentence."""
HINT = re.compile(r"[;:?(]|\bmust\b|\bgive\b|\btake|\bneeds?\b|\bis one of\b|\bmake\b|\bcheck\b")
"""Signs that a message says what to do or what is wanted."""
NAMES = re.compile(r"\[|^[a-z]+( [a-z]+){8,}$")
"""Annotations and lists of names."""


@dataclass(frozen=True)
class Message:
    """A sentence of the package."""

    text: str
    module: str
    advice: str | None

    @property
    def whole(self) -> bool:
        """False for a part that others are made with."""
        return self.text.endswith((".", "?")) and not self.text.startswith((" ", ",", ";"))

    @property
    def group(self) -> str:
        """Section of the page."""
        fits = [(len(s), g) for g, starts in GROUPS.items() for s in starts
                if self.module.startswith(s)]  # fmt: skip
        return max(fits)[1]

    @property
    def tells(self) -> bool:
        """Whether its reader knows what to do."""
        return bool(self.advice or HINT.search(self.text))


def written(node: ast.AST | None) -> str | None:
    """A string as the user sees it, with … for values; None for other expressions."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.sub(r"%(\.\d+)?[sdgef]", "…", node.value)
    if isinstance(node, ast.FormattedValue):
        value = node.value
        if isinstance(value, ast.IfExp) and (a := written(value.body)) is not None:
            b = written(value.orelse) or "…"
            return f"{a} / {b}" if a and b else a or b
        return "…"
    if isinstance(node, ast.JoinedStr):
        return "".join(written(part) or "" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Mod):
        left, right = written(node.left), written(node.right)
        if isinstance(node.op, ast.Mod):
            return left
        return None if left is None and right is None else (left or "…") + (right or "…")
    return None


def advice() -> list[tuple[re.Pattern, str]]:
    """Patterns of messages and their ways out."""
    given = tomllib.loads((DOCS / "advice.toml").read_text(encoding="utf-8"))
    return [(re.compile(one["message"]), one["advice"]) for one in given["messages"]]


def messages() -> list[Message]:
    """All sentences of the package, in the order of its modules."""
    ways, found = advice(), {}
    for file in sorted(PACKAGE.rglob("*.py")):
        module = str(file.relative_to(PACKAGE).with_suffix(""))
        todo: list[ast.AST] = [ast.parse(file.read_text(encoding="utf-8"))]
        while todo:
            node = todo.pop(0)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                continue  # a docstring
            text = written(node)
            if text is None or isinstance(node, ast.FormattedValue):
                todo = [*ast.iter_child_nodes(node), *todo]
                continue
            words = re.findall(r"[\w’']+", text.replace("…", " "))
            if len(words) >= WORDS and " " in text.strip() and not NAMES.search(text):
                way = next((a for pattern, a in ways if pattern.search(text)), None)
                found.setdefault(text, Message(text.strip(), module, way))
    return list(found.values())
