# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""What the documentation says is so: examples in docstrings, thresholds, versions."""

import ast
import doctest
import importlib
import math
import re
import sys
from pathlib import Path

import pytest

import hypergap_dolfinx

FOLDER = Path(__file__).parents[1]
PACKAGE = FOLDER / "hypergap_dolfinx"


TIES = "Tie", "TiedProblem", "NonlinearTiedProblem", "find_touching"


def test_examples():
    """In this order: each goes on where the one before ended."""
    runner, names = doctest.DocTestRunner(), {}
    for name in (*TIES, "Contact", "ContactProblem"):
        text = getattr(hypergap_dolfinx, name).__doc__
        example = doctest.DocTestParser().get_doctest(text, names, name, None, None)
        assert len(example.examples) > 3
        runner.run(example, clear_globs=False)
        names = example.globs
    assert runner.summarize(verbose=False) == (0, runner.tries)


def test_readme(capsys):
    """The example of contact in README.md runs as it stands."""
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    (example,) = re.findall(
        r"^## Contact\b.*?^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL
    )
    exec(example, {})
    *_, last = capsys.readouterr().out.splitlines()
    force, iterations, num = re.fullmatch(r"\[.* (\S+)\] (\d+) (\d+)", last).groups()
    assert abs(float(force)) == pytest.approx(1.08, rel=0.01)
    assert int(iterations) <= 8 and int(num) >= 5


def constants(file):
    """Names of a module's numbers in upper case, and their values."""
    names = [
        name.id
        for statement in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(statement, ast.Assign | ast.AnnAssign)
        for target in getattr(statement, "targets", None) or [statement.target]
        for name in ast.walk(target)
        if isinstance(name, ast.Name) and name.id.strip("_").isupper()
    ]
    module = ".".join(file.relative_to(FOLDER).with_suffix("").parts)
    values = {name: getattr(importlib.import_module(module), name) for name in names}
    number = {name: v for name, v in values.items() if isinstance(v, int | float)}
    return {f"{module.removeprefix('hypergap_dolfinx.')}.{n}": v for n, v in number.items()}


def test_thresholds():
    """CONTRIBUTING.md has a row for each number that is a constant of a module, and no other."""
    pytest.importorskip("pyvista")  # for hypergap_dolfinx.plot
    text = (FOLDER / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+\.[A-Z_0-9]+)` \| `([^`]+)` \|", text, re.MULTILINE)
    names = {"__builtins__": {}, "pi": math.pi, "eps": sys.float_info.epsilon}
    told = {name: eval(value, names) for name, value in rows}
    assert len(told) == len(rows), "a constant has two rows"
    is_so = {}
    for file in PACKAGE.rglob("*.py"):
        if file.name != "__init__.py":
            is_so |= constants(file)
    differ = sorted(told.keys() ^ is_so.keys())
    assert not differ
    assert told == pytest.approx(is_so, rel=1e-12, abs=0)


def test_version():
    """It stands in four files."""
    version = re.escape(hypergap_dolfinx.__version__)
    for file, line in {
        "pyproject.toml": f'^version = "{version}"',
        "CITATION.cff": f"^version: {version}$",
        "CHANGELOG.md": rf"^## {version}\b",
    }.items():
        text = (FOLDER / file).read_text(encoding="utf-8")
        assert re.search(line, text, re.MULTILINE), file
