# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The pages' Python runs: for their pictures when the site is built, and in the tests.

A page's blocks of Python run one after the other, in one namespace. A block of text behind one is
what it prints, numbers to 2 % (to 30 % where versions of Gmsh make other meshes).

``python snippets.py PAGE`` runs one in the present folder; with ``--write`` its outputs are put
into it.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).parents[1]
BLOCK = re.compile(
    r"^```python\n(?P<code>.*?)^```\n(?:\n```text\n(?P<output>.*?)^```\n)?",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


def pages() -> list[Path]:
    """Pages with Python in them."""
    texts = [*DOCS.glob("*.md"), *DOCS.glob("tutorial/*.md"), *DOCS.glob("how-to/*.md")]
    return sorted(page for page in texts if BLOCK.search(page.read_text(encoding="utf-8")))


def pictures(page: Path) -> list[str]:
    """Names of the pictures that a page's Python makes."""
    text = page.read_text(encoding="utf-8")
    return re.findall(r"\]\((?:\.\./)?pictures/([^)]+)\)", text)


def agree(expected: str, actual: str, tolerance: float) -> bool:
    """Whether two outputs are the same, but for their numbers' last digits."""
    split = [[NUMBER.split(text), NUMBER.findall(text)] for text in (expected, actual)]
    (words, numbers), (other_words, other_numbers) = split
    if [" ".join(w.split()) for w in words] != [" ".join(w.split()) for w in other_words]:
        return False
    pairs = zip(map(float, numbers), map(float, other_numbers), strict=True)
    return all(abs(a - b) <= tolerance * max(abs(a), abs(b)) + 1e-9 for a, b in pairs)


def run(page: Path) -> list[tuple[re.Match, str]]:
    """Run a page in the present folder.

    Returns:
        Each block with an output, and what it prints.
    """
    text, names, outputs = page.read_text(encoding="utf-8"), {"__name__": "__main__"}, []
    for block in BLOCK.finditer(text):
        line = text.count("\n", 0, block.start("code"))
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile("\n" * line + block["code"], str(page), "exec"), names)
        if block["output"] is not None:
            outputs.append((block, printed.getvalue()))
    return outputs


def wrong(page: Path) -> list[tuple[str, str]]:
    """Outputs on a page, and those that its Python has instead. It runs in the present folder."""
    tolerance = 0.3 if "import gmsh" in page.read_text(encoding="utf-8") else 0.02
    pairs = [(block["output"], printed) for block, printed in run(page)]
    return [pair for pair in pairs if not agree(*pair, tolerance)]


def write(page: Path):
    """Put the outputs into a page."""
    text, end = page.read_text(encoding="utf-8"), 0
    parts = []
    for block, printed in run(page):
        parts += [text[end : block.start("output")], printed]
        end = block.end("output")
    page.write_text("".join(parts) + text[end:], encoding="utf-8")


def make_pictures(app):
    """Run the pages whose pictures aren't there, or are older than the page."""
    folder = DOCS / "pictures"
    folder.mkdir(exist_ok=True)
    for page in pages():
        files = [folder / name for name in pictures(page)]
        new = page.stat().st_mtime
        if all(file.exists() and file.stat().st_mtime >= new for file in files):
            continue
        print(f"running {page.relative_to(DOCS)}", flush=True)
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        subprocess.run([sys.executable, __file__, page], cwd=folder, env=environment, check=True)


def setup(app):
    """Called by Sphinx."""
    app.connect("builder-inited", make_pictures)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    sys.path.append(str(DOCS.parent))
    page = Path(sys.argv[1]).resolve()
    if "--write" in sys.argv:
        sys.exit(write(page))
    found = wrong(page)
    for expected, actual in found:
        print(f"{page} has\n{expected}\nbut its Python prints\n{actual}", file=sys.stderr)
    sys.exit(bool(found))
