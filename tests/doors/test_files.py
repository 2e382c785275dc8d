# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""What DOLFINx's writers write of a tied problem, opened again by other programs."""

import importlib.util
import json
import os
import subprocess
import sys

from mpi4py import MPI

import numpy as np
import pytest

import meshes
import ufl
from dolfinx import fem, io
from hypergap_dolfinx import Tie, TiedProblem, files

pytestmark = pytest.mark.ranks

comm = MPI.COMM_WORLD
E, NU, PULL = 2.0, 0.3, 0.7

READ_VTX = """
import json, sys
import adios2, numpy
with adios2.FileReader(sys.argv[1]) as file:
    read = lambda name: numpy.vstack(
        [file.read(name, block_id=i) for i in range(len(file.all_blocks_info(name)[0]))]
    )
    names = [n for n, v in file.available_variables().items() if v["Type"] == "double"]
    print(json.dumps({n: read(n).tolist() for n in names if n != "step"}))
"""


def sigma(u):
    """Plane strain."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(2))


def exact(x):
    """Pulled upwards, free to contract."""
    return np.array([-NU * (1 + NU) * x[0], (1 - NU**2) * x[1]]) * PULL / E


@pytest.fixture
def functions():
    """What goes into each file; displacements and tractions are exact."""
    blocks = [
        meshes.block(comm, (5, 2), lambda x: x * (2, 1)),
        meshes.block(comm, (7, 3), lambda x: x * (2, 1) + (0, 1), cell="triangle"),
    ]
    V = [fem.functionspace(mesh, ("Lagrange", 2, (2,))) for mesh, _ in blocks]
    a, L, bcs = [], [], []
    for W, (_, ft), tag in zip(V, blocks, (meshes.BOTTOM, meshes.TOP), strict=True):
        u, v, g = ufl.TrialFunction(W), ufl.TestFunction(W), fem.Function(W)
        g.interpolate(exact)
        a.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        L.append(ufl.inner(fem.Constant(W.mesh, (0.0, 0.0)), v) * ufl.dx)
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(W, 1, ft.find(tag))))
    tie = Tie((V[0], blocks[0][1].find(meshes.TOP)), (V[1], blocks[1][1].find(meshes.BOTTOM)))
    problem = TiedProblem(a, L, bcs=bcs, ties=[tie])
    us = problem.solve()
    us[0].name = "displacement"
    stress = files.interpolated(sigma(us[1]), V[1].mesh, 1, "stress")
    return {"lower": [us[0]], "stress": [stress], "sigma": files.on_sigma(tie, problem)}


def check(name, x, values):
    """Values at points, as the exact solution has them."""
    x = np.asarray(x)
    values = {key: np.asarray(value) for key, value in values.items()}
    if name == "lower":
        assert np.allclose([x[:, 1].min(), x[:, 1].max()], [0, 1])
        assert np.abs(values["displacement"][:, :2] - exact(x.T).T).max() <= 1e-12
    elif name == "stress":
        expected = np.zeros((3, 3))
        expected[1, 1] = PULL
        assert np.abs(values["stress"].reshape(-1, 3, 3) - expected).max() <= 1e-12
    else:
        assert np.abs(x[:, 1] - 1).max() <= 1e-14
        assert np.abs(values["traction"] - (0, PULL, 0)).max() <= 1e-12
        assert np.abs(values["gap"]).max() <= 1e-12
        assert np.abs(values["slip"]).max() <= 1e-12
        alpha = values["alpha"]
        assert np.allclose([alpha.min(), alpha.max()], [0, 1])


def test_vtk(functions, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    for name, fs in functions.items():
        with io.VTKFile(comm, tmp_path / f"{name}.pvd", "w") as file:
            file.write_function(fs, 0.0)
    comm.barrier()
    for name, fs in functions.items() if comm.rank == 0 else ():  # one reads what all wrote
        grid = pyvista.read(tmp_path / f"{name}.pvd")[0]
        check(name, grid.points, {f.name: grid[f.name] for f in fs})


def test_xdmf(functions, tmp_path):
    """What XDMFFile takes and what it doesn't, as the docstring says."""
    (u,), (stress,), fields = functions.values()
    mesh, lower = stress.function_space.mesh, u.function_space.mesh
    w = fem.Function(fem.functionspace(lower, ("Lagrange", 1, (2,))), name="displacement")
    w.interpolate(u)
    constant = files.interpolated(stress, mesh, 0, "stress")
    assert np.abs(constant.x.array.reshape(-1, 9).mean(axis=0)[4] - PULL) <= 1e-12
    taken = [(lower, [w]), (mesh, [constant])]
    refused = [(lower, [u]), (mesh, [stress]), *((f.function_space.mesh, [f]) for f in fields)]
    for i, (domain, fs) in enumerate(taken + refused):
        with io.XDMFFile(comm, tmp_path / f"{i}.xdmf", "w") as file:
            file.write_mesh(domain)
            for f in fs:
                if i < len(taken):
                    file.write_function(f, 0.0)
                else:
                    with pytest.raises(RuntimeError, match="needs to be interpolated"):
                        file.write_function(f, 0.0)


@pytest.mark.skipif(not hasattr(io, "VTXWriter"), reason="DOLFINx without ADIOS2")
def test_vtx(functions, tmp_path):
    if importlib.util.find_spec("adios2") is None:
        pytest.skip("no adios2 to read with")
    for name, fs in functions.items():
        with io.VTXWriter(comm, tmp_path / f"{name}.bp", fs, engine="BP4") as file:
            file.write(0.0)
    comm.barrier()
    for name in functions if comm.rank == 0 else ():
        # In a process of its own: two ADIOS2 libraries in one don't get along
        command = [sys.executable, "-c", READ_VTX, tmp_path / f"{name}.bp"]
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("PMI", "OMPI"))}
        out = subprocess.run(command, env=environment, capture_output=True, check=True).stdout
        values = json.loads(out)
        check(name, values.pop("geometry"), values)
