# Copyright (C) 2026 The hypergap_dolfinx developers
#
# This file is part of hypergap_dolfinx
#
# SPDX-License-Identifier:    LGPL-3.0-or-later
r"""The gap along the normal of Γ1's facet, times area, and its derivatives. NumPy alone.

From a point :math:`\mathbf x_1(X)` of Γ1 a ray along its facet's normal in the middle,
:math:`\mathbf M`, meets Γ0 in :math:`\mathbf x_0(\xi)`, where Γ0's normal is :math:`\mathbf N_0`.
Then

.. math:: f = \frac{\mathbf N_0\cdot(\mathbf x_0 - \mathbf x_1)\;\mathbf N_1\cdot\mathbf M}
                   {\mathbf N_0\cdot\mathbf M}

is the distance along the ray times the area of Γ1 as seen along it, for each
:math:`dX`. There :math:`\partial f/\partial\xi = 0`: first derivatives don't need to know how the
ray's end moves along Γ0, and second ones need it to first order.
All this is a function of seven vectors, q: :math:`\mathbf r = \mathbf x_0 - \mathbf x_1`, two
tangents of Γ0 and of Γ1 each, and those of Γ1 in the facet's middle.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
import numpy.typing as npt

from hypergap_dolfinx.gap.opposite import LAST, Frames, cross, reference_middle
from hypergap_dolfinx.gap.surface import Surface, tabulate

NEWTON = 10  # steps to where a ray meets a curved facet: round-off after 4


class At(IntEnum):
    """Vectors of q."""

    R, Z1, Z2, T1, T2, C1, C2 = range(7)


def dot(a, b) -> npt.NDArray[np.float64]:
    """Of vectors, ``(num, 3)``."""
    return np.einsum("pi,pi->p", a, b)


@dataclass(frozen=True)
class Rays:
    """Points of Γ1 and what is opposite of them."""

    facets: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    """Of Γ0 and of Γ1, ``(num,)`` each."""
    X: npt.NDArray[np.float64]
    """On Γ1, ``(num, 2)``."""
    xi: npt.NDArray[np.float64]
    """On Γ0, ``(num, 2)``."""
    x: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """Both ends, ``(num, 3)`` each."""
    q: npt.NDArray[np.float64]
    """The seven vectors, ``(num, 7, 3)``."""
    bends: npt.NDArray[np.float64] | None
    """Second derivatives of Γ0 by ξ, ``(num, 3, 3)``: by ξ₁ twice, ξ₁ and ξ₂, ξ₂ twice. None for
    straight triangles."""

    @cached_property
    def normals(self) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """N₀, N₁ and M, ``(num, 3)`` each."""
        q = self.q
        return (
            cross(q[:, At.Z1], q[:, At.Z2]),
            cross(q[:, At.T1], q[:, At.T2]),
            cross(q[:, At.C1], q[:, At.C2]),
        )

    @cached_property
    def products(self) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """N₀ · r, N₁ · M and N₀ · M, ``(num,)`` each: f is s A / B."""
        n0, n1, m = self.normals
        return dot(n0, self.q[:, At.R]), dot(n1, m), dot(n0, m)

    def gradient(self) -> npt.NDArray[np.float64]:
        """∂f/∂q, ``(num, 7, 3)``; nothing by Γ0's tangents, along which r and M are one."""
        (s, a, b), (n0, n1, m), q = self.products, self.normals, self.q
        h, slope = (s / b)[:, None], (a / b)[:, None]
        result = np.zeros_like(q)
        result[:, At.R] = slope * n0
        result[:, At.T1], result[:, At.T2] = h * cross(q[:, At.T2], m), h * cross(m, q[:, At.T1])
        by_m = h * (n1 - slope * n0)
        result[:, At.C1], result[:, At.C2] = cross(q[:, At.C2], by_m), cross(by_m, q[:, At.C1])
        return result

    def towards(self, w) -> npt.NDArray[np.float64]:
        """How the end of a ray that is fixed on Γ0 moves on Γ1 against the ray, ``(num, 7, 3)``.

        Args:
            w: A direction in the plane across M, ``(num, 3)``.

        Returns:
            Derivatives by q of w · (x₀ − x₁ − h M).
        """
        s, _, b = self.products
        h, result = (s / b)[:, None], np.zeros_like(self.q)
        result[:, At.R] = w
        result[:, At.C1], result[:, At.C2] = (
            -h * cross(self.q[:, At.C2], w),
            -h * cross(w, self.q[:, At.C1]),
        )
        return result

    @cached_property
    def feet(self) -> npt.NDArray[np.float64]:
        """How the rays' ends move on Γ0, ∂ξ/∂q, ``(num, 2, 7, 3)``."""
        (_, _, m), (_, _, b) = self.normals, self.products
        dual = cross(self.q[:, At.Z2], m), cross(m, self.q[:, At.Z1])
        # A foot's motion is that against the ray, seen from Γ1: the other sign
        return np.stack([self.towards(-d / b[:, None]) for d in dual], axis=1)

    def some(self, some) -> "Rays":
        """A part of them: numbers, or which."""
        f0, f1 = self.facets
        bends = None if self.bends is None else self.bends[some]
        ends = self.x[0][some], self.x[1][some]
        facets = f0[some], f1[some]
        return Rays(facets, self.X[some], self.xi[some], ends, self.q[some], bends)


def cast(surfaces: tuple[Surface, Surface], frames: Frames, facets, X) -> Rays:
    """Rays from points of Γ1 to the facets of Γ0 that they meet.

    Args:
        surfaces: Γ0 and Γ1 where they are.
        frames: Of Γ1.
        facets: Of both, ``(num,)`` each.
        X: Reference coordinates on Γ1, ``(num, 2)``.
    """
    below, above = surfaces
    f0, f1 = facets
    at1, m = _jets(above, above.nodes[f1], X), frames.normal[f1]
    nodes, x1 = below.nodes[f0], at1[0]
    xi = np.tile(reference_middle(below), (len(X), 1))
    straight = below.geometry.dim == 3
    for _ in range(1 if straight else NEWTON):
        at0 = _jets(below, nodes, xi)
        rest = x1 - at0[0]
        n0 = cross(at0[1], at0[2])
        rest -= (dot(n0, rest) / dot(n0, m))[:, None] * m  # along Γ0's tangents
        square = np.maximum(dot(n0, n0), 1e-300)
        step = dot(cross(at0[2], n0), rest) / square, dot(cross(n0, at0[1]), rest) / square
        xi += np.column_stack(step)
        if np.abs(step).max(initial=0) < LAST:
            break
    at0 = _jets(below, nodes, xi, bends=not straight)
    q = np.stack((at0[0] - x1, *at0[1:3], *at1[1:3], *frames.tangents[f1].swapaxes(0, 1)), axis=1)
    bends = None if straight else at0[3:].swapaxes(0, 1)
    return Rays((f0, f1), X, xi, (at0[0], x1), q, bends)


def _jets(surface: Surface, nodes, X, *, bends=False) -> npt.NDArray[np.float64]:
    """Points of facets, both slopes, and second derivatives; ``(3 or 6, num, 3)``."""
    table, origin = _table(surface, X, 1 + bends), nodes[:, 0]
    steps = nodes[:, 1:] - origin[:, None]
    # Faster than an einsum with so short axes
    found = sum(table[:, :, m + 1, None] * steps[:, m] for m in range(steps.shape[1]))
    found[0] += origin
    return found


def _table(surface: Surface, X, order: int) -> npt.NDArray[np.float64]:
    """Shape functions and derivatives: none, (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)."""
    if not len(X):
        return np.zeros(((order + 1) * (order + 2) // 2, 0, surface.geometry.dim))
    return surface.geometry.tabulate(order, np.ascontiguousarray(X))[..., 0]


def by_dofs(surfaces: tuple[Surface, Surface], rays: Rays) -> npt.NDArray:
    """∂q/∂u at the dofs of Γ0's facet, then those of Γ1's, ``(num, 7, num_dofs)``."""
    above = surfaces[1]
    to_dofs = [tabulate(s.element, s.geometry.points) for s in surfaces]  # (node, dof)
    on0, on1 = (
        _table(s, at, 1) @ table
        for s, at, table in zip(surfaces, (rays.xi, rays.X), to_dofs, strict=True)
    )
    middle = _table(above, reference_middle(above)[None], 1)[1:, 0] @ to_dofs[1]
    num0 = on0.shape[2]
    T = np.zeros((len(rays.X), 7, num0 + on1.shape[2]))
    T[:, At.R, :num0], T[:, At.Z1, :num0], T[:, At.Z2, :num0] = on0
    T[:, At.R, num0:], T[:, At.T1, num0:], T[:, At.T2, num0:] = -on1[0], on1[1], on1[2]
    T[:, At.C1, num0:], T[:, At.C2, num0:] = middle
    return T
