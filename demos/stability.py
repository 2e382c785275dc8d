# # Stiff and extreme scenes
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# How accurate is a tie of steel and rubber, of microns and metres, of one cell and a thousand?
# Patch tests and the pressurised cylinder are repeated while one parameter after the other is
# varied, in 2D and 3D, with degrees 1 and 2, and with either side as Γ1. The same problem on one
# fused mesh shows the loss of digits by the conditioning of the bodies. A row is met if its error
# is below its bound, or if the fused mesh has a tenth of the error or more. Contact has its own
# rows: a block that only contact holds, and ironing.

# +
import argparse
import itertools
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import friction
from ironing import Ironing

import meshes
from hypergap_dolfinx import Contact, ContactProblem, SolveError, Tie, TiedProblem

comm = MPI.COMM_WORLD
EPS = np.finfo(float).eps
# -


def stress(u, E, nu):
    """Plane strain, or three dimensions."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(len(u)))


# ## Patch tests
#
# Two blocks, the second one on top of the first. With one material any constant gradient is exact,
# with two materials that of oedometric compression. Each scene names what is unusual.

SCENE = {
    "dim": 2,
    "degree": 1,
    "swap": False,
    "cells": (2, 3),  # of both blocks along the interface
    "E": (1.0, 1.0),
    "unit": 1.0,  # of length
    "shift": 0.0,  # distance from the origin
    "thickness": 1.0,  # of the second block, whose length is 1
    "gap": 0.0,  # between the blocks (negative: overlap), in cells of the finer one
    "held": True,  # around, by symmetry planes
    "kink": 180.0,  # angle of the first block in the middle of the interface
}
TAGS = {2: (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP)}
TAGS[3] = (*TAGS[2], meshes.BACK, meshes.FRONT)


def heights(s, x):
    """Lower and upper side of both blocks over the first coordinate."""
    slope = 1 / np.tan(np.deg2rad(s["kink"]) / 2)
    middle = -slope * (0.5 - np.abs(x - 0.5)) if s["kink"] != 180 else 0 * x
    depth = 1 + max(0.0, 0.5 * slope)
    top = s["thickness"] + max(0.0, -0.5 * slope)
    gap = s["gap"] / max(s["cells"])
    return (np.full_like(x, -depth), middle), (middle + gap, np.full_like(x, top))


def placed(s, x, block):
    """Maps the unit square or cube to a block; the last coordinate goes up."""
    low, high = heights(s, x[:, 0])[block]
    x = x.copy()
    x[:, -1] = low + x[:, -1] * (high - low)
    return s["unit"] * (x + s["shift"])


def gradients(s):
    """The exact displacement gradient in both blocks."""
    dim = s["dim"]
    if s["E"][0] != s["E"][1]:  # σ_yy the same, no other strain
        up = np.zeros((dim, dim))
        up[-1, -1] = 1e-3 * min(s["E"])
        return up / s["E"][0], up / s["E"][1]
    H = 1e-3 * np.array([[3, -2, 1], [5, 4, 2], [-1, 2, 3]])[:dim, :dim]
    return H, H


def exact(s, x, block):
    """The exact displacement of points (num_points, dim) of a block; it vanishes in the middle."""
    origin = np.full(s["dim"], s["unit"] * (s["shift"] + 0.5))
    origin[-1] = s["unit"] * s["shift"]
    return (x - origin) @ gradients(s)[block].T


def block_mesh(s, fused):
    """The blocks' meshes, or the one of a fused mesh with the finer block's cells."""
    dim, cell = s["dim"], {2: "triangle", 3: "tetrahedron"}[s["dim"]]
    even = 2 if s["kink"] != 180 else 1  # a node at the kink
    for block in (None,) if fused else (0, 1):
        n = max(s["cells"]) if fused else s["cells"][block]
        n = [even * n] * (dim - 1) + [2 * (1 + fused)]
        mesh, ft = meshes.block(comm, n, cell=cell)
        x = mesh.geometry.x[:, :dim]
        if fused:
            half = np.where(x[:, -1:] <= 0.5, 0, 1)
            low, high = (np.column_stack((x[:, :-1], 2 * x[:, -1] - i)) for i in (0, 1))
            mesh.geometry.x[:, :dim] = np.where(half, placed(s, high, 1), placed(s, low, 0))
        else:
            mesh.geometry.x[:, :dim] = placed(s, x, block)
        yield mesh, ft, block


def patch(s, fused=False):
    """Solve a scene; largest relative error of the displacement, and the problem."""
    s = SCENE | s
    dim, last = s["dim"], 2 * s["dim"]
    bodies, sides = [], []
    for mesh, ft, block in block_mesh(s, fused):
        V = fem.functionspace(mesh, ("Lagrange", s["degree"], (dim,)))
        bodies.append((mesh, ft, block, V))
        sides.append((V, ft.find(last if block == 0 else last - 1)))
    sides = sides[::-1] if s["swap"] else sides
    ties = [] if fused else [Tie(*sides, adjust=s["gap"] != 0)]  # moves Γ1, so before the rest

    a, L, bcs, us = [], [], [], []
    for mesh, ft, block, V in bodies:
        DG = fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
        cells = np.arange(len(DG.dofmap.list), dtype=np.int32)
        middle = dolfinx.mesh.compute_midpoints(mesh, dim, cells)[:, dim - 1]
        which = (middle > s["unit"] * s["shift"]).astype(int) if fused else cells * 0 + block
        E = fem.Function(DG)
        E.x.array[DG.dofmap.list[:, 0]] = np.array(s["E"])[which]
        sigma = fem.Function(fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (dim, dim))))
        H = np.array(gradients(s))[which]
        eps = (H + H.transpose(0, 2, 1)) / 2
        trace = np.trace(eps, axis1=1, axis2=2)[:, None, None]
        values = np.array(s["E"])[which, None, None] / 1.3 * (eps + 0.75 * trace * np.eye(dim))
        sigma.x.array[:] = values.ravel()
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)
        a.append(ufl.inner(stress(u, E, 0.3), ufl.sym(ufl.grad(v))) * ufl.dx)
        # Held at the bottom, symmetry planes around: loads where a component is not prescribed
        outer = set(TAGS[dim]) - {last - 1 if block == 1 else None, last if block == 0 else None}
        load = ufl.dot(sigma, ufl.FacetNormal(mesh))
        L.append(sum(ufl.inner(load, v) * ds(tag) for tag in outer))
        reference = fem.Function(V)
        x = V.tabulate_dof_coordinates()[:, :dim]
        blocks = (x[:, -1] > s["unit"] * s["shift"]) if fused else np.full(len(x), block)
        values = np.where(blocks[:, None] == 1, exact(s, x, 1), exact(s, x, 0))
        reference.x.array[:] = values.ravel()
        for tag in outer - {last}:
            for c in range(dim):
                if tag == last - 1 or (s["held"] and c == (tag - 1) // 2):
                    W, to_V = V.sub(c).collapse()
                    g = fem.Function(W)
                    g.x.array[:] = reference.x.array[to_V]
                    dofs = fem.locate_dofs_topological((V.sub(c), W), dim - 1, ft.find(tag))
                    bcs.append(fem.dirichletbc(g, dofs, V.sub(c)))
        us.append(reference)
    problem = TiedProblem(a, L, bcs=bcs, ties=ties)
    error = size = 0.0
    for u, reference in zip(problem.solve(), us, strict=True):
        error = max(error, np.abs(u.x.array - reference.x.array).max(initial=0))
        size = max(size, np.abs(reference.x.array).max(initial=0))
    return comm.allreduce(error, MPI.MAX) / comm.allreduce(size, MPI.MAX), problem


# ## The cylinder
#
# A quarter of two rings of radii 2 : 2.5 : 3 under inner pressure, of one material or two. The
# exact displacement of a ring between two pressures is Lamé's.

RADII = (2.0, 2.5, 3.0)


def lame(r0, r1, p0, p1, E, nu):
    """Factors of r and 1/r in the radial displacement of a ring."""
    area = r1**2 - r0**2
    A, B = (p0 * r0**2 - p1 * r1**2) / area, (p0 - p1) * r0**2 * r1**2 / area
    return np.array(((1 - 2 * nu) * A, B)) * (1 + nu) / E


def cylinder(n, degree, E, nu, swap=False, fused=False):
    """Relative L² error of the displacement, and the problem; n cells in a quarter circle."""
    a, c, b = RADII
    rings = ((a, c), (c, b))
    at_c = np.array((c, 1 / c))
    unit = [lame(*rings[0], *p, E[0], nu) @ at_c for p in ((1, 0), (0, 1))]
    q = unit[0] / (lame(*rings[1], 1, 0, E[1], nu) @ at_c - unit[1])
    factors = lame(*rings[0], 1, q, E[0], nu), lame(*rings[1], q, 0, E[1], nu)
    bodies = (
        [(min(n), 2 * max(n) // 3 * 2, (a, b))]
        if fused
        else [(n[i], max(n) // 3 * 2, rings[i]) for i in (0, 1)]
    )
    forms, loads, bcs, sides, fields = [], [], [], [], []
    for i, (n_hoop, n_radial, radii) in enumerate(bodies):
        mesh, ft = meshes.ring_sector(comm, n_hoop, n_radial // 2 * 2, *radii, degree=degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        DG = fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
        x = dolfinx.mesh.compute_midpoints(mesh, 2, np.arange(len(DG.dofmap.list), dtype=np.int32))
        outer = (np.hypot(*x.T[:2]) > c).astype(int) if fused else np.full(len(x), i)
        modulus, A, B = fem.Function(DG), fem.Function(DG), fem.Function(DG)
        for f, values in zip((modulus, A, B), (E, *zip(*factors, strict=True)), strict=True):
            f.x.array[DG.dofmap.list[:, 0]] = np.array(values)[outer]
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)
        forms.append(ufl.inner(stress(u, modulus, nu), ufl.sym(ufl.grad(v))) * ufl.dx)
        p = fem.Constant(mesh, default_scalar_type(1 if i == 0 else 0))
        loads.append(-p * ufl.dot(ufl.FacetNormal(mesh), v) * ds(meshes.INNER))
        for tag, component in ((meshes.START, 1), (meshes.END, 0)):
            dofs = fem.locate_dofs_topological(V.sub(component), 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        x = ufl.SpatialCoordinate(mesh)
        fields.append((A + B / ufl.dot(x, x)) * x)
        sides.append((V, ft.find(meshes.OUTER if i == 0 else meshes.INNER)))
    ties = [] if fused else [Tie(*(sides[::-1] if swap else sides))]
    problem = TiedProblem(forms, loads, bcs=bcs, ties=ties)
    totals = np.zeros(2)
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
    for u, field in zip(problem.solve(), fields, strict=True):
        # The zero function's error is the exact field's norm, by the same form
        for i, f in enumerate((u, fem.Function(u.function_space))):
            e = f - field
            totals[i] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    error, norm = comm.allreduce(totals)
    return np.sqrt(error / norm), problem


# ## Rigid motions
#
# Two closed rings that are adjusted to each other; the outer one is turned by 1e-3. The stress
# should be zero.


def turned(n, degree, swap):
    """Largest strain of a prescribed rotation by 1e-3, and the problem."""
    forms, loads, sides = [], [], []
    for i, radii in enumerate(((2.0, 2.5), (2.5, 3.0))):
        mesh, ft = meshes.ring_sector(comm, 4 * n[i], 2, *radii, angle=2 * np.pi, degree=degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        forms.append(ufl.inner(stress(u, 1.0, 0.3), ufl.sym(ufl.grad(v))) * ufl.dx)
        zero = fem.Constant(mesh, default_scalar_type((0, 0)))
        loads.append(ufl.inner(zero, v) * ufl.dx)
        sides.append((V, ft.find(meshes.OUTER if i == 0 else meshes.INNER)))
    tie = Tie(*(sides[::-1] if swap else sides), adjust=True)
    g = fem.Function(V)
    g.interpolate(lambda x: (-1e-3 * x[1], 1e-3 * x[0]))
    dofs = fem.locate_dofs_topological(V, 1, ft.find(meshes.OUTER))
    problem = TiedProblem(forms, loads, bcs=[fem.dirichletbc(g, dofs)], ties=[tie])
    total = area = 0.0
    for u in problem.solve():
        s = stress(u, 1.0, 0.3)
        one = fem.Constant(u.function_space.mesh, default_scalar_type(1))
        total += comm.allreduce(fem.assemble_scalar(fem.form(ufl.inner(s, s) * ufl.dx)))
        area += comm.allreduce(fem.assemble_scalar(fem.form(one * ufl.dx)))
    return np.sqrt(total / area), problem


# ## Contact
#
# A block between walls is pressed on another one by a pressure, and only contact holds it. A column
# that is cut by a plane sticks if the coefficient of friction is larger than its slope (see
# `friction.py`). And a die is drawn along a foundation in load steps of different lengths: its
# reaction is the derivative of the energy, apart from dissipation.

PRESSED = {
    "dim": 2,
    "degree": 1,
    "swap": False,
    "cells": (2, 3),
    "E": (1.0, 1.0),
    "nu": 0.3,
    "unit": 1.0,
    "shift": 0.0,
    "start": 0.0,  # the gap at first, in cells of the finer block
    "sliver": 0.0,  # of the lower block that has nothing above it
    "friction": None,  # coefficient
}


FRICTION = (0.0, 0.1, 0.5, 1.0, 2.0)


def pressed(scene):
    """Relative error of the pressures that there are, and the problem."""
    s = PRESSED | scene
    dim, unit, u, F, bcs, sides = s["dim"], s["unit"], [], [], [], []
    p = 1e-3 * min(s["E"])
    for i, E in enumerate(s["E"]):
        size = np.ones(dim)
        low = np.zeros(dim)
        low[-1] = (-1, s["start"] / max(s["cells"]))[i]
        size[0] += s["sliver"] * (i == 0)

        def place(x, low=low, size=size):
            return unit * (low + x * size + s["shift"])

        n = [s["cells"][i]] * (dim - 1) + [2]
        cell = {2: "quadrilateral", 3: "hexahedron"}[dim]
        mesh, ft = meshes.block(comm, n, place, cell=cell)
        V = fem.functionspace(mesh, ("Lagrange", s["degree"], (dim,)))
        w, v = fem.Function(V), ufl.TestFunction(V)
        E, nu, load = (fem.Constant(mesh, default_scalar_type(x)) for x in (E, s["nu"], i * p))
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)(2 * dim)
        F.append(ufl.inner(stress(w, E, nu), ufl.grad(v)) * ufl.dx + load * v[dim - 1] * ds)
        walls = [(c // 2, c + 1) for c in range(2 * dim - 2)]
        for component, tag in (*walls, *[(dim - 1, 2 * dim - 1)] * (1 - i)):
            dofs = fem.locate_dofs_topological(V.sub(component), dim - 1, ft.find(tag))
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(component)))
        u.append(w)
        sides.append((V, ft.find(2 * dim - i)))  # the one's top, the other's bottom
    contact = Contact(*(sides[::-1] if s["swap"] else sides), friction=s["friction"])
    problem = ContactProblem(F, u, bcs=bcs, contacts=[contact], rtol=1e-13)
    problem.solve()
    error = np.abs(contact.pressures(problem) / p - 1)  # what is cut off has no pressure of its own
    return error[problem.rows(contact).valid].max(), problem


def contact_scenes(quick):
    """Scenes of contact: axis, value, what is unusual, bound."""
    for value in powers(-6, 6, 6 if quick else 2):
        yield "contrast", value, {"E": (1.0, value)}, 1e-12 + 200 * EPS * value
    for value in (0.4999,) if quick else (0.49, 0.499, 0.4999):
        yield "Poisson ratio", value, {"nu": value}, 1e-11
    for cells in ((2, 20), (20, 2)):
        # Where Γ1 is finer, pressures have round-off of 1e-12 to 2e-11, by the processor
        yield "cell sizes", "{}:{}".format(*cells), {"cells": cells}, 5e-11
    for value in powers(-9, 9, 9 if quick else 3):
        yield "length unit", value, {"unit": value}, 1e-12
    for value in powers(-12, 12, 12 if quick else 4):
        yield "stiffness unit", value, {"E": (value, value)}, 1e-12
    for value in (1e3,) if quick else (1e3, 1e6):
        yield "far from origin", value, {"shift": value}, 1e-12 + 1e3 * EPS * value
    for value in (-0.3, 3.0) if quick else (-0.3, -0.03, 0.1, 1.0, 3.0):
        yield "start / h", value, {"start": value}, 1e-9
    for value in powers(-9, -3, 4 if quick else 1):  # it isn't loaded
        yield "sliver", value, {"sliver": value}, 1e-9 + 3 * value
    for value in FRICTION[::4] if quick else FRICTION:
        yield "friction", value, {"friction": value}, 1e-12


def contact_rows(quick):
    """Rows of the table; in the place of KSP's reason they have the number of Newton steps."""
    nothing = {"fused": 0.0, "residual": np.nan, "infog12": None, "infog28": None}
    for axis, value, scene, bound in contact_scenes(quick):
        for dim, degree in itertools.product((2, 3), (1, 2)):
            if dim == 3 and (degree == 2 or max(scene.get("cells", (1,))) > 10):
                continue
            common = {"dim": dim, "degree": degree}
            result = {"scene": "contact", "axis": axis, "value": value, **common, **nothing}
            try:
                runs = [pressed(scene | common | {"swap": swap}) for swap in (False, True)]
            except SolveError:  # a row that isn't met, and no end of the table
                result |= {"error": np.inf, "bound": bound, "constraint": np.nan}
                yield result | {"reason": None, "ok": False}
                continue
            error, problem = max(runs, key=lambda run: run[0])
            rows = problem.rows(problem.contacts[0])
            gap = np.abs(rows.distance[rows.state.active]).max()
            result |= {"error": float(error), "bound": bound, "constraint": float(gap)}
            yield result | {"reason": problem.iterations, "ok": bool(error <= bound)}
    nothing["constraint"] = np.nan
    for value, dim, degree in itertools.product(FRICTION[1:], (2, 3), (1, 2)):
        if quick and value < FRICTION[-1]:
            continue
        runs = [friction.block(comm, degree, dim, swap, value) for swap in (False, True)]
        error, told = max(run["error"] for run in runs), all(run["told"] for run in runs)
        result = {"scene": "cut column", "axis": "friction", "value": value, **nothing}
        result |= {"dim": dim, "degree": degree, "error": error, "bound": 1e-10}
        yield result | {"reason": max(run["steps"] for run in runs), "ok": error <= 1e-10 and told}
    ironed = [("step / h", size, None, size, 1e-6) for size in (0.01, 0.1, 1.0, 5.0)]
    ironed += [("friction", mu, mu, 0.3, 2e-5) for mu in FRICTION]
    for axis, value, mu, size, bound in ironed[3::5] if quick else ironed:
        found = Ironing(comm, friction=mu).go(6, size)
        error, steps = (max(row[name] for row in found) for name in ("energy_error", "iterations"))
        halved = sum(row["halvings"] for row in found)
        result = {"scene": "ironing", "axis": axis, "value": value, **nothing}
        result |= {"dim": 2, "degree": 1, "error": error, "bound": bound}
        yield result | {"reason": steps, "ok": error <= bound and not halved}


# ## What the solver says


def diagnosis(problem):
    """Relative residuals of the system and of the constraints, KSP reason, MUMPS's INFOG."""
    A, b, x = problem.A, problem.b, problem.x
    r = b.duplicate()
    A.mult(x, r)
    r.axpy(-1.0, b)
    num = len(problem.ties)
    parts, solution = r.getNestSubVecs(), x.getNestSubVecs()
    size = max(part.norm(PETSC_INF) for part in solution[: len(problem.u)])
    gap = max((part.norm(PETSC_INF) for part in parts[len(parts) - num :] if num), default=0.0)
    pc = problem.solver.getPC()
    factor = pc.getFactorMatrix() if pc.getType() in ("lu", "cholesky") else None
    result = {
        "residual": r.norm() / b.norm(),
        "constraint": gap / size,
        "reason": problem.solver.getConvergedReason(),
        "infog12": factor and factor.getMumpsInfog(12),
        "infog28": factor and factor.getMumpsInfog(28),
    }
    r.destroy()
    return result


PETSC_INF = 3  # PETSc's NORM_INFINITY


# ## The axes


def powers(low, high, step):
    """Powers of ten."""
    return [10.0**i for i in range(low, high + 1, step)]


def patch_rows(quick):
    """Scenes of patch tests: axis, value, what is unusual, bounds in 2D and 3D."""
    step = 10 if quick else 2
    for value in powers(-10, 10, step):
        yield "contrast", value, {"E": (1.0, value)}, (1e-11, 1e-10)
    for value in (1000,) if quick else (1, 10, 100, 1000):
        for cells in ((1, value), (value, 1)):
            yield "cell sizes", f"{cells[0]}:{cells[1]}", {"cells": cells}, (1e-11, None)
    for value in (10,) if quick else (10, 50):
        for cells in ((1, value), (value, 1)):
            scene = {"cells": cells, "held": False}
            yield "cell sizes", f"{cells[0]}:{cells[1]}", scene, (None, 1e-10)
    for value in powers(-9, 9, 9 if quick else 3):
        yield "length unit", value, {"unit": value}, (1e-12, 1e-12)
    for value in powers(-12, 12, 12 if quick else 4):
        yield "stiffness unit", value, {"E": (value, value)}, (1e-12, 1e-12)
    for value in (0.0, *powers(3, 9, 3)):
        bound = 1e-12 + 1e3 * EPS * value
        yield "far from origin", value, {"shift": value}, (bound, bound)
    for value in powers(-6, -2, 4 if quick else 1):
        for name, cells in (("thin layer", (3, 2)), ("thin layer, finer", (2, 3))):
            yield name, value, {"thickness": value, "cells": cells}, (1e-10, 1e-10)
    for value in (-0.5, 0.5) if quick else (-0.5, -0.2, -0.05, 0.0, 0.05, 0.2, 0.5):
        yield "gap / h", value, {"gap": value}, (1e-11, 1e-11)
    for value in (10, 350) if quick else (10, 30, 60, 90, 150, 179, 181, 210, 270, 300, 330, 350):
        yield "kink", value, {"kink": value}, (1e-11, None)
    # The worst pairs together
    yield (
        "contrast, cell sizes",
        "1e-10, 1:100",
        {"E": (1, 1e-10), "cells": (1, 100)},
        (1e-11, None),
    )
    yield "contrast, cell sizes", "1e10, 1:100", {"E": (1, 1e10), "cells": (1, 100)}, (1e-11, None)
    yield "units", "1e-9, 1e12", {"unit": 1e-9, "E": (1e12, 1e12)}, (1e-12, 1e-12)
    yield "thin, contrast", "1e-4, 1e6", {"thickness": 1e-4, "E": (1, 1e6)}, (1e-10, 1e-10)
    yield "thin, far", "1e-3, 1e3", {"thickness": 1e-3, "shift": 1e3}, (2e-10, 2e-10)


def rows(quick):
    """All scenes, one dictionary each."""
    for axis, value, scene, bounds in patch_rows(quick):
        for dim, degree in itertools.product((2, 3), (1, 2)):
            bound = bounds[dim - 2]
            too_large = dim == 3 and degree == 2 and max(scene.get("cells", (1,))) > 10
            if bound is None or too_large:
                continue
            common = {"dim": dim, "degree": degree}
            runs = [patch(scene | common | {"swap": swap}) for swap in (False, True)]
            fused = patch(common | {k: v for k, v in scene.items() if k != "gap"}, fused=True)[0]
            yield row("patch", axis, value, common, runs, fused, bound)
    cylinders = [
        ("contrast", v, (6, 9), (1.0, v), 0.3) for v in powers(-10, 10, 10 if quick else 2)
    ]
    for nu in (0.3, 0.4999) if quick else (0.3, 0.49, 0.499, 0.4999, 0.49999):
        cylinders.append(("Poisson ratio", nu, (6, 9), (1.0, 1.0), nu))
    for n in ((3, 5), (6, 9), (12, 17)):
        cylinders.append(("coarse", f"{n[0]}:{n[1]}", n, (1.0, 1.0), 0.3))
    for axis, value, n, E, nu in cylinders:
        for degree in (1, 2) if axis == "coarse" else (2,):
            runs = [cylinder(n, degree, E, nu, swap) for swap in (False, True)]
            fused = cylinder(n, degree, E, nu, fused=True)[0]
            common = {"dim": 2, "degree": degree}
            yield row("cylinder", axis, value, common, runs, fused, 1.05 * fused, strict=True)
    yield from contact_rows(quick)
    for n, degree in itertools.product(((3, 5), (6, 9), (12, 17)), (1, 2)):
        runs = [turned(n, degree, swap) for swap in (False, True)]
        common = {"dim": 2, "degree": degree}
        yield row("turned rings", "coarse", f"{n[0]}:{n[1]}", common, runs, 0.0, 1e-10)


def row(scene, axis, value, common, runs, fused, bound, strict=False):
    """A row of the table, with the worse of both sides as Γ1."""
    error, problem = max(runs, key=lambda run: run[0])
    result = {"scene": scene, "axis": axis, "value": value, **common}
    result |= {"error": float(error), "bound": float(bound), "fused": float(fused)}
    ok = error <= bound or (not strict and fused >= error / 10)
    return result | diagnosis(problem) | {"ok": bool(ok)}


def picture(table, folder):
    """Error over bound of each row, axis by axis."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(f"{r['scene']}: {r['axis']}" for r in table))
    _, ax = plt.subplots(figsize=(8, 5))
    for r in table:
        at = names.index(f"{r['scene']}: {r['axis']}")
        ax.semilogx(max(r["error"], 1e-17) / r["bound"], at, "o" if r["ok"] else "x", color="C0")
    ax.axvline(1, color="k", lw=0.8)
    ax.set(yticks=range(len(names)), yticklabels=names, xlabel="error / bound")
    folder.mkdir(parents=True, exist_ok=True)
    plt.savefig(folder / "stability.png", dpi=150, bbox_inches="tight")


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description="Ties in stiff and extreme scenes.")
    parser.add_argument("--quick", action="store_true", help="the ends of each axis only")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    table = []
    if comm.rank == 0:
        print(
            f"{'scene':13s}{'axis':21s}{'value':>14s} dim k  error     bound     / fused   residual"
            "  gap       KSP INFOG(12) (28)"
        )
    for r in rows(args.quick):
        table.append(r)
        ratio = r["error"] / r["fused"] if r["fused"] else np.nan
        text = f"{r['value']:.5g}" if isinstance(r["value"], float) else str(r["value"])
        line = f"{r['scene']:13s}{r['axis']:21s}{text:>14s} {r['dim']}D  {r['degree']}  "
        line += f"{r['error']:.1e}   {r['bound']:.1e}   {ratio:7.1e}   {r['residual']:.1e}   "
        line += f"{r['constraint']:.1e}   {r['reason']} {r['infog12']!s:>7} {r['infog28']!s:>5}   "
        if comm.rank == 0:
            print(line + ("met" if r["ok"] else "NOT MET"), flush=True)
    if comm.rank == 0:
        print(f"{sum(r['ok'] for r in table)} of {len(table)} rows met")
        if args.json:
            args.json.write_text(json.dumps(table, indent=1))
        if args.plot:
            picture(table, args.plot)
    return 0 if all(r["ok"] for r in table) else 1


if __name__ == "__main__":
    sys.exit(main())
