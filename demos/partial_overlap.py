# # Surfaces that overlap in part, in three dimensions
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A plate and a block on it whose outlines don't match: the block stands inside of the plate's face,
# over its edge or corner, or is a bar that crosses it; or only patches of the plate can be tied.
# What lies opposite to the other side is tied, what doesn't is free.
#
# - flat: both are stretched in the plane of the interface, alike. There is no traction on it, so
#   the free part is exact too, and a method passes when the error is round-off.
# - curved: a pad on a cylinder and a patch on a sphere, turned against the other's mesh, with a
#   smooth field, which is prescribed in the plate's facets that the pad doesn't cover as a whole.
#   Errors fall as they do without an interface.
# - bent: a block glued on a plate, beside one mesh of both: the load's work and the mean stress in
#   the block, degree 2.

# +
import argparse
import itertools
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import (
    compute_midpoints,
    create_submesh,
    entities_to_geometry,
    exterior_facet_indices,
    locate_entities_boundary,
    meshtags,
)

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem, progress

# -

nu = 0.3


def sigma(u, E=1.0):
    """Stress of a displacement."""
    eps = ufl.sym(ufl.grad(u))
    return E / (1 + nu) * (eps + nu / (1 - 2 * nu) * ufl.tr(eps) * ufl.Identity(3))


def stretching(x):
    """No traction on planes of constant z."""
    return 0.3 * x[0] - 0.2 * x[1], 0.5 * x[0] + 0.4 * x[1], -nu / (1 - nu) * 0.7 * x[2]


def smooth(x, m=np):
    """A field that is in no finite element space; of an array or, with ``m=ufl``, a coordinate."""
    return (
        m.sin(1.3 * x[0] + 0.4) * m.cos(0.9 * x[1]),
        0.7 * m.cos(1.1 * x[0]) * m.exp(0.5 * x[2]),
        m.sin(x[0] + 0.5 * x[1] - 0.7 * x[2]),
    )


# ## Where the block stands
#
# Angle, size and centre of its face on the unit square.

FLAT = {
    "inside": (0, (0.45, 0.45), (0.51, 0.5)),
    "rotated": (30, (0.45, 0.45), (0.51, 0.5)),
    "over an edge": (0, (0.5, 0.5), (0.9, 0.45)),
    "over a corner": (20, (1.0, 1.0), (1.0, 1.0)),
    "crossing": (40, (2.0, 0.3), (0.5, 0.5)),
    "a patch with a hole": (0, (0.9, 0.9), (0.5, 0.5)),
    "two patches": (10, (0.9, 0.9), (0.5, 0.5)),
}

# The plate's patches: not all of its face is tied.

PATCHES = {
    "a patch with a hole": lambda x: np.abs(x[:2] - 0.5).max(axis=0) > 0.2,
    "two patches": lambda x: np.abs(x[0] - 0.5) > 0.2,
}
CELLS = {
    "tetrahedron": ("tetrahedron",) * 2,
    "hexahedron": ("hexahedron",) * 2,
    "mixed": ("tetrahedron", "hexahedron"),
}


def placed(angle, size, centre, x):
    """Points of the unit square's plane turned about its centre, scaled and moved."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn = np.array([(c, s, 0), (-s, c, 0), (0, 0, 1)])
    return ((x - (0.5, 0.5, 0)) * (*size, 1)) @ turn + (*centre, 0)


def flat_patch(comm, scene, cell, degree, swap, E):
    """Relative errors of displacement and stress, and the largest traction over the stress."""
    n = (6, 6, 2) if scene in PATCHES else (4, 4, 2)
    below = meshes.block(comm, n, lambda x: x - (0, 0, 1), cell=CELLS[cell][0])
    n = [max(2, round(4 * length)) for length in FLAT[scene][1]]
    above = meshes.block(
        comm, (*n, 2), lambda x: placed(*FLAT[scene], x / (1, 1, 2)), cell=CELLS[cell][1]
    )
    forms, loads, sides = [], [], []
    for (mesh, ft), tag, modulus in zip((below, above), (meshes.FRONT, meshes.BACK), E):
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        x, n = ufl.SpatialCoordinate(mesh), ufl.FacetNormal(mesh)
        modulus = fem.Constant(mesh, default_scalar_type(modulus))
        around = (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP)
        ds = ufl.Measure("ds", mesh, subdomain_data=ft)(around)
        forms.append(ufl.inner(sigma(u, modulus), ufl.sym(ufl.grad(v))) * ufl.dx)
        exact = ufl.as_vector(stretching(x))
        loads.append(ufl.dot(ufl.dot(sigma(exact, modulus), n), v) * ds)
        facets = ft.find(tag)
        if tag == meshes.FRONT and scene in PATCHES:
            middles = compute_midpoints(mesh, 2, facets).T
            facets = facets[PATCHES[scene](middles)]
        sides.append((V, facets))
    mesh, ft = below
    g = fem.Function(sides[0][0])
    g.interpolate(lambda x: np.array(stretching(x)))
    held = fem.locate_dofs_topological(sides[0][0], 2, ft.find(meshes.BACK))
    tie = Tie(*(sides[::-1] if swap else sides))
    problem = TiedProblem(forms, loads, bcs=[fem.dirichletbc(g, held)], ties=[tie])
    us = problem.solve()
    q = tie.quadrature(2 * degree)
    traction = np.abs(q.evaluate(tie.traction(problem))).max(initial=0)
    traction = comm.allreduce(traction, MPI.MAX) / max(E)
    return *errors(us, lambda x, m: stretching(x)), float(traction)


def errors(us, exact):
    """Relative L² errors of displacements and of their gradients."""
    totals = np.zeros(4)
    for u in us:
        u_exact = ufl.as_vector(exact(ufl.SpatialCoordinate(u.function_space.mesh), ufl))
        dx = ufl.dx(metadata={"quadrature_degree": 6})
        for i, (f, g) in enumerate(((u, u_exact), (ufl.grad(u), ufl.grad(u_exact)))):
            for j, e in enumerate((f - g, g)):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    error_u, norm_u, error_s, norm_s = us[0].function_space.mesh.comm.allreduce(totals)
    return float(np.sqrt(error_u / norm_u)), float(np.sqrt(error_s / norm_s))


# ## Curved ones
#
# Both surfaces are images of the plane; the pad is a turned rectangle there.

PAD = 17, (0.62, 0.55), (0.0, 0.0)


def on_cylinder(x):
    """Angle, length and radius."""
    return np.column_stack((x[:, 2] * np.sin(x[:, 0]), x[:, 1], x[:, 2] * np.cos(x[:, 0])))


def on_sphere(x):
    """Two angles and the radius."""
    c, s = np.cos(x), np.sin(x)
    return x[:, 2:] * np.column_stack((s[:, 0] * c[:, 1], s[:, 1], c[:, 0] * c[:, 1]))


CURVED = {
    "pad on a cylinder": (on_cylinder, lambda x: (np.arctan2(x[:, 0], x[:, 2]), x[:, 1])),
    "patch on a sphere": (
        on_sphere,
        lambda x: (np.arctan2(x[:, 0], x[:, 2]), np.arcsin(x[:, 1] / np.linalg.norm(x, axis=1))),
    ),
}


def under_the_pad(mesh, facets, angles):
    """Facets whose vertices lie under the pad."""
    nodes = entities_to_geometry(mesh, 2, facets)[:, :3]
    x = np.column_stack(angles(mesh.geometry.x[nodes.ravel()]))
    angle, size, _ = PAD
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    y = np.abs(x @ np.array([(c, -s), (s, c)])) * 2
    return facets[(y < np.array(size) - 1e-9).all(axis=1).reshape(-1, 3).all(axis=1)]


def curved_patch(comm, scene, cell, degree, level):
    """Relative errors of displacement and its gradient."""
    surface, angles = CURVED[scene]

    def below(x):
        return surface((x - (0.5, 0.5, 0)) * (1.2, 1.2, 0.3) + (0, 0, 0.7))

    def above(x):
        return surface(placed(*PAD, x * (1, 1, 0.25)) + np.array((0, 0, 1)))

    forms, loads, bcs, sides = [], [], [], []
    ends = ((6, below, meshes.FRONT), (4, above, meshes.BACK))
    for n, place, tag in ends:
        n = (n * level, n * level, 2 * level)
        mesh, ft = meshes.block(comm, n, place, cell=cell, degree=degree)
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        stress = sigma(ufl.as_vector(smooth(ufl.SpatialCoordinate(mesh), ufl)))
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
        forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        loads.append(-ufl.dot(ufl.div(stress), v) * dx)
        mesh.topology.create_connectivity(2, 3)
        if tag == meshes.FRONT:
            tied = under_the_pad(mesh, ft.find(tag), angles)
            held = np.setdiff1d(exterior_facet_indices(mesh.topology), tied).astype(np.int32)
        else:  # the pad is held at its other face
            held = ft.find(meshes.FRONT)
            around = (meshes.LEFT, meshes.RIGHT, meshes.BOTTOM, meshes.TOP)
            rule = {"quadrature_degree": 2 * degree + 2}
            ds = ufl.Measure("ds", mesh, subdomain_data=ft, metadata=rule)(around)
            loads[-1] += ufl.dot(ufl.dot(stress, ufl.FacetNormal(mesh)), v) * ds
        g = fem.Function(V)
        g.interpolate(lambda x: np.array(smooth(x)))
        bcs.append(fem.dirichletbc(g, fem.locate_dofs_topological(V, 2, held)))
        sides.append((V, ft.find(tag)))
    us = TiedProblem(forms, loads, bcs=bcs, ties=[Tie(*sides)]).solve()
    return errors(us, smooth)


# ## A block glued on a wider plate, bent
#
# Beside it one mesh of both, whose cells are those of a box that lie in the plate or the block.

PLATE = (0, 0, -0.25), (3, 1, 0)
BLOCK = (1, 0.25, 0), (2, 0.75, 0.5)


def bent(comm, bodies, degree, tied=None, swap=False):
    """A plate held at x = 0 and pulled down at x = 3: its work, and the block's mean stress."""
    forms, loads, bcs, spaces = [], [], [], []
    for mesh in bodies:
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        end = locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 3))
        tags = meshtags(mesh, 2, end, np.ones(len(end), dtype=np.int32))
        loads.append(-v[2] * ufl.ds(1, subdomain_data=tags, domain=mesh))
        held = locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[0], 0))
        zero = fem.Function(V)
        bcs.append(fem.dirichletbc(zero, fem.locate_dofs_topological(V, 2, held)))
        spaces.append(V)
    sides = list(zip(spaces, tied, strict=True)) if tied else []
    ties = [Tie(*(sides[::-1] if swap else sides))] if tied else []
    us = TiedProblem(forms, loads, bcs=bcs, ties=ties).solve()
    work = sum(fem.assemble_scalar(fem.form(ufl.action(L, u))) for L, u in zip(loads, us))
    total = 0.0
    for u in us:  # where z > 0
        mesh = u.function_space.mesh
        above = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(mesh)[2], 0), 1.0, 0.0)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
        stress = sigma(u)
        total += fem.assemble_scalar(fem.form(above * ufl.inner(stress, stress) * dx))
    return comm.allreduce(work), np.sqrt(comm.allreduce(total))


def between(low, high):
    """Places in the unit cube to places in a box."""
    return lambda x: np.array(low) + x * np.subtract(high, low)


def block_on_plate(comm, cell, degree, level, swap):
    """Relative differences of work and stress from those of one mesh of about the same size."""
    box, _ = meshes.block(comm, (12 * level, 4 * level, 3 * level), cell=cell)
    box.geometry.x[:] = between((0, 0, -0.25), (3, 1, 0.5))(box.geometry.x)
    cells = np.arange(box.topology.index_map(3).size_local, dtype=np.int32)
    x = compute_midpoints(box, 3, cells)
    inside = ((x > BLOCK[0]) & (x < BLOCK[1])).all(axis=1) | (x[:, 2] < 0)
    fused = create_submesh(box, 3, cells[inside])[0]
    reference = bent(comm, [fused], degree)
    plate = meshes.block(comm, (9 * level, 5 * level, level), between(*PLATE), cell=cell)
    block = meshes.block(comm, (4 * level, 3 * level, 2 * level), between(*BLOCK), cell=cell)
    tied = plate[1].find(meshes.FRONT), block[1].find(meshes.BACK)
    found = bent(comm, [plate[0], block[0]], degree, tied, swap)
    return [float(abs(a / b - 1)) for a, b in zip(found, reference, strict=True)]


# ## All of them


def rows_of(comm, cells, degrees):
    """A row for each flat scene, and two for each curved one."""
    rows = []
    for scene, cell, degree, swap in itertools.product(FLAT, cells, degrees, (False, True)):
        for E in ((1.0, 1.0), (1.0, 10.0)):
            progress.show(comm, f"{scene}, degree {degree}")
            name = scene + (", two materials" if E[1] != 1 else "")
            l2, stress, traction = flat_patch(comm, scene, cell, degree, swap, E)
            ok = max(l2, stress) <= 1e-11 and traction <= 1e-9
            rows.append((name, cell, degree, swap, l2, stress, traction, 1e-11, bool(ok)))
    for scene, degree in itertools.product(CURVED, degrees):
        cell = "tetrahedron"
        found = []
        for level in (1, 2):
            progress.show(comm, f"{scene}, degree {degree}, level {level}")
            found.append(curved_patch(comm, scene, cell, degree, level))
            bound = found[0][0] / 2 ** (1.9, 2.8)[degree - 1] if level == 2 else None
            ok = bound is None or found[1][0] <= bound
            name = f"{scene}, level {level}"
            rows.append((name, cell, degree, False, *found[-1], None, bound, bool(ok)))
    if 2 in degrees:
        kinds = sorted({cell for name in cells for cell in CELLS[name]})
        for cell, swap in itertools.product(kinds, (False, True)):
            before = np.inf
            for level in (1, 2):
                name = f"block on a plate, level {level}"
                progress.show(comm, name)
                l2, stress = block_on_plate(comm, cell, 2, level, swap)
                ok = max(l2, stress) <= min(0.03, before)
                before = max(l2, stress)
                rows.append((name, cell, 2, swap, l2, stress, None, 0.03, bool(ok)))
    progress.show(comm)
    names = ("scene", "cell", "degree", "swap", "l2", "stress", "traction", "bound", "ok")
    return [dict(zip(names, row, strict=True)) for row in rows]


def main():
    """Run every case and print its errors."""
    parser = argparse.ArgumentParser(description="Surfaces that overlap in part.")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--cell", nargs="+", choices=tuple(CELLS), default=list(CELLS))
    parser.add_argument("--degree", type=int, nargs="+", default=[1, 2])
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    rows = rows_of(comm, args.cell, args.degree)
    if comm.rank > 0:
        return
    print("scene                                cell         degree  Γ1     u        gradient")
    for row in rows:
        line = "{scene:37s}{cell:13s}{degree:<8d}{side:6s}{l2:9.1e}{stress:9.1e}"
        print(
            line.format(**row, side="below" if row["swap"] else "above"), "" if row["ok"] else "!"
        )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
