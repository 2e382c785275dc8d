# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Pictures with PyVista: Σ, deformed shapes, fields, tractions and contact.

All functions are collective. Rank 0 draws and returns the plotter or grid, other ranks return None.
Of complex values the real part is drawn.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.colors import LinearSegmentedColormap
from vtkmodules.vtkFiltersGeometry import (
    vtkDataSetSurfaceFilter,
    vtkUnstructuredGridGeometryFilter,
)

from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx.plot import vtk_mesh
from hypergap_dolfinx.contact import Contact
from hypergap_dolfinx.contact_problem import ContactProblem
from hypergap_dolfinx.core import display
from hypergap_dolfinx.core.compat import geometry_dofmap
from hypergap_dolfinx.surface.trace import Surface, is_mixed, lengths
from hypergap_dolfinx.tie import Tie
from hypergap_dolfinx.tolerances import CLOSED_NORMAL

_BODY, _EDGE, _SHEAR, _AWAY = "#e8e4da", "#555555", "#1b7837", "#777777"
_WARM = LinearSegmentedColormap.from_list("warm", ("#fdae61", "#d7301f", "#67000d"))
"""Colours of pressures and tractions, seen on light bodies, from low to high."""
_SIZE = [1200, 900]
"""Pixels of a picture."""
_ARROW = pyvista.Arrow(tip_length=0.35, tip_radius=0.1, shaft_radius=0.03)


def grid(mesh: Mesh) -> pyvista.UnstructuredGrid | None:
    """Cells of all ranks as one PyVista grid.

    Args:
        mesh: A mesh.
    """
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local)
    return _merged(mesh.comm, vtk_mesh(mesh, mesh.topology.dim, owned))


def _merged(comm: MPI.Comm, part, **values: npt.NDArray) -> pyvista.UnstructuredGrid | None:
    """One grid of the parts of all ranks, (cells, types, x) with values at points. Collective."""
    parts = comm.gather((part, values))
    if parts is None:
        return None
    grids = []
    for arrays, values in parts:
        if len(arrays[1]):
            grids.append(pyvista.UnstructuredGrid(*arrays))
            grids[-1].point_data.update(values)
    return pyvista.merge(grids, merge_points=False)


def gap_domain(
    ties: Tie | Sequence[Tie],
    filename: str | Path | None = None,
    *,
    distance: float | None = None,
    window: bool = False,
) -> pyvista.Plotter | None:
    """Tied bodies, pulled apart, with Σ between them coloured by α.

    Args:
        ties: A tie or several; their bodies are drawn.
        filename: Path of the picture; None saves none.
        distance: Drawn distance of Γ1 from Γ0; by default a sixth of the interface's extent.
        window: True to open a window.
    """
    ties = [ties] if isinstance(ties, Tie) else ties
    return _draw_gap_domains(ties, None, "alpha", filename, distance, window)


def deformed(
    us: fem.Function | Iterable[fem.Function],
    filename: str | Path | None = None,
    *,
    factor: float | None = None,
    window: bool = False,
) -> pyvista.Plotter | None:
    """Deformed bodies, coloured by the length of the displacement; in 2D with undeformed edges.

    Args:
        us: Displacement of each body; ``w.sub(0)`` of mixed elements.
        filename: Path of the picture; None saves none.
        factor: Factor of the drawn displacements; by default the largest is drawn as a tenth of the
            extent of all bodies.
        window: True to open a window.

    Raises:
        ValueError: A function that isn't a vector.
    """
    us = [us] if isinstance(us, fem.Function) else list(us)
    if any(len(u.function_space.value_shape) != 1 for u in us):
        raise ValueError("deformed draws displacements; draw other fields with plot.field.")
    comm, dim = us[0].function_space.mesh.comm, us[0].function_space.mesh.geometry.dim
    plotter = _plotter(comm, window)
    drawn = [(_with_values(u, "displacement"), u) for u in us]
    if plotter:
        grids = [g for g, _ in drawn if g is not None]
        length = max(np.linalg.norm(g["displacement"], axis=1).max() for g in grids)
        bounds = np.array([g.bounds for g in grids])
        size = np.max(bounds[:, 1::2].max(axis=0) - bounds[:, ::2].min(axis=0))
        factor = 0.1 * size / (length or 1) if factor is None else factor
        for g in grids:
            if dim == 2:
                before = g.extract_all_edges()
                before.points[:, 2] -= 1e-3 * size  # behind the deformed body
                plotter.add_mesh(before, color="black", opacity=0.4)
            warped = g.copy()
            warped.points = g.points + factor * g["displacement"]
            warped["length"] = np.linalg.norm(g["displacement"], axis=1)
            bar = _bar("length of u")
            _add(plotter, warped, scalars="length", cmap="Blues", clim=(0, length),
                 scalar_bar_args=bar)  # fmt: skip
        text = f"deformation x {factor:.3g}"
        plotter.add_text(text, position="upper_left", color="black", font_size=12)
    return _finish(plotter, dim, filename, window)


def field(
    fs: fem.Function | Iterable[fem.Function],
    filename: str | Path | None = None,
    *,
    title: str = "value",
    window: bool = False,
) -> pyvista.Plotter | None:
    """Bodies, coloured by a scalar function or the length of a vector function.

    For functions on Σ take :func:`interface`.

    Args:
        fs: Function on each body, or on a side of ties: ``tie.traction(problem, on="side1")``.
        filename: Path of the picture; None saves none.
        title: Title of the colour bar.
        window: True to open a window.

    Raises:
        ValueError: A function with tensor values.
    """
    fs = [fs] if isinstance(fs, fem.Function) else list(fs)
    if any(len(f.function_space.value_shape) > 1 for f in fs):
        raise ValueError("field draws scalars and vectors; take a component or an invariant.")
    mesh = fs[0].function_space.mesh
    plotter = _plotter(mesh.comm, window)
    grids = [_with_values(f, "values") for f in fs]
    drawn = [g for g in grids if g is not None]
    if plotter and drawn:
        for g in drawn:
            scalar = not np.any(g["values"][:, 1:])
            g["value"] = g["values"][:, 0] if scalar else np.linalg.norm(g["values"], axis=1)
        values = np.concatenate([g["value"] for g in drawn])
        clim = (values.min(), values.max())
        if np.isclose(-clim[0], clim[1], rtol=1e-3):  # then the scale has a 0 in its middle
            clim = (-clim[1], clim[1])
        for f, cells in zip(fs, grids, strict=True):
            if cells is None:
                continue
            on, bar = f.function_space.mesh, _bar(title)
            place = 2 * (on.topology.dim < on.geometry.dim)  # a side before its body
            _add(plotter, cells, place=place, scalars="value", cmap="inferno", clim=clim,
                 scalar_bar_args=bar)  # fmt: skip
    return _finish(plotter, mesh.geometry.dim, filename, window)


def interface(
    tie: Tie,
    f: fem.Function,
    filename: str | Path | None = None,
    *,
    title: str = "value",
    distance: float | None = None,
    window: bool = False,
) -> pyvista.Plotter | None:
    """Σ between its pulled-apart bodies, coloured by a scalar or the length of a vector.

    Args:
        tie: The tie.
        f: A function on ``tie.sigma``, as ``tie.gap`` and ``tie.traction`` return them.
        filename: Path of the picture; None saves none.
        title: Title of the colour bar.
        distance: Drawn distance of Γ1 from Γ0; by default a sixth of the interface's extent (3D: a
            third).
        window: True to open a window.

    Raises:
        ValueError: A function on another mesh.
    """
    if not isinstance(tie, Tie) or f.function_space.mesh is not tie.sigma:
        raise ValueError("interface draws functions on tie.sigma; others: field, contact.")
    return _draw_gap_domains([tie], f, title, filename, distance, window)


def traction(
    tie: Tie,
    traction: fem.Function,
    filename: str | Path | None = None,
    *,
    window: bool = False,
) -> pyvista.Plotter | None:
    """Traction on the interface as arrows, in 2D on both bodies, in 3D on the body of Γ0.

    Tractions of more than three times the mean, as at singular corners, are drawn as long and in
    the colour of those of three times the mean.

    Args:
        tie: The tie.
        traction: λ on Σ, from ``tie.traction(problem)``; a vector.
        filename: Path of the picture; None saves none.
        window: True to open a window.

    Raises:
        ValueError: A traction that isn't on Σ.
    """
    comm, dim = tie.domain.comm, tie.surfaces[0].gdim
    if traction.function_space.mesh is not tie.sigma:
        raise ValueError(
            "the traction is a function on tie.sigma, as tie.traction(problem) gives it; "
            "plot.field draws those on a body's surface."
        )
    plotter = _plotter(comm, window)
    drawn = tie.spaces if dim == 2 else tie.spaces[:1]
    for mesh in {id(V.mesh): V.mesh for V in drawn}.values():
        body = grid(mesh)
        if plotter and body is not None:
            _add(plotter, body, color=_BODY)
    q = tie.quadrature(1)
    parts = comm.gather((q.x[:, 0], q.evaluate(traction)[:, 0].real, q.normal[:, 0]))
    if plotter and parts is not None:
        x, t = (np.vstack([part[i] for part in parts]) for i in (0, 1))
        points = pyvista.PolyData(_padded(x))
        length = np.linalg.norm(t, axis=1)
        largest = min(length.max(), 3 * length.mean())
        t = t * np.minimum(1, largest / np.where(length > 0, length, 1))[:, None]
        points["traction"] = _padded(t)
        points["length"] = np.linalg.norm(t, axis=1)
        scale = 0.15 * np.ptp(_padded(x), axis=0).max() / (largest or 1)
        bar, clim = _bar("traction"), (0, largest)
        if dim == 3:  # arrows of pressure point into the body: they end at the surface, to be seen
            inwards = np.einsum("pi,pi->p", t, np.vstack([part[2] for part in parts])) < 0
            points.points[inwards] -= scale * points["traction"][inwards]
        arrows = points.glyph(orient="traction", scale="length", factor=scale, geom=_ARROW)
        plotter.add_mesh(arrows, scalars="length", cmap=_WARM, clim=clim, lighting=dim == 3,
                         scalar_bar_args=bar)  # fmt: skip
    mean = _mean_normal(tie.domain.surfaces[0])
    return _finish(plotter, dim, filename, window, mean + 0.4 * _beside(mean), mean)


def contact(
    contact: Contact,
    problem: ContactProblem,
    filename: str | Path | None = None,
    *,
    largest: float | None = None,
    values: Sequence[fem.Function] | None = None,
    window: bool = False,
) -> pyvista.Plotter | None:
    """Displaced bodies in contact, with the pressure on Γ1 as colours and arrows.

    Green arrows are friction tractions on Γ1's body, with a scale of their own; in 2D some are left
    out where they would overlap. Points are active vertices of Γ1. In 3D the body of Γ1 is left
    out, since it would hide the contact; a body in contact with itself is translucent.

    Args:
        contact: The contact.
        problem: A solved problem with this contact.
        filename: Path of the picture; None saves none.
        largest: Pressure at the end of the colour bar; by default the largest one.
        values: Scalar function on each body of the problem, drawn as its colour (blue, from 0 on):
            an equivalent stress from :func:`hypergap_dolfinx.files.interpolated` for example.
        window: True to open a window.
    """
    comm, dim = contact.spaces[0].mesh.comm, contact.spaces[0].mesh.geometry.dim
    surface, p = contact.displaced(problem)[1], contact.pressures(problem)
    drawn = _drawn(contact.pressure(problem, on="surface"))
    shear = contact.shears(problem) if contact.friction else np.zeros(0)
    plotter, itself = _plotter(comm, window), contact.spaces[0] == contact.spaces[1]
    bodies = [
        _with_values(u, "displacement", None if values is None else values[i])
        for i, u in enumerate(problem.every_u)
    ]
    known = [body["value"].max() for body in bodies if body and "value" in body.point_data]
    for u, body in zip(problem.every_u, bodies, strict=True):
        hides = dim == 3 and u.function_space == contact.spaces[1]
        if plotter and body is not None and (itself or not hides):
            body.points += body["displacement"]
            colours: Any = {"color": _BODY}
            if known:
                colours = {"scalars": "value", "cmap": "Blues", "clim": (0, max(known)),
                           "show_scalar_bar": False}  # fmt: skip
            _add(plotter, body, opacity=0.3 if hides else 1.0, **colours)
    if plotter and drawn:
        largest = (p.max(initial=0) or 1.0) if largest is None else largest
        extent = np.ptp(surface.x, axis=0).max()
        lift = 0.01 * extent  # so that surfaces at one place are drawn one before the other
        scale: Any = {"scalars": "pressure", "cmap": _WARM, "clim": (0, largest)}
        bar: Any = {"lighting": False, "scalar_bar_args": _bar("pressure")}
        direction, x = surface.vertex_normals, surface.x
        if dim == 3:  # before Γ0's body, also where they overlap
            rows = problem.rows(contact)
            overlap = -(rows.g[rows.state.active] / rows.m[rows.state.active]).min(initial=0)
            move = -(lift + 2 * overlap) * direction
            x = x + move
            drawn.points += move[[lengths(surface.x - at).argmin() for at in drawn.points]]
        # What isn't pressed is thin, or lets Γ0's body be seen
        pressed = drawn.point_data_to_cell_data()["pressure"] > 0.01 * largest
        if pressed.any():
            plotter.add_mesh(drawn.extract_cells(pressed), line_width=8, **scale, **bar)
        if not pressed.all():
            away, seen = drawn.extract_cells(~pressed), 1.0 if dim == 2 else 0.15
            plotter.add_mesh(away, line_width=3, color=_AWAY, lighting=False, opacity=seen)
        on = contact.active
        if on.any():
            points = pyvista.PolyData(_padded(x[on]))
            points["arrow"], points["pressure"] = _padded(direction[on]), p[on]
            plotter.add_mesh(points, color="black", point_size=8, render_points_as_spheres=True)
            length, tails = (0.15, 0.25)[dim - 2] * extent / largest, points.copy()
            tails.points = points.points - length * p[on][:, None] * points["arrow"]
            arrows = tails.glyph(orient="arrow", scale="pressure", factor=length, geom=_ARROW)
            plotter.add_mesh(arrows, show_scalar_bar=False, lighting=dim == 3, **scale)
            if shear.any():
                tails["shear"] = _padded(shear[on])
                tails["size"] = np.linalg.norm(shear[on], axis=1)
                tails.points = points.points - 2 * lift * points["arrow"]  # beside Γ1
                most = tails["size"].max()
                length = (0.1, 0.25)[dim - 2] * extent
                if dim == 2:  # one behind the other: not all are drawn
                    tails = tails.extract_points(_apart(tails.points, tails["size"], length / 2))
                    tails.points[:, 2] += 2 * lift
                factor = length / most
                arrows = tails.glyph(orient="shear", scale="size", factor=factor, geom=_ARROW)
                plotter.add_mesh(arrows, color=_SHEAR, name="shear", lighting=dim == 3)
                text = f"green: shear, up to {most:.3g}"
                plotter.add_text(text, position="upper_left", color=_SHEAR, font_size=12)
    up = -_mean_normal(surface)
    return _finish(plotter, dim, filename, window, _beside(up) + up, up)


def _apart(points: npt.NDArray, size: npt.NDArray, distance: float) -> list[int]:
    """Indices of points that are a distance apart, the largest ones first."""
    chosen: list[int] = []
    for i in np.argsort(-size, kind="stable"):
        if all(np.linalg.norm(points[i] - points[j]) > distance for j in chosen):
            chosen.append(int(i))
    return chosen


def _drawn(f: fem.Function) -> pyvista.UnstructuredGrid | None:
    """Grid with the pressure on cells of a surface; on rank 0. Collective."""
    V = f.function_space
    mesh = V.mesh
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local)
    cells, types, x = vtk_mesh(V, owned)  # type: ignore[arg-type]
    return _merged(mesh.comm, (cells, types, x), pressure=np.real(f.x.array)[: len(x)])


def _padded(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows padded with zeros to three components."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def _with_values(
    u: fem.Function, name: str, f: fem.Function | None = None
) -> pyvista.UnstructuredGrid | None:
    """Grid with a vector function, and a scalar one as "value"; on rank 0. Collective."""
    if is_mixed(u.function_space):
        raise ValueError("fields of a mixed space are drawn one by one: u.sub(0) for example.")
    u = u.collapse() if u.function_space.component() else u
    V, comm, more = u.function_space, u.function_space.mesh.comm, {}
    owned = np.arange(V.mesh.topology.index_map(V.mesh.topology.dim).size_local)
    if f is not None:  # both on one discontinuous element
        degrees = [one.function_space.ufl_element().basix_element.degree for one in (u, f)]
        element = "Discontinuous Lagrange", max(degrees)
        V = fem.functionspace(V.mesh, (*element, V.value_shape))
        both = fem.Function(V), fem.Function(fem.functionspace(V.mesh, element))
        for into, one in zip(both, (u, f), strict=True):
            into.interpolate(one)
        u, more = both[0], {"value": np.real(both[1].x.array)}
    elif V.ufl_element().basix_element.degree == 0:  # VTK's cells have values at their vertices
        V = fem.functionspace(V.mesh, ("Discontinuous Lagrange", 1, V.value_shape))
        constant, u = u, fem.Function(V)
        u.interpolate(constant)
    cells, types, x = vtk_mesh(V, owned)  # type: ignore[arg-type]
    values = np.real(u.x.array).reshape(-1, V.dofmap.index_map_bs)[: len(x)]
    more = {key: array[: len(x)] for key, array in more.items()}
    return _merged(comm, (cells, types, x), **{name: _padded(values)}, **more)


Place = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], float]
"""Map of a body to its drawn position, x ↦ c + s (x − c) + d, as (d, c, s)."""


def _moved(x, shift, centre, scale):
    x = np.asarray(x, dtype=float)
    return centre + scale * (x - centre) + shift


def _pulled_apart(ties: Sequence[Tie], distance: float) -> dict[int, Place]:
    """Drawn position of each body (by its mesh), away from the bodies tied to it."""
    first = ties[0].spaces[0].mesh
    places: dict[int, Place] = {id(first): (np.zeros(3), np.zeros(3), 1.0)}
    todo = list(ties)
    while todo:
        meshes = [[id(V.mesh) for V in tie.spaces] for tie in todo]
        at = next((t for t, ids in enumerate(meshes) if ids[0] in places or ids[1] in places), None)
        if at is None:  # another assembly
            places[meshes[0][0]] = (np.zeros(3), np.zeros(3), 1.0)
            continue
        tie, (i0, i1) = todo.pop(at), meshes[at]
        step, centre, scale = _separation(tie.domain.surfaces, distance)
        if i0 in places and i1 not in places:
            shift, _, s = places[i0]
            places[i1] = (shift + step, centre, s * scale)
        elif i1 in places and i0 not in places:
            shift, _, s = places[i1]
            places[i0] = (shift - step, centre, s / scale)
    return places


def _mean_normal(surface: Surface) -> npt.NDArray[np.float64]:
    """Mean of the outward normals, ``(3,)``; nearly zero for closed surfaces."""
    size = surface.size ** (surface.gdim - 1)
    return (size[:, None] * _padded(surface.normals)).sum(axis=0) / size.sum()


def _beside(direction: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """View direction across a given one, and a little down on it."""
    axis = np.eye(3)[np.abs(direction).argmin()]
    across = np.cross(direction, axis)
    length = np.linalg.norm(across)
    return (across / length if length else axis) + 0.35 * axis


def _separation(surfaces: tuple[Surface, Surface], distance: float) -> Place:
    """Drawn position of Γ1: a translation along Γ0's mean normal, or a scaling."""
    surface = surfaces[0]
    x = _padded(surface.x[surface.facets].mean(axis=1))
    normals, size = _padded(surface.normals), surface.size ** (surface.gdim - 1)
    extent = np.ptp(_padded(surface.x), axis=0).max()
    mean = _mean_normal(surface)
    if np.linalg.norm(mean) > CLOSED_NORMAL:
        return distance * mean / np.linalg.norm(mean), np.zeros(3), 1.0
    # Closed around a centre: the outer body grows, or the inner one shrinks
    centre = (size[:, None] * x).sum(axis=0) / size.sum()
    outward = np.sign((size * np.einsum("fi,fi->f", normals, x - centre)).sum())
    return np.zeros(3), centre, 1 + outward * 2 * distance / extent


def _draw_gap_domains(
    ties: Sequence[Tie], f: fem.Function | None, title: str, filename, distance, window: bool
) -> pyvista.Plotter | None:
    """Pulled-apart bodies with Σ between them, coloured by a function on it or by α."""
    comm, dim = ties[0].domain.comm, ties[0].surfaces[0].gdim
    if distance is None:
        distance = np.ptp(ties[0].surfaces[0].x, axis=0).max() / (6 if dim == 2 else 3)
    places = _pulled_apart(ties, distance)
    mean = _mean_normal(ties[0].surfaces[0])
    closed = dim == 3 and np.linalg.norm(mean) <= CLOSED_NORMAL
    bodies = {id(V.mesh): V.mesh for tie in ties for V in tie.spaces}
    plotter = _plotter(comm, window)
    for key, mesh in bodies.items():
        body = grid(mesh)
        if plotter and body is not None:
            body.points = _moved(body.points, *places[key])
            _add(plotter, body.clip("y", crinkle=True) if closed else body, color=_BODY)
    for tie in ties:
        sigma = _sigma(tie, [places[id(V.mesh)] for V in tie.spaces], f)
        if plotter and sigma is not None:
            if closed:
                sigma = sigma.clip("y", crinkle=True)
            clim = (0, 1) if f is None else sigma.get_data_range("value")
            options: Any = {"scalars": "value", "cmap": "viridis", "clim": clim}
            _add(plotter, sigma, edges="white", scalar_bar_args=_bar(title), **options)
    up = mean * np.sign(mean[np.abs(mean).argmax()] or 1)  # upper bodies are drawn above others
    return _finish(plotter, dim, filename, window, (0, 1, 0.3) if closed else _beside(up), up)


def _sigma(
    tie: Tie, places: Sequence[Place], f: fem.Function | None
) -> pyvista.UnstructuredGrid | None:
    """Σ between two moved bodies with the values of f or α; on rank 0. Collective."""
    domain, mesh = tie.domain, tie.sigma
    cells = np.arange(len(domain.alpha_vertices))
    if f is None:
        points, nodes = domain.geometry.points, geometry_dofmap(mesh)
        drawn = vtk_mesh(mesh, mesh.topology.dim, cells)
    else:
        V = f.function_space
        points, nodes = V.ufl_element().basix_element.points, V.dofmap.list
        drawn = vtk_mesh(V, cells)  # type: ignore[arg-type]
    weights = np.column_stack((1 - points.sum(axis=1), points))
    alpha = np.zeros(nodes.max(initial=-1) + 1)
    alpha[nodes[domain.in_mesh]] = domain.alpha_vertices @ weights.T
    values = alpha
    if f is not None:
        components = f.x.array.real.reshape(-1, f.function_space.dofmap.index_map_bs)
        scalar = components.shape[1] == 1
        values = components[:, 0] if scalar else np.linalg.norm(components, axis=1)
    cells, types, x = drawn
    t = alpha[: len(x), None]
    moved = (1 - t) * _moved(x, *places[0]) + t * _moved(x, *places[1])
    return _merged(mesh.comm, (cells, types, moved), value=values[: len(x)])


def _plotter(comm: MPI.Comm, window: bool) -> pyvista.Plotter | None:
    if comm.rank > 0:
        return None
    if not window:
        display.prepare()
    plotter = pyvista.Plotter(off_screen=not window, window_size=_SIZE, lighting="none")
    plotter.add_light(pyvista.Light(light_type="headlight"))
    plotter.background_color = pyvista.Color("white")
    return plotter


def _add(
    plotter: pyvista.Plotter,
    cells: pyvista.UnstructuredGrid,
    edges: str = _EDGE,
    place: int = 0,
    **options,
):
    """Draw cells and their edges, with their curvature; before those of lower places."""
    dim = cells.get_cell(0).dimension if cells.n_cells else 2
    if dim == 1:  # a side's traction in the plane
        _before(plotter.add_mesh(cells, lighting=False, line_width=8, **options), place)
        return
    skin = _skin(cells)
    lit: Any = {"lighting": False}
    if dim == 3:
        lit = {"ambient": 0.4, "diffuse": 0.6}
        if not cells.get_cell(0).is_linear:
            lit |= {"smooth_shading": True, "split_sharp_edges": True}
    _before(plotter.add_mesh(skin, **lit, **options), place)
    lines = _outlines(skin)
    num_facets = len(np.unique(skin["vtkOriginalCellIds"]))
    lines.field_data["facet"] = [np.sqrt(skin.area / max(1, num_facets))]
    _before(plotter.add_mesh(lines, color=edges, line_width=1.5, lighting=False), place + 1)


def _before(actor: pyvista.Actor, place: int):
    """Draw what lies in one place in an order, the last before all others."""
    mapper = actor.mapper
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(0, -20 * place)
    mapper.SetRelativeCoincidentTopologyLineOffsetParameters(0, -20 * place)


def _skin(cells: pyvista.UnstructuredGrid) -> pyvista.PolyData:
    """Triangles of the outer faces of cells, several for each curved face."""
    faces = cells
    if cells.n_cells and cells.get_cell(0).dimension == 3:
        outside = vtkUnstructuredGridGeometryFilter()
        outside.SetInputDataObject(cells)  # faces that no other cell has, with their nodes
        outside.Update()
        faces = pyvista.wrap(outside.GetOutput())
    finer, level = vtkDataSetSurfaceFilter(), 3  # each edge in eight
    while level and faces.n_cells * 4**level > np.prod(_SIZE):  # not one a pixel
        level -= 1
    finer.SetInputDataObject(faces)
    finer.SetNonlinearSubdivisionLevel(level)
    finer.PassThroughCellIdsOn()
    finer.Update()
    return pyvista.wrap(finer.GetOutput()).triangulate()


def _outlines(skin: pyvista.PolyData) -> pyvista.PolyData:
    """Edges of the faces that triangles subdivide: those of a single triangle of a face."""
    corners = skin.faces.reshape(-1, 4)[:, 1:].astype(np.int64)
    one, other = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    key = np.minimum(one, other) * skin.n_points + np.maximum(one, other)
    order = np.argsort(key)
    key, face = key[order], np.repeat(skin["vtkOriginalCellIds"], 3)[order]
    starts = np.flatnonzero(np.append(True, key[1:] != key[:-1])) if len(key) else order
    alone = np.diff(np.append(starts, len(key))) == 1
    between = np.minimum.reduceat(face, starts) != np.maximum.reduceat(face, starts)
    ends = np.stack(np.divmod(key[starts[alone | between]], skin.n_points), axis=1)
    return pyvista.PolyData(skin.points, lines=np.insert(ends, 0, 2, axis=1))


def _bar(title: str) -> Any:
    """Options of a colour bar beside the picture."""
    return {"title": f"{title}\n", "vertical": True, "fmt": "%.3g", "color": "black",
            "position_x": 0.87, "position_y": 0.2, "height": 0.6}  # fmt: skip


def _finish(plotter, dim: int, filename, window: bool, look_from=(1, 1, 1), up=(0, 0, 1)):
    """Set the camera, save, show."""
    if plotter is None:
        return None
    beside = 0.86  # part of the picture's width that is left of the scale
    if dim == 2:
        x0, x1, y0, y1, _, _ = plotter.bounds
        plotter.view_xy()
        plotter.enable_parallel_projection()
        width, height = plotter.window_size
        # Half of the picture's height: bodies fill it, or what is left of the scale
        plotter.camera.parallel_scale = 0.58 * max(y1 - y0, (x1 - x0) / beside * height / width)
    else:
        plotter.view_vector(look_from, up)
    plotter.camera.SetWindowCenter(1 - beside, 0)
    pixels = plotter.window_size[1] / (2 * plotter.camera.parallel_scale)  # for a length of one
    for actor in plotter.actors.values():
        if isinstance(actor, pyvista.Actor) and "facet" in actor.mapper.dataset.field_data:
            # Edges of fine cells would hide them: they take at most a fifth of the colour
            size = pixels * actor.mapper.dataset.field_data["facet"][0]
            actor.prop.opacity = min(1, 0.2 * size / (2 * 1.5))
    if filename is not None:
        Path(filename).parent.mkdir(parents=True, exist_ok=True)
        plotter.screenshot(filename)
    if window:
        plotter.show()
    return plotter
