# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The gallery: a page for each demo, from the Markdown in its comments and demos/README.md."""

import re
import shutil
from itertools import groupby
from pathlib import Path

DOCS = Path(__file__).parents[1]
DEMOS = DOCS.parent / "demos"
ROW = re.compile(
    r"^\| (?:<img src=\"pictures/(?P<picture>[\w.]+)\".*?>)? ?\| "
    r"\[(?P<name>\w+)\]\(\w+\.py\)(?P<how>.*?) \| (?P<shows>.*) \|$"
)


def rows():
    """Headings and rows of demos/README.md's tables."""
    for line in (DEMOS / "README.md").read_text(encoding="utf-8").splitlines():
        if match := ROW.match(line) or re.match(r"^\*\*([^*]+)\*\*$", line):
            yield match if match.re is ROW else match[1]


def results() -> dict[str, str]:
    """Results of each demo, the sections of demos/README.md behind its tables."""
    text = (DEMOS / "README.md").read_text(encoding="utf-8")
    found = re.findall(r"^### (\w+)\n\n(.*?)\n(?=\n### |\n`pictures|\Z)", text, re.M | re.S)
    return {name: part.replace("(../docs/", "(../") for name, part in found}


def cells(text: str):
    """Markdown and code of a demo, in turn."""
    lines = [line for line in text.splitlines() if line not in ("# +", "# -")]
    for comment, part in groupby(lines, key=lambda line: line == "#" or line.startswith("# ")):
        if comment:
            yield "\n".join(line[2:] for line in part)
        elif code := "\n".join(part).strip("\n"):
            yield f"```python\n{code}\n```"


def title_of(text: str) -> str:
    """First heading of a demo."""
    return re.search(r"^# # (.*)$", text, re.MULTILINE)[1]


def page(name: str, row) -> str:
    """A demo as a page."""
    text = (DEMOS / f"{name}.py").read_text(encoding="utf-8")
    _, _, rest = text.partition(f"# # {title_of(text)}\n")
    rest = re.sub(r"^# Copyright.*\n#\n# SPDX.*\n(#\n)?", "", rest, flags=re.MULTILINE)
    rest = re.sub(r"\]\((\w+)\.py\)", r"](\1.md)", rest)
    picture = f"![](pictures/{row['picture']})\n\n" if row["picture"] else ""
    return (
        f"# {title_of(text)}\n\n{picture}**Result**\n\n{results()[name]}\n\n"
        f"Run it: `python demos/{name}.py`; the file: "
        f"[{name}.py](../../demos/{name}.py)\n\n" + "\n\n".join(cells(rest)).lstrip("\n") + "\n"
    )


def make(app):
    """Write the pages."""
    folder = DOCS / "gallery"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DEMOS / "pictures", folder / "pictures", ignore=lambda _, n: ["make.py"])
    made, index = [], (DOCS / "gallery.md.in").read_text(encoding="utf-8")
    for row in rows():
        if isinstance(row, str):
            index += f"\n## {row}\n\n"
            continue
        name = row["name"]
        text = (DEMOS / f"{name}.py").read_text(encoding="utf-8")
        picture = f"![](gallery/pictures/{row['picture']})" if row["picture"] else ""
        shows = row["shows"][0].upper() + row["shows"][1:]
        title = f"[**{title_of(text)}**](gallery/{name}.md){row['how']}"
        index += f":::{{container}} demo\n{picture}\n\n{title}\n\n{shows}.\n:::\n\n"
        if name not in made:
            (folder / f"{name}.md").write_text(page(name, row), encoding="utf-8")
            made.append(name)
    names = "\n".join(f"gallery/{name}" for name in made)
    (DOCS / "gallery.md").write_text(
        f"{index}\n```{{toctree}}\n:hidden:\n\n{names}\n```\n", encoding="utf-8"
    )


def setup(app):
    """Called by Sphinx."""
    app.connect("builder-inited", make)
    return {"parallel_read_safe": True}
