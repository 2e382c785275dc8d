# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What an installation brings, and what an import does."""

import json
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import hypergap_dolfinx

pytestmark = pytest.mark.serial

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

IMPORT = """
import json, sys
from mpi4py import MPI
from petsc4py import PETSc
import dolfinx.fem.petsc
for name in {"numba", "scipy"} & set(sys.modules):
    sys.modules[name] = None  # DOLFINx brought it; here an import of it fails
known = lambda: {module.partition(".")[0] for module in sys.modules}
before = known()
import hypergap_dolfinx
print(json.dumps(sorted(known() - before - set(sys.stdlib_module_names))))
"""


def test_import_is_light():
    """Nothing but our own package that DOLFINx has not brought, and what Python has."""
    command = [sys.executable, "-c", IMPORT]
    run = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, check=True)
    packages = json.loads(run.stdout.splitlines()[-1])  # MPI may have said something before
    assert packages == ["hypergap_dolfinx"]


@pytest.mark.parametrize("missing", ["petsc4py", "dolfinx"])
def test_missing_petsc(missing):
    """One line says what to install where DOLFINx has no PETSc."""
    code = f"import sys; sys.modules[{missing!r}] = None; import hypergap_dolfinx"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    last = run.stderr.strip().splitlines()[-1]
    assert run.returncode and last.startswith("ImportError: hypergap_dolfinx needs DOLFINx with")
    assert missing in last and "pip install" in last


def test_nothing_shadows_dolfinx():
    """DOLFINx comes from wherever the user has it: only extras may name it."""
    assert PROJECT["dependencies"] == ["numpy", "scipy"]


def test_wheel_holds_the_package_alone(tmp_path):
    pytest.importorskip("setuptools", "77", "setuptools builds the wheel")
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "COPYING"):
        shutil.copy(ROOT / name, source)
    for folder in ("hypergap_dolfinx", "meshes", "demos", "tests"):
        shutil.copytree(
            ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    build = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
    subprocess.run([sys.executable, "-c", build, tmp_path], cwd=source, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.split("-")[1] == hypergap_dolfinx.__version__
    inside = {Path(name) for name in zipfile.ZipFile(wheel).namelist()}
    modules = {path for path in inside if not path.parts[0].endswith(".dist-info")}
    package = {
        path.relative_to(source)
        for path in (source / "hypergap_dolfinx").rglob("*")
        if path.is_file()
    }
    assert modules == package
    assert {"LICENSE", "COPYING"} <= {path.name for path in inside}
