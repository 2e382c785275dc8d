# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the documentation says is so: examples in docstrings, versions."""

import doctest
import re
from pathlib import Path

import pytest

import hypergap_dolfinx

FOLDER = Path(__file__).parents[2]
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
