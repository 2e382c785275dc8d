# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions in the form that DOLFINx's writers take: one Lagrange element for all in a file.

``VTXWriter`` and ``VTKFile`` take functions of any degree, continuous or not, one element a file:
those of :func:`on_sigma`, those of :func:`interpolated`, and displacements. ``XDMFFile`` takes only
continuous functions of the mesh's own degree and constants on cells: those of :func:`interpolated`
of degree 0, and displacements of a higher degree after ``w.interpolate(u)`` into a space of the
mesh's degree; none of :func:`on_sigma`. No writer takes functions on mixed spaces: give them
``w.sub(0).collapse()``.
"""

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from hypergap_dolfinx.core.compat import interpolation_points
from hypergap_dolfinx.solvers.system import TiedSystem
from hypergap_dolfinx.tie import Tie


def interpolated(
    expression: ufl.core.expr.Expr, mesh: Mesh, degree: int, name: str
) -> fem.Function:
    """A discontinuous function with an expression's values, a stress for example. Collective.

    Args:
        expression: UFL expression of any shape.
        mesh: Mesh of the function.
        degree: Degree of the function; 0 for ``XDMFFile``.
        name: Name of the function in files.

    Returns:
        The function. Plane tensors become 3 × 3: writers scramble 2 × 2, as (xx, xy, yx; yy, …).
    """
    if expression.ufl_shape == (2, 2):
        rows = [[expression[i, j] for j in (0, 1)] + [0] for i in (0, 1)]
        expression = ufl.as_tensor([*rows, [0, 0, 0]])
    element = ("Discontinuous Lagrange", degree, expression.ufl_shape)
    f = fem.Function(fem.functionspace(mesh, element), name=name)
    f.interpolate(fem.Expression(expression, interpolation_points(f.function_space)))
    return f


def on_sigma(tie: Tie, problem: TiedSystem) -> list[fem.Function]:
    """Fields on Σ for one file: α, λ, the normal gap and, of vectors, the slip. Collective.

    Σ has no thickness; in 2D ParaView's "Warp by scalar" shows it, with α as the height.

    Args:
        tie: One of the problem's ties.
        problem: A solved problem.

    Returns:
        Functions on ``tie.sigma`` with one element, discontinuous: for ``VTXWriter`` and
        ``VTKFile``.
    """
    spaces = [u.function_space for u in problem.u]
    bodies = (part.among(spaces) for part in tie.components)
    gap, slip = tie.gap(*(problem.u[i] for i in bodies if i is not None))
    alpha = fem.Function(gap.function_space, name="alpha")
    alpha.interpolate(tie.alpha)
    fields = [alpha, tie.traction(problem), gap]
    return fields if slip is None else [*fields, slip]
