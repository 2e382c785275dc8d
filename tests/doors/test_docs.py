# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What the documentation says is so: examples in docstrings and pages, versions, links."""

import doctest
import inspect
import logging
import re
import runpy
from pathlib import Path

from mpi4py import MPI

import gallery
import links
import messages
import pytest
import scenes
import snippets

import hypergap_dolfinx

FOLDER = Path(__file__).parents[2]
DOCS = FOLDER / "docs"
PAGES = [str(page.relative_to(DOCS)) for page in snippets.pages()]
ON_RANKS = "index.md", "tutorial/contact-1.md", "tutorial/ties-1.md"


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
    """The examples of README.md run as they stand, and it is short."""
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert text.count("\n") <= 130
    tie, contact = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lower, upper = scenes.blocks()
    V = [scenes.fem.functionspace(body, ("Lagrange", 1, (2,))) for body in (lower, upper)]
    (a0, a1), (L0, L1) = scenes.linear(V)
    names = {"V0": V[0], "V1": V[1], "a0": a0, "a1": a1, "L0": L0, "L1": L1}
    names |= {"f0": scenes.facets_at(lower, 1), "f1": scenes.facets_at(upper, 1)}
    exec(tie, names | {"bcs": [scenes.clamped(V[0], 0)]})
    exec(contact, {})
    *_, last = capsys.readouterr().out.splitlines()
    force, iterations, num = re.fullmatch(r"\[.* (\S+)\] (\d+) (\d+)", last).groups()
    assert abs(float(force)) == pytest.approx(1.08, rel=0.01)
    assert int(iterations) <= 8 and int(num) >= 5


def test_version():
    """It comes from the package; what can't read it there has the same."""
    version = re.escape(hypergap_dolfinx.__version__)
    for file, line in {
        "conda/recipe.yaml": f'^  version: "{version}"$',
        "CITATION.cff": f"^version: {version}$",
        "CHANGELOG.md": rf"^## {version}\b",
    }.items():
        text = (FOLDER / file).read_text(encoding="utf-8")
        assert re.search(line, text, re.MULTILINE), file


@pytest.mark.ranks(2, page=ON_RANKS)
@pytest.mark.parametrize("page", PAGES)
def test_page(page, tmp_path, monkeypatch, caplog):
    """A page's Python runs, prints what stands there, and makes its pictures, without a warning."""
    page = DOCS / page
    text = page.read_text(encoding="utf-8")
    for package, sign in {
        "gmsh": "import gmsh",
        "pyvista": "import plot",
        "matplotlib": "import matplotlib",
    }.items():
        if sign in text:
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.WARNING):
        assert not snippets.wrong(page)
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
    MPI.COMM_WORLD.barrier()  # rank 0 draws
    assert not [name for name in snippets.pictures(page) if not (tmp_path / name).exists()]


def test_messages():
    """Each message says what to do, or has advice on the page of errors; all advice is used."""
    found = messages.messages()
    assert len(found) > 150
    assert not [message.text for message in found if message.whole and not message.tells]
    texts = [message.text for message in found]
    unused = [p.pattern for p, _ in messages.advice() if not any(map(p.search, texts))]
    assert not unused


def test_links():
    """Links of Markdown in the repository lead somewhere (those of the site: `make docs`)."""
    assert not [link for _, link in links.of_markdown() if not links.is_outside(link)]


def test_paper():
    """It is short, its citations are in its list, and its commands name demos that are there."""
    text = (DOCS / "paper" / "paper.md").read_text(encoding="utf-8")
    assert len(text.split("---", 2)[2].split()) <= 1000
    keys = re.findall(r"^@\w+\{(\w+),", (DOCS / "paper" / "paper.bib").read_text(), re.MULTILINE)
    assert set(re.findall(r"@(\w+)", text)) <= set(keys)
    assert all((FOLDER / demo).exists() for demo in re.findall(r"demos/\w+\.py", text))


def test_api():
    """The API's pages have the members of what they name, or those of a list."""
    options = runpy.run_path(str(DOCS / "conf.py"))["autodoc_default_options"]
    assert options == {"inherited-members": True}  # a default for "members" replaces lists
    text = "".join(page.read_text(encoding="utf-8") for page in DOCS.glob("api/*.md"))
    named = re.findall(r"^\.\. auto(?:class|module):: \S+\n((?:   :.*\n)*)", text, re.MULTILINE)
    assert named and all("   :members:" in part for part in named)
    lists = [part for part in named if re.search(":members: [a-z]", part)]
    assert lists and all(":no-inherited-members:" in part for part in lists)  # else all are there


def test_no_colon_becomes_a_type():
    """Sphinx takes what stands before a colon in these first lines for a type."""
    lines = []
    names = "Tie", "TiedProblem", "NonlinearTiedProblem", "Contact", "ContactProblem"
    for part in (getattr(hypergap_dolfinx, name) for name in names):
        for name, member in inspect.getmembers(part):
            text = "" if name.startswith("_") else inspect.getdoc(member) or ""
            lines += text.split("\n")[:1] if isinstance(member, property) else []
            lines += re.findall(r"^Returns:\n\s+(.*)", text, re.MULTILINE)
    assert len(lines) > 50
    assert not [line for line in lines if re.search(r":(\s|$)", re.sub("``.*?``", "", line))]


def test_gallery():
    """Each demo has a page, a short row and results."""
    rows = [row for row in gallery.rows() if not isinstance(row, str)]
    names = {file.stem for file in gallery.DEMOS.glob("*.py")}
    assert {row["name"] for row in rows} == set(gallery.results()) == names
    assert max(len(row["shows"]) for row in rows) <= 80
