# Copyright (C) 2026 The hypergap_dolfinx developers
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Functions for DOLFINx's file writers.

``VTXWriter`` and ``VTKFile`` accept functions of any degree, continuous or not, all of one element
per file: displacements, and results of :func:`on_sigma` and :func:`interpolated`. ``XDMFFile``
accepts continuous functions of the degree of the mesh, and functions of degree 0: results of
:func:`interpolated` of degree 0, and displacements interpolated into a space of that degree. No
writer accepts functions of mixed spaces: collapse them, ``w.sub(0).collapse()``.
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
    """Discontinuous Lagrange function of an expression, such as a stress. Collective.

    Args:
        expression: UFL expression of any shape.
        mesh: Mesh of the function.
        degree: Degree of the function; 0 for ``XDMFFile``.
        name: Name of the function in files.

    Returns:
        The function. Tensors of shape (2, 2) are padded to (3, 3), since writers misplace the
        components of the former.
    """
    if expression.ufl_shape == (2, 2):
        rows = [[expression[i, j] for j in (0, 1)] + [0] for i in (0, 1)]
        expression = ufl.as_tensor([*rows, [0, 0, 0]])
    element = ("Discontinuous Lagrange", degree, expression.ufl_shape)
    f = fem.Function(fem.functionspace(mesh, element), name=name)
    f.interpolate(fem.Expression(expression, interpolation_points(f.function_space)))
    return f


def on_sigma(tie: Tie, problem: TiedSystem) -> list[fem.Function]:
    """Fields on Σ for one file: α, λ, the normal gap and, for vectors, the slip. Collective.

    Σ has no thickness. In 2D ParaView's "Warp by scalar" with α as the height makes it visible.

    Args:
        tie: One of the problem's ties.
        problem: A solved problem.

    Returns:
        Discontinuous functions on ``tie.sigma`` with one element, for ``VTXWriter`` and
        ``VTKFile``.
    """
    spaces = [u.function_space for u in problem.u]
    bodies = (part.among(spaces) for part in tie.components)
    gap, slip = tie.gap(*(problem.u[i] for i in bodies if i is not None))
    alpha = fem.Function(gap.function_space, name="alpha")
    alpha.interpolate(tie.alpha)
    fields = [alpha, tie.traction(problem), gap]
    return fields if slip is None else [*fields, slip]
