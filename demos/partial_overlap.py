# # Surfaces that overlap in part, in three dimensions
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# A block stands on a plate: inside its face, over its edge or its corner, or across it as a bar. Or
# only patches of the plate can be tied. The parts that lie opposite each other are tied, the rest
# is free.
#
# - flat: both are stretched equally in the plane of the interface. The interface has no traction,
#   so the exact solution has none on the free part either, and the error should be round-off.
# - curved: a pad on a cylinder and a patch on a sphere, turned against the other mesh. The exact
#   solution is a smooth field. It is prescribed on the facets of the plate that the pad doesn't
#   cover completely. Errors converge as without an interface.
# - loaded: a block glued on a bent plate, and a bush that sticks out of a bracket and is pushed
#   sideways. Each is compared with one mesh of both parts: the work of the load and the mean stress
#   in the smaller part, degree 2.

# +
import argparse
import itertools
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import (
    compute_midpoints,
    create_submesh,
    exterior_facet_indices,
    locate_entities_boundary,
    meshtags,
)

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, TiedProblem, compat, progress

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
        # The zero function's error is the exact field's norm, by the same form
        for j, f in enumerate((u, fem.Function(u.function_space))):
            for i, e in enumerate((f - u_exact, ufl.grad(f) - ufl.grad(u_exact))):
                totals[2 * i + j] += fem.assemble_scalar(fem.form(ufl.inner(e, e) * dx))
    error_u, norm_u, error_s, norm_s = us[0].function_space.mesh.comm.allreduce(totals)
    return float(np.sqrt(error_u / norm_u)), float(np.sqrt(error_s / norm_s))


# ## Curved ones
#
# Both surfaces are images of a plane, in which the pad is a rotated rectangle.

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
    nodes = compat.entities_to_geometry(mesh, 2, facets)[:, :3]
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


# ## Real loads
#
# The one mesh consists of those cells of a box that lie in either part. A load acts on one face,
# another face is held. The stress is that of the part where `inside` is true.


@dataclass
class Scene:
    """Two parts, where they are held and loaded."""

    held: Callable
    """Whether places are on the face that is held."""
    loaded: Callable
    """The same of the face that is pulled."""
    pull: tuple[float, float, float]
    inside: Callable
    """Where stress is measured, of a coordinate."""


def solve_loaded(comm, scene, bodies, degree, tied=None, swap=False):
    """Displacements, the load's work, and the mean stress in a part."""
    forms, loads, bcs, spaces = [], [], [], []
    for mesh in bodies:
        V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        forms.append(ufl.inner(sigma(u), ufl.sym(ufl.grad(v))) * ufl.dx)
        end = locate_entities_boundary(mesh, 2, scene.loaded)
        tags = meshtags(mesh, 2, end, np.ones(len(end), dtype=np.int32))
        pull = ufl.as_vector(scene.pull)
        loads.append(ufl.dot(pull, v) * ufl.ds(1, subdomain_data=tags, domain=mesh))
        held = locate_entities_boundary(mesh, 2, scene.held)
        zero = fem.Function(V)
        bcs.append(fem.dirichletbc(zero, fem.locate_dofs_topological(V, 2, held)))
        spaces.append(V)
    sides = list(zip(spaces, tied, strict=True)) if tied else []
    ties = [Tie(*(sides[::-1] if swap else sides))] if tied else []
    us = TiedProblem(forms, loads, bcs=bcs, ties=ties).solve()
    work = sum(fem.assemble_scalar(fem.form(ufl.action(L, u))) for L, u in zip(loads, us))
    total = 0.0
    for u in us:
        mesh = u.function_space.mesh
        part = ufl.conditional(scene.inside(ufl.SpatialCoordinate(mesh)), 1.0, 0.0)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * degree})
        stress = sigma(u)
        total += fem.assemble_scalar(fem.form(part * ufl.inner(stress, stress) * dx))
    return us, ties, (comm.allreduce(work), np.sqrt(comm.allreduce(total)))


def some_cells(mesh, wanted):
    """A mesh of the cells whose middles are wanted."""
    cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    return create_submesh(mesh, 3, cells[wanted(compute_midpoints(mesh, 3, cells))])[0]


# A block glued on a wider plate, which is held at x = 0 and pulled down at x = 3.

PLATE = (0, 0, -0.25), (3, 1, 0)
BLOCK = (1, 0.25, 0), (2, 0.75, 0.5)
BENT = Scene(
    held=lambda x: np.isclose(x[0], 0),
    loaded=lambda x: np.isclose(x[0], 3),
    pull=(0, 0, -1),
    inside=lambda x: ufl.gt(x[2], 0),
)


def between(low, high):
    """Places in the unit cube to places in a box."""
    return lambda x: np.array(low) + x * np.subtract(high, low)


def block_on_plate(comm, cell, level):
    """One mesh; two and the facets to be tied."""
    box, _ = meshes.block(comm, (12 * level, 4 * level, 3 * level), cell=cell)
    box.geometry.x[:] = between((0, 0, -0.25), (3, 1, 0.5))(box.geometry.x)
    fused = some_cells(box, lambda x: ((x > BLOCK[0]) & (x < BLOCK[1])).all(axis=1) | (x[:, 2] < 0))
    plate = meshes.block(comm, (9 * level, 5 * level, level), between(*PLATE), cell=cell)
    block = meshes.block(comm, (4 * level, 3 * level, 2 * level), between(*BLOCK), cell=cell)
    tied = plate[1].find(meshes.FRONT), block[1].find(meshes.BACK)
    return fused, [plate[0], block[0]], tied


# A bush that sticks out of a bracket's hole, farther on one side. The bracket is held around its
# end, the bush is pushed at its upper face, along the bracket and across it.

BORE, HOLE, EYE, END = 0.3, 0.5, 1.0, 1.0  # radii; how much longer the bracket is at its end
THICKNESS, BUSH = (-0.25, 0.25), (-0.4, 0.6)  # along the axis
PUSHED = Scene(
    held=lambda x: (
        (np.abs(np.arctan2(x[1], x[0])) > 2 * np.pi / 3 - 1e-6)
        & (np.hypot(x[0], x[1]) > rim(np.arctan2(x[1], x[0])) - 1e-3)
    ),
    loaded=lambda x: np.isclose(x[2], BUSH[1]),
    pull=(1, 0.5, 0),
    inside=lambda x: ufl.lt(x[0] ** 2 + x[1] ** 2, HOLE**2),
)


def rim(angle):
    """Radius of the bracket's outline."""
    return EYE + END * ((1 - np.cos(angle)) / 2) ** 4


def around(radii, heights):
    """Places in the unit cube to places around an axis.

    Args:
        radii: From 0 to 1 as lists of places; the last radius may be None, the bracket's outline.
        heights: The same along the axis.
    """

    def place(x):
        angle = 2 * np.pi * x[:, 1]
        inner = np.interp(x[:, 0], *radii)
        share = np.maximum(inner - HOLE, 0) / (EYE - HOLE)
        r = inner + share * (rim(angle) - EYE)
        return np.column_stack((r * np.cos(angle), r * np.sin(angle), np.interp(x[:, 2], *heights)))

    return place


def bush_in_bracket(comm, cell, level):
    """One mesh; two and the facets to be tied; degree 2 of geometry."""

    def part(n, radii, heights):
        n = tuple(level * np.array(n))
        kind = {"cell": cell, "degree": 2, "periodic": True}
        return meshes.block(comm, n, around(radii, heights), **kind)

    radii = (0, 1 / 3, 1), (BORE, HOLE, EYE)
    heights = (0, 1 / 6, 4 / 6, 1), (BUSH[0], *THICKNESS, BUSH[1])
    whole = part((3, 12, 6), radii, heights)[0]

    def wanted(x):
        return (np.hypot(x[:, 0], x[:, 1]) < HOLE) | (
            (x[:, 2] > THICKNESS[0]) & (x[:, 2] < THICKNESS[1])
        )

    bracket = part((2, 12, 3), ((0, 1), (HOLE, EYE)), ((0, 1), THICKNESS))
    bush = part((1, 16, 7), ((0, 1), (BORE, HOLE)), ((0, 1), BUSH))
    tied = bracket[1].find(meshes.LEFT), bush[1].find(meshes.RIGHT)
    return some_cells(whole, wanted), [bracket[0], bush[0]], tied


LOADED = {
    "block on a plate": (BENT, block_on_plate),
    "bush in a bracket": (PUSHED, bush_in_bracket),
}


def under_load(comm, name, cell, degree, level, swap):
    """Relative differences of work and stress from those of one mesh of about the same size."""
    scene, make = LOADED[name]
    fused, parts, tied = make(comm, cell, level)
    reference = solve_loaded(comm, scene, [fused], degree)[2]
    found = solve_loaded(comm, scene, parts, degree, tied, swap)[2]
    return [float(abs(a / b - 1)) for a, b in zip(found, reference, strict=True)]


def draw(comm, folder):
    """The block and the plate pulled apart with Σ between them; both scenes deformed."""
    from hypergap_dolfinx import plot

    for name, (scene, make) in LOADED.items():
        _, parts, tied = make(comm, "hexahedron", 1)
        us, ties, _ = solve_loaded(comm, scene, parts, 2, tied)
        plot.deformed(us, folder / f"{name.replace(' ', '_')}.png")
        if scene is BENT:
            plot.gap_domain(ties, folder / "gap_domain.png")
    if comm.rank == 0:
        print(f"\npictures in {folder}/")


# ## All of them


def rows_of(comm, cells, degrees, scenes):
    """A row for each flat scene, and two for each curved or loaded one."""
    rows = []
    flat, curved, loaded = ([s for s in some if s in scenes] for some in (FLAT, CURVED, LOADED))
    for scene, cell, degree, swap in itertools.product(flat, cells, degrees, (False, True)):
        for E in ((1.0, 1.0), (1.0, 10.0)):
            progress.show(comm, f"{scene}, degree {degree}")
            name = scene + (", two materials" if E[1] != 1 else "")
            l2, stress, traction = flat_patch(comm, scene, cell, degree, swap, E)
            ok = max(l2, stress) <= 1e-11 and traction <= 1e-9
            rows.append((name, cell, degree, swap, l2, stress, traction, 1e-11, bool(ok)))
    for scene, degree in itertools.product(curved, degrees):
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
        for scene, cell, swap in itertools.product(loaded, kinds, (False, True)):
            before = np.inf
            for level in (1, 2):
                name = f"{scene}, level {level}"
                progress.show(comm, name)
                l2, stress = under_load(comm, scene, cell, 2, level, swap)
                # Differences below 1 % are no error of either mesh alone
                ok = level == 1 or max(l2, stress) <= min(0.03, max(before, 0.01))
                before = max(l2, stress)
                bound = 0.03 if level == 2 else None
                rows.append((name, cell, 2, swap, l2, stress, None, bound, bool(ok)))
    progress.show(comm)
    names = ("scene", "cell", "degree", "swap", "l2", "stress", "traction", "bound", "ok")
    return [dict(zip(names, row, strict=True)) for row in rows]


def main():
    """Run every case and print its errors."""
    parser = argparse.ArgumentParser(description="Surfaces that overlap in part.")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--cell", nargs="+", choices=tuple(CELLS), default=list(CELLS))
    parser.add_argument("--degree", type=int, nargs="+", default=[1, 2])
    every = [*FLAT, *CURVED, *LOADED]
    parser.add_argument("--scene", nargs="+", choices=every, default=every)
    args = parser.parse_args()
    comm = MPI.COMM_WORLD
    rows = rows_of(comm, args.cell, args.degree, args.scene)
    if args.plot:
        draw(comm, args.plot)
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
