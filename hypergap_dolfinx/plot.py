# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
"""Pictures of tied bodies with PyVista: Σ pulled apart, deformed shapes, tractions.

Nothing else in the package imports this module. All functions are collective; rank 0 draws.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import pyvista

from dolfinx import fem
from dolfinx.mesh import Mesh
from dolfinx.plot import vtk_mesh
from hypergap_dolfinx import display
from hypergap_dolfinx.compat import geometry_dofmap
from hypergap_dolfinx.surface import Surface
from hypergap_dolfinx.tie import Tie

_BODY, _EDGE = "#e8e4da", "#555555"


def grid(mesh: Mesh) -> pyvista.UnstructuredGrid | None:
    """The cells of all ranks as one PyVista grid. Collective.

    Args:
        mesh: The mesh.

    Returns:
        The grid on rank 0, None on the others.
    """
    owned = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local)
    cells, types, x = vtk_mesh(mesh, mesh.topology.dim, owned)
    parts = mesh.comm.gather((cells, types, x))
    if parts is None:
        return None
    return pyvista.merge(
        [pyvista.UnstructuredGrid(*part) for part in parts if len(part[1])], merge_points=False
    )


def gap_domain(
    ties: Sequence[Tie],
    filename: str | Path | None = None,
    *,
    distance: float | None = None,
    window: bool = False,
) -> pyvista.Plotter | None:
    """The bodies, pulled apart along their interfaces, and Σ between them coloured by α.

    Args:
        ties: The ties; their bodies are drawn.
        filename: Where to save the picture.
        distance: How far Γ1 is drawn from Γ0; a sixth of the interface's extent if not given.
        window: Whether to open a window.

    Returns:
        The plotter on rank 0, None on the others.
    """
    comm = ties[0].sigma.comm
    places = _pulled_apart(ties, distance)
    bodies = {id(V.mesh): V.mesh for tie in ties for V in tie.spaces}
    plotter = _plotter(comm, window)
    for key, mesh in bodies.items():
        body = grid(mesh)
        if plotter and body is not None:
            body.points = _moved(body.points, *places[key])
            _add(plotter, body, color=_BODY)
    dim = ties[0].sigma.geometry.dim
    for tie in ties:
        sigma = _sigma(tie, [places[id(V.mesh)] for V in tie.spaces])
        if plotter and sigma is not None:
            sigma = sigma.shrink(0.92) if dim == 3 else sigma
            options = {"scalars": "α", "cmap": "viridis", "clim": (0, 1)}
            _add(plotter, sigma, edges="white", scalar_bar_args=_bar("alpha"), **options)
    return _finish(plotter, dim, filename, window)


def deformed(
    us: Iterable[fem.Function],
    filename: str | Path | None = None,
    *,
    factor: float | None = None,
    window: bool = False,
) -> pyvista.Plotter | None:
    """The bodies before (black) and after deformation (coloured by the displacement's length).

    Args:
        us: Displacement of each body.
        filename: Where to save the picture.
        factor: What displacements are drawn times; if not given, the largest is drawn as a tenth
            of the assembly.
        window: Whether to open a window.

    Returns:
        The plotter on rank 0, None on the others.
    """
    us = list(us)
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
            edges = g if dim == 2 else g.extract_surface()
            plotter.add_mesh(edges.extract_all_edges(), color="black", opacity=0.4)
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
    fs: Iterable[fem.Function],
    filename: str | Path | None = None,
    *,
    title: str = "value",
    window: bool = False,
) -> pyvista.Plotter | None:
    """The bodies, coloured by the values of a function; of a vector its length.

    Args:
        fs: Function on each body.
        filename: Where to save the picture.
        title: Title of the scale.
        window: Whether to open a window.

    Returns:
        The plotter on rank 0, None on the others.
    """
    fs = list(fs)
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
        for g in drawn:
            bar = _bar(title)
            _add(plotter, g, scalars="value", cmap="inferno", clim=clim, scalar_bar_args=bar)
    return _finish(plotter, mesh.geometry.dim, filename, window)


def traction(
    tie: Tie,
    traction: fem.Function,
    filename: str | Path | None = None,
    *,
    window: bool = False,
) -> pyvista.Plotter | None:
    """The bodies and the traction on the interface, as arrows.

    Args:
        tie: The tie.
        traction: λ on Σ, from ``tie.traction(problem)``; a vector.
        filename: Where to save the picture.
        window: Whether to open a window.

    Returns:
        The plotter on rank 0, None on the others.
    """
    comm, dim = tie.sigma.comm, tie.sigma.geometry.dim
    plotter = _plotter(comm, window)
    for mesh in {id(V.mesh): V.mesh for V in tie.spaces}.values():
        body = grid(mesh)
        if plotter and body is not None:
            _add(plotter, body, color=_BODY, opacity=0.3 if dim == 3 else 1.0)
    q = tie.quadrature(1)
    parts = comm.gather((q.x[:, 0], q.evaluate(traction)[:, 0]))
    if plotter and parts is not None:
        x, t = (np.vstack([part[i] for part in parts]) for i in (0, 1))
        points = pyvista.PolyData(_padded(x))
        points["traction"] = _padded(t)
        points["length"] = np.linalg.norm(t, axis=1)
        largest = points["length"].max()
        scale = 0.12 * np.ptp(_padded(x), axis=0).max() / (largest or 1)
        arrows = points.glyph(orient="traction", scale="length", factor=scale)
        bar, clim = _bar("traction"), (0, largest)
        plotter.add_mesh(arrows, scalars="length", cmap="plasma", clim=clim, scalar_bar_args=bar)
    return _finish(plotter, dim, filename, window)


def _padded(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows with zeros up to three components."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def _with_values(u: fem.Function, name: str) -> pyvista.UnstructuredGrid | None:
    """A grid with the values of a vector function at its points; on rank 0. Collective."""
    V, comm = u.function_space, u.function_space.mesh.comm
    owned = np.arange(V.mesh.topology.index_map(V.mesh.topology.dim).size_local)
    cells, types, x = vtk_mesh(V, owned)  # type: ignore[arg-type]
    values = np.real(u.x.array).reshape(-1, V.dofmap.index_map_bs)[: len(x)]
    parts = comm.gather((cells, types, x, _padded(values)))
    if parts is None:
        return None
    grids = []
    for cells, types, x, values in parts:
        if len(types):
            grids.append(pyvista.UnstructuredGrid(cells, types, x))
            grids[-1][name] = values
    return pyvista.merge(grids, merge_points=False)


Place = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], float]
"""Where a body is drawn: x ↦ c + s (x − c) + d, as (d, c, s)."""


def _moved(x, shift, centre, scale):
    x = np.asarray(x, dtype=float)
    return centre + scale * (x - centre) + shift


def _pulled_apart(ties: Sequence[Tie], distance: float | None) -> dict[int, Place]:
    """Where each body (by its mesh) is drawn: away from the one that it is tied to."""
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
        step, centre, scale = _separation(tie.surfaces, distance)
        if i0 in places and i1 not in places:
            shift, _, s = places[i0]
            places[i1] = (shift + step, centre, s * scale)
        elif i1 in places and i0 not in places:
            shift, _, s = places[i1]
            places[i0] = (shift - step, centre, s / scale)
    return places


def _separation(surfaces: tuple[Surface, Surface], distance: float | None) -> Place:
    """How Γ1 moves away from Γ0: a translation along the mean normal, or a scaling."""
    surface = surfaces[0]
    x = _padded(surface.x[surface.facets].mean(axis=1))
    normals, size = _padded(surface.normals), surface.size ** (surface.gdim - 1)
    extent = np.ptp(_padded(surface.x), axis=0).max()
    distance = extent / 6 if distance is None else distance
    mean = (size[:, None] * normals).sum(axis=0) / size.sum()
    if np.linalg.norm(mean) > 0.5:
        return distance * mean / np.linalg.norm(mean), np.zeros(3), 1.0
    # Closed around a centre: the outer body grows, or the inner one shrinks
    centre = (size[:, None] * x).sum(axis=0) / size.sum()
    outward = np.sign((size * np.einsum("fi,fi->f", normals, x - centre)).sum())
    return np.zeros(3), centre, 1 + outward * 2 * distance / extent


def _sigma(tie: Tie, places: Sequence[Place]) -> pyvista.UnstructuredGrid | None:
    """Σ between two moved bodies; on rank 0. Collective."""
    domain, mesh = tie.domain, tie.sigma
    points = domain.geometry.points
    weights = np.column_stack((1 - points.sum(axis=1), points))
    alpha = np.zeros(len(mesh.geometry.x))
    num_owned = len(domain.alpha_vertices)
    alpha[geometry_dofmap(mesh)[:num_owned]] = domain.alpha_vertices @ weights.T
    tdim = mesh.topology.dim
    parts = mesh.comm.gather((*vtk_mesh(mesh, tdim, np.arange(num_owned)), alpha))
    if parts is None:
        return None
    grids = []
    for cells, types, x, at in parts:
        if len(types):
            t = at[: len(x), None]
            moved = (1 - t) * _moved(x, *places[0]) + t * _moved(x, *places[1])
            grids.append(pyvista.UnstructuredGrid(cells, types, moved))
            grids[-1]["α"] = at[: len(x)]
    return pyvista.merge(grids, merge_points=False)


def _plotter(comm: MPI.Comm, window: bool) -> pyvista.Plotter | None:
    if comm.rank > 0:
        return None
    if not window:
        display.prepare()
    plotter = pyvista.Plotter(off_screen=not window, window_size=[1200, 900])
    plotter.background_color = pyvista.Color("white")
    return plotter


def _add(plotter: pyvista.Plotter, cells: pyvista.UnstructuredGrid, edges: str = _EDGE, **options):
    """Cells and their edges; the edges of curved cells are no lines of VTK's own triangles."""
    flat = cells.get_cell(0).dimension == 2
    plotter.add_mesh(cells, lighting=not flat, **options)
    lines = cells.extract_all_edges() if flat else cells.extract_surface().extract_all_edges()
    plotter.add_mesh(lines, color=edges, line_width=1.5)


def _bar(title: str) -> Any:
    """A scalar bar beside the picture."""
    return {"title": title, "vertical": True, "fmt": "%.3g", "position_x": 0.87, "height": 0.6,
            "position_y": 0.2, "color": "black"}  # fmt: skip


def _finish(plotter, dim: int, filename, window: bool):
    """Set the camera, save, show."""
    if plotter is None:
        return None
    if dim == 2:
        plotter.view_xy()
        plotter.enable_parallel_projection()
        plotter.camera.zoom(1.1)
    else:
        plotter.camera_position = "iso"
    if filename is not None:
        Path(filename).parent.mkdir(parents=True, exist_ok=True)
        plotter.screenshot(filename)
    if window:
        plotter.show()
    return plotter
