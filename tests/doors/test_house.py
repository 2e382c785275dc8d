# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The structure of the package: rooms, names, thresholds, the first words of sentences."""

import ast
import re
import runpy
from collections import defaultdict
from pathlib import Path

FOLDER = Path(__file__).parents[2]
PACKAGE = FOLDER / "hypergap_dolfinx"
TREES = {file: ast.parse(file.read_text(encoding="utf-8")) for file in PACKAGE.rglob("*.py")}


def constants(tree):
    """Names in upper case that a module assigns, and their values as they are written."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value:
            for target in getattr(statement, "targets", None) or [statement.target]:
                for name in ast.walk(target):
                    if isinstance(name, ast.Name) and name.id.strip("_").isupper():
                        yield name.id, statement.value


def test_rooms():
    """At most a dozen rooms, and a dozen files in each beside ``__init__``."""
    rooms = defaultdict(int)
    for file in TREES:
        rooms[file.parent] += file.name != "__init__.py"
    assert len(rooms) <= 12 and max(rooms.values()) <= 12, dict(rooms)


def test_imports_run_one_way():
    """No circle among the modules."""
    names = {".".join(f.relative_to(FOLDER).with_suffix("").parts): t for f, t in TREES.items()}
    uses = {}
    for name, tree in names.items():
        froms = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module]
        found = {n.module for n in froms} | {f"{n.module}.{a.name}" for n in froms for a in n.names}
        uses[name] = found & names.keys() - {name}
    while uses:
        leaves = {name for name, found in uses.items() if not found & uses.keys()}
        assert leaves, sorted(uses)
        uses = {name: found for name, found in uses.items() if name not in leaves}


def test_one_name_one_meaning():
    """No constant has two values, no class's name is used twice."""
    values, classes = defaultdict(set), defaultdict(list)
    for file, tree in TREES.items():
        for name, value in constants(tree):
            values[name].add(ast.unparse(value))
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name].append(file.name)
    assert not {name: v for name, v in values.items() if len(v) > 1}
    assert not {name: files for name, files in classes.items() if len(files) > 1}


def test_thresholds():
    """Numbers stand in the rooms' ``tolerances`` with measurements, and in CONTRIBUTING.md."""
    for file, tree in TREES.items():
        if file.name != "tolerances.py":
            numbers = [
                name
                for name, value in constants(tree)
                if re.fullmatch(r"[\d.e\-+*/() ]+", ast.unparse(value))
            ]
            assert not numbers, (file, numbers)
    made = runpy.run_path(str(FOLDER / ".ci" / "thresholds"))
    rows = list(made["rows"]())
    assert len(rows) <= 166
    assert not [name for _, name, _, _, measured in rows if measured in ("", "–")]
    text = (FOLDER / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert made["table"]() in text, "run .ci/thresholds"


def sentences(text):
    """Sentences of a docstring."""
    return [s for s in re.split(r"(?<=[.:;!?])\s+|\n\s*\n", text) if s.strip()]


def test_first_words():
    """Docstrings say what a thing is: few sentences begin with a relative clause."""
    docs = []
    for tree in TREES.values():
        for node in ast.walk(tree):
            for child in (
                getattr(node, "body", None) if isinstance(getattr(node, "body", None), list) else ()
            ):
                if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                    if isinstance(child.value.value, str):
                        docs += sentences(child.value.value)
    bad = [s for s in docs if re.match(r"(What|Which|Where|Whether|Of)\b", s.strip())]
    assert len(bad) <= 0.03 * len(docs), (len(bad), len(docs), bad[:20])


def test_files_of_tests():
    """Each has a name of its own: pytest imports them by it."""
    names = [file.name for file in (FOLDER / "tests").rglob("test_*.py")]
    assert len(set(names)) == len(names), sorted(n for n in names if names.count(n) > 1)
