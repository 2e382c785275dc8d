# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later

# # Any contacts
#
# Two or three random bodies are pressed on each other and slid: ellipses, rounded boxes, polygons,
# wedges, brackets with inner corners, arches and beams in the plane; ellipsoids, rounded blocks,
# plates and wavy plates in space. Degrees, cells, sizes of facets (1 : 4 to 4 : 1), stiffness
# (1 : 1000 to 1000 : 1), friction (none to .8), small and finite sliding, from apart or touching,
# all free facets given or only those in front: all is random. What comes out is judged here, by the
# displaced meshes and the bodies' own residuals, not by the gaps with which it was solved:
#
# - no body overlaps another one by more than a tenth of a facet, or at a kink by θ more than means
#   of gaps see: half a facet times tan(θ/2), and at most a facet;
# - each body is in equilibrium away from the contacts, and what contact does to them balances;
# - no vertex has a pressure where the bodies are apart;
# - pressures push, and shear stays in Coulomb's cone;
# - no cell is inverted.
#
# Scenes are well posed by construction:
#
# - each body is held on a good part of its boundary, by displacements or by a bed of springs in all
#   of it, so that it needs no contact to stay where it is; springs are stiff enough, and tractions
#   small enough, not to let it tip over a corner on which it stands;
# - materials are convex in strain (linear) or polyconvex up to J = e (neo-Hookean, with ln² J), and
#   no cell is turned over at the start;
# - in the plane no sharp corner starts on a sharp corner, off which bodies can slip to either side;
# - what is prescribed squeezes bodies, taken as rigid, by no more than 30 % of the smaller one's
#   height (of a beam or an arch: of the geometric mean of thickness and length), and brings no part
#   that is held onto another body.
#
# Equilibria may still be unstable or not unique: arches snap, corners slide past corners.
#
#     python demos/any_contacts.py --scenes 100 --seed 1 --json rows.json
#     python demos/any_contacts.py --dim 3 --only 7

# +
import argparse
import json
import logging
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from itertools import permutations
from pathlib import Path

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import ufl
from dolfinx import default_scalar_type, fem

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the meshes beside this folder
from hypergap_dolfinx import Contact, ContactProblem, InterfaceError, SolveError, compat
from meshes import bodies
from meshes.boundary import Boundary, chunks

LIMIT = 200  # Newton steps in a load step
OVERLAP = 0.1, 1.0  # of a facet: where outlines turn by less than 23°, and by more than 127°
TIPPING = 0.08  # way over height by which a traction moves a body on springs: from 1/6 on it tips
APART = 0.1  # of a facet, from the other body to the facets around a vertex with a pressure
BALANCE = 1e-6  # of forces in the bodies
MOMENT = {"finite": 1e-3, "small": np.inf}  # the same, of moments with friction
TOLD = {  # what the log says of it
    "overlap of": "surfaces overlap by",
    "det F": "turn cells over",
    "moment": "friction acts across gaps",
}
UNLOADED = 1e-6  # pressure over the stiffest modulus: what has less has round-off
# -

# ## A part of a scene


# +
class Part:
    """A meshed body with its material and what holds it.

    All that varies is a constant of the form, so that parts with the same cells share kernels.
    """

    def __init__(self, body, h, cell, degree, order):
        """Mesh it, where it was built.

        Args:
            body: As in ``meshes.bodies``.
            h: Cell size.
            cell: Kind of cell.
            degree: Of displacements.
            order: Of the geometry.
        """
        self.body, self.cell, self.degree, self.order = body, cell, degree, order
        self.mesh, self.ends = body.mesh(MPI.COMM_SELF, h, cell, order)
        self.dim = self.mesh.geometry.dim
        self.held = np.empty(0, dtype=np.int32)
        self.motion, self.along, self.load, self.load_along = np.zeros((4, self.dim))
        self.spring = self.start_gap = 0.0
        self.modulus, self.poisson = 1.0, 0.3

    def move(self, turn, shift):
        """Turn and move the mesh; ``turn`` takes places in rows from the right."""
        x = self.mesh.geometry.x
        x[:, : self.dim] = x[:, : self.dim] @ turn + shift
        self.V = fem.functionspace(self.mesh, ("Lagrange", self.degree, (self.dim,)))
        self.boundary = Boundary(self.V)

    def hold(self, up, band):
        """Divide the boundary into what is held and what is free.

        Args:
            up: Direction of the front, a unit vector.
            band: Part of the height at the back that is held, unless it is held at its ends.
        """
        b = self.boundary
        height = b.X @ up
        low, high = height.min(), height.max()
        back = height.max(axis=1) < low + band * (high - low)
        back |= height.max(axis=1) == height.max(axis=1).min()
        if len(self.ends):
            back = np.isin(b.facets, self.ends)
        self.at_back, self.height = back, high - low
        self.given = ~back
        self.front = b.normals @ up > -0.05

    @property
    def give(self):
        """Length of which it may be squeezed by 30 %."""
        slender = (0, 0) in self.body.ends or (0, 1) in self.body.ends
        across = np.ptp(self.boundary.X, axis=(0, 1)).max()
        return np.sqrt(self.body.thickness * across) if slender else self.height

    def form(self, linear):
        """Make the form and the boundary conditions."""
        mesh, V = self.mesh, self.V
        self.u, v = fem.Function(V), ufl.TestFunction(V)
        E, nu = self.modulus, self.poisson
        mu, lame, spring = (
            fem.Constant(mesh, default_scalar_type(value))
            for value in (E / 2 / (1 + nu), E * nu / (1 + nu) / (1 - 2 * nu), self.spring)
        )
        self.traction = fem.Constant(mesh, np.zeros(self.dim, dtype=default_scalar_type))
        self.goal = fem.Constant(mesh, np.zeros(self.dim, dtype=default_scalar_type))
        G, eps = ufl.Identity(self.dim) + ufl.grad(self.u), ufl.sym(ufl.grad(self.u))
        J = ufl.det(G)
        if linear:
            W = mu * ufl.inner(eps, eps) + lame / 2 * ufl.tr(eps) ** 2
        else:
            W = mu / 2 * (ufl.inner(G, G) - self.dim - 2 * ufl.ln(J))
            W += lame / 2 * ufl.ln(J) ** 2  # its force is no number where a cell is turned over
        W += spring / 2 * ufl.inner(self.u, self.u)
        back = np.sort(self.boundary.facets[self.at_back])
        tags = dolfinx.mesh.meshtags(mesh, self.dim - 1, back, np.ones_like(back))
        ds = ufl.Measure("ds", mesh, subdomain_data=tags)(1)
        dx = ufl.dx(metadata={"quadrature_degree": 2 * self.degree})
        self.F = ufl.derivative(W * dx, self.u) - ufl.inner(self.traction, v) * ds
        if self.spring:
            return []
        dofs = fem.locate_dofs_topological(V, self.dim - 1, back)
        self.held = dofs
        return [fem.dirichletbc(self.goal, dofs, V)]

    def set(self, share, slide):
        """Prescribe the share of the motion, or of the traction, and of the slide."""
        if self.spring:
            self.traction.value[:] = share * self.load + slide * self.load_along
        else:
            self.goal.value[:] = share * self.motion + slide * self.along

    @property
    def squeezed(self):
        """The least det F at vertices and nodes: how far the worst cell is from turning over."""
        mesh, points = self.mesh, lattice(self.mesh)
        element, V_element = mesh.ufl_domain().ufl_coordinate_element(), self.V.ufl_element()
        x = mesh.geometry.x[compat.geometry_dofmap(mesh), : self.dim]
        u = self.values[self.V.dofmap.list]
        at = V_element.sub_elements[0].basix_element.points
        places = np.einsum("an,cni->cai", element.sub_elements[0].tabulate(0, at)[0], x) + u
        before = jacobians(element, points, x)
        return float((jacobians(V_element, points, places) / before).min())

    @property
    def values(self):
        """Displacements at the dofs, ``(num_dofs, dim)``."""
        return self.u.x.array.reshape(-1, self.dim)


def turned_over(mesh):
    """Whether det J ≤ 0 at a vertex or node of a cell."""
    points = lattice(mesh)
    x = mesh.geometry.x[compat.geometry_dofmap(mesh), : mesh.geometry.dim]
    det = jacobians(mesh.ufl_domain().ufl_coordinate_element(), points, x)
    scale = np.abs(det).max(axis=1, keepdims=True)
    det *= np.sign(det.mean(axis=1, keepdims=True))
    return bool((det <= 1e-3 * scale).any())


def lattice(mesh):
    """Points of a reference cell: vertices, and the middles between them."""
    kind = mesh.ufl_domain().ufl_coordinate_element().cell_type
    return basix.create_lattice(kind, 2, basix.LatticeType.equispaced, True)


def jacobians(element, points, x):
    """Determinants of the derivatives of places x of an element's nodes, ``(cell, point)``."""
    d = element.sub_elements[0].tabulate(1, points)[1:]
    return np.linalg.det(np.einsum("jpn,cni->cpij", d, x))


# -

# ## Scenes
#
# Each body is lowered onto those that are already placed, along the last coordinate. Then the whole
# scene is rotated at random.


# +
def clearance(upper, lower):
    """Vertical distance of two boundaries, of samples to pieces; infinite if none is above."""
    least = np.inf
    boxes = [(x.min(axis=(0, 1))[:-1], x.max(axis=(0, 1))[:-1]) for _, x in (upper, lower)]
    low, high = np.maximum(boxes[0][0], boxes[1][0]), np.minimum(boxes[0][1], boxes[1][1])
    for (_, points), (other, x), sign in ((upper, lower, 1), (lower, upper, -1)):
        points = points.reshape(-1, points.shape[2])
        points = points[((points[:, :-1] >= low) & (points[:, :-1] <= high)).all(axis=1)]
        pieces = other.pieces(x).x
        near = (pieces.max(axis=1)[:, :-1] >= low) & (pieces.min(axis=1)[:, :-1] <= high)
        pieces = pieces[near.all(axis=1)]
        for part in chunks(np.arange(len(points)), len(pieces)):
            heights = sign * _heights(points[part], pieces)
            # Of what is above or below a point the outermost counts
            outer = np.where(np.isnan(heights), -np.inf, heights).max(axis=1, initial=-np.inf)
            apart = sign * points[part][:, -1] - outer
            least = min(least, apart[np.isfinite(outer)].min(initial=np.inf))
    return least


def _heights(points, pieces):
    """Heights of pieces at points' places below or above; NaN beside them, ``(point, piece)``."""
    a = pieces[:, 0]
    if pieces.shape[2] == 2:
        d = pieces[:, 1] - a
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (points[:, :1] - a[:, 0]) / d[:, 0]
        return np.where((t >= 0) & (t <= 1), a[:, 1] + t * d[:, 1], np.nan)
    e, f = pieces[:, 1] - a, pieces[:, 2] - a
    det = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    rel = points[:, None, :2] - a[:, :2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        s = (rel[..., 0] * f[:, 1] - rel[..., 1] * f[:, 0]) / det
        t = (e[:, 0] * rel[..., 1] - e[:, 1] * rel[..., 0]) / det
        inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    s, t = np.where(inside, s, 0), np.where(inside, t, 0)
    return np.where(inside, a[:, 2] + s * e[:, 2] + t * f[:, 2], np.nan)


def rotation(rng, dim, angle=None):
    """A random one, or in the plane (in space about the last axis) by an angle."""
    if dim == 3 and angle is None:
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        q = q * np.sign(np.diag(r))
        return q * np.sign(np.linalg.det(q))
    angle = rng.uniform(0, 2 * np.pi) if angle is None else angle
    turn = np.eye(dim)
    turn[:2, :2] = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
    return turn


def tilt(rng, dim, front_down, most):
    """A rotation by a small angle about a horizontal axis, after one that puts the front down."""
    turn = np.eye(dim)
    angle = rng.uniform(-most, most) + np.pi * front_down
    i, j = (0, 1) if dim == 2 else (int(rng.integers(2)), 2)
    turn[np.ix_((i, j), (i, j))] = (
        (np.cos(angle), np.sin(angle)),
        (-np.sin(angle), np.cos(angle)),
    )
    return turn if dim == 2 else turn @ rotation(rng, 3, rng.uniform(0, 2 * np.pi))


class Scene:
    """Parts, what is between them, and how they are moved."""

    def __init__(self, seed, dim):
        """Draw scenes until one is well posed."""
        rng = np.random.default_rng((seed, dim))
        for self.draws in range(1, 200):
            if self._draw(rng, dim):
                break
        else:
            raise RuntimeError(f"no well-posed scene with seed {seed}")
        self.seed, self.dim = seed, dim
        self.largest = 0.0
        self._turn(rng)

    def _draw(self, rng, dim):
        """Draw a scene; False if it isn't well posed."""
        self.kind = str(rng.choice(("two", "two", "stack", "side by side")))
        if dim == 3:
            self.kind = str(rng.choice(("two", "two", "two", "stack")))
        self.degree = int(rng.choice((1, 1, 2)))  # with the cells of degree 2 twice as large
        self.linear = bool(rng.random() < 0.2)
        self.sliding = "small" if self.linear and rng.random() < 0.6 else "finite"
        self.friction = None if rng.random() < 0.4 else float(rng.uniform(0.02, 0.8))
        self.facing = bool(rng.random() < 0.35)
        self.by_traction = bool(rng.random() < 0.2)
        num = 2 if self.kind == "two" else 3
        forms = [
            (bodies.PLANE if dim == 2 else bodies.SPACE)[rng.integers(8 if dim == 2 else 4)]
            for _ in range(num)
        ]
        shapes = [
            form(rng, rng.uniform(1.5, 3) if k == 0 else rng.uniform(0.6, 1.5))
            for k, form in enumerate(forms)
        ]
        ratio = np.exp(rng.uniform(-np.log(4), np.log(4), num))
        ratio[0] = 1
        nodes = rng.uniform(100, 400) if dim == 2 else rng.uniform(300, 900)
        volumes = np.array([shape.volume for shape in shapes])
        h = self.degree * ((volumes / ratio**dim).sum() / nodes) ** (1 / dim)
        self.parts = []
        for shape, r in zip(shapes, ratio, strict=True):
            least = 0.15 if dim == 2 else 0.25  # of the size: a body of a few cells
            size = min(h * r, 2 * self.degree * least * shape.volume ** (1 / dim))
            cell = str(rng.choice(shape.cells))
            order = self.degree if shape.curved else int(rng.integers(1, self.degree + 1))
            self.parts.append(Part(shape, size, cell, self.degree, order))
        stiff = 10 ** (rng.uniform(0, 3, num) if num > 2 else rng.uniform(-3, 3) * np.eye(2)[0])
        for part, E in zip(self.parts, stiff / stiff.min(), strict=True):
            part.modulus, part.poisson = float(E), float(rng.uniform(0, 0.4))
        count = sum(part.mesh.geometry.x.shape[0] for part in self.parts)
        if count > (900 if dim == 2 else 1600) or any(turned_over(p.mesh) for p in self.parts):
            return False
        return self._place(rng, dim) and self._load(rng, dim)

    def _place(self, rng, dim):
        """Let the parts down on each other."""
        up = np.eye(dim)[-1]
        self.apart = 0.0 if rng.random() < 0.5 else float(rng.uniform(0.01, 0.15))
        if self.by_traction:
            self.apart = 0.0
        for k, part in enumerate(self.parts):
            on_top = k > 0 and not (self.kind == "stack" and k == 1)
            part.move(tilt(rng, dim, on_top, rng.choice((0.0, 0.3))), np.zeros(dim))
            if self.kind == "stack" and k == 1 and part.body.kind in ("beam", "arch"):
                return False  # on springs it would fold up
            part.hold(-up if on_top else up, rng.uniform(0.1, 0.25))
            if k == 0:
                continue
            low, high = (f(self.parts[0].boundary.X, axis=(0, 1)) for f in (np.min, np.max))
            middle = (part.boundary.X.min(axis=(0, 1)) + part.boundary.X.max(axis=(0, 1))) / 2
            shift = rng.uniform(low + 0.2 * (high - low), high - 0.2 * (high - low)) - middle
            if self.kind == "side by side" and k == 2:
                first = self.parts[1].boundary.X
                side = rng.choice((-1, 1))
                edge = first.max(axis=(0, 1)) if side > 0 else first.min(axis=(0, 1))
                half = np.ptp(part.boundary.X, axis=(0, 1)) / 2
                room = rng.uniform(0.01, 0.2) * part.height
                shift[0] = edge[0] + side * (half[0] + room) - middle[0]
            shift[-1] = 10.0
            below = self.parts[:k] if self.kind == "stack" else self.parts[:1]
            x = part.boundary.X + shift
            drop = min(clearance((part.boundary, x), (b.boundary, b.boundary.X)) for b in below)
            if not np.isfinite(drop):
                return False
            gap = self.apart * min(part.give, self.parts[0].give)
            gap += 2e-3 * part.height * (dim == 3)  # edges of facets cross between samples
            shift[-1] -= drop - gap
            part.move(np.eye(dim), shift)
            part.start_gap = gap
            if dim == 2 and any(self._corner_on_corner(part, other, gap) for other in below):
                return False
        return True

    def _corner_on_corner(self, a, b, gap):
        """Whether sharp corners of two bodies are less than a facet apart but for the gap."""
        x, y = (p.boundary.X[p.boundary.sharp] for p in (a, b))
        if not len(x) or not len(y):
            return False
        reach = gap + max(np.median(a.boundary.size), np.median(b.boundary.size))
        return bool(np.linalg.norm(x[:, None] - y, axis=2).min() < reach)

    def _load(self, rng, dim):
        """Say what is prescribed; False if that asks for too much."""
        give = min(part.give for part in self.parts)
        self.pressed = float(rng.uniform(0.05, 0.3)) * (0.2 if self.linear else 1)
        self.slid = float(rng.uniform(0.05, 0.6)) * (0.1 if self.linear else 1)
        self.steps = int(rng.integers(2, 5)), int(rng.integers(0, 5))
        if not self.steps[1]:
            self.slid = 0.0
        size = min(float(np.median(part.boundary.size)) for part in self.parts)
        least = (0.1 if self.linear else 0.2) * size / give  # else a corner isn't noticed
        self.pressed = min(max(self.pressed, least), 0.3)
        depth = self.pressed * give
        for k, part in enumerate(self.parts):
            way = np.zeros(dim)
            way[: dim - 1] = rng.normal(size=dim - 1)
            way /= np.linalg.norm(way)
            if k:
                part.along = self.slid * give * way
                part.motion[-1] = -depth - part.start_gap
        if self.kind == "stack":  # what lies between is on springs
            self.parts[2].motion[-1] -= self.parts[1].start_gap
            self.parts[1].motion, self.parts[1].along = np.zeros((2, dim))
            self.parts[1].spring = self._spring(rng, self.parts[1])
        last = self.parts[-1]
        if self.by_traction:
            if last.body.ends:
                return False
            last.spring = self._spring(rng, last)
        if not self._within(give):
            return False
        for part in self.parts:
            if part.spring:
                size = part.body.volume / part.boundary.measures[part.at_back].sum()
                most = TIPPING * part.height / max(np.linalg.norm(part.motion), 1e-300)
                part.load, part.load_along = (
                    part.spring * size * min(1, most) * way for way in (part.motion, part.along)
                )
        return True

    def _spring(self, rng, part):
        """Stiffness of the bed of springs over the volume."""
        soft = min(p.modulus for p in self.parts)
        return float(soft * np.exp(rng.uniform(np.log(0.5), np.log(3))) / part.height**2)

    def _within(self, give):
        """Whether rigid bodies would overlap by no more than 30 %, and not where they are held."""
        for slide in (0, 1):
            x = [part.boundary.X + part.motion + slide * part.along for part in self.parts]
            for i, j in permutations(range(len(x)), 2):
                a, b = self.parts[i], self.parts[j]
                pieces = b.boundary.pieces(x[j])
                held = x[i][a.at_back][:, a.boundary.corner_points].reshape(-1, a.dim)
                room = (0.06 if self.linear else 0.15) * give
                if not a.spring and (
                    pieces.contains(held).any() or pieces.nearest(held, room)[0].min() < room
                ):
                    return False
                if self.kind == "side by side" and min(i, j) > 0:
                    points = x[i].reshape(-1, a.dim)
                    within = points[pieces.contains(points)]
                    if pieces.nearest(within)[0].max(initial=0) > 0.2 * min(a.height, b.height):
                        return False
                elif i > j:
                    overlap = -clearance((a.boundary, x[i]), (b.boundary, x[j]))
                    if overlap > 0.3 * give * (1 + 1e-9):
                        return False
        return True

    def _turn(self, rng):
        """Turn all of it, and make forms and contacts' sides."""
        turn = rotation(rng, self.dim)
        for part in self.parts:
            part.move(turn, np.zeros(self.dim))
            part.motion, part.along, part.load, part.load_along = (
                v @ turn for v in (part.motion, part.along, part.load, part.load_along)
            )
        if self.kind == "stack":
            self.parts[1].given[:] = True
        self.bcs = [bc for part in self.parts for bc in part.form(self.linear)]
        pairs = [(0, 1), (0, 2), (1, 2)] if len(self.parts) == 3 else [(0, 1)]
        apart = {"stack": (0, 2), "side by side": (1, 2)}.get(self.kind)
        if self.sliding == "small":  # Σ stays between what was let down on each other
            pairs = [pair for pair in pairs if pair != apart]
        pairs = [pair for pair in pairs if self._may_meet(*pair)]
        self.pairs, self.of_pair, self.contacts = pairs, [], []
        for pair in pairs:
            sides, masks = [], []
            for i in pair:
                part = self.parts[i]
                beside = self.kind == "side by side" and 0 not in pair
                middle = self.kind == "stack" and i == 1
                mask = part.given & (part.front | (not self.facing or beside or middle))
                masks.append(mask)
                sides.append((part.V, part.boundary.facets[mask]))
            self.of_pair.append(masks)
            moduli = tuple(self.parts[i].modulus for i in pair)
            if rng.random() < 0.5:
                sides.reverse()
                moduli = moduli[::-1]
            self.contacts.append(
                (sides, {"stiffness": moduli, "sliding": self.sliding, "friction": self.friction})
            )

    def _may_meet(self, i, j):
        """Whether bodies can come near each other: their boxes do, with room for the motion."""
        a, b = self.parts[i], self.parts[j]
        room = np.linalg.norm(a.motion) + np.linalg.norm(a.along) + np.linalg.norm(b.motion)
        room += np.linalg.norm(b.along) + 0.1 * min(a.height, b.height)
        (low, high), (low1, high1) = (
            (p.boundary.X.min(axis=(0, 1)), p.boundary.X.max(axis=(0, 1))) for p in (a, b)
        )
        return bool((low - room < high1).all() and (low1 - room < high).all())

    @property
    def about(self):
        """What is special about it, for a row."""
        sizes = [np.median(part.boundary.size) for part in self.parts]
        return {
            "seed": self.seed,
            "scene": " on ".join(part.body.kind for part in self.parts[::-1]),
            "kind": self.kind,
            "degree": self.degree,
            "cells": [f"{part.cell} {part.order}" for part in self.parts],
            "dofs": sum(part.u.x.array.size for part in self.parts),
            "sizes": [float(s) for s in sizes],
            "stiffness": [part.modulus for part in self.parts],
            "friction": self.friction or 0.0,
            "sliding": self.sliding,
            "linear": self.linear,
            "by_traction": self.by_traction,
            "facing": self.facing,
            "apart": self.apart,
            "pressed": self.pressed,
            "slid": self.slid,
            "draws": self.draws,
        }


# -

# ## What is checked


# +
def overlaps(scene, x):
    """Largest overlap over the size of facets, and the largest of what no kink accounts for.

    Between facets that are given to a contact. The size is that of the larger facet of both bodies;
    a kink is what both outlines together turn within that distance, as the mean of a gap over a
    facet sees no more of one than of the other.
    """
    worst, excess = 0.0, -OVERLAP[0]
    normals = [part.boundary.normals_at(y) for part, y in zip(scene.parts, x, strict=True)]
    for pair, masks in zip(scene.pairs, scene.of_pair, strict=True):
        for one in (0, 1):
            i, j = pair[one], pair[1 - one]
            a, b = scene.parts[i].boundary, scene.parts[j].boundary
            pieces = b.pieces(x[j])
            facet = np.repeat(np.flatnonzero(masks[one]), x[i].shape[1])
            points = x[i][masks[one]].reshape(-1, scene.dim)
            within = pieces.contains(points)
            points, facet = points[within], facet[within]
            depth, opposite = pieces.nearest(points)
            size = np.maximum(a.size[facet], b.size[opposite])
            for p, d, h, f, g in zip(points, depth, size, facet, opposite, strict=True):
                if not masks[1 - one][g]:
                    continue
                worst = max(worst, float(d / h))
                if d / h - OVERLAP[0] > excess:
                    turn = sum(
                        _turn(p, h, x[k], normals[k], n)
                        for k, n in ((i, normals[i][f]), (j, normals[j][g]))
                    )
                    excess = max(excess, float(d / h - unseen(turn)))
    return worst, excess


def unseen(turn):
    """Overlap, over the size of facets, up to which means of gaps are positive at a kink.

    A kink by θ that is d deep between two vertices has slopes α and θ − α to its sides. Means of
    gaps over h beside it are −d + h/2 tan α and −d + h/2 tan(θ − α): one of them is negative if
    d > h/2 tan(θ/2).
    """
    return float(np.clip(np.tan(min(turn, np.pi) / 2) / 2, *OVERLAP))


def _turn(point, reach, x, normals, normal):
    """Angle by which a boundary turns within reach of a point."""
    near = (np.linalg.norm(x - point, axis=2) <= reach).any(axis=1)
    n = np.vstack((normals[near], normal))
    return float(np.arccos(np.clip((n @ n.T).min(), -1, 1)))


def where_pressed(scene, problem, x):
    """Checks of pressures: distance over facet size, least pressure, excess of the cone."""
    apart, least, cone = 0.0, 0.0, 0.0
    for contact, pair, masks in zip(problem.contacts, scene.pairs, scene.of_pair, strict=True):
        rows = problem.rows(contact)
        state = rows.state
        p = np.where(state.active, state.p, 0)
        if not p.any():
            continue
        stiffest = max(part.modulus for part in scene.parts)
        largest = max(np.abs(p).max(), UNLOADED * stiffest)
        least = min(least, float(p.min() / largest))
        if scene.friction:
            q = np.linalg.norm(np.where(rows.rubs, state.q, 0), axis=0)
            cone = max(cone, float((q - scene.friction * rows.pressed).max() / largest))
        one = next(k for k in (0, 1) if scene.parts[pair[k]].V == contact.spaces[1])
        i, j = pair[one], pair[1 - one]
        a, b = scene.parts[i].boundary, scene.parts[j].boundary
        pieces = b.pieces(x[j])
        facets = np.flatnonzero(masks[one])
        ends = a.X[facets][:, a.corner_points]  # (facet, corner, dim)
        # Pressures may be in the middle of edges, too
        ends = np.concatenate((ends, a.X[facets], ends.mean(axis=1, keepdims=True)), axis=1)
        for v in np.flatnonzero(p > 1e-6 * largest):
            at = np.abs(ends - contact.surfaces[1].x[v]).max(axis=2).min(axis=1)
            around = facets[at < at.min() + 1e-6 * a.size.min()]
            points = x[i][around].reshape(-1, scene.dim)
            distance, opposite = pieces.nearest(points)
            distance[pieces.contains(points)] = 0
            size = np.maximum(np.repeat(a.size[around], x[i].shape[1]), b.size[opposite])
            apart = max(apart, float((distance / size).min()))
    return apart, least, cone


def balance(scene, problem, x):
    """Forces left where there is no contact; sums of forces and moments; against `force`.

    All over forces in the bodies. Where bodies are held forces can't be told from reactions: there
    they are the contacts' own, which must balance the others.
    """
    left, scale = 0.0, 0.0
    totals, forces = [], []
    on_held = [np.zeros(part.values.shape) for part in scene.parts]
    for contact in problem.contacts:
        rows = problem.rows(contact)
        for V, side, force in zip(contact.spaces, rows.sides, rows.contact_forces(), strict=True):
            k = next(k for k, part in enumerate(scene.parts) if part.V == V)
            on_held[k][side.dofs] += force
    for k, part in enumerate(scene.parts):
        b = fem.assemble_vector(problem.F[k]).array.reshape(-1, scene.dim)
        at = part.V.tabulate_dof_coordinates()[:, : scene.dim]
        if scene.sliding == "finite":
            at = at + part.values
        free = np.ones(len(b), dtype=bool)
        if not part.spring:
            free[part.held] = False
        touching = np.zeros(len(b), dtype=bool)
        for pair, masks in zip(scene.pairs, scene.of_pair, strict=True):
            for i, mask in zip(pair, masks, strict=True):
                if i == k:
                    touching[fem.locate_dofs_topological(
                        part.V, scene.dim - 1, part.boundary.facets[mask])] = True  # fmt: skip
        scale += np.linalg.norm(b, axis=1).sum()
        left = max(left, np.linalg.norm(b[free & ~touching], axis=1).max(initial=0))
        f = np.where(free[:, None], b, on_held[k])[touching]
        moment = cross(at[touching], f).sum(axis=0)
        totals.append((f.sum(axis=0), moment))
        forces.append(f.sum(axis=0))
    extent = max(np.abs(part.boundary.X).max() for part in scene.parts)
    stiffest = max(part.modulus for part in scene.parts)
    scale = max(scale, UNLOADED * stiffest * extent ** (scene.dim - 1), scene.largest)
    scene.largest = scale  # its digits are lost when forces fall
    total = np.linalg.norm(sum(f for f, _ in totals))
    moment = np.linalg.norm(sum(m for _, m in totals)) / extent
    for contact, pair in zip(problem.contacts, scene.pairs, strict=True):
        force = contact.force(problem, on=scene.parts[pair[1]].u)
        forces[pair[1]] = forces[pair[1]] - force
        forces[pair[0]] = forces[pair[0]] + force
    against = max(np.linalg.norm(f) for f in forces)
    return [float(value / scale) for value in (left, total, moment, against)]


def cross(a, b):
    """Cross products; of two components a number."""
    return np.cross(a, b) if a.shape[1] == 3 else a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def wrong(row):
    """What is wrong with a load step, in words.

    Moments of shear on both sides differ by the gaps that are left within facets, with small
    sliding by those at the start.
    """
    found = []
    if row["excess"] > 0:
        found.append(f"overlap of {row['overlap']:.2f} facets, by {row['excess']:.2f} unexplained")
    if row["apart"] > APART:
        found.append(f"pressure {row['apart']:.2f} facets apart")
    moment = MOMENT[row["sliding"]] if row["friction"] else BALANCE
    bounds = {"left": BALANCE, "balance": BALANCE, "force": BALANCE, "moment": moment}
    for name, bound in bounds.items():
        if not row[name] <= bound:
            found.append(f"{name} {row[name]:.1e}")
    if row["squeezed"] <= 0:
        found.append(f"det F = {row['squeezed']:.2g}")
    if row["least"] < -1e-8:
        found.append(f"pull of {-row['least']:.1e}")
    if row["cone"] > 1e-6:
        found.append(f"shear beyond the cone by {row['cone']:.1e}")
    return found


# -

# ## Solving


# +
class TooManySteps(Exception):
    """A load step takes more Newton steps than it may."""


class Counted(ContactProblem):
    """A problem with a limit to its Newton steps."""

    count = 0

    def assemble_matrix(self):
        """Assemble, and count."""
        self.count += 1
        if self.count > LIMIT:
            raise TooManySteps(f"more than {LIMIT} Newton steps")
        super().assemble_matrix()


class Told(logging.Handler):
    """What the package warns of, while it is in use."""

    def __init__(self):
        """Nothing yet."""
        super().__init__(logging.WARNING)
        self.lines, self.log = [], logging.getLogger("hypergap_dolfinx")
        self.caught = warnings.catch_warnings()

    def emit(self, record):
        """Keep a line."""
        self.lines.append(record.getMessage())

    def __enter__(self):
        """Listen."""
        self.caught.__enter__()
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *about: self.lines.append(str(message))
        self.log.addHandler(self)
        self.log.propagate = False
        return self

    def __exit__(self, *error):
        """Listen no longer."""
        self.log.removeHandler(self)
        self.log.propagate = True
        self.caught.__exit__(*error)


def solve(scene, row, spoil=None):
    """Solve a scene load step by load step, and check each; into its row."""
    contacts = [Contact.between(*sides, **options) for sides, options in scene.contacts]
    parts = scene.parts
    problem = Counted(
        [part.F for part in parts], [part.u for part in parts], bcs=scene.bcs, contacts=contacts
    )
    press, along = scene.steps
    path = [((k + 1) / press, 0.0) for k in range(press)]
    path += [(1.0, (k + 1) / along) for k in range(along)]
    for k, (share, slide) in enumerate(path):
        for part in parts:
            part.set(share, slide)
        problem.count = 0
        problem.solve()
        if spoil:
            spoil(scene, problem)
        row["steps"].append(checked(scene, problem))
        row["wrong"] += [f"step {k + 1}: {what}" for what in wrong(row["steps"][-1])]


def run(seed, dim, spoil=None):
    """Solve a scene, and tell what came of it.

    Args:
        seed: Tells which.
        dim: Of space.
        spoil: Changes a solved scene, to see the checks fail.
    """
    start = time.perf_counter()
    scene = Scene(seed, dim)
    row = {**scene.about, "steps": [], "error": "", "wrong": [], "status": "solved"}
    made = time.perf_counter()
    try:
        with Told() as told:
            solve(scene, row, spoil)
    except (SolveError, TooManySteps) as error:
        row["status"], row["error"] = "failed", str(error)
    except InterfaceError as error:
        row["status"], row["error"] = "refused", str(error)
    except Exception as error:  # a sweep goes on
        where = traceback.extract_tb(error.__traceback__)[-1]
        row["status"] = "crashed"
        row["error"] = f"{type(error).__name__}: {error} ({where.name}, line {where.lineno})"
    if row["wrong"] and row["status"] == "solved":
        known = [wrong for wrong, line in TOLD.items() if line in " ".join(told.lines)]
        every = all(any(what in line for what in known) for line in row["wrong"])
        row["status"] = "told" if every else "wrong"
    row["ok"] = row["status"] == "solved"
    row["planned"] = sum(scene.steps)
    row["told"] = told.lines
    row["seconds"] = [made - start, time.perf_counter() - made]
    return row


def checked(scene, problem):
    """All checks of a load step."""
    x = [part.boundary.at(part.values) for part in scene.parts]
    overlap, excess = overlaps(scene, x)
    apart, least, cone = where_pressed(scene, problem, x)
    left, total, moment, force = balance(scene, problem, x)
    active = sum(int(contact.active.sum()) for contact in problem.contacts)
    return {
        "friction": scene.friction or 0.0,
        "sliding": scene.sliding,
        "newton": problem.iterations,
        "halvings": problem.halvings,
        "active": active,
        "squeezed": min(part.squeezed for part in scene.parts),
        "overlap": overlap,
        "excess": excess,
        "apart": apart,
        "least": least,
        "cone": cone,
        "left": left,
        "balance": total,
        "moment": moment,
        "force": force,
    }


def failed(row):
    """A line on a scene that isn't solved, or wrong."""
    at = f"step {len(row['steps']) + 1} of {row['planned']}: " if row["error"] else ""
    if row["error"] and row["steps"] and row["steps"][-1]["squeezed"] < 0.1:
        at += f"(det F {row['steps'][-1]['squeezed']:.2g}) "
    said = "; ".join(([at + row["error"]] if row["error"] else []) + row["wrong"][:2])
    return (
        f"{row['seed']:5} {row['status']:8} {row['scene']} (degree {row['degree']}, "
        f"μ {row['friction']:.2f}, {row['sliding']}): {said[:230]}"
    )


def summary(rows):
    """A table."""
    kinds = Counter(kind for row in rows for kind in set(row["scene"].split(" on ")))
    solved = Counter(kind for row in rows if row["ok"] for kind in set(row["scene"].split(" on ")))
    print()
    for kind, number in sorted(kinds.items()):
        print(f"with {kind:15} {solved[kind]:4} of {number}")
    for name, of in (
        *((f"degree {d}", lambda r, d=d: r["degree"] == d) for d in (1, 2)),
        *((f"{s} sliding", lambda r, s=s: r["sliding"] == s) for s in ("small", "finite")),
        ("no friction", lambda r: not r["friction"]),
        ("friction", lambda r: r["friction"] > 0),
        ("three bodies", lambda r: r["kind"] != "two"),
        ("by traction", lambda r: r["by_traction"]),
        ("all", lambda r: True),
    ):
        those = [row for row in rows if of(row)]
        print(f"{name:20} {sum(row['ok'] for row in those):4} of {len(those)}")
    status = Counter(row["status"] for row in rows)
    print(", ".join(f"{number} {name}" for name, number in status.items()))
    apart = sum(row["ok"] and not any(step["active"] for step in row["steps"]) for row in rows)
    print(f"no contact at all in {apart} of those solved")
    steps = [step for row in rows for step in row["steps"]]
    if steps:
        newton = [step["newton"] for step in steps]
        print(
            f"{len(steps)} load steps: Newton steps {np.median(newton):.0f} (median), "
            f"{np.percentile(newton, 99):.0f} (99 %), {max(newton)} (most); "
            f"{sum(step['halvings'] for step in steps)} halvings in "
            f"{sum(step['halvings'] > 0 for step in steps)} load steps"
        )
        for name in ("overlap", "excess", "apart", "left", "balance", "moment", "force"):
            values = [step[name] for step in steps if step[name] is not None]
            if values:
                print(f"{name:20} {np.percentile(values, 99):.1e} (99 %), {max(values):.1e} (most)")
    print(f"{sum(sum(row['seconds']) for row in rows):.0f} s, "
          f"{sum(row['seconds'][0] for row in rows):.0f} of them for scenes")  # fmt: skip


def in_processes(seeds, dim, jobs):
    """Rows of scenes, solved in several processes; one that dies costs its scene."""
    with tempfile.TemporaryDirectory() as folder:
        running, rows = [], {}
        left = [list(seeds[k::jobs]) for k in range(jobs)]

        def begin(k):
            file = Path(folder) / f"{k}.json"
            command = [sys.executable, __file__, "--dim", str(dim), "--lines", str(file)]
            return file, subprocess.Popen([*command, "--only", *map(str, left[k])])

        running = [begin(k) if left[k] else None for k in range(jobs)]
        while any(running):
            for k, job in enumerate(running):
                if job is None:
                    continue
                try:
                    status = job[1].wait(timeout=1)
                except subprocess.TimeoutExpired:
                    continue
                lines = job[0].read_text().splitlines() if job[0].exists() else []
                for line in lines:
                    row = json.loads(line)
                    rows[row["seed"]] = row
                left[k] = [seed for seed in left[k] if seed not in rows]
                job[0].unlink(missing_ok=True)
                if left[k]:
                    seed = left[k].pop(0)
                    error = f"the process died ({status})"
                    rows[seed] = dead(seed, error)
                    print(failed(rows[seed]), flush=True)
                running[k] = begin(k) if left[k] else None
    return [rows[seed] for seed in seeds]


def dead(seed, error):
    """The row of a scene whose process died."""
    return {
        "seed": seed, "status": "crashed", "ok": False, "error": error, "scene": "?", "kind": "?",
        "degree": 0, "friction": 0.0, "sliding": "?", "by_traction": False, "steps": [],
        "wrong": [], "told": [], "planned": 0, "seconds": [0, 0],
    }  # fmt: skip


def main():
    """Solve scenes, and say what came of them."""
    parser = argparse.ArgumentParser(description="Random bodies are pressed and slid.")
    parser.add_argument("--dim", type=int, choices=(2, 3), default=2)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    parser.add_argument("--only", type=int, nargs="+", help="these scenes")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--lines", type=Path, help=argparse.SUPPRESS)  # rows, one by one
    args = parser.parse_args()
    seeds = args.only or list(range(args.seed, args.seed + args.scenes))
    if args.jobs > 1:
        rows = in_processes(seeds, args.dim, args.jobs)
    else:
        rows = []
        for seed in seeds:
            rows.append(run(seed, args.dim))
            if not rows[-1]["ok"]:
                print(failed(rows[-1]), flush=True)
            if args.lines:
                with open(args.lines, "a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    if not args.lines:
        summary(rows)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__" and MPI.COMM_WORLD.rank == 0:
    main()
