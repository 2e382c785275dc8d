# # What the gap domain Σ is
#
# Copyright (C) 2026 The hypergap_dolfinx developers
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
#
# Two blocks touch each other along a line, Γ0 on one and Γ1 on the other, and their nodes don't
# match. The gap domain Σ is a mesh of its own between them. In space it has no thickness; it has
# one coordinate more, α, which is 0 on Γ0 and 1 on Γ1. Drawn apart by α, it becomes visible.

# +
import argparse
import json
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pyvista
from matplotlib import pyplot as plt

from dolfinx import fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
import meshes
from hypergap_dolfinx import Tie, plot

parser = argparse.ArgumentParser(description="A picture of the gap domain.")
parser.add_argument("--plot", type=Path, metavar="DIR", default="results/gap_domain")
parser.add_argument("--json", type=Path, metavar="FILE")
args = parser.parse_args()
folder = args.plot
comm = MPI.COMM_WORLD
# -

# Two blocks with five and seven cells along the interface, and the tie between them:

lower, lower_tags = meshes.block(comm, (5, 2), lambda x: x * (2, 0.7) - (0, 0.7))
upper, upper_tags = meshes.block(comm, (7, 3), lambda x: x * (2, 0.7))
V = [fem.functionspace(mesh, ("Lagrange", 1)) for mesh in (lower, upper)]
tie = Tie((V[0], lower_tags.find(meshes.TOP)), (V[1], upper_tags.find(meshes.BOTTOM)))

# `tie.sigma` is a DOLFINx mesh like any other: here 12 triangles, one for each edge on Γ0 and Γ1.
# `tie.alpha` is a function on it.

num_triangles = tie.sigma.topology.index_map(2).size_global

# In space Σ is made of tetrahedra: with a facet on Γ0 and a vertex on Γ1, the other way round, or
# with an edge on either.

block, block_tags = meshes.block(comm, (3, 2, 3), lambda x: x - (0, 1, 0), cell="tetrahedron")
other, other_tags = meshes.block(comm, (4, 2, 4), cell="tetrahedron")
W = [fem.functionspace(mesh, ("Lagrange", 1)) for mesh in (block, other)]
solid = Tie((W[0], block_tags.find(meshes.TOP)), (W[1], other_tags.find(meshes.BOTTOM)))
on_gamma1 = solid.domain.alpha_vertices.sum(axis=1).round().astype(int)
kinds = comm.allreduce(np.bincount(on_gamma1, minlength=4)[1:4])
if comm.rank == 0:
    print(f"Σ has {num_triangles} triangles in the plane; in space, tetrahedra with a facet on")
    print(f"Γ0: {kinds[0]}, with an edge on both: {kinds[1]}, with a facet on Γ1: {kinds[2]}")
    if args.json:
        numbers = {"triangles": num_triangles, "tetrahedra": kinds.tolist()}
        args.json.write_text(json.dumps(numbers))

# Drawn as it is, Σ is a line; drawn with Γ1 lifted off Γ0, it fills the gap.

plot.gap_domain([tie], folder / "touching.png", distance=0)
plot.gap_domain([tie], folder / "apart.png", distance=0.5)
if comm.rank == 0:
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.6), constrained_layout=True)
    for ax, name in zip(axes, ("touching", "apart"), strict=True):
        image = plt.imread(folder / f"{name}.png")
        ax.imshow(image if name == "apart" else image[:, :1020])  # no colours, no scale
        ax.set_axis_off()
    axes[0].set_title("in space: the bodies touch, their nodes don't match")
    axes[1].set_title("with α as one more coordinate: Σ fills the gap")
    arrow = {"arrowstyle": "->"}
    axes[0].annotate("Γ0 and Γ1", (700, 452), (740, 60), arrowprops=arrow, fontsize=13)
    for text, xy, at in (
        ("Γ1, α = 1", (700, 345), (880, 60)),
        ("Γ0, α = 0", (700, 555), (880, 860)),
        ("Σ", (330, 450), (20, 455)),
    ):
        axes[1].annotate(text, xy, at, arrowprops=arrow, fontsize=13)
    figure.savefig(folder / "gap_domain.png", dpi=110)

# The tetrahedra, lifted by α, shrunk, and coloured by the number of their vertices on Γ1:

places = comm.gather(solid.domain.x + 0.6 * solid.domain.alpha_vertices[..., None] * (0, 1, 0))
kinds = comm.gather(on_gamma1)
if comm.rank == 0:
    points = np.vstack(places).reshape(-1, 3)
    cells = np.arange(len(points)).reshape(-1, 4)
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
    grid["on Gamma1"] = np.concatenate(kinds)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1100, 800))
    plotter.add_mesh(
        grid.shrink(0.8),
        show_edges=True,
        edge_color="white",
        cmap=["#440154", "#21918c", "#fde725"],
        clim=(0.5, 3.5),
        ambient=0.3,
        annotations={1: "1", 2: "2", 3: "3"},
        scalar_bar_args={"n_labels": 0, "color": "black", "vertical": True},
    )
    plotter.view_vector((1.4, 1, 2.2), viewup=(0, 1, 0))
    plotter.screenshot(folder / "tetrahedra.png")
